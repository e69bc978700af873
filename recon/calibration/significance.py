"""How sure it is that several numbers are not all nought, said as one number of standard deviations.

From the functions of SciPy themselves: its distributions take half a second to load.
"""

import numpy as np
from jaxtyping import Float64
from scipy.special import chdtrc, ndtri

SMALLEST_CHANCE = 1e-300  # below it the normal distribution's inverse is infinite; 37 sigma will do


def equivalent_sigma(
    values: Float64[np.ndarray, " numbers"], covariance: Float64[np.ndarray, "numbers numbers"]
) -> float:
    """Return the sigma at which one normal number is as unlikely as these together (χ² with as many degrees of freedom).

    Examples
    --------
    One number of three standard deviations:

    >>> import numpy as np
    >>> round(equivalent_sigma(np.array([3.0]), np.eye(1)), 6)
    3.0
    """
    chi_square = float(values @ np.linalg.solve(covariance, values))
    chance = max(float(chdtrc(len(values), chi_square)), SMALLEST_CHANCE)
    return float(-ndtri(chance / 2))
