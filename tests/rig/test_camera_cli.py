"""``rig camera``: a photo, the settings and a preview by hand, from a simulated camera and from a real driver."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest
import simplejpeg

from sim_backend.ptpip.process import EmulatedCamera, emulate_camera
from sim_backend.ptpip.sources import drawn_photos

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def configure(tmp_path: Path) -> Callable[..., None]:
    """Return a function that writes the template with another camera, and with these camera settings."""

    def write(camera: str, *settings: str) -> None:
        text = resources.files("rig").joinpath("template.toml").read_text(encoding="utf-8")
        before = text
        text = text.replace('camera = ""', f'camera = "{camera}"').replace(
            "[camera.settings]", "\n".join(["[camera.settings]", *settings])
        )
        assert text != before
        (tmp_path / "rig.toml").write_text(text, encoding="utf-8")

    return write


@pytest.fixture
def eos():
    with emulate_camera(drawn_photos(), model="canon-eos-40d") as body:
        yield body


def test_a_simulated_photo_is_saved(rig: Run, tmp_path: Path) -> None:
    code, out, err = rig("camera", "snap", "photo.jpg", "--sim", "--times", "2")
    assert (code, err) == (0, "")
    assert "s a photo" in out
    simplejpeg.decode_jpeg_header((tmp_path / "photo.jpg").read_bytes())


def test_a_photo_comes_from_the_configured_camera_with_its_settings(
    rig: Run, configure: Callable[..., None], eos: EmulatedCamera, tmp_path: Path
) -> None:
    configure(f"gphoto2:{eos.address}", 'shutterspeed = "1/8"')
    code, out, err = rig("camera", "snap", "photo.jpg")
    assert (code, err) == (0, "")
    assert simplejpeg.decode_jpeg_header((tmp_path / "photo.jpg").read_bytes())[:2] == (432, 648)
    code, out, err = rig("camera", "settings", "iso=200")
    assert (code, err) == (0, "")
    assert out.startswith("Canon EOS 40D (emulated, ")
    assert 'shutterspeed = "1/8"\n' in out
    assert 'iso = "200"\n' in out
    code, out, err = rig("camera", "preview", "live.jpg")
    assert (code, err) == (0, "")
    simplejpeg.decode_jpeg_header((tmp_path / "live.jpg").read_bytes())


def test_a_photo_never_overwrites_a_file(rig: Run, tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_text("precious", encoding="utf-8")
    code, _, err = rig("camera", "snap", "photo.jpg", "--sim")
    assert code == 1
    assert "never overwritten" in err
    assert (tmp_path / "photo.jpg").read_text(encoding="utf-8") == "precious"


@pytest.mark.parametrize(
    ("camera", "sentence"),
    [
        ("", "no camera configured"),
        ("gphoto2", "no driver answers to 'gphoto2'"),
        ("gphoto2:/dev/ttyUSB0", "no driver answers to"),
        ("polaroid:usb:", "no driver answers to 'polaroid:usb:'"),
    ],
)
def test_a_camera_that_cannot_be_is_one_sentence(
    rig: Run, configure: Callable[..., None], camera: str, sentence: str
) -> None:
    configure(camera, "# none")
    code, _, err = rig("camera", "settings")
    assert code == 1
    assert sentence in err
    assert len(err.strip().splitlines()) == 1


def test_a_camera_that_is_not_there_is_one_sentence(rig: Run, configure: Callable[..., None]) -> None:
    with emulate_camera(drawn_photos()) as gone:
        address = gone.address
    configure(f"gphoto2:{address}")
    code, _, err = rig("camera", "snap", "photo.jpg")
    assert code == 1
    assert "nothing answers there" in err
    assert len(err.strip().splitlines()) == 1


def test_a_change_without_a_value_is_refused(rig: Run) -> None:
    code, _, err = rig("camera", "settings", "iso", "--sim")
    assert code == 1
    assert "NAME=VALUE" in err
