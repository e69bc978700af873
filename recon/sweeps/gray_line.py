"""Reads a ``gray_line`` sweep: the line shift gives a place within a period, the Gray code the period.

Once the period is known, the shifted line is one stripe of an ordinary sweep, seen in the photos of one period: the same
windows are made of it, and the same fit reads them. What the display shows is in :mod:`recon.patterns.gray_line`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Int32

from recon.method import Method
from recon.metrics import PhotoQuality
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.pattern import GrayLinePattern
from recon.sessions.photos import Counts, saturation_count
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.black_level import LEAST_PEAK_COUNTS, PEAK_SIGMA, step_of_counts
from recon.sweeps.correspondence import SweepResult, place_by_likelihood, place_by_parabola
from recon.sweeps.noise import ROUNDING_VARIANCE, dark_variance
from recon.sweeps.photo_stream import black_photo, has_black, photo_stream
from recon.sweeps.stripe_peak import NO_PEAK, PeakWindows

# A bit whose two photos differ by less than this share of the clearest bit's is in doubt: shot noise alone does not reach it.
WEAK_SHARE = 0.25
# How far from the middle of its half period a pixel may be, in half periods: half of one, and as much again as footprint and
# noise may add. Another half period begins to fit at one.
FARTHEST_FROM_MIDDLE = 0.75
PIXELS_A_CHUNK = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class BarReading:
    """What the Gray code says of each pixel.

    ``number`` is its half period, ``lit`` where the bars are seen at all, ``between`` the half period beside it where the weakest
    bit is in doubt (else ``number``), ``sound`` whether no other bit is in doubt and those two are neighbours.
    """

    number: Int32[np.ndarray, " pixels"]
    between: Int32[np.ndarray, " pixels"]
    lit: Bool[np.ndarray, " pixels"]
    sound: Bool[np.ndarray, " pixels"]


def decode_gray_line(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    method: Method,
    on_photo: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Stream the photos of one sweep and return every pixel's place; one period of line photos is kept at a time."""
    pattern = capture_set.sweep(axis).pattern
    assert isinstance(pattern, GrayLinePattern)
    first = session.photo_numbers(capture_set, axis).start
    quality: list[PhotoQuality] = []

    def photos(start: int, stop: int, *, like: np.ndarray | None) -> Iterator[Counts]:
        numbers = range(first + start, first + stop)
        return photo_stream(session, capture_set, axis, numbers, like=like, quality=quality, on_photo=on_photo)

    camera = session.manifest.camera
    black = black_photo(session, capture_set) if has_black(session, capture_set) else None
    lines = line_samples(photos(0, pattern.steps, like=black), pattern)
    clipped = saturation_count(lines)
    shape = (camera.rows, camera.columns)
    dark, variance = _dark_of_lines(lines, shape)
    black = dark if black is None else black
    code = photos(pattern.steps, pattern.count, like=black)
    bars = read_bars(code, pattern, pixels=black.size, dark_variance=variance)
    windows, doubtful = line_windows(lines, bars, pattern, black=black.ravel(), dark_variance=variance)
    del lines
    sweep, strip = pattern.as_sweep(), tuple(quality)
    if method == "paper":
        result = place_by_parabola(windows, sweep, black=black, dark=variance, photos=strip)
    else:
        result = place_by_likelihood(
            windows,
            sweep,
            black=black,
            dark=variance,
            clipped=clipped,
            photos=strip,
            continuous=session.manifest.display.continuous,
        )
    status = result.status.copy()
    status[doubtful.reshape(shape)] = PixelStatus.BAD_CODE
    return replace(result, status=status)


def line_samples(photos: Iterator[Counts], pattern: GrayLinePattern) -> np.ndarray:
    """Return the counts [pixels, steps] of the photos of the line shift."""
    samples: np.ndarray | None = None
    for step, counts in enumerate(photos):
        if samples is None:
            samples = np.empty((counts.size, pattern.steps), dtype=counts.dtype)
        samples[:, step] = counts.ravel()
    assert samples is not None  # a period has four steps at least
    return samples


def line_phase(lines: np.ndarray) -> tuple[Float32[np.ndarray, " pixels"], Float32[np.ndarray, " pixels"]]:
    """Return where in the period each pixel's line is, in steps, and the amplitude of its fundamental wave in counts.

    The fundamental of all samples is steadier than the brightest of them where a wide footprint makes the curve flat.
    """
    pixels, steps = lines.shape
    turn = 2 * np.pi * np.arange(steps) / steps
    waves = np.stack([np.cos(turn), np.sin(turn)], axis=1).astype(np.float32)
    phase, amplitude = np.empty(pixels, np.float32), np.empty(pixels, np.float32)
    for low in range(0, pixels, PIXELS_A_CHUNK):
        part = slice(low, low + PIXELS_A_CHUNK)
        real, imaginary = (lines[part].astype(np.float32) @ waves).T
        phase[part] = np.arctan2(imaginary, real) * (steps / (2 * np.pi)) % steps
        amplitude[part] = np.hypot(real, imaginary) * (2 / steps)
    return phase, amplitude


def read_bars(photos: Iterator[Counts], pattern: GrayLinePattern, *, pixels: int, dark_variance: float) -> BarReading:
    """Read the Gray code from its photos of so many pixels, lowest bit first, each followed by its inverse."""
    strongest = np.iinfo(np.int32).max
    code, weak_bit, clearest = (np.zeros(pixels, np.int32) for _ in range(3))
    weakest, second = (np.full(pixels, strongest, np.int32) for _ in range(2))
    for bit in range(pattern.bits):
        contrast = next(photos).ravel().astype(np.int32) - next(photos).ravel()
        strength = np.abs(contrast)
        code |= (contrast > 0).astype(np.int32) << bit
        second = np.minimum(second, np.maximum(weakest, strength))
        weak_bit[strength < weakest] = bit
        weakest = np.minimum(weakest, strength)
        clearest = np.maximum(clearest, strength)
    number = _number_of(code, pattern.bits)
    other = _number_of(code ^ (1 << weak_bit), pattern.bits)
    limit = np.maximum(WEAK_SHARE * clearest, PEAK_SIGMA * np.sqrt(2 * dark_variance))
    weak = weakest < limit
    beside = np.abs(other - number) == 1
    return BarReading(
        number=number,
        between=np.where(weak & beside, other, number).astype(np.int32),
        lit=clearest > max(PEAK_SIGMA * np.sqrt(2 * dark_variance), LEAST_PEAK_COUNTS),
        sound=(second >= limit) & (~weak | beside) & (number < pattern.bars),
    )


def line_windows(
    lines: np.ndarray, bars: BarReading, pattern: GrayLinePattern, *, black: np.ndarray, dark_variance: float
) -> tuple[PeakWindows, Bool[np.ndarray, " pixels"]]:
    """Return the windows of a whole sweep about each pixel's line, and the pixels whose period is in doubt.

    A pixel in doubt has no peak in the windows.
    """
    pixels, steps = lines.shape
    phase, amplitude = line_phase(lines)
    half_width = steps // 2 - 1
    bar = steps / 2
    # Stripe numbers: bar j reaches from j·bar − ½ to (j + 1)·bar − ½; between two bars it is their common edge that counts.
    middle = (bars.number + bars.between + 1) * (bar / 2) - 0.5
    period = np.rint((middle - phase) / steps)
    from_middle = np.abs(phase + period * steps - middle)
    rise = PEAK_SIGMA * np.sqrt(2 * dark_variance / steps)
    brightest = lines.max(axis=1).astype(np.int32) - black
    seen = (amplitude > rise) & (brightest > LEAST_PEAK_COUNTS)
    sound = seen & bars.lit & bars.sound & (from_middle <= FARTHEST_FROM_MIDDLE * bar)
    peak = np.clip(np.rint(phase) + period * steps, 0, pattern.places - 1).astype(np.int32)
    peak[~sound] = NO_PEAK
    samples = np.zeros((pixels, 2 * half_width + 1), dtype=lines.dtype)
    window = np.arange(-half_width, half_width + 1)
    for low in range(0, pixels, PIXELS_A_CHUNK):
        rows = low + np.flatnonzero(sound[low : low + PIXELS_A_CHUNK])
        samples[rows] = np.take_along_axis(lines[rows], (peak[rows, None] + window) % steps, axis=1)
    return PeakWindows(peak, samples, half_width, pattern.places), (seen | bars.lit) & ~sound


def _number_of(code: np.ndarray, bits: int) -> Int32[np.ndarray, " pixels"]:
    """Return the numbers whose reflected binary codes these are: each bit is the parity of those from the highest to it."""
    number = code.copy()
    for shift in range(1, bits):
        number ^= code >> shift
    return number


def _dark_of_lines(lines: np.ndarray, shape: tuple[int, int]) -> tuple[Counts, float]:
    """Return the counts between the lines, and the variance of one of them.

    They are read from the three samples farthest from each pixel's line. A wide footprint still sees the lines there, but
    nearly the same of them, so that the second difference of the three is noise: its variance is six times that of a sample.
    """
    steps = lines.shape[1]
    opposite = np.rint(line_phase(lines)[0]).astype(np.int64) + steps // 2
    before, middle, after = (
        np.take_along_axis(lines, ((opposite + offset) % steps)[:, None], axis=1).reshape(shape)
        for offset in (-1, 0, 1)
    )
    twice_the_mean = before.astype(np.int32) + after
    variance = dark_variance(2 * middle.astype(np.int32), twice_the_mean) / 3
    return middle, max(variance, ROUNDING_VARIANCE * step_of_counts(lines[:, 0]) ** 2)
