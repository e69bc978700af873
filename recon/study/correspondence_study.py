"""How close the places of method ``full`` come to the bound that the photos themselves set, and whether their sds are true."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from recon.sessions.pattern import StripePattern
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.stripe_bound import SampleNoise, blurred_profile, place_bound_px
from recon.study.study_result import Cell, Curve, StudyFigure, StudyTable
from recon.sweeps.black_level import noise_floor, reach_floor
from recon.sweeps.correspondence import window_half_width
from recon.sweeps.curve_reach import curve_half_width
from recon.sweeps.noise import dark_variance

FOOTPRINTS_PX = (0.4, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0)
PEAK_SNRS = (30.0, 100.0, 300.0)
# Read noise alone; and photon noise with a tenth of the peak's variance left as read noise.
NOISES = {"read": 1.0, "photon": 0.1}
COLUMNS = 200
# Counts at the peak, of 65,535: rounding is far below any noise.
PEAK_COUNTS, BLACK_COUNTS = 20_000.0, 10_000.0
# Places advance by so much from pixel to pixel: all phases within a step, and next to no footprint of its own.
ADVANCE_PX = (0.0137, 0.0011)
DECILES = 10
COVERED_SD = 1.959964


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Errors of the places in device pixels and their predicted sds, of pixels that have both."""

    error_px: Float64[np.ndarray, " pixels"]
    sd_px: Float64[np.ndarray, " pixels"]

    def rms_px(self) -> float:
        """Return the root mean square error."""
        return float(np.sqrt((self.error_px**2).mean()))

    def by_decile(self) -> tuple[tuple[float, float], ...]:
        """Return rms of the normalised errors and coverage of the 95 % interval in each decile of predicted sd."""
        ratio = (self.error_px / self.sd_px)[np.argsort(self.sd_px, kind="stable")]
        return tuple(
            (float(np.sqrt((part**2).mean())), float((np.abs(part) <= COVERED_SD).mean()))
            for part in np.array_split(ratio, DECILES)
        )


def stripe_patterns() -> dict[str, StripePattern]:
    """Return the two stripes: a hard one of one step, and a raised cosine of six."""
    return {
        "hard 1": StripePattern(profile="hard", width_px=1.0, first_px=0.0, step_px=1.0, count=48),
        "raised cosine 6": StripePattern(profile="raised_cosine", width_px=6.0, first_px=0.0, step_px=1.0, count=48),
    }


def sample_noise(kind: str, peak_snr: float) -> SampleNoise:
    """Return the noise, in units of the peak, whose sd at the peak is one over ``peak_snr``."""
    share = NOISES[kind]
    return SampleNoise(read=share / peak_snr**2, gain=(1 - share) / peak_snr**2)


def decoded(
    pattern: StripePattern, footprint_sd_px: float, noise: SampleNoise, *, columns: int, rng: np.random.Generator
) -> Seen:
    """Photograph a sweep through a Gaussian footprint and decode it: noise, footprint and reach are the decoder's to find."""
    # Loads the compiler, which would slow every other command.
    from recon.sweeps.likelihood import places_by_likelihood
    from recon.sweeps.peak_tracker import PeakTracker

    row, col = np.mgrid[:columns, :columns]
    centre = pattern.count / 2 + ADVANCE_PX[0] * (col - columns / 2) + ADVANCE_PX[1] * (row - columns / 2)
    grid = np.linspace(-pattern.count, pattern.count, 20_001)
    profile = blurred_profile(grid, footprint_sd_px, pattern)
    profile /= profile.max()

    def photo(index: int) -> np.ndarray:
        generator = np.random.default_rng([seed, index])
        place = pattern.first_px + pattern.step_px * index
        height = np.interp(centre.ravel() - place, grid, profile)
        height += generator.normal(0.0, np.sqrt(noise.variance(height)))
        return np.rint(BLACK_COUNTS + PEAK_COUNTS * height).reshape(centre.shape).astype(np.uint16)

    seed = int(rng.integers(1 << 31))
    black = np.rint(BLACK_COUNTS + PEAK_COUNTS * rng.normal(0.0, np.sqrt(noise.read), centre.shape)).astype(np.uint16)
    dark = dark_variance(photo(0), photo(pattern.count - 1))
    half_width = curve_half_width(
        photo,
        range(pattern.count),
        black=black,
        floor=reach_floor(black, dark),
        least=window_half_width(pattern, "full"),
    )
    tracker = PeakTracker(noise_floor(black, 2 * dark), half_width=half_width)
    for index in range(pattern.count):
        tracker.feed(photo(index))
    places = places_by_likelihood(
        tracker.finish(),
        np.arange(centre.size, dtype=np.int64),
        pattern,
        black=black,
        dark_variance=dark,
        clipped=65_535,
        continuous=True,
    )
    good = np.isfinite(places.place_px)
    return Seen((places.place_px - centre)[good], places.sd_px[good].astype(np.float64))


def correspondence(_: Path, size: StudySize, tell: Tell) -> Findings:
    """Decode sweeps with Gaussian footprints of 0.4 to 4 px at peak signal-to-noise 30, 100 and 300."""
    columns = size.columns_or(COLUMNS)
    rng = np.random.default_rng(size.seed)
    rows: list[tuple[Cell, ...]] = []
    curves = []
    for label, pattern in stripe_patterns().items():
        for kind in NOISES:
            for snr in PEAK_SNRS:
                ratios = []
                for footprint in FOOTPRINTS_PX:
                    noise = sample_noise(kind, snr)
                    seen = decoded(pattern, footprint, noise, columns=columns, rng=rng)
                    bound = place_bound_px(footprint, pattern, noise=noise, width_known=True)
                    free = place_bound_px(footprint, pattern, noise=noise, width_known=False)
                    ratios.append(seen.rms_px() / bound)
                    rows.append((label, kind, snr, footprint, *_figures(seen, bound, free, columns**2)))
                    tell(f"{label}, {kind} noise, 1:{snr:g}, footprint {footprint:g} px: {ratios[-1]:.3f} of the bound")
                curves.append(Curve(label=f"{label}, {kind}, 1:{snr:g}", x=FOOTPRINTS_PX, y=tuple(ratios)))
    headings = (
        "stripe",
        "noise",
        "peak / noise",
        "footprint sd (px)",
        "rms (px)",
        "bound (px)",
        "rms / bound",
        "rms / bound, width unknown",
        "bias / bound",
        "normalised rms",
        "lowest decile",
        "highest decile",
        "covered (%)",
        "lowest decile (%)",
        "highest decile (%)",
        "decoded (%)",
    )
    setting = (
        f"{columns} × {columns} pixels whose places take every phase within a step, seen through a Gaussian footprint. The "
        "decoder is given photos and pattern; noise, width of the footprint and reach of the curves it finds itself. The "
        "bound is that of all samples for a known width; beside it for a width unknown and fitted in each pixel alone. "
        "Normalised errors, and how many of the 95 % intervals hold the truth, "
        "over all pixels and over the deciles of predicted standard deviation."
    )
    table = StudyTable(title="Places against their bound", headings=headings, rows=tuple(rows))
    figure = StudyFigure(
        title="Rms over bound",
        x_label="footprint sd (px)",
        y_label="rms / bound",
        curves=tuple(curves),
        y_scale="linear",
    )
    return Findings(setting, (table,), (figure,))


def _figures(seen: Seen, bound_px: float, free_px: float, pixels: int) -> tuple[float, ...]:
    """Return the numbers of one row of the table."""
    deciles = seen.by_decile()
    spreads, covered = [one for one, _ in deciles], [100 * one for _, one in deciles]
    ratio = seen.error_px / seen.sd_px
    return (
        seen.rms_px(),
        bound_px,
        seen.rms_px() / bound_px,
        seen.rms_px() / free_px,
        float(seen.error_px.mean()) / bound_px,
        float(np.sqrt((ratio**2).mean())),
        min(spreads),
        max(spreads),
        float(np.mean(covered)),
        min(covered),
        max(covered),
        100 * len(seen.error_px) / pixels,
    )
