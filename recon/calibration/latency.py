"""From the command to the light: how late the display is, from photos taken at known times after ``show``.

The display changes from one steady frame to another. A photo whose shutter opens ``after_s`` behind the command and stays open
for the exposure time T holds the share of the new frame

    s = (G(after + T) − G(after)) / T,    G(t) = ∫ light,

where the light changes in a straight line from L − R/2 to L + R/2: G is 0 before, (t − L + R/2)² / 2R during the change, and
t − L behind it. The latency L, at which half of the change is done, and the rise time R are fitted to the shares. What the
camera needs from its command until its shutter opens is taken for negative latency of the display: the two only ever act
together.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

Samples = Float64[np.ndarray, " photos"]

# A share farther from 0 and 1 than this is on the way.
ON_THE_WAY = 0.05
FEWEST_PHOTOS = 6
# A difference between the halves of photos that is less certain is none.
READOUT_SIGMA = 4.0
# A rolling shutter's rows are taken for so many that open one after the other.
SPREAD_STEPS = 16
LEAST_RISE_S = 1e-6
LEAST_SHARE_SD = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Latency:
    """How late the light is: half changed ``latency_s`` after the command, in a change that takes ``rise_s``.

    ``share`` is that of the new frame in the photo taken ``after_s``, ``share_rms`` its distance from the fit. ``readout_s`` is
    how much later than the first row of a photo its last one opens, where that was measured.
    """

    after_s: Samples
    share: Samples
    exposure_s: float
    latency_s: float
    latency_sd_s: float
    rise_s: float
    rise_sd_s: float
    share_rms: float
    readout_s: float = 0.0
    readout_sd_s: float = 0.0
    spread_s: float = 0.0

    @property
    def settled_s(self) -> float:
        """How long after the command a shutter may open, at the earliest: latency, half the change, two standard deviations."""
        return self.latency_s + self.rise_s / 2 + 2 * float(np.hypot(self.latency_sd_s, self.rise_sd_s / 2))

    def model(self, after_s: Samples) -> Samples:
        """Return the share that the fit has at these times."""
        return new_share(
            after_s,
            latency_s=self.latency_s,
            rise_s=self.rise_s,
            exposure_s=self.exposure_s,
            spread_s=self.spread_s,
        )


def new_share(
    after_s: Samples, *, latency_s: float, rise_s: float, exposure_s: float, spread_s: float = 0.0
) -> Samples:
    """Return the share of the new frame in photos whose shutter opens ``after_s`` behind the command.

    ``spread_s`` is how much later than the first of the rows seen the last one opens; ``after_s`` is the time of the mean one.
    """
    if spread_s > 0:
        rows_s = spread_s * ((np.arange(SPREAD_STEPS) + 0.5) / SPREAD_STEPS - 0.5)
        each = new_share((after_s[:, None] + rows_s).ravel(), latency_s=latency_s, rise_s=rise_s, exposure_s=exposure_s)
        return each.reshape(-1, SPREAD_STEPS).mean(axis=1)
    rise_s = max(rise_s, LEAST_RISE_S)
    since_s = after_s - latency_s + rise_s / 2
    return (_light_after(since_s + exposure_s, rise_s) - _light_after(since_s, rise_s)) / exposure_s


def _light_after(since_s: Samples, rise_s: float) -> Samples:
    """Return the light, in seconds of the new frame's, that came until so long after the change began."""
    since_s = np.maximum(since_s, 0.0)
    return np.where(since_s < rise_s, since_s**2 / (2 * rise_s), since_s - rise_s / 2)


def fit_latency(after_s: Samples, share: Samples, *, exposure_s: float, spread_s: float = 0.0) -> Latency:
    """Return latency and rise time.

    Parameters
    ----------
    after_s, share:
        When the shutter opened after the command, and the share of the new frame in the photo: 0 the old one, 1 the new one,
        in light (:meth:`recon.calibration.level_response.LevelResponse.light_table` undoes a gamma).
    exposure_s, spread_s:
        How long it was open, and how much later than the first row seen the last one opened (:func:`new_share`).

    Raises
    ------
    ValueError
        Where no photo shows the new frame, none of the photos shows any of the old one, or there are fewer than six.
    """
    if after_s.size < FEWEST_PHOTOS:
        raise ValueError(f"{after_s.size} photos were taken, {FEWEST_PHOTOS} are needed")
    if not (share > 1 - ON_THE_WAY).any():
        raise ValueError(f"no photo up to {after_s.max():.2f} s after the command shows the new frame")
    if not (share < 1 - ON_THE_WAY).any():
        raise ValueError(f"every photo from {after_s.min():.3f} s after the command shows the new frame alone")

    def misses(parameters: np.ndarray) -> np.ndarray:
        latency_s, rise_s = parameters
        seen = new_share(after_s, latency_s=latency_s, rise_s=rise_s, exposure_s=exposure_s, spread_s=spread_s)
        return seen - share

    # A rise that is short against exposure and spacing hardly changes the shares, and one guess would stay where it is.
    starts = [
        (float(latency_s), float(rise_s))
        for latency_s in np.linspace(after_s.min(), after_s.max() + exposure_s, 24)
        for rise_s in np.geomspace(exposure_s / 100, 2 * np.ptp(after_s), 5)
    ]
    start = min(starts, key=lambda each: float(np.sum(misses(np.array(each)) ** 2)))
    fit = least_squares(misses, start, bounds=([-np.inf, LEAST_RISE_S], np.inf), x_scale=exposure_s)
    latency_s, rise_s = float(fit.x[0]), float(fit.x[1])
    share_rms = float(np.sqrt(np.mean(fit.fun**2)))
    variance = max(float(np.sum(fit.fun**2)) / max(1, after_s.size - 2), LEAST_SHARE_SD**2)
    steps_s = np.array([exposure_s / 500, max(rise_s / 10, exposure_s / 20)])
    # The share is a curve with corners: slopes are taken over steps that reach from one sample's exposure into the next.
    jacobian = np.column_stack(
        [
            (misses(np.array([latency_s + steps_s[0], rise_s])) - misses(np.array([latency_s - steps_s[0], rise_s])))
            / (2 * steps_s[0]),
            (misses(np.array([latency_s, rise_s + steps_s[1]])) - misses(np.array([latency_s, rise_s]))) / steps_s[1],
        ]
    )
    latency_sd_s, rise_sd_s = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * variance)
    return Latency(
        after_s=after_s,
        share=share,
        exposure_s=exposure_s,
        latency_s=latency_s,
        latency_sd_s=float(latency_sd_s),
        rise_s=rise_s,
        rise_sd_s=float(rise_sd_s),
        share_rms=share_rms,
        spread_s=spread_s,
    )


def fit_rolling_latency(
    after_s: Samples,
    share: Float64[np.ndarray, "photos 2"],
    *,
    exposure_s: float,
    at_share: tuple[float, float],
) -> Latency:
    """Return the latency to the first row of photos whose rows may open one after the other.

    Parameters
    ----------
    after_s, exposure_s:
        As for :func:`fit_latency`.
    share:
        The share of the new frame in the upper and in the lower half of the part that sees the display.
    at_share:
        Where the mean rows of the halves are in the photo: 0 its top, 1 its bottom.

    Notes
    -----
    Rows that open later seem to meet an earlier light: the latencies of the halves differ by the readout time times the distance
    of their rows. What is fitted in the end is all rows together, at the time at which their mean one opened.
    """
    upper, lower = (fit_latency(after_s, share[:, half], exposure_s=exposure_s) for half in (0, 1))
    apart = at_share[1] - at_share[0]
    readout_s = (upper.latency_s - lower.latency_s) / apart
    readout_sd_s = float(np.hypot(upper.latency_sd_s, lower.latency_sd_s)) / apart
    if readout_s < READOUT_SIGMA * readout_sd_s:
        return replace(
            fit_latency(after_s, share.mean(axis=1), exposure_s=exposure_s), readout_s=0.0, readout_sd_s=readout_sd_s
        )
    mean_row = sum(at_share) / 2
    # Half of the rows seen lie between the means of the halves.
    spread_s = 2 * readout_s * apart
    found = fit_latency(after_s + readout_s * mean_row, share.mean(axis=1), exposure_s=exposure_s, spread_s=spread_s)
    sd_s = float(np.hypot(found.latency_sd_s, readout_sd_s * mean_row))
    return replace(found, latency_sd_s=sd_s, readout_s=readout_s, readout_sd_s=readout_sd_s)


def latency_warnings(latency: Latency, *, waits_s: float) -> tuple[str, ...]:
    """Return what to do where a capture that opens its shutter ``waits_s`` after the command would see the frame before."""
    if latency.settled_s <= waits_s:
        return ()
    return (
        f"The light of a frame is whole {1000 * latency.settled_s:.0f} ms after the command, photos are taken after "
        f"{1000 * waits_s:.0f} ms and would show the frame before: raise settle_s in section [timing] by "
        f"{np.ceil(100 * (latency.settled_s - waits_s)) / 100:.2f} s or more.",
    )
