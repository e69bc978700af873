"""The small motions of the two displays in liquid that let the light paths meet.

A pixel has eight measured numbers and seven unknowns, so its two light paths need not meet; by how much they miss, the gap,
tells of the displays, whatever the object. What is minimised is the gap over the standard deviation that noise gives it:
the gap alone grows with the angle between the paths and would be smallest for a wrong shape.

Unknown are three numbers a display (see :mod:`recon.registration.in_plane`). Motions that gaps hardly tell of stay nought: a
direction in the six numbers is moved along only where the gaps know it better than it was known before.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import eigh

from recon.geometry.entry_point import EntryPoints, entry_points
from recon.geometry.light_paths import LightPaths

# Three numbers of the display at position 0, then three at position 1.
Motions = Float64[np.ndarray, " 6"]
MotionCovariance = Float64[np.ndarray, "6 6"]
# Shifts of the near and of the far display's points for the six numbers, and the paths after a motion.
Shifts = tuple[Float64[np.ndarray, "pixels 3 6"], Float64[np.ndarray, "pixels 3 6"]]

MOST_ROUNDS = 30
SETTLED_SD = 0.01
# The gaps determine a direction if they know it this much better than it was known before.
DETERMINED_SHARE = 0.5
NORMAL_CONSISTENT_MAD = 1.4826
# Geman and McClure's loss (1987) with this width keeps 95 % of the efficiency of least squares for Gaussian noise.
LOSS_WIDTH_SD = 3.787
# Noise turns U×V, along which gaps are measured, and so fakes a response to motions that open no gap. A direction of which
# it makes more than this share is not determined; the motion found along the others is at most as wrong, as a share.
LARGEST_FAKED_SHARE = 0.05
# A patch's mean gap: of so many pixels at least, and without stray ones.
FEWEST_SHARING = 5
STRAY_SD = 5.0
# A pixel whose paths are so nearly parallel has no well-defined gap.
ANGLE_SIGMA = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class GapFit:
    """The motions found, with the covariance that the scatter of the gaps themselves gives them.

    ``directions`` [6, determined]: the directions in the six numbers that gaps determine, orthonormal in units of what was known
    before. ``gap_before`` and ``gap_after``: the gap in standard deviations, a robust rms, 1 where noise alone parts the paths.
    ``shared_before`` and ``shared_after``: what is alike within a patch, the rms of the patches' mean gaps over their own sds.
    """

    motions: Motions
    covariance: MotionCovariance
    directions: Float64[np.ndarray, "6 determined"]
    gap_before: float
    gap_after: float
    shared_before: float
    shared_after: float


def fit_motions(
    liquid_after: Callable[[Motions], LightPaths],
    shifts: Callable[[LightPaths], Shifts],
    air: LightPaths,
    *,
    known: MotionCovariance,
    bands: Int64[np.ndarray, "pixels 2"],
) -> GapFit:
    """Find the motions that minimise Σ (gap / its sd)², robustly (iteratively reweighted Gauss–Newton).

    Parameters
    ----------
    liquid_after : the paths in liquid after a motion of the two displays.
    shifts : how far the near and the far display's points move for each of the six numbers.
    air : the paths in air of the same pixels.
    known : covariance of the motions before any gap is looked at; its mean is nought.
    bands : the band of rows and the band of columns of the photo in which each pixel lies. Pixels of one see the same rows or
        columns of display pixels, lit by the same stripes, and err alike; the covariance is taken from the scatter between bands,
        so that they do not count as independent.
    """
    patch = bands[:, 0] * (int(bands[:, 1].max()) + 1) + bands[:, 1]
    root = np.linalg.cholesky(known)
    motions = np.zeros(6)
    before = _residuals(liquid_after(motions), air, shifts)
    basis = np.eye(6)
    # First with all six numbers, held by what was known before; then without the directions that gaps do not tell.
    for restricted in (False, True):
        if restricted:
            basis = _determined(_residuals(liquid_after(motions), air, shifts), root, bands)
            motions = root @ basis @ (basis.T @ np.linalg.solve(root, motions))
        for _ in range(MOST_ROUNDS if basis.shape[1] else 0):
            residuals = _residuals(liquid_after(motions), air, shifts)
            slopes = residuals.slopes @ root @ basis
            weight = residuals.weight
            information = (slopes * weight[:, None]).T @ slopes + np.eye(basis.shape[1])
            place = basis.T @ np.linalg.solve(root, motions)
            step = -np.linalg.solve(information, slopes.T @ (weight * residuals.normalised) + place)
            motions = motions + root @ basis @ step
            if (np.abs(step) * np.sqrt(np.diag(information))).max() < SETTLED_SD:
                break
    residuals = _residuals(liquid_after(motions), air, shifts)
    covariance = np.zeros((6, 6))
    if basis.shape[1]:
        inner = _band_covariance(residuals.slopes @ root @ basis, residuals, bands)
        inner = np.linalg.inv(np.linalg.inv(inner) + np.eye(len(inner)))
        covariance = root @ basis @ inner @ basis.T @ root.T
    shared = (_shared_gap(one, patch) for one in (before, residuals))
    return GapFit(motions, covariance, basis, before.rms, residuals.rms, *shared)


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Normalised gaps [pixels], each pixel's weight, and the gaps' robust rms, divided out of it.

    ``slopes`` [pixels, 6] is how the normalised gaps change with the motions, ``faked`` [2, pixels, 6] the sd of that from the
    noise of the path in liquid, then of that in air.
    """

    normalised: np.ndarray
    slopes: np.ndarray
    faked: np.ndarray
    weight: np.ndarray
    rms: float


def _residuals(liquid: LightPaths, air: LightPaths, shifts: Callable[[LightPaths], Shifts]) -> _Residuals:
    points = entry_points(liquid, air, weighted=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        normalised = points.gap_mm / points.gap_sd_mm
        used = np.isfinite(normalised) & (points.angle_rad > ANGLE_SIGMA * points.angle_sd_rad)
    normalised = np.where(used, normalised, 0.0)
    slopes, faked = _gap_slopes(liquid, air, points, shifts(liquid))
    slopes, faked = np.where(used[:, None], slopes, 0.0), np.where(used[:, None], faked, 0.0)
    rms = NORMAL_CONSISTENT_MAD * float(np.median(np.abs(normalised[used]))) if used.any() else 0.0
    scale = max(1.0, rms)
    weight = (1 + (normalised / (LOSS_WIDTH_SD * scale)) ** 2) ** -2 / scale**2
    return _Residuals(normalised, slopes, faked, np.where(used, weight, 0.0), rms)


def _shared_gap(residuals: _Residuals, patch: np.ndarray) -> float:
    """Return the rms over patches of their mean normalised gap, in units of what noise of each pixel by itself would leave."""
    used = residuals.weight > 0
    held = np.clip(residuals.normalised[used], -STRAY_SD, STRAY_SD)
    count = np.bincount(patch[used])
    several = count >= FEWEST_SHARING
    if not several.any():
        return 0.0
    total = np.bincount(patch[used], held)[several]
    return float(np.sqrt((total**2 / count[several]).mean()))


def _gap_slopes(
    liquid: LightPaths, air: LightPaths, points: EntryPoints, shifts: Shifts
) -> tuple[np.ndarray, np.ndarray]:
    """Return how the normalised gap changes with the six numbers: the liquid path at the crossing, along c = U×V/|U×V|.

    A line through two points, moved by d and e, is moved by (1 + a) d − a e beyond the near one, a the distance over the
    baseline. Terms of the order of gap times motion are left out: they vanish where the search ends. Noise δU turns c by
    −(c·δU) (V×c)/|U×V|, since c stays at right angles to U and V; δV likewise.
    """
    u, v = liquid.direction, air.direction
    cross = np.cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = np.linalg.norm(cross, axis=1, keepdims=True)
        common = cross / sine
        lever = (points.distance_liquid_mm / liquid.baseline_mm)[:, None, None]
        moved = (lever * shifts[1] - (1 + lever) * shifts[0]) / points.gap_sd_mm[:, None, None]
        faked = []
        for paths, turned in ((liquid, np.cross(v, common) / sine), (air, np.cross(common, u) / sine)):
            out_of_plane = paths.turn_variance_along(common)
            faked.append(np.sqrt(out_of_plane)[:, None] * np.einsum("pi,pim->pm", turned, moved))
    return np.einsum("pi,pim->pm", common, moved), np.stack(faked)


def _determined(residuals: _Residuals, root: np.ndarray, bands: np.ndarray) -> Float64[np.ndarray, "6 determined"]:
    """Return the directions, in units of what was known before, that gaps know better than that."""
    slopes, weight = residuals.slopes @ root, residuals.weight[:, None]
    strength, vectors = np.linalg.eigh((slopes * weight).T @ slopes)
    seen = vectors[:, strength > 1.0]
    faked = sum(((one @ root @ seen) * weight).T @ (one @ root @ seen) for one in residuals.faked)
    share, mixed = eigh(faked, np.diag(strength[strength > 1.0])) if seen.shape[1] else (np.zeros(0), np.zeros((0, 0)))
    sound, _ = np.linalg.qr(seen @ mixed[:, share < LARGEST_FAKED_SHARE])
    if not sound.shape[1]:
        return sound
    variance, turned = np.linalg.eigh(_band_covariance(slopes @ sound, residuals, bands))
    return sound @ turned[:, variance < DETERMINED_SHARE**2]


def _band_covariance(slopes: np.ndarray, residuals: _Residuals, bands: np.ndarray) -> np.ndarray:
    """Return the covariance of a least squares answer whose errors are alike within a band of rows and within one of columns.

    Two ways of clustering (Cameron, Gelbach and Miller 2011, equation 2.7). In no direction is it taken as better than either,
    patches of both, or independent pixels would make it.
    """
    weighted = slopes * residuals.weight[:, None]
    whiten = np.linalg.cholesky(np.linalg.inv(weighted.T @ slopes))
    pull = (weighted * residuals.normalised[:, None]) @ whiten
    row, column = bands.T
    by_row, by_column, by_patch = (
        _scatter(pull, group) for group in (row, column, row * (int(column.max()) + 1) + column)
    )
    most = np.eye(pull.shape[1])
    for one in (by_patch, by_row, by_column, by_row + by_column - by_patch):
        most = _larger(most, one)
    return whiten @ most @ whiten.T


def _scatter(pull: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the scatter of the groups' sums (Liang and Zeger 1986)."""
    groups = int(group.max()) + 1
    summed = np.stack([np.bincount(group, pull[:, k], groups) for k in range(pull.shape[1])], axis=1)
    return summed.T @ summed


def _larger(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the covariance that is no smaller than either of two in any direction, along the axes of both."""
    root = np.linalg.cholesky(first)
    inverse = np.linalg.inv(root)
    share, turned = np.linalg.eigh(inverse @ second @ inverse.T)
    along = root @ turned
    return (along * np.maximum(share, 1.0)) @ along.T
