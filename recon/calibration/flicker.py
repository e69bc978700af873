"""Flicker of the display: how much the brightness of photos swings at each shutter time, and its frequency.

A brightness of 1 + d · sin(2πft) leaves the mean over an exposure time T swinging by d · |sin(πfT) / (πfT)|. Swings at several
shutter times therefore give f and d without knowing to a millisecond when a photo was taken, and whatever the shutter: a rolling
one shows the swing in bands within each photo, a global one from photo to photo. Where the sensor's readout time is known, the
bands give the frequency a second time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

Rows = Float64[np.ndarray, "photos rows"]
Shutters = Float64[np.ndarray, " shutters"]

LOWEST_HZ, HIGHEST_HZ = 30.0, 2000.0
# A sine sampled at n unrelated moments: the sd of its root mean square, times the square root of n, as a share of it (√(1/8)).
SAMPLING_SD = 0.36
FEWEST_SHUTTERS = 4
# A swing below this share of the light is nothing to a stripe's place, and below what JPEG files show.
LEAST_SWING = 0.002
SIGNIFICANCE = 4.0
# Shutter times that cameras offer, in thirds of a stop.
USUAL_DIVISORS = (500, 400, 320, 250, 200, 160, 125, 100, 80, 60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3, 2, 1)
USUAL_TIMES = tuple(Fraction(1, divisor) for divisor in USUAL_DIVISORS)


@dataclass(frozen=True, slots=True)
class Swing:
    """How much photos of one shutter time swing about their mean: an amplitude, as a share of the light."""

    exposure_s: float
    swing: float
    sd: float


@dataclass(frozen=True, slots=True)
class Bands:
    """Bands across a photo, as a rolling shutter draws them: how many from first to last row, and how strong."""

    per_photo: float
    per_photo_sd: float
    swing: float


@dataclass(frozen=True, slots=True)
class Flicker:
    """The flicker that explains the swings; ``found`` is False where they are no more than noise."""

    frequency_hz: float
    frequency_sd_hz: float
    depth: float
    depth_sd: float
    found: bool

    def swing_at(self, exposure_s: float) -> float:
        """Return the largest swing left at this exposure time, within two standard deviations of the frequency."""
        if not self.found:
            return 0.0
        near = self.frequency_hz + self.frequency_sd_hz * np.linspace(-2, 2, 41)
        return float(self.depth * np.abs(np.sinc(near * exposure_s)).max())


def swing_of(rows: Rows, *, exposure_s: float) -> Swing:
    """Return the swing in photos of one steady frame, taken at unrelated moments.

    Parameters
    ----------
    rows:
        Mean value of each row of each photo, NaN where a row does not see the display; differences between rows that all photos
        have are taken out.

    Notes
    -----
    The variance over photos and rows, less that of noise, is half of the squared amplitude. Noise of a row is told from its
    second differences down the photo, which a band many rows wide hardly has.
    """
    kept = rows[:, np.isfinite(rows).all(axis=0)]
    photos = kept.shape[0]
    if photos < 2 or kept.shape[1] < 8:
        raise ValueError("two photos or more are needed, in which eight rows or more see the display")
    relative = kept / kept.mean(axis=0) - 1
    noise = float(np.mean(np.diff(relative, n=2, axis=1) ** 2)) / 6
    variance = float(np.mean(relative**2)) * photos / (photos - 1)
    between = relative.mean(axis=1)
    bands = variance - float(np.mean(between**2)) * photos / (photos - 1) - noise
    squared = max(0.0, 2 * (variance - noise))
    # Bands are the swing seen whole in each photo; what differs from photo to photo is sampled.
    sampled = 1.0 if squared == 0 else float(np.clip(1 - 2 * max(0.0, bands) / squared, 0.1, 1.0))
    swing = float(np.sqrt(squared))
    of_noise = np.sqrt(2 * noise / kept.size) + LEAST_SWING / 4
    return Swing(exposure_s, swing, float(np.hypot(SAMPLING_SD * sampled * swing / np.sqrt(photos), of_noise)))


def bands_of(rows: Rows) -> Bands | None:
    """Return the bands of two photos or more, taken at unrelated moments; None where no more than noise runs down them."""
    finite = np.isfinite(rows).all(axis=0)
    kept = rows[:, finite]
    place = np.flatnonzero(finite) / rows.shape[1]
    relative = kept / kept.mean(axis=0) - 1
    relative -= relative.mean(axis=1, keepdims=True)
    cycles = np.arange(0.75, min(kept.shape[1] / 4, 200.0), 0.05)
    power = np.array([_power_at(each, place, relative) for each in cycles])
    best = int(np.argmax(power))
    noise = float(np.mean(np.diff(relative, n=2, axis=1) ** 2)) / 6
    samples = kept.shape[1]
    if power[best] < SIGNIFICANCE**2 * 2 * noise / samples + LEAST_SWING**2:
        return None
    finer = np.linspace(cycles[best] - 0.05, cycles[best] + 0.05, 201)
    fine = np.array([_power_at(each, place, relative) for each in finer])
    # The mean over the photos, which was taken out, held its share of the wave.
    swing = float(np.sqrt(fine.max() * kept.shape[0] / (kept.shape[0] - 1)))
    # Cramér–Rao bound for the frequency of a sine in white noise (Rife and Boorstyn 1974), for all photos together.
    left = max(float(np.var(relative)) - swing**2 / 2, noise)
    sd = np.sqrt(6 * left / (np.pi**2 * swing**2 * samples * kept.shape[0])) / (place[-1] - place[0])
    return Bands(float(finer[int(np.argmax(fine))]), float(sd), swing)


def _power_at(cycles: float, place: np.ndarray, relative: np.ndarray) -> float:
    """Return the squared amplitude of a wave with so many cycles a photo, each photo with its own phase, averaged."""
    wave = np.column_stack([np.cos(2 * np.pi * cycles * place), np.sin(2 * np.pi * cycles * place)])
    wave -= wave.mean(axis=0)
    found, *_ = np.linalg.lstsq(wave, relative.T, rcond=None)
    return float(np.mean(np.sum(found**2, axis=0)))


def fit_flicker(swings: Sequence[Swing]) -> Flicker:
    """Return the frequency and depth of a sine that explain the swings.

    Raises
    ------
    ValueError
        For fewer than four shutter times.
    """
    if len({swing.exposure_s for swing in swings}) < FEWEST_SHUTTERS:
        raise ValueError(f"{FEWEST_SHUTTERS} shutter times or more are needed to tell a frequency")
    exposure_s = np.array([swing.exposure_s for swing in swings])
    seen = np.array([swing.swing for swing in swings])
    sd = np.array([swing.sd for swing in swings])
    if seen.max() < LEAST_SWING or float((seen / sd).max()) < SIGNIFICANCE:
        return Flicker(float("nan"), float("nan"), 0.0, float(np.median(sd)), found=False)

    def misses(parameters: np.ndarray) -> np.ndarray:
        frequency_hz, depth = parameters
        return (depth * np.abs(np.sinc(frequency_hz * exposure_s)) - seen) / sd

    def cost(frequency_hz: float) -> tuple[float, float]:
        shape = np.abs(np.sinc(frequency_hz * exposure_s)) / sd
        depth = float(np.clip(shape @ (seen / sd) / max(shape @ shape, 1e-30), 0, 1))
        return float(np.sum((depth * shape - seen / sd) ** 2)), depth

    highest = min(HIGHEST_HZ, 2 / exposure_s.min())
    tried = np.geomspace(LOWEST_HZ, highest, 4000)
    start_hz = min(tried, key=lambda each: cost(float(each))[0])
    fit = least_squares(
        misses, [start_hz, cost(float(start_hz))[1]], bounds=([LOWEST_HZ, 0], [HIGHEST_HZ, 1]), x_scale=[10.0, 0.01]
    )
    excess = max(1.0, 2 * float(fit.cost) / max(1, len(swings) - 2))
    jacobian = np.asarray(fit.jac)
    frequency_sd_hz, depth_sd = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian) * excess))
    return Flicker(float(fit.x[0]), float(frequency_sd_hz), float(fit.x[1]), float(depth_sd), found=True)


def safe_times(flicker: Flicker, *, largest_swing: float) -> tuple[Fraction, ...]:
    """Return the usual shutter times at which no more than ``largest_swing`` of the flicker is left."""
    return tuple(each for each in USUAL_TIMES if flicker.swing_at(float(each)) <= largest_swing)


def flicker_warnings(flicker: Flicker, *, exposure_s: float, largest_swing: float = 0.005) -> tuple[str, ...]:
    """Return what to do where photos of this exposure time swing by more than ``largest_swing`` of the light."""
    left = flicker.swing_at(exposure_s)
    if left <= largest_swing:
        return ()
    safe = safe_times(flicker, largest_swing=largest_swing)
    multiple_s = max(1, round(exposure_s * flicker.frequency_hz)) / flicker.frequency_hz
    offered = f", such as {' s, '.join(str(each) for each in safe[:3])} s" if safe else ""
    return (
        f"The display flickers at {flicker.frequency_hz:.1f} Hz and {100 * left:.1f} % of it is left in photos of "
        f"{1000 * exposure_s:.4g} ms: expose for a multiple of {1000 / flicker.frequency_hz:.2f} ms (near: "
        f"{1000 * multiple_s:.4g} ms){offered}, or raise the display's brightness until it stops dimming by pulses.",
    )
