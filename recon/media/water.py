"""Pure water: density and refractive index by temperature and wavelength, at normal pressure.

Index: IAPWS R9-97, "Release on the Refractive Index of Ordinary Water Substance as a Function of Wavelength, Temperature and
Pressure" (1997), against vacuum. Density: Tanaka et al., Metrologia 38 (2001) 301, of the CIPM, at 101,325 Pa, 0 to 40 °C.
"""

import numpy as np

from recon.errors import ReconError

KELVIN_AT_0_C = 273.15
# The middle of each primary of a display; white is judged by its green.
PRIMARY_NM = {"red": 620.0, "green": 530.0, "blue": 465.0, "white": 530.0}
LIQUID_C = (0.0, 40.0)
VISIBLE_NM = (200.0, 1100.0)

REFERENCE_NM, REFERENCE_KG_PER_M3 = 589.0, 1000.0
ULTRAVIOLET, INFRARED = 0.2292020, 5.432937
A = (
    0.244257733,
    9.74634476e-3,
    -3.73234996e-3,
    2.68678472e-4,
    1.58920570e-3,
    2.45934259e-3,
    0.900704920,
    -1.66626219e-2,
)


def water_density_kg_per_m3(temperature_c: float) -> float:
    """Return the density of air-free water at normal pressure.

    Examples
    --------
    >>> round(water_density_kg_per_m3(20.0), 4)
    998.2067
    """
    above = temperature_c - 3.983035
    return 999.974950 * (1 - above**2 * (temperature_c + 301.797) / (522528.9 * (temperature_c + 69.34881)))


def refractive_index(*, density_kg_per_m3: float, temperature_k: float, wavelength_nm: float) -> float:
    """Return the index of water against vacuum, Eq. 1 of IAPWS R9-97; valid from 200 to 1,100 nm."""
    density = density_kg_per_m3 / REFERENCE_KG_PER_M3
    warmth = temperature_k / KELVIN_AT_0_C
    square = (wavelength_nm / REFERENCE_NM) ** 2
    refraction = density * (
        A[0]
        + A[1] * density
        + A[2] * warmth
        + A[3] * square * warmth
        + A[4] / square
        + A[5] / (square - ULTRAVIOLET**2)
        + A[6] / (square - INFRARED**2)
        + A[7] * density**2
    )
    return float(np.sqrt((1 + 2 * refraction) / (1 - refraction)))


def water_index(temperature_c: float, *, wavelength_nm: float) -> float:
    """Return the index of water in an open tank, against vacuum.

    Raises
    ------
    ReconError
        Outside 0 to 40 °C or 200 to 1,100 nm.

    Examples
    --------
    >>> [round(water_index(20.0, wavelength_nm=nm), 4) for nm in (465.0, 530.0, 620.0)]
    [1.3387, 1.3355, 1.3325]
    """
    if not LIQUID_C[0] <= temperature_c <= LIQUID_C[1]:
        raise ReconError(
            f"water at {temperature_c:g} °C: its index is known from 0 to 40 °C; give the index itself (liquid.n)"
        )
    if not VISIBLE_NM[0] <= wavelength_nm <= VISIBLE_NM[1]:
        raise ReconError(f"water at {wavelength_nm:g} nm: its index is known from 200 to 1100 nm; give it (liquid.n)")
    return refractive_index(
        density_kg_per_m3=water_density_kg_per_m3(temperature_c),
        temperature_k=temperature_c + KELVIN_AT_0_C,
        wavelength_nm=wavelength_nm,
    )
