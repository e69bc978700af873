"""The verdict of a reconstruction: what a person should think of it, why, and what to do next."""

import numpy as np

from recon.maps import Maps
from recon.metrics import Funnel, PhotoQuality, Statistic, Verdict
from recon.status import REASONS, PixelStatus

# Judgements, not measurements: where a tired operator should stop and look.
FEWEST_POINTS = 100
FAIL_SHARE = 0.05
CHECK_SHARE = 0.6
LOST_SHARE = 0.2
SATURATED_SHARE = 0.01
# Gaps are in units of their own sd; noise alone gives 1, and a slip of the display between sets far more.
CHECK_GAP_RATIO = 2.0
UNWATCHED = (
    "Not checked: whether the object rose or sank when the tank was filled; nothing but reference photos would show it, and "
    "there are none."
)


def verdict(
    funnel: Funnel,
    maps: Maps,
    *,
    gap_ratio: float | None,
    photos: tuple[PhotoQuality, ...],
    scene: tuple[str, ...] = (),
    doubts: tuple[str, ...] = (),
    unwatched: bool = False,
) -> Verdict:
    """Grade a result.

    ``gap_ratio`` is the median of |gap| over what noise predicts, None where no noise is known; ``scene`` is what the
    reference photos say did not stay as it was, and ``doubts`` which assumptions the session itself contradicts. Nobody can know
    whether the object stood still where it was ``unwatched``: without reference photos.
    """
    if funnel.entry_points < FEWEST_POINTS or funnel.entry_points < FAIL_SHARE * max(funnel.matched, 1):
        return Verdict(
            grade="fail",
            reasons=(
                f"{funnel.entry_points} of {funnel.matched} matched pixels became points.",
                *_losses(maps, funnel, share=0.0),
            ),
            next_action="Look at the status map: it names the reason at each pixel. Check the display poses first.",
        )
    reasons = list(_losses(maps, funnel, share=LOST_SHARE))
    action = "Use the points; look at the sd map before you quote one of them."
    if gap_ratio is None:
        action = (
            "Use the points; this method states no uncertainty, so look at the gap map before you quote one of them."
        )
    matched = funnel.matched - int(np.count_nonzero(maps.status == PixelStatus.BESIDE_OBJECT))
    if funnel.entry_points < CHECK_SHARE * max(matched, 1):
        reasons.append(
            f"Only {funnel.entry_points / max(matched, 1):.0%} of the pixels matched on the object became points."
        )
        action = "Look at the status map and the gap map: is the loss where you need points?"
    if gap_ratio is not None and gap_ratio > CHECK_GAP_RATIO:
        reasons.append(
            f"The light paths miss each other {gap_ratio:.1f} times as far as noise explains: "
            "display or object moved between sets, or a pose is wrong."
        )
        action = "Check that neither display nor object moved when the tank was filled, and measure the poses again."
    if doubts:
        reasons.extend(doubts)
        action = (
            "Find out what is there before you use the points about it; where the object moved, photograph it again."
        )
    saturated = float(np.mean([photo.saturated_share > SATURATED_SHARE for photo in photos])) if photos else 0.0
    if saturated > 0:
        reasons.append(f"{saturated:.0%} of the photos are clipped over more than {SATURATED_SHARE:.0%} of their area.")
        action = "Shorten the exposure: a clipped stripe has lost its peak."
    if scene:
        more = f" (and {len(scene) - 1} more)" if len(scene) > 1 else ""
        reasons.append(f"{scene[0].removesuffix('.')}{more}.")
        action = "Look at the section Capture for what moved and what it costs; photograph the object again."
    if reasons:
        return Verdict(grade="check", reasons=tuple(reasons), next_action=action)
    fine = f"{funnel.entry_points} points; {funnel.entry_points / max(matched, 1):.1%} of the pixels matched on the object."
    if gap_ratio is not None:
        fine += f" Their light paths miss each other by {gap_ratio:.2f} times what noise explains (about 1 is good)."
    reasons = [fine, *((UNWATCHED,) if unwatched else ())]
    return Verdict(grade="pass", reasons=tuple(reasons), next_action=action)


def _losses(maps: Maps, funnel: Funnel, *, share: float) -> tuple[str, ...]:
    reasons = []
    for status in (
        PixelStatus.BAD_CODE,
        PixelStatus.BAD_FIT,
        PixelStatus.TWO_PATHS,
        PixelStatus.SWEEP_EDGE,
        PixelStatus.PARALLEL_PATHS,
        PixelStatus.GAP_TOO_LARGE,
        PixelStatus.OUTSIDE_DEPTH,
    ):
        count = int(np.count_nonzero(maps.status == status))
        if count > share * max(funnel.lit, 1) and count > 0:
            reasons.append(f"{count / max(funnel.lit, 1):.0%} of the lit pixels have no point: {REASONS[status]}.")
    covered = int(np.count_nonzero(maps.status == PixelStatus.COVERED))
    if covered > share * max(funnel.lit, 1) and covered > 0:
        reasons.append(
            f"{covered / max(funnel.lit, 1):.0%} of the lit pixels have no measurement of their own: the surface about them "
            "covers them."
        )
    return tuple(reasons)


def gap_ratio(gap_mm: np.ndarray, gap_sd_mm: np.ndarray) -> float | None:
    """Return the median of |gap| over its sd, scaled so that Gaussian noise gives 1; None without any."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(gap_mm) / gap_sd_mm
    ratio = ratio[np.isfinite(ratio)]
    return float(1.4826 * np.median(ratio)) if len(ratio) else None


def statistic(name: str, unit: str, values: np.ndarray, *, how: str) -> Statistic | None:
    """Return mean, median, rms and 95th percentile of the finite values; None where there are none."""
    finite = values[np.isfinite(values)].astype(np.float64)
    if len(finite) == 0:
        return None
    return Statistic(
        name=name,
        unit=unit,
        mean=float(finite.mean()),
        median=float(np.median(finite)),
        rms=float(np.sqrt((finite**2).mean())),
        p95=float(np.percentile(finite, 95)),
        how=how,
    )
