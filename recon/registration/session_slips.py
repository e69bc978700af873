"""A session registered by itself: how its display slipped in its plane when the tank was filled, and the poses that follow."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.calibration.significance import equivalent_sigma
from recon.geometry.light_paths import LightPaths, light_paths, nearer_first
from recon.registration.gap_fit import GapFit, MotionCovariance, Motions, Shifts, fit_motions
from recon.registration.in_plane import moved_in_plane, shifts_by_motion
from recon.sessions.manifest import Manifest, Pose

# How far a display may slip in its plane, where no calibration says better: a tablet in its holder.
SLIP_SD_MM = 2.0
SLIP_SD_RAD = 0.02
# One session in 16,000 that did not slip is corrected, by as little as its noise.
SIGNIFICANT_SIGMA = 4.0
# A slip of the display parts all paths by one law. Where a motion leaves gaps that whole patches share, and more than this part
# of their mean square before, they have another cause, and the poses stay as they are.
SOUND_SHARED_GAP = 3.0
LARGEST_SHARE_LEFT = 0.5
# A position is spoken of where it moved at all.
TOLD_SIGMA = 3.0
MOST_PIXELS = 20_000
FEWEST_PIXELS = 500
BANDS_A_SIDE = 24
SAMPLE_SEED = 2018

Places = Float64[np.ndarray, "pixels 2"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlaces:
    """Where the pixels ``pixels`` (flat indices) look in each set, in screen mm, with sd: by set name, [pixels, 2]."""

    pixels: np.ndarray
    screen_mm: Mapping[str, Places]
    sd_mm: Mapping[str, Places]


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The motions of the two displays between air and liquid, and whether they were taken over.

    ``covariance`` is nought where nothing was taken over: the poses then stay as they were given. ``conflict_sigma`` is how
    surely the motions contradict what was known before, 0 where no calibration is known.
    """

    fit: GapFit
    sigma: float
    applied: bool
    conflict_sigma: float = 0.0

    @property
    def motions(self) -> Motions:
        """The motions that were taken over, nought where none was."""
        return self.fit.motions if self.applied else np.zeros(6)

    @property
    def covariance(self) -> MotionCovariance:
        """The covariance of the motions that were taken over."""
        return self.fit.covariance if self.applied else np.zeros((6, 6))

    def sentences(self, unit: str) -> tuple[str, ...]:
        """Say what was corrected, one sentence a position, and what contradicts a calibration."""
        if not self.applied:
            return ()
        found = [
            _sentence(position, self.fit, unit) for position in (0, 1) if _part_sigma(self.fit, position) > TOLD_SIGMA
        ]
        if self.conflict_sigma > SIGNIFICANT_SIGMA:
            found.append(
                f"The slip contradicts the calibration ({self.conflict_sigma:.0f} sd): the display moved after it was measured, "
                "or the object did; calibrate again with the tank filled."
            )
        return tuple(found)


def register(
    places: MeasuredPlaces, manifest: Manifest, *, known: MotionCovariance | None = None
) -> Registration | None:
    """Measure how the display slipped between air and liquid; None where too few pixels have all their places.

    ``known`` is the covariance of the slips that a calibration with wet poses leaves; without it they may be a tablet's in
    its holder.
    """
    n_liquid = manifest.n_liquid()
    if len(places.pixels) < FEWEST_PIXELS:
        return None
    sample = sample_of(len(places.pixels))
    columns = manifest.camera.columns
    row, column = np.divmod(places.pixels[sample], columns)
    bands = np.column_stack([row * BANDS_A_SIDE // manifest.camera.rows, column * BANDS_A_SIDE // columns])
    air = paths_of(places, manifest, "air", sample, n_medium=manifest.n_air)
    before = wet_poses(manifest)

    def liquid_after(motions: Motions) -> LightPaths:
        return paths_of(places, registered(manifest, motions), "liquid", sample, n_medium=n_liquid)

    def shifts(paths: LightPaths) -> Shifts:
        return motion_shifts(paths, before)

    fit = fit_motions(liquid_after, shifts, air, known=_wide() if known is None else known, bands=bands)
    if not fit.directions.shape[1]:
        return Registration(fit, 0.0, applied=False)
    root = np.linalg.cholesky(_wide() if known is None else known)
    place = fit.directions.T @ np.linalg.solve(root, fit.motions)
    inner = fit.directions.T @ np.linalg.solve(root, np.linalg.solve(root, fit.covariance).T) @ fit.directions
    sigma = equivalent_sigma(place, inner)
    conflict = 0.0 if known is None else equivalent_sigma(place, inner + np.eye(len(place)))
    applied = sigma > SIGNIFICANT_SIGMA and explains_gaps(fit)
    return Registration(fit, sigma, applied=applied, conflict_sigma=conflict)


def explains_gaps(fit: GapFit) -> bool:
    """Tell whether the motions take away what gaps have in common within patches, as far as that is more than a little."""
    left, before = fit.shared_after, fit.shared_before
    return left < SOUND_SHARED_GAP or left**2 < LARGEST_SHARE_LEFT * before**2


def registered(manifest: Manifest, motions: Motions) -> Manifest:
    """Return the manifest with the displays of the sets in liquid moved in their planes."""
    sets = tuple(
        one.model_copy(
            update={"pose": moved_in_plane(manifest.pose_of(one), motions[3 * one.position : 3 * one.position + 3])}
        )
        if one.condition == "liquid"
        else one
        for one in manifest.sets
    )
    return manifest.model_copy(update={"sets": sets})


def wet_poses(manifest: Manifest) -> tuple[Pose, Pose]:
    """Return where the display stood in liquid, at positions 0 and 1."""
    first, second = (manifest.pose_of(manifest.set_named(f"pos{position}_liquid")) for position in (0, 1))
    return first, second


def motion_shifts(paths: LightPaths, poses: tuple[Pose, Pose]) -> Shifts:
    """Return how far near and far display points move for each of the six numbers of the two poses' motions."""
    by_place = []
    for position, points in zip(nearer_first(poses), (paths.near_mm, paths.far_mm), strict=True):
        whole = np.zeros((len(points), 3, 6))
        whole[:, :, 3 * position : 3 * position + 3] = shifts_by_motion(points, poses[position])
        by_place.append(whole)
    return by_place[0], by_place[1]


def paths_of(
    places: MeasuredPlaces, manifest: Manifest, condition: str, sample: np.ndarray, *, n_medium: float
) -> LightPaths:
    """Return the light paths of some of the pixels in one condition."""
    names = [f"pos{position}_{condition}" for position in (0, 1)]
    first, second = (manifest.pose_of(manifest.set_named(name)) for name in names)
    return light_paths(
        (places.screen_mm[names[0]][sample], places.screen_mm[names[1]][sample]),
        (places.sd_mm[names[0]][sample], places.sd_mm[names[1]][sample]),
        (first, second),
        cover_glass=manifest.display.cover_glass,
        n_medium=n_medium,
    )


def sample_of(count: int) -> np.ndarray:
    """Return which of so many pixels are enough to tell motions by: all, or some drawn at random, in order."""
    if count <= MOST_PIXELS:
        return np.arange(count)
    return np.sort(np.random.default_rng(SAMPLE_SEED).choice(count, MOST_PIXELS, replace=False))


def _wide() -> MotionCovariance:
    return np.diag(np.square([SLIP_SD_MM, SLIP_SD_MM, SLIP_SD_RAD] * 2))


def _part_sigma(fit: GapFit, position: int) -> float:
    """Return how sure it is that the display moved at one position, in standard deviations."""
    part = slice(3 * position, 3 * position + 3)
    variance = np.diag(fit.covariance)[part]
    moved = variance > 0
    return float(np.sqrt((fit.motions[part][moved] ** 2 / variance[moved]).max(initial=0.0)))


def _sentence(position: int, fit: GapFit, unit: str) -> str:
    part = slice(3 * position, 3 * position + 3)
    moved, covariance = fit.motions[part], fit.covariance[part, part]
    shift = float(np.hypot(moved[0], moved[1]))
    towards = moved[:2] / shift if shift > 0 else np.array([1.0, 0.0])
    shift_sd = float(np.sqrt(towards @ covariance[:2, :2] @ towards))
    turn_deg, turn_sd_deg = np.degrees(moved[2]), np.degrees(np.sqrt(covariance[2, 2]))
    return (
        f"Liquid display at position {position} shifted by {shift:.3f} ± {shift_sd:.3f} {unit} in its plane and turned by "
        f"{turn_deg:.3f} ± {turn_sd_deg:.3f}°: corrected."
    )
