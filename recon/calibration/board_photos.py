"""A session's own photos of a board on the display: which corners each set shows directly, past the object.

A corner that is seen through the object is somewhere else than it seems. Three nets catch it, each by itself enough for most:

1. it does not fit one smooth map from the board to the photo (:mod:`recon.calibration.detection`);
2. the session's own sweeps show that light is bent there: dry, it does not run from one display position to the other and on to
   the camera, or it comes through only when wet (:func:`bent_pixels`). What the camera sees directly when dry it sees wet through
   the liquid's flat surface alone;
3. it is off the exact path, refraction at liquid and cover glass included, by more than the other corners' scatter allows
   (:mod:`recon.calibration.bundle`).

What no photo can tell is a plane-parallel sheet: it shifts the picture as a slip of the display does.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from jaxtyping import Bool
from scipy.ndimage import binary_fill_holes, find_objects, label

from recon.calibration.board import BOARD, board_on
from recon.calibration.bundle import FEWEST_CORNERS
from recon.calibration.detection import BoardView, detect_board, outside
from recon.geometry.beside import straight_paths
from recon.geometry.light_paths import light_paths
from recon.patterns.sweep_frames import screen_mm
from recon.reconstruct import PARABOLA_SD_PX
from recon.sessions.manifest import Axis, CaptureSet, Manifest
from recon.sessions.pattern import GrayLinePattern, PhaseShiftPattern, StripePattern
from recon.sessions.photos import read_grey
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.set_places import Correspondences, SweepResults, combined_status, correspondences

Views = Mapping[str, tuple[BoardView, ...]]
AXES: tuple[Axis, Axis] = ("x", "y")
DRY_SETS = ("pos0_air", "pos1_air")
# A corner is measured over a window of up to this many pixels to each side; none of them may be bent.
LARGEST_MARGIN_PX = 12


def has_board_photos(session: Session) -> bool:
    """Tell whether a session holds photos of a board, and says which one."""
    return session.manifest.board is not None and any(key[1] == BOARD for key in session.photos)


def board_views(session: Session, *, threads: int = 0) -> dict[str, tuple[BoardView, ...]]:
    """Return what every photo of the board shows, by set; ``board_mm`` of the views are screen mm."""
    manifest = session.manifest
    assert manifest.board is not None, "only a session that says which board was shown has views of it"
    board = board_on(manifest.display, manifest.board)
    camera = manifest.camera
    keys = sorted(key for key in session.photos if key[1] == BOARD)

    def view_of(key: tuple[str, str, int]) -> BoardView:
        path = session.photo_file(*key)
        counts = read_grey(path, rows=camera.rows, cols=camera.columns, primary=manifest.display.primary)
        return detect_board(counts, board, name=f"{key[0]} {key[2]}")

    with ThreadPoolExecutor(threads or None) as pool:
        found = list(pool.map(view_of, keys))
    names = dict.fromkeys(key[0] for key in keys)
    return {name: tuple(view for key, view in zip(keys, found, strict=True) if key[0] == name) for name in names}


def bent_pixels(
    sweeps: SweepResults, manifest: Manifest, *, margin_px: int = LARGEST_MARGIN_PX
) -> Bool[np.ndarray, "rows cols"]:
    """Return the pixels whose light does not come straight from the display when the tank is dry, with a margin.

    With them go what they enclose, and pixels next to them that see the display in liquid only, as where glass reflects totally
    when dry. A pixel that no sweep reached counts as straight: only the other nets judge it. The manifest's dry poses and its
    camera's place are relied on to a tenth of a degree.
    """
    camera = manifest.camera
    shape = (camera.rows, camera.columns)
    assert camera.pose is not None, "straight rays are those towards a camera whose place is known"
    sets = [manifest.set_named(name) for name in DRY_SETS]
    seen_dry = combined_status(sweeps, sets) == PixelStatus.OK
    pixels = np.flatnonzero(seen_dry)
    inside = np.logical_and.reduce(
        [_within_sweeps(correspondences(sweeps, one, manifest, pixels), one, manifest) for one in sets]
    )
    seen_dry[pixels] = inside
    pixels = pixels[inside]
    bent = np.zeros(shape, dtype=bool)
    if len(pixels):
        found = [correspondences(sweeps, one, manifest, pixels) for one in sets]
        paths = light_paths(
            (found[0].screen_mm, found[1].screen_mm),
            (_sd_mm(found[0], sets[0], manifest), _sd_mm(found[1], sets[1], manifest)),
            (manifest.pose_of(sets[0]), manifest.pose_of(sets[1])),
            cover_glass=manifest.display.cover_glass,
            n_medium=manifest.n_air,
        )
        sd_rad = np.sqrt(np.trace(paths.direction_covariance(), axis1=1, axis2=2))
        centre_mm = np.array(camera.pose.centre_mm)
        bent.ravel()[pixels[~straight_paths(paths, centre_mm, sd_rad, pixels=pixels, shape=shape)]] = True
    within = filled(closed(bent, margin_px))
    wet = [one for one in manifest.sets if one.condition == "liquid"]
    only_wet = np.any(
        [np.all([sweeps[one.name, axis].status == PixelStatus.OK for axis in AXES], axis=0) for one in wet], axis=0
    )
    regions, _ = label(closed(within | (only_wet & ~seen_dry.reshape(shape)), margin_px))
    # At the edges of what was swept, away from the object, pixels see the display in one medium only as well.
    of_object = np.isin(regions, np.unique(regions[within])) & (regions > 0)
    return cv2.dilate(of_object.astype(np.uint8), _disk(margin_px)).astype(bool)


def seen_directly(views: Views, region: Bool[np.ndarray, "rows cols"]) -> dict[str, tuple[BoardView, ...]]:
    """Return the views with only the corners that lie outside a region of the photo."""
    return {name: tuple(outside(view, region) for view in ones) for name, ones in views.items()}


def closed(region: Bool[np.ndarray, "rows cols"], reach_px: int) -> Bool[np.ndarray, "rows cols"]:
    """Return a region with gaps of up to twice the reach closed, such as the dark outline of an object."""
    return cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_CLOSE, _disk(reach_px)).astype(bool)


def filled(region: Bool[np.ndarray, "rows cols"]) -> Bool[np.ndarray, "rows cols"]:
    """Return a region with its holes, as the middle of a lens is one; a hole larger than what surrounds it stays one."""
    parts, _ = label(region)
    whole = region.copy()
    for number, box in enumerate(find_objects(parts), start=1):
        part = parts[box] == number
        hole = binary_fill_holes(part) & ~part
        if np.count_nonzero(hole) < np.count_nonzero(part):
            whole[box] |= hole
    return whole


def corner_reach_px(views: Views, manifest: Manifest) -> int:
    """Return how far from a corner the photo is used to measure it, at most: half the margin between corner and marker."""
    assert manifest.board is not None, "only a session that says which board was shown has views of it"
    square_mm = manifest.board.square_px * manifest.display.pitch_mm
    scales = [_px_per_mm(view) for ones in views.values() for view in ones if len(view.corner) >= FEWEST_CORNERS]
    if not scales:
        return LARGEST_MARGIN_PX
    reach_px = 0.5 * (1 - manifest.board.marker_share) * square_mm * max(scales)
    return int(np.clip(np.ceil(reach_px), 2, LARGEST_MARGIN_PX))


def _px_per_mm(view: BoardView) -> float:
    return float(np.ptp(view.place_px, axis=0).max() / np.ptp(view.board_mm, axis=0).max())


def _within_sweeps(found: Correspondences, capture_set: CaptureSet, manifest: Manifest) -> Bool[np.ndarray, " pixels"]:
    """Return which pixels look far enough inside the swept area: the profile of a stripe at its edge is cut, and biased."""
    inside = np.ones(len(found.screen_mm), dtype=bool)
    for number, axis in enumerate(AXES):
        first_px, last_px, blur_px = _reach(capture_set.sweep(axis).pattern)
        low_mm, high_mm = screen_mm(np.array([first_px + blur_px, last_px - blur_px]), axis, manifest.display)
        with np.errstate(invalid="ignore"):
            inside &= (found.screen_mm[:, number] >= low_mm) & (found.screen_mm[:, number] <= high_mm)
    return inside


def _sd_mm(found: Correspondences, capture_set: CaptureSet, manifest: Manifest) -> np.ndarray:
    """Return how well places on the display are known; the usual scatter of a parabola's vertex where the method does not say."""
    patterns = [capture_set.sweep(axis).pattern for axis in AXES]
    steps_px = np.array([1.0 if isinstance(one, PhaseShiftPattern) else one.step_px for one in patterns])
    return np.where(np.isfinite(found.sd_mm), found.sd_mm, PARABOLA_SD_PX * steps_px * manifest.display.pitch_mm)


def _reach(pattern: StripePattern | GrayLinePattern | PhaseShiftPattern) -> tuple[float, float, float]:
    """Return the first and the last place that a pattern reaches, and how far from them its reading is good again."""
    if isinstance(pattern, PhaseShiftPattern):
        return pattern.first_px, pattern.last_px, pattern.periods_px[-1]
    places = pattern.count if isinstance(pattern, StripePattern) else pattern.places
    return pattern.first_px, pattern.first_px + (places - 1) * pattern.step_px, pattern.width_px


def _disk(radius_px: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1, 2 * radius_px + 1))
