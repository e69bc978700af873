"""From drive levels to photo values: the gamma of display and camera together, black level, clipping, and a table.

A display's light follows its level about as ``black + span · (level / 255) ** gamma`` (IEC 61966-2-1 takes 2.2 for its
approximate form). A camera that writes JPEG files bends the curve once more; what is measured is what the decoder meets, both.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression, least_squares

Levels = Float64[np.ndarray, " levels"]

# More clipped pixels than this, and the mean of the photo no longer follows the light.
LARGEST_CLIPPED_SHARE = 0.005
# Levels that are needed to tell black, span and gamma apart, and to see that they fit.
FEWEST_LEVELS = 5
# Rounding to whole counts, averaged over a hundred pixels and more.
LEAST_SD = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class LevelResponse:
    """How photo values follow drive levels; values are counts, ``full_scale`` at most.

    ``monotone`` is the nearest sequence to ``value`` that never falls, ``residual_rms`` how far the measured values are from it
    and ``model_rms`` how far from the gamma curve. ``clipped_from`` is the lowest level at which the photo clips.
    """

    level: Levels
    value: Levels
    value_sd: Levels
    monotone: Levels
    full_scale: float
    gamma: float
    gamma_sd: float
    black: float
    black_sd: float
    white: float
    white_sd: float
    residual_rms: float
    model_rms: float
    clipped_from: float | None

    def light_table(self) -> Float64[np.ndarray, " 256"]:
        """Return the relative value, 0 at black and 1 at white, of each drive level: monotone cubic between those measured."""
        span = self.monotone[-1] - self.monotone[0]
        curve = PchipInterpolator(self.level, (self.monotone - self.monotone[0]) / span)
        return np.clip(curve(np.clip(np.arange(256.0), self.level[0], self.level[-1])), 0.0, 1.0)

    def curve(self, level: Levels) -> Levels:
        """Return the gamma curve at these levels, in counts."""
        return self.black + (self.white - self.black) * (level / 255) ** self.gamma


def drive_levels(counts: Float64[np.ndarray, "..."], *, level: Levels, value: Levels) -> Float64[np.ndarray, "..."]:
    """Return the drive level whose photo value each count is: the response undone, so that counts follow the pattern again.

    ``value`` are the measured counts of the drive levels ``level``, both rising; linear between them, held beyond them.
    """
    rising = np.maximum.accumulate(value)
    return np.interp(counts, rising, level)


def fit_levels(
    levels: Float64[np.ndarray, " photos"],
    values: Float64[np.ndarray, " photos"],
    clipped: Float64[np.ndarray, " photos"],
    *,
    full_scale: float,
) -> LevelResponse:
    """Return how photo values follow levels.

    Parameters
    ----------
    levels, values, clipped:
        For each photo the level that filled the display, the mean count of its :func:`lit_region`, and the share of it that is
        clipped. A level may come several times: their scatter is the standard deviation of a photo.
    full_scale:
        The largest count, 255 or 65,535.

    Raises
    ------
    ValueError
        For fewer than five levels that do not clip.

    Notes
    -----
    Weighted least squares of black, white and gamma. Where the curve misses by more than the photos' scatter, the standard
    deviations grow by the square root of χ² per degree of freedom.
    """
    level, group = np.unique(levels, return_inverse=True)
    count = np.bincount(group)
    value = np.bincount(group, weights=values) / count
    share = np.array([clipped[group == place].max() for place in range(level.size)])
    spread = float(np.sum((values - value[group]) ** 2)) / max(1, levels.size - level.size)
    value_sd = np.maximum(np.sqrt(spread), LEAST_SD) / np.sqrt(count)
    clips = share > LARGEST_CLIPPED_SHARE
    if np.count_nonzero(~clips) < FEWEST_LEVELS:
        raise ValueError(f"{np.count_nonzero(~clips)} levels do not clip, {FEWEST_LEVELS} are needed")
    monotone = isotonic_regression(value, weights=1 / value_sd**2).x
    used = ~clips
    (black, white, gamma), sd = _fitted_curve(level[used], value[used], value_sd[used])
    model = black + (white - black) * (level / 255) ** gamma
    return LevelResponse(
        level=level,
        value=value,
        value_sd=value_sd,
        monotone=np.asarray(monotone, dtype=np.float64),
        full_scale=full_scale,
        gamma=gamma,
        gamma_sd=float(sd[2]),
        black=black,
        black_sd=float(sd[0]),
        white=white,
        white_sd=float(sd[1]),
        residual_rms=float(np.sqrt(np.mean((value - monotone) ** 2))),
        model_rms=float(np.sqrt(np.mean((value - model)[used] ** 2))),
        clipped_from=float(level[clips][0]) if clips.any() else None,
    )


def _fitted_curve(level: Levels, value: Levels, sd: Levels) -> tuple[tuple[float, float, float], np.ndarray]:
    """Return black, white and gamma, and their standard deviations."""

    def misses(parameters: np.ndarray) -> np.ndarray:
        black, white, gamma = parameters
        return (black + (white - black) * (level / 255) ** gamma - value) / sd

    start = np.array([value[0], value[-1], 2.2])
    fit = least_squares(misses, start, bounds=([-np.inf, -np.inf, 0.05], [np.inf, np.inf, 20.0]), x_scale="jac")
    freedom = max(1, level.size - 3)
    excess = max(1.0, 2 * float(fit.cost) / freedom)
    jacobian = np.asarray(fit.jac)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * excess
    black, white, gamma = (float(each) for each in fit.x)
    return (black, white, gamma), np.sqrt(np.diag(covariance))


def level_warnings(response: LevelResponse) -> tuple[str, ...]:
    """Return what a person should do about the response, one sentence each; nothing where it is good."""
    warnings = []
    span = response.white - response.black
    if response.clipped_from is not None:
        warnings.append(
            f"Photos clip from level {response.clipped_from:.0f} of 255 up: shorten the exposure or close the aperture until "
            "white stays below the top of the range."
        )
    elif response.white < 0.4 * response.full_scale:
        warnings.append(
            f"White reaches only {100 * response.white / response.full_scale:.0f} % of the range: expose longer, or turn the "
            "display's brightness up."
        )
    if response.black > 0.15 * response.full_scale:
        warnings.append(
            f"Black is at {100 * response.black / response.full_scale:.0f} % of the range: darken the room, or switch off the "
            "display's automatic contrast."
        )
    largest_fall = float(np.max(response.monotone - response.value))
    if largest_fall > max(0.02 * span, 4 * float(response.value_sd.max())):
        warnings.append(
            "A higher level gave a darker photo: switch off the display's dynamic contrast and the camera's automatic exposure, "
            "then measure again."
        )
    if response.gamma < 0.5 or response.gamma > 3.5:
        warnings.append(
            f"A gamma of {response.gamma:.2f} is unlike any display: set picture mode and tone curve to neutral."
        )
    return tuple(warnings)
