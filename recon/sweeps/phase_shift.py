"""Reads a ``phase_shift`` sweep: the phase of each period by least squares, unwrapped from the coarsest to the finest.

With N ≥ 3 equal shifts the least-squares cosine through a pixel's samples I_k is their discrete Fourier component (Bruning et al.
1974): mean a = Σ I_k / N, amplitude and phase of (2/N) Σ I_k exp(2πik/N). Overtones of a bent response up to order N − 2 fall out
of it. Each period tells the place up to whole periods; the coarser one before it tells which.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.pattern import PhaseShiftPattern
from recon.sessions.photos import saturation_count
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.black_level import LEAST_PEAK_COUNTS, PEAK_SIGMA, step_of_counts
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.display_response import response_of, response_undone
from recon.sweeps.map_scatter import scatter_beyond
from recon.sweeps.noise import ROUNDING_VARIANCE, NoiseModel, noise_from_residuals
from recon.sweeps.photo_stream import black_photo, has_black, photo_stream
from recon.sweeps.stripe_model import LARGEST_MISFIT

NOISE_SAMPLE_PIXELS = 8000
# A finer period must be where the coarser one says, to this share of it; half of it would be the next one.
FARTHEST_FROM_COARSER = 0.35
# Five standard deviations of the coarser place must stay within half of the finer period.
LARGEST_COARSE_SD = 0.1
# So many pixels' own curves are kept for the report, which draws some of those that became points.
CURVES = 144


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """Phase (in turns, 0 to 1), amplitude and mean of each period, and the squared misfit summed over all photos."""

    turns: Float64[np.ndarray, "periods pixels"]
    amplitude: Float64[np.ndarray, "periods pixels"]
    mean: Float64[np.ndarray, "periods pixels"]
    misfit: Float64[np.ndarray, " pixels"]


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places in device pixels with their sd, and whether every period was where the coarser one said."""

    place_px: Float64[np.ndarray, " pixels"]
    sd_px: Float64[np.ndarray, " pixels"]
    consistent: Bool[np.ndarray, " pixels"]


class PhaseTracker:
    """Feed the photos of a sweep in order; ask for the phases at the end. Its memory does not grow with the photos."""

    def __init__(self, pixels: int, pattern: PhaseShiftPattern) -> None:
        self._pattern = pattern
        self._wave = np.zeros((len(pattern.periods_px), pixels), np.complex128)
        self._sum = np.zeros((len(pattern.periods_px), pixels))
        self._squares = np.zeros(pixels)
        self._fed = 0

    def feed(self, counts: Float64[np.ndarray, " pixels"]) -> None:
        """Take the next photo."""
        period, shift = divmod(self._fed, self._pattern.steps)
        self._fed += 1
        self._sum[period] += counts
        self._wave[period] += counts * np.exp(2j * np.pi * shift / self._pattern.steps)
        self._squares += counts**2

    def finish(self) -> Phases:
        """Return the least-squares cosines."""
        steps = self._pattern.steps
        mean, amplitude = self._sum / steps, np.abs(self._wave) * (2 / steps)
        explained = steps * (mean**2 + amplitude**2 / 2).sum(axis=0)
        return Phases(
            turns=np.angle(self._wave) / (2 * np.pi) % 1.0,
            amplitude=amplitude,
            mean=mean,
            misfit=np.maximum(self._squares - explained, 0.0),
        )


def decode_phase_shift(
    session: Session, capture_set: CaptureSet, axis: Axis, *, on_photo: Callable[[], None] = lambda: None
) -> SweepResult:
    """Stream the photos of one sweep, one at a time, and return every pixel's place."""
    pattern = capture_set.sweep(axis).pattern
    assert isinstance(pattern, PhaseShiftPattern)
    camera = session.manifest.camera
    shape = (camera.rows, camera.columns)
    pixels = camera.rows * camera.columns
    quality: list[PhotoQuality] = []
    some = np.arange(0, pixels, max(-(-pixels // NOISE_SAMPLE_PIXELS), 1))
    response = response_of(session)
    tracker, samples = PhaseTracker(pixels, pattern), np.empty((pattern.count, len(some)))
    clipped, step = np.zeros(pixels, dtype=bool), 1
    numbers = session.photo_numbers(capture_set, axis)
    black = black_photo(session, capture_set) if has_black(session, capture_set) else None
    photos = photo_stream(session, capture_set, axis, numbers, like=black, quality=quality, on_photo=on_photo)
    for number, counts in enumerate(photos):
        clipped |= counts.ravel() >= saturation_count(counts)
        if number == 0 and response is None:
            step = step_of_counts(counts)
        values = response_undone(counts, response)
        samples[number] = values[some]
        tracker.feed(values)
    phases = tracker.finish()
    level = np.zeros(pixels) if black is None else response_undone(black, response)
    noise = _noise(phases, samples, some, pattern, black=level, read_variance=ROUNDING_VARIANCE * step**2)
    sd_turns, misfit = _phase_sd(phases, pattern, noise=noise, black=level)
    places = unwrapped(phases.turns, sd_turns, pattern)
    status = _status(phases, places, pattern, noise=noise, clipped=clipped)
    fine = status == PixelStatus.OK
    place_px, sd_px = (np.where(fine, one, np.nan).reshape(shape) for one in (places.place_px, places.sd_px))
    # JPEG bends fringes finer than its blocks much alike in every phase: no residual shows it, the map of places does.
    sd_px = np.hypot(sd_px, scatter_beyond(place_px, sd_px, np.ones(shape)))
    return SweepResult(
        place_px=place_px,
        sd_px=sd_px.astype(np.float32),
        status=status.reshape(shape),
        noise=noise,
        misfit=float(np.median(misfit[fine])) if fine.any() else float("nan"),
        photos=tuple(quality),
        curves=_curves(samples, some, phases, places, pattern, photos=tuple(quality), status=status, columns=shape[1]),
    )


def unwrapped(
    turns: Float64[np.ndarray, "periods pixels"],
    sd_turns: Float64[np.ndarray, "periods pixels"],
    pattern: PhaseShiftPattern,
) -> Places:
    """Return the places that the phases of all periods come to, coarsest first (temporal unwrapping)."""
    area_px = pattern.last_px - pattern.first_px
    # Half of what the coarsest period reaches beyond the area belongs to either end of it.
    spare = (1 - area_px / pattern.periods_px[0]) / 2
    coarsest = np.where(turns[0] > 1 - spare, turns[0] - 1, turns[0])
    place = coarsest * pattern.periods_px[0]
    sd_px = sd_turns[0] * pattern.periods_px[0]
    consistent = np.isfinite(place)
    for period_px, phase, sd in zip(pattern.periods_px[1:], turns[1:], sd_turns[1:], strict=True):
        finer = (np.rint(place / period_px - phase) + phase) * period_px
        consistent &= np.abs(finer - place) <= FARTHEST_FROM_COARSER * period_px
        consistent &= sd_px <= LARGEST_COARSE_SD * period_px
        place, sd_px = finer, sd * period_px
    return Places(place_px=pattern.first_px + place, sd_px=sd_px, consistent=consistent)


def _phase_sd(
    phases: Phases, pattern: PhaseShiftPattern, *, noise: NoiseModel, black: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sd of each phase in turns, and each pixel's χ² over its degrees of freedom.

    The derivative of the phase by sample k is −(2/NA) sin of its own phase, so that var = (4/N²A²) Σ v_k sin²; with v = read +
    gain·s + (relative·s)² and s = a + A cos that sum is N/2 · [v(a) + (relative·A/2)²].
    """
    variance = noise.variance(phases.mean - black) + (noise.relative * phases.amplitude / 2) ** 2
    sd = np.sqrt(2 * variance / pattern.steps) / np.maximum(phases.amplitude, 1e-9) / (2 * np.pi)
    freedom = len(pattern.periods_px) * (pattern.steps - 3)
    if freedom == 0:
        return sd, np.ones(sd.shape[1])
    ratio = phases.misfit / (variance.mean(axis=0) * freedom)
    # Where the samples are not quite a cosine, the misfit is taken as noise of the same kind (Birge's ratio).
    return sd * np.sqrt(np.maximum(ratio, 1.0)), ratio


def _status(
    phases: Phases, places: Places, pattern: PhaseShiftPattern, *, noise: NoiseModel, clipped: np.ndarray
) -> np.ndarray:
    """Say why a pixel has no place; the first test that fails names it."""
    least = max(PEAK_SIGMA * np.sqrt(2 * noise.read_variance / pattern.steps), LEAST_PEAK_COUNTS / 2)
    rms = np.sqrt(phases.misfit / pattern.count)
    tests: tuple[tuple[np.ndarray, PixelStatus], ...] = (
        (~places.consistent, PixelStatus.BAD_CODE),
        ((places.place_px < pattern.first_px) | (places.place_px > pattern.last_px), PixelStatus.SWEEP_EDGE),
        (clipped | (rms > LARGEST_MISFIT * 2 * phases.amplitude[-1]), PixelStatus.BAD_FIT),
        (phases.amplitude.max(axis=0) < least, PixelStatus.UNLIT),
    )
    status = np.full(len(rms), PixelStatus.OK, dtype=np.uint8)
    for failed, reason in tests:
        status[failed] = reason
    return status


def _noise(
    phases: Phases,
    samples: np.ndarray,
    some: np.ndarray,
    pattern: PhaseShiftPattern,
    *,
    black: np.ndarray,
    read_variance: float,
) -> NoiseModel:
    """Read the noise from what a sample of the pixels leaves of its cosines; it is no less than ``read_variance``."""
    freedom_share = (pattern.steps - 3) / pattern.steps
    if freedom_share == 0:
        return NoiseModel(read_variance)
    model = np.stack(list(_models(phases, some, pattern)))
    return noise_from_residuals(
        (model - black[some]).ravel(),
        (samples - model).ravel(),
        read_variance=read_variance,
        freedom_share=freedom_share,
    )


def _models(phases: Phases, some: np.ndarray, pattern: PhaseShiftPattern) -> Iterator[np.ndarray]:
    """Yield what each photo of these pixels should be."""
    for number in range(pattern.count):
        period, shift = divmod(number, pattern.steps)
        turns = phases.turns[period, some] - shift / pattern.steps
        yield phases.mean[period, some] + phases.amplitude[period, some] * np.cos(2 * np.pi * turns)


def _curves(
    samples: np.ndarray,
    some: np.ndarray,
    phases: Phases,
    places: Places,
    pattern: PhaseShiftPattern,
    *,
    photos: tuple[PhotoQuality, ...],
    status: np.ndarray,
    columns: int,
) -> tuple[SampleCurve, ...]:
    """Return a few pixels' samples of the finest period for the report, each at the crest of its fringe next to the pixel."""
    finest = np.arange(pattern.count - pattern.steps, pattern.count)
    period_px = pattern.periods_px[-1]
    model = np.stack(list(_models(phases, some, pattern)))[finest]
    good = np.flatnonzero(status[some] == PixelStatus.OK)
    curves = []
    for place in good[:: max(len(good) // CURVES, 1)]:
        pixel = int(some[place])
        centre_px = float(places.place_px[pixel])
        offset = pattern.first_px + period_px * np.arange(pattern.steps) / pattern.steps - centre_px
        crest_px = centre_px + offset - period_px * np.rint(offset / period_px)
        order = np.argsort(crest_px)
        curves.append(
            SampleCurve(
                row=pixel // columns,
                col=pixel % columns,
                set=photos[0].set,
                axis=photos[0].sweep,
                place_px=tuple(crest_px[order].tolist()),
                intensity=tuple(samples[finest, place][order].tolist()),
                model=tuple(model[order, place].tolist()),
                peak_px=centre_px,
                sd_px=float(places.sd_px[pixel]),
            )
        )
    return tuple(curves)
