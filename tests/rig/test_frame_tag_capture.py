"""The frame tag through a capture: every photo proves which frame it shows, and a photo of another frame is not kept."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import simplejpeg
from rich.console import Console

from drivers.protocols import DeviceInfo, Frame, Photo
from recon.patterns.frame_tag import LARGEST_NUMBER, TagPlace, tag_levels
from recon.patterns.frame_tag_reading import find_tag
from recon.sessions.journal import read_journal, read_photos
from rig.by_hand.display_cli import tag as tag_command
from rig.capturing.capture import capture
from rig.capturing.frames import frame_of
from rig.config import RigConfig, parse_config
from rig.devices import Devices
from rig.errors import CaptureError, ConfigError
from rig.planning.plan import all_photos, set_name, set_order
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import take
from sim_backend.photography import Photographer
from sim_backend.scene import Scene
from sim_backend.world import World

PANEL = 64
ENLARGED = 2  # photo pixels a device pixel, for the camera that looks straight at the panel
OPTIONS = SceneOptions(display_columns=PANEL, camera_columns=ENLARGED * PANEL, step_px=8.0, width_px=8.0)
SWEPT = {"first_column_px": 40, "last_column_px": 56, "first_row_px": 40, "last_row_px": 56}
TAG = {"column": 2, "row": 3, "cell_px": 2, "seen_px": (0.0, 0.0, 70.0, 70.0)}


def with_tag(config: RigConfig, **changes: Any) -> RigConfig:
    data = config.model_dump() | {"frame_tag": TAG | changes}
    data["capture"]["swept"] = SWEPT
    return parse_config(data, source="test")


@pytest.fixture(scope="module")
def tag_scene() -> Scene:
    return open_scene("semi_ellipsoid", OPTIONS)


@pytest.fixture(scope="module")
def tag_config(tag_scene: Scene) -> RigConfig:
    return with_tag(config_of_scene(tag_scene, OPTIONS))


def panel_picture(frame: Frame) -> np.ndarray:
    """Draw a frame device pixel by device pixel."""
    assert frame.levels is not None
    shape = (PANEL, PANEL)
    picture = np.broadcast_to(frame.levels if frame.axis == "x" else frame.levels[:, None], shape).copy()
    for patch in frame.patches:
        rows, columns = patch.levels.shape
        picture[patch.row : patch.row + rows, patch.column : patch.column + columns] = patch.levels
    return picture


class StraightCamera:
    """Looks straight at the panel. ``see`` may spoil what it sees."""

    def __init__(self, world: World, see: Callable[[Frame, int], Frame] = lambda frame, _: frame) -> None:
        self._world = world
        self._see = see
        self._count = 0
        self._photo = b""

    def info(self) -> DeviceInfo:
        return DeviceInfo("simulated", "a camera that looks straight at the panel")

    def settings(self) -> dict[str, str]:
        return {}

    def apply_settings(self, settings: dict[str, str]) -> None:
        assert not settings

    def expose(self, *, timeout_s: float) -> None:  # noqa: ARG002
        frame = self._see(self._world.look().frame, self._count)
        self._count += 1
        picture = np.kron(panel_picture(frame), np.ones((ENLARGED, ENLARGED))) * 0.7 + 15
        self._photo = simplejpeg.encode_jpeg(
            np.round(picture).astype(np.uint8)[..., None], colorspace="GRAY", quality=92
        )

    def collect(self, *, timeout_s: float) -> tuple[Photo, ...]:  # noqa: ARG002
        return (Photo(self._photo, ".jpg"),)

    def keep_awake(self) -> None: ...


def run(config: RigConfig, folder: Path, devices: Devices, scene: Scene, *, resume: bool = False) -> int:
    return capture(config, folder, devices=devices, scene=scene, resume=resume, console=Console(quiet=True)).photos_done


def test_every_photo_of_a_capture_proves_its_frame(tag_config, tag_scene, open_bench, tmp_path: Path) -> None:
    with open_bench(tag_config, tag_scene) as (devices, world):
        done = run(tag_config, tmp_path / "s", replace(devices, camera=StraightCamera(world)), tag_scene)
    records = list(read_photos(tmp_path / "s/journal.jsonl"))
    assert done == len(records) == 4 * (2 + 3 + 3)
    for record in records:
        assert record.device["frame_tag"] == record.device["frame_id"]


def test_a_photo_of_the_frame_before_is_taken_again_at_once(tag_config, tag_scene, open_bench, tmp_path: Path) -> None:
    earlier: list[Frame] = []

    def late(frame: Frame, count: int) -> Frame:
        earlier.append(frame)
        return earlier[-2] if count == 5 else frame

    with open_bench(tag_config, tag_scene) as (devices, world):
        assert run(tag_config, tmp_path / "s", replace(devices, camera=StraightCamera(world, late)), tag_scene) == 32
    records = list(read_photos(tmp_path / "s/journal.jsonl"))
    # A photo is checked while the next one comes: that one is kept as well.
    assert [record.device["frame_tag"] for record in records] == [*range(5), 6, 5, *range(7, 32)]
    (spoiled,) = (entry for entry in read_journal(tmp_path / "s/journal.jsonl") if entry["event"] == "photo_spoiled")
    assert "it shows frame 4, frame 5 was commanded, so it was not saved" in spoiled["reason"]


def test_a_display_that_stays_behind_ends_the_capture_and_resuming_takes_what_is_missing(
    tag_config, tag_scene, open_bench, tmp_path: Path
) -> None:
    earlier: list[Frame] = []

    def late(frame: Frame, count: int) -> Frame:
        earlier.append(frame)
        return earlier[4] if count >= 5 else frame

    with open_bench(tag_config, tag_scene) as (devices, world):
        late_rig = replace(devices, camera=StraightCamera(world, late))
        with pytest.raises(CaptureError, match=r"it shows frame 4, frame 5 was commanded, so it was not saved; raise"):
            run(tag_config, tmp_path / "s", late_rig, tag_scene)
        assert len(list(read_photos(tmp_path / "s/journal.jsonl"))) == 5
        good_rig = replace(devices, camera=StraightCamera(world))
        assert run(tag_config, tmp_path / "s", good_rig, tag_scene, resume=True) == 32


def test_a_tag_that_cannot_be_read_stops_the_capture_with_a_sentence(
    tag_config, tag_scene, open_bench, tmp_path: Path
) -> None:
    def covered(frame: Frame, count: int) -> Frame:
        return replace(frame, patches=()) if count >= 3 else frame

    with open_bench(tag_config, tag_scene) as (devices, world):
        rig = replace(devices, camera=StraightCamera(world, covered))
        with pytest.raises(CaptureError, match=r"frame tag cannot be read.*look at what covers or darkens it"):
            run(tag_config, tmp_path / "s", rig, tag_scene)
    assert len(list(read_photos(tmp_path / "s/journal.jsonl"))) == 3


def test_without_a_place_in_the_photo_the_tag_is_shown_and_not_read(
    tag_scene, tag_config, open_bench, tmp_path: Path
) -> None:
    config = with_tag(tag_config, seen_px=None)

    def covered(frame: Frame, _: int) -> Frame:
        assert frame.patches
        return replace(frame, patches=())

    with open_bench(config, tag_scene) as (devices, world):
        assert run(config, tmp_path / "s", replace(devices, camera=StraightCamera(world, covered)), tag_scene) == 32
    assert all("frame_tag" not in record.device for record in read_photos(tmp_path / "s/journal.jsonl"))


def test_the_tag_is_seen_by_simulated_optics_in_all_four_sets_on_white_and_on_black() -> None:
    options = SceneOptions(display_columns=512, camera_columns=400, width_px=32.0, step_px=80.0)
    scene = open_scene("semi_ellipsoid", options)
    data = config_of_scene(scene, options).model_dump()
    data["capture"]["swept"] = {
        f"{end}_{side}_px": at for end, at in (("first", 160), ("last", 320)) for side in ("column", "row")
    }
    data["frame_tag"] = {"column": 26, "row": 26, "cell_px": 3}
    config = parse_config(data, source="test")
    photographer = Photographer(scene)
    for place in set_order(config):
        for photo in [photo for photo in all_photos(config) if photo.set_name == set_name(place)][:2]:
            grey = cv2.imdecode(np.frombuffer(take(photo, place, photographer, config), np.uint8), cv2.IMREAD_GRAYSCALE)
            assert grey is not None
            found = find_tag(grey)
            assert found is not None, photo
            assert found.number == photo.frame_id


def test_no_stripe_enters_the_square_of_the_tag(tag_config) -> None:
    place = tag_config.frame_tag.place
    square = (slice(place.row, place.row + place.side_px), slice(place.column, place.column + place.side_px))
    for photo in all_photos(tag_config):
        shown = panel_picture(frame_of(photo, tag_config))[square]
        np.testing.assert_array_equal(shown, tag_levels(photo.frame_id, cell_px=place.cell_px))


def test_numbers_begin_again_when_the_bits_are_used_up(tag_config) -> None:
    photo = replace(all_photos(tag_config)[0], frame_id=LARGEST_NUMBER + 8)
    (patch,) = frame_of(photo, tag_config).patches
    np.testing.assert_array_equal(patch.levels, tag_levels(7, cell_px=2))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"column": 30, "row": 30}, "lies in the swept area with its stripes; move it, or sweep less"),
        ({"column": 50}, "takes 24 × 24 device pixels from column 50, row 3; the display has 64 × 64"),
        ({"seen_px": (0.0, 0.0, 200.0, 50.0)}, "within photos of 128 × 128"),
        ({"seen_px": (50.0, 0.0, 20.0, 50.0)}, "give first column, first row, last column and last row"),
        ({"cell_px": 0}, "greater than 0"),
    ],
)
def test_a_tag_in_a_bad_place_is_refused(tag_config, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        with_tag(tag_config, **changes)


def test_a_tag_beside_the_swept_area_may_share_its_rows_or_its_columns(tag_config) -> None:
    # Stripes are centred at 40 to 56 and reach 4 pixels further: from column 36. The tag ends at column 35.
    beside = with_tag(tag_config, column=12, row=38)
    assert beside.frame_tag is not None
    assert beside.frame_tag.place == TagPlace(column=12, row=38, cell_px=2)
    with pytest.raises(ConfigError, match="swept area"):
        with_tag(tag_config, column=13, row=38)


def test_the_hand_command_finds_the_tag_and_says_what_to_configure(
    tag_config, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = np.kron(panel_picture(frame_of(all_photos(tag_config)[7], tag_config)), np.ones((4, 4), np.uint8))
    cv2.imwrite(str(tmp_path / "photo.png"), picture)
    tag_command(tmp_path / "photo.png")
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("frame 7, contrast ")
    # The tag is at columns 2 to 25 and rows 3 to 26, four photo pixels each: half its 96 pixels more on every side.
    seen_px = [float(number) for number in second.removeprefix("seen_px = [").removesuffix("]").split(",")]
    np.testing.assert_allclose(seen_px, [0, 0, 8 + 96 + 48, 12 + 96 + 48], atol=3)
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((50, 50), np.uint8))
    with pytest.raises(ConfigError, match="no frame tag was found"):
        tag_command(tmp_path / "black.png")
