"""``rig calibrate run``: from a simulated rig that nobody knows to a calibration that agrees with the simulator's truth."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from faults_page import OperatorReads
from scipy.stats import chi2

from drivers.errors import DeviceNotFoundError
from drivers.protocols import Photo
from recon.calibration.calibration_file import Calibration, read_calibration
from recon.calibration.errors import CalibrationError
from rig.calibrating.boards import printed_board
from rig.calibrating.calibration_steps import leave_out, lens_of_kept, photograph_lens, photograph_poses
from rig.calibrating.computation import compute_calibration
from rig.calibrating.guide import Guide
from rig.calibrating.hands import ConsoleHands
from rig.config import RigConfig, parse_config
from rig.errors import CaptureError, CaptureStopped, ConfigError
from rig.rehearsing.board_hand import SimulatedHand
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.camera import SimulatedCamera
from sim_backend.scene import Scene

OPTIONS = SceneOptions(camera_columns=400)
# The maker's pitch is off by a fifth of a per cent; only the stage's travel can tell.
PITCH_OFF, PITCH_SD = 1.002, 0.005
# One set of numbers in 100,000 is farther off than this.
CHANCE = 1e-5


@dataclass(frozen=True)
class Lab:
    scene: Scene
    config: RigConfig
    folder: Path
    said: list[str]

    def simulation(self) -> Simulation:
        return Simulation(self.scene, own_noise=True)

    def guide(self) -> None:
        Guide(
            self.folder,
            self.config,
            self.scene,
            self.simulation(),
            self.said.append,
            ready=lambda *steps: self.said.extend(f"· {step}" for step in steps),
            ask=lambda question: pytest.fail(question),
            response=False,
            wet=True,
            fill=True,
        ).run()


def lab_at(folder: Path) -> Lab:
    scene = open_scene("lab", OPTIONS)
    config = config_of_scene(scene, OPTIONS)
    given = config.calibrate.model_copy(update={"pitch_sd": PITCH_SD, "photos": 2})
    display = config.display.model_copy(update={"pitch_mm": config.display.pitch_mm * PITCH_OFF})
    return Lab(scene, config.model_copy(update={"calibrate": given, "display": display}), folder, [])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    lab = lab_at(tmp_path_factory.mktemp("lab") / "calibration")
    lab.guide()
    return lab


@pytest.fixture
def made(lab: Lab) -> Calibration:
    return read_calibration(lab.folder / "calibration.json")


def rotation_vector(turn: np.ndarray) -> np.ndarray:
    """Of a small turn."""
    return 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])


def assert_within(error: np.ndarray, covariance: np.ndarray) -> None:
    scale = np.sqrt(np.diag(covariance))
    distance = (error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale)
    assert distance < chi2.ppf(1 - CHANCE, len(error)), error / scale


def test_the_lens_is_that_of_the_scene_within_its_covariance(lab: Lab, made: Calibration) -> None:
    true, found = lab.scene.camera, made.camera.intrinsics
    error = np.array(
        [
            found.focal_x_px - true.focal_x_px,
            found.focal_y_px - true.focal_y_px,
            found.centre_x_px - true.centre_x_px,
            found.centre_y_px - true.centre_y_px,
            *(np.array(found.distortion) - np.array(true.distortion)),
        ]
    )
    assert_within(error, np.array(made.camera.covariance))


def test_all_four_poses_are_those_of_the_scene_within_their_covariance(lab: Lab, made: Calibration) -> None:
    """In the camera's frame, dry and wet: the simulated display does not slip."""
    camera_from_world = lab.scene.camera.world_from_camera().T
    errors = []
    for name, pose in made.poses.items():
        true = lab.scene.display_pose_at(lab.scene.stage_positions_mm[int(name[3])])
        axes = camera_from_world @ np.column_stack([true.x_axis, true.y_axis, true.away()])
        centre_mm = camera_from_world @ (true.centre_mm - np.array(lab.scene.camera.position_mm))
        found = pose.world_from_screen()
        errors.append(np.concatenate([rotation_vector(found[:3, :3] @ axes.T), found[:3, 3] - centre_mm]))
    assert list(made.poses) == ["pos0_air", "pos1_air", "pos0_liquid", "pos1_liquid"]
    assert_within(np.concatenate(errors), made.pose_covariance())


def test_the_pitch_is_the_true_one_and_not_the_makers(lab: Lab, made: Calibration) -> None:
    assert made.quality.pitch_sd_share is not None
    sd_mm = made.quality.pitch_sd_share * made.display.pitch_mm
    error_mm = made.display.pitch_mm - lab.scene.display.pitch_mm
    assert abs(error_mm) < 4.5 * sd_mm
    assert sd_mm < 0.8 * PITCH_SD * made.display.pitch_mm  # the photos have told something


def test_the_file_tells_its_photos_and_what_its_error_means(made: Calibration) -> None:
    assert len(made.provenance.photos) == made.camera.views + 8
    assert made.provenance.devices["camera"].kind == "simulated"
    quality = made.quality
    assert quality.fep_error_mm is not None
    assert quality.fep_shape_error_mm is not None
    assert quality.normal_error_deg is not None
    assert 0 < quality.fep_shape_error_mm < quality.fep_error_mm
    assert quality.corner_sd_px < 0.12


def without_numbers(line: str) -> str:
    """Return a line without what differs from lab to lab: numbers, places, layouts, the map, the folder."""
    line = re.sub(r"\S*/?(my-calibration|/calibration)\b", "DIR", line)
    line = re.sub(r"\[[■□ ]+\]|layout new|both layouts alike|parts of the photo: [a-z ,]+", "~", line)
    return re.sub(r"-?\d+(\.\d+)?", "0", line)


def test_the_how_to_shows_what_an_operator_reads(lab: Lab) -> None:
    """But for numbers, every line of the run that the page shows is said in this one."""
    page = (Path(__file__).parents[2] / "docs/how-to/calibrate.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```text\n(Step 1 of.*?)```", page, re.DOTALL)
    shown = [line for line in block.splitlines() if line and line != "…"]
    said = {without_numbers(line) for line in lab.said}
    assert len(shown) > 20
    verdicts = ("PASS", "CHECK", "FAIL")  # it falls with the size of the photos
    assert [line for line in shown if without_numbers(line) not in said and not line.startswith(verdicts)] == []


def test_what_is_done_is_kept_and_said_when_the_guide_is_run_again(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.calibrating.computation.compute_calibration", lambda folder, say: None)  # noqa: ARG005
    before = (lab.folder / "journal.jsonl").read_bytes()
    lab.said.clear()
    lab.guide()
    assert (lab.folder / "journal.jsonl").read_bytes() == before
    assert any(line.startswith("done: covered") for line in lab.said)
    assert "dry, done: 2 photos at each position" in lab.said
    assert "wet, done: 2 photos at each position" in lab.said


def test_a_changed_photo_is_refused_by_its_hash(operator_reads: OperatorReads, lab: Lab) -> None:
    path = lab.folder / "photos" / "poses_dry" / "0000.jpg"
    whole = path.read_bytes()
    path.write_bytes((lab.folder / "photos" / "poses_dry" / "0001.jpg").read_bytes())
    try:
        with operator_reads.raised(CaptureError):
            compute_calibration(lab.folder, lab.said.append)
    finally:
        path.write_bytes(whole)


def test_another_rig_is_refused_in_a_folder_that_was_begun(operator_reads: OperatorReads, lab: Lab) -> None:
    options = SceneOptions(camera_columns=320)
    scene = open_scene("lab", options)
    with operator_reads.raised(CaptureError):
        photograph_lens(lab.folder, config_of_scene(scene, options), simulation=Simulation(scene), say=lab.said.append)


def test_a_camera_that_goes_away_costs_no_photo_and_the_same_command_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = lab_at(tmp_path / "c")
    collect, photos = SimulatedCamera.collect, []

    def unplugged(camera: SimulatedCamera, *, timeout_s: float) -> tuple[Photo, ...]:
        if len(photos) == 2:
            raise DeviceNotFoundError("camera: nothing answers any more; look at its cable")
        photos.append(collect(camera, timeout_s=timeout_s))
        return photos[-1]

    monkeypatch.setattr(SimulatedCamera, "collect", unplugged)
    with pytest.raises(DeviceNotFoundError):
        photograph_lens(lab.folder, lab.config, simulation=lab.simulation(), say=lab.said.append)
    monkeypatch.setattr(SimulatedCamera, "collect", collect)
    poses = SimulatedHand.pose
    monkeypatch.setattr(
        SimulatedHand, "pose", lambda hand, number, advice: "done" if number == 3 else poses(hand, number, advice)
    )
    found = photograph_lens(lab.folder, lab.config, simulation=lab.simulation(), say=lab.said.append)
    assert [view.name for view in found.views] == ["0000", "0001", "0002"]
    assert any(line.startswith("2 photos are kept: covered") for line in lab.said)
    files = sorted(path.name for path in (lab.folder / "photos" / "camera").iterdir())
    assert files == ["0000.jpg", "0001.jpg", "0002.jpg"]


def test_a_display_that_stays_dark_ends_the_poses_in_one_sentence(
    operator_reads: OperatorReads, tmp_path: Path
) -> None:
    lab = lab_at(tmp_path / "c")
    dark = lab.scene.camera.model_copy(update={"signal": 0.01})
    scene = lab.scene.model_copy(update={"camera": dark}).resized(camera_columns=200)
    config = config_of_scene(scene, SceneOptions())
    with operator_reads.raised(CaptureError):
        photograph_poses(
            tmp_path / "c", config, wet=False, fill=False, simulation=Simulation(scene), say=lab.said.append
        )
    assert len(list((tmp_path / "c" / "photos" / "poses_dry").iterdir())) == 2  # tried twice, both kept


def test_a_shaken_photo_is_told_and_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lab = lab_at(tmp_path / "c")
    poses = SimulatedHand.pose

    def shaking(hand: SimulatedHand, number: int, advice: tuple[str, ...]) -> str:
        hand.swing_mm = (12.0, 0.0, 0.0)
        return "done" if number == 1 else poses(hand, number, advice)

    monkeypatch.setattr(SimulatedHand, "pose", shaking)
    found = photograph_lens(lab.folder, lab.config, simulation=lab.simulation(), say=lab.said.append)
    assert found.views == ()
    (line,) = (line for line in lab.said if line.startswith("! 0000"))
    assert "blurred" in line or "no board is seen" in line or "markers" in line


def test_dry_photos_are_refused_while_the_tank_holds_liquid_and_wet_ones_while_it_does_not(
    operator_reads: OperatorReads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = lab_at(tmp_path / "c")
    said = lab.said.append
    with operator_reads.raised(CaptureError):
        photograph_poses(lab.folder, lab.config, wet=True, fill=False, simulation=lab.simulation(), say=said)
    monkeypatch.setattr("rig.calibrating.pose_capture.learn_tank_ml", lambda devices, config: 4000.0)  # noqa: ARG005
    with operator_reads.raised(CaptureError):
        photograph_poses(lab.folder, lab.config, wet=False, fill=True, simulation=lab.simulation(), say=said)


def test_a_computation_without_photos_names_the_command_that_takes_them(
    operator_reads: OperatorReads, tmp_path: Path
) -> None:
    with operator_reads.raised(CaptureError):
        compute_calibration(tmp_path, [].append)


@pytest.fixture
def copy(lab: Lab, tmp_path: Path) -> Path:
    """The lab's folder, to be written to."""
    folder = tmp_path / "copy"
    shutil.copytree(lab.folder, folder)
    return folder


def test_a_view_that_is_left_out_takes_no_part(lab: Lab, copy: Path) -> None:
    with pytest.raises(CalibrationError, match="no photo of camera that counts is called 0099"):
        leave_out(copy, "camera", ["0099"])
    leave_out(copy, "camera", ["0003"])
    names = [view.name for view in lens_of_kept(copy, lab.config).views]
    assert "0002" in names
    assert "0003" not in names
    assert (copy / "photos" / "camera" / "0003.jpg").exists()


def test_the_letters_b_and_d_leave_out_the_last_photo_and_end(
    lab: Lab, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = [view.name for view in lens_of_kept(copy, lab.config).views]
    leave_out(copy, "camera", kept[-2:])
    typed = iter(["x", "b", "d"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda question: next(typed))  # noqa: ARG005
    monkeypatch.setattr("rig.calibrating.calibration_steps.hands_at", lambda devices, config, board: ConsoleHands())  # noqa: ARG005
    found = photograph_lens(copy, lab.config, simulation=lab.simulation(), say=lab.said.append)
    assert [view.name for view in found.views] == kept[:-3]
    assert [view.name for view in lens_of_kept(copy, lab.config).views] == kept[:-3]


def test_ctrl_c_ends_in_a_sentence_and_keeps_every_photo(lab: Lab, copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out(copy, "camera", [lens_of_kept(copy, lab.config).views[-1].name])
    before = sorted(path.name for path in (copy / "photos" / "camera").iterdir())

    def interrupted(*told: object) -> str:  # noqa: ARG001
        raise KeyboardInterrupt

    monkeypatch.setattr(SimulatedHand, "pose", interrupted)
    with pytest.raises(CaptureStopped, match="every photo so far is kept, and the same command goes on"):
        photograph_lens(copy, lab.config, simulation=lab.simulation(), say=lab.said.append)
    assert sorted(path.name for path in (copy / "photos" / "camera").iterdir()) == before


def test_nobody_at_the_terminal_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(CaptureError, match="a person has to answer"):
        ConsoleHands().pose(0, ())


def test_a_printed_board_that_nobody_measured_is_refused(lab: Lab) -> None:
    given = lab.config.calibrate.model_copy(update={"square_mm": None})
    with pytest.raises(ConfigError, match="measure the squares of the printed board with a caliper"):
        printed_board(lab.config.model_copy(update={"calibrate": given}))


def test_a_configuration_takes_its_boards_from_the_section_calibrate(config: RigConfig) -> None:
    data = config.model_dump(mode="json")
    data["calibrate"] = {"squares": [11, 8], "square_mm": 15.0, "board": "display"}
    read = parse_config(data, source="test")
    assert read.calibrate.squares == (11, 8)
    assert read.calibrate.board == "display"
