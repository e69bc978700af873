"""A thin object from two sets and a calibrated camera, beside four sets: both find what one refraction must give, by hand.

The cone of the paper, seen by a lens that distorts from a place beside its axis. What the method must find is computed here by
the law of sines, ray by ray; it is not the cone's own normal, since the flat back bends light too.
"""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scipy.ndimage import binary_dilation

from recon.errors import SessionError
from recon.evaluation.truth import load_truth
from recon.maps import Maps
from recon.run import decode_session
from recon.running.outcome import Outcome, reconstruct
from recon.running.settings import Settings
from recon.sessions.manifest import Manifest
from recon.sessions.session import Session, open_session
from recon.status import PixelStatus
from recon.surface.thin_stage import NEIGHBOURHOOD_PX
from rig.config import RigConfig
from rig.planning.plan import plan_capture, set_order, summarise
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session
from sim_backend.light_paths import look
from sim_backend.scene import Scene

SETTINGS = Settings(threads=2)
N_GLASS = 1.7
HEIGHT, RADIUS = 1.0, 4.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    scene = open_scene("thin_cone", SceneOptions(camera_columns=72, step_px=2.0))
    lens = {"distortion": (-0.8, 0.5, 2e-3, -1e-3, 0.0), "position_mm": (1.5, -1.0, -60.0)}
    # Turned towards the cone: the camera stands 1.4° and 1.0° beside its axis.
    turn, lean = np.arctan2(1.5, 60.0), np.arctan2(1.0, 60.0)
    about_y = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(lean), np.sin(lean)], [0, -np.sin(lean), np.cos(lean)]])
    axes = about_y @ about_x
    lens |= {"x_axis": tuple(map(float, axes[:, 0])), "y_axis": tuple(map(float, axes[:, 1]))}
    return scene.model_copy(update={"camera": scene.camera.model_copy(update=lens)})


@pytest.fixture(scope="module")
def four(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    folder = tmp_path_factory.mktemp("thin") / "four"
    config = config_of_scene(scene, SceneOptions(step_px=2.0))
    simulate_session(scene, config, folder, workers=2, console=Console(quiet=True))
    return open_session(folder)


@pytest.fixture(scope="module")
def outcomes(four: Session) -> tuple[Outcome, Outcome]:
    """The same photos with the object, once beside those without it, once beside the camera's calibration."""
    sweeps = decode_session(four, SETTINGS)
    manifest = four.manifest.model_dump()
    manifest["sets"] = [one for one in manifest["sets"] if one["condition"] == "with"]
    two = replace(four, manifest=Manifest.model_validate(manifest))
    with_object = {key: sweep for key, sweep in sweeps.items() if key[0].endswith("with")}
    return reconstruct(four, sweeps, SETTINGS), reconstruct(two, with_object, SETTINGS)


def bent(ray: np.ndarray, normal: np.ndarray, n_from: float, n_to: float) -> np.ndarray:
    """Turn rays in their plane of incidence by the law of sines; ``normal`` points against them."""
    cosine = -(ray * normal).sum(axis=1)
    sideways = ray + cosine[:, None] * normal
    length = np.linalg.norm(sideways, axis=1, keepdims=True)
    sideways = np.divide(sideways, length, out=np.zeros_like(sideways), where=length > 0)
    angle = np.arcsin(n_from / n_to * np.sin(np.arccos(cosine)))
    return np.sin(angle)[:, None] * sideways - np.cos(angle)[:, None] * normal


def one_refraction(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal that one refraction gives for each pixel [rows, cols, 3], and where the pixel sees the cone's side."""
    camera = scene.camera
    row, column = np.indices((camera.rows, camera.columns)).reshape(2, -1).astype(float)
    ray = look(camera, column, row)
    start = np.array(camera.position_mm)
    hit = start + ray * (-start[2] / ray[:, 2])[:, None]
    inside = bent(ray, np.tile([0.0, 0.0, -1.0], (len(ray), 1)), 1.0, N_GLASS)
    # On the cone x² + y² = (R/H)² (H − z)²: a quadratic in the way s, whose positive root nearer to the back it is.
    slope = RADIUS / HEIGHT
    a = (inside[:, :2] ** 2).sum(axis=1) - slope**2 * inside[:, 2] ** 2
    b = (hit[:, :2] * inside[:, :2]).sum(axis=1) + slope**2 * HEIGHT * inside[:, 2]
    c = (hit[:, :2] ** 2).sum(axis=1) - (slope * HEIGHT) ** 2
    s = (-b + np.sqrt(b * b - a * c)) / a
    place = hit + s[:, None] * inside
    radius = np.linalg.norm(place[:, :2], axis=1)
    normal = np.column_stack([place[:, :2] / radius[:, None] / slope, np.ones(len(ray))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outside = bent(inside, -normal, N_GLASS, 1.0)
    # n U − V with both towards the camera (Eq. 3), turned towards the display.
    found = -(N_GLASS * -ray - -outside)
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    shape = (camera.rows, camera.columns)
    # A pixel on the apex or the rim sees two sides at once.
    clear = (np.linalg.norm(hit[:, :2], axis=1) < 0.9 * RADIUS) & (radius > 0.15 * RADIUS)
    return found.reshape(*shape, 3), clear.reshape(shape)


def off_deg(maps: Maps, normal: np.ndarray, where: np.ndarray) -> np.ndarray:
    chosen = where & maps.valid()
    sine = np.linalg.norm(np.cross(maps.normal[chosen], normal[chosen]), axis=1)
    assert chosen.sum() > 0.9 * where.sum()
    assert ((maps.normal[chosen] * normal[chosen]).sum(axis=1) > 0).all()
    return np.degrees(np.arcsin(np.clip(sine, 0, 1)))


def test_two_sets_and_four_sets_find_the_normals_of_one_refraction(
    scene: Scene, outcomes: tuple[Outcome, Outcome]
) -> None:
    normal, clear = one_refraction(scene)
    four, two = outcomes
    # A place is known to a twentieth of a display pixel of 1/8: over a baseline of 10 that is 0.05°, over n − 1 of 0.7 a tenth.
    for outcome in (four, two):
        assert np.median(off_deg(outcome.maps, normal, clear)) < 0.1
    assert np.median(off_deg(two.maps, four.maps.normal, clear & four.maps.valid())) < 0.1


def test_what_lies_beside_the_object_is_told_apart_without_photos_of_it_alone(
    four: Session, outcomes: tuple[Outcome, Outcome]
) -> None:
    """Against the simulator's truth; within the window that both means are taken over, the rim belongs to the object."""
    truth = load_truth(four.folder)
    window = np.ones((NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX))
    away = ~binary_dilation(~truth.lit | truth.judged, structure=window)
    assert away.sum() > 1000
    for outcome in outcomes:
        beside = outcome.maps.status == PixelStatus.BESIDE_OBJECT
        assert not (beside & truth.judged).any()
        assert beside[away].mean() > 0.95


def test_a_result_says_where_its_visual_rays_came_from(outcomes: tuple[Outcome, Outcome]) -> None:
    four, two = outcomes
    assert "photographed without the object" in four.warnings[0]
    assert "calibrated camera" in two.warnings[0]


def test_two_sets_without_a_known_camera_are_refused_with_what_is_missing(four: Session) -> None:
    sets = tuple(one for one in four.manifest.sets if one.condition == "with")
    camera = four.manifest.camera.model_copy(update={"intrinsics": None})
    unknown = replace(four, manifest=four.manifest.model_copy(update={"sets": sets, "camera": camera}))
    sweeps = decode_session(unknown, SETTINGS)
    with pytest.raises(
        SessionError, match=r"whose pose or lens is not known; give camera\.pose and camera\.intrinsics"
    ):
        reconstruct(unknown, sweeps, SETTINGS)


def test_a_calibrated_rig_plans_two_sets_where_it_is_asked_to(scene: Scene) -> None:
    asked = config_of_scene(scene, SceneOptions(visual_rays="camera"))
    assert set_order(asked) == ((1, "with"), (0, "with"))
    summary = summarise(plan_capture(asked), asked)
    assert (summary.sets, summary.questions) == (2, 1)
    assert 2 * summary.photos == summarise(plan_capture(config_of_scene(scene, SceneOptions())), asked).photos
    lensless = asked.model_dump() | {"camera": asked.camera.model_dump() | {"intrinsics": None}}
    with pytest.raises(ValueError, match=r"capture\.visual_rays takes them from the camera: add the sections"):
        RigConfig.model_validate(lensless)
