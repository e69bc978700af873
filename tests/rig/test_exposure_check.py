"""Every photo proves that it was exposed as its set, and every set that it was begun with the settings of the others."""

import io
import json
from pathlib import Path

import pytest
from faults_page import OperatorReads
from PIL import Image

from drivers.errors import DeviceProtocolError
from drivers.protocols import Photo
from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.capturing.exposure_check import Exposure, check_exposure, exposure_of_jpeg, exposure_of_settings
from rig.devices import Devices
from rig.errors import CaptureError

# What libgphoto2 calls the same exposure on an EOS, on a generic camera and on a Nikon.
SAME = [
    {"shutterspeed": "1/4", "aperture": "8", "iso": "100"},
    {"shutterspeed": "0.2500s", "f-number": "f/8", "iso": "100"},
    {"shutterspeed": "0.2500s", "f-number": "f/8.0", "iso": "100"},
    {"shutter": "1/4", "aperture": "8", "iso": "100"},
]


def photo(time_s: float | None, *, f_number: float = 8.0, iso: int = 100) -> tuple[Photo, ...]:
    """A JPEG whose Exif was written by Pillow; without any where there is no time."""
    exif = Image.Exif()
    if time_s is not None:
        exif.get_ifd(0x8769).update({0x829A: time_s, 0x829D: f_number, 0x8827: iso})
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "jpeg", exif=exif)
    return (Photo(file.getvalue(), ".jpg"),)


@pytest.mark.parametrize("settings", SAME)
def test_settings_are_read_as_cameras_write_them(settings: dict[str, str]) -> None:
    assert exposure_of_settings(settings) == Exposure(0.25, 8.0, 100.0)


def test_what_is_no_number_is_not_known() -> None:
    assert exposure_of_settings({"shutterspeed": "bulb", "aperture": "implicit auto", "iso": "Auto"}) == Exposure(
        None, None, None
    )


@pytest.mark.parametrize(
    ("shutterspeed", "written_s"),
    # The times between which cameras round: full stops are powers of two, which they write in round numbers.
    [("1/4", 0.25), ("1/60", 1 / 64), ("1/15", 1 / 16), ("30", 32.0), ("0.3", 0.315), ("1/1000", 1 / 1024)],
)
def test_a_camera_that_rounds_is_right(shutterspeed: str, written_s: float) -> None:
    check_exposure(photo(written_s), {"shutterspeed": shutterspeed, "aperture": "8", "iso": "100"}, name="photo")


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        (photo(0.2), "an exposure time of 0.2 s, its set was begun with 0.25 s"),
        (photo(0.5), "an exposure time of 0.5 s"),
        (photo(0.25, f_number=9.0), "an f-number of 9, its set was begun with 8"),
        (photo(0.25, iso=125), "an ISO sensitivity of 125, its set was begun with 100"),
    ],
)
def test_a_third_of_a_stop_is_noticed(found: tuple[Photo, ...], sentence: str) -> None:
    with pytest.raises(DeviceProtocolError, match=f"photo pos0_air x 3 has {sentence}"):
        check_exposure(found, SAME[0], name="photo pos0_air x 3")


def test_what_the_file_does_not_tell_is_not_compared() -> None:
    check_exposure(photo(None), SAME[0], name="photo")
    check_exposure((Photo(b"II*\0", ".cr2"), Photo(b"\xff\xd8 broken \xff\xd9", ".jpg")), SAME[0], name="photo")
    check_exposure(photo(0.5), {}, name="photo")


# Through a capture


def events(folder: Path, name: str) -> list[dict[str, object]]:
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()]
    return [line for line in lines if line["event"] == name]


def run(config, scene, devices: Devices, folder: Path, quiet, *, resume: bool = False) -> None:
    capture(config, folder, devices=devices, scene=scene, resume=resume, console=quiet)


def test_each_set_begins_with_its_settings_read_back_and_each_photo_tells_them(
    config, scene, open_bench, quiet, tmp_path: Path
) -> None:
    with open_bench(config, scene) as (devices, _):
        run(config, scene, devices, tmp_path / "s", quiet)
        settings = devices.camera.settings()
    frozen = events(tmp_path / "s", "camera_frozen")
    assert [line["set"] for line in frozen] == ["pos0_air", "pos1_air", "pos1_liquid", "pos0_liquid"]
    assert all(line["settings"] == settings for line in frozen)
    for record in open_session(tmp_path / "s").photos.values():
        data = (tmp_path / "s" / record.file).read_bytes()
        assert exposure_of_jpeg(data) == exposure_of_settings(settings) == Exposure(0.25, 8.0, 100.0)


def test_a_photo_taken_with_a_turned_dial_is_taken_again(config, scene, open_bench, quiet, tmp_path: Path) -> None:
    with open_bench(config, scene) as (devices, _):
        devices.camera.dial_turned = 2
        run(config, scene, devices, tmp_path / "s", quiet)
    spoiled = events(tmp_path / "s", "photo_spoiled")
    assert [(line["index"], line["attempt"]) for line in spoiled] == [(0, 1), (0, 2)]
    assert "keep hands off the camera's dials" in str(spoiled[0]["reason"])


def test_a_dial_that_stays_turned_ends_in_one_sentence(
    operator_reads: OperatorReads, config, scene, open_bench, quiet, tmp_path: Path
) -> None:
    with open_bench(config, scene) as (devices, _):
        devices.camera.dial_turned = 1000
        with operator_reads.raised(DeviceProtocolError):
            run(config, scene, devices, tmp_path / "s", quiet)
        assert open_session(tmp_path / "s").photos == {}
        devices.camera.dial_turned = 0
        run(config, scene, devices, tmp_path / "s", quiet, resume=True)


def test_a_set_with_other_settings_than_those_before_is_not_begun(
    operator_reads: OperatorReads, config, scene, open_bench, quiet, tmp_path: Path
) -> None:
    with open_bench(config, scene) as (devices, _):
        devices.camera.dial_turned = 1000
        with pytest.raises(DeviceProtocolError):
            run(config, scene, devices, tmp_path / "s", quiet)
    with open_bench(config, scene) as (devices, _):  # the next day
        devices.camera.apply_settings({"iso": "200"})
        with operator_reads.raised(CaptureError):
            run(config, scene, devices, tmp_path / "s", quiet, resume=True)
