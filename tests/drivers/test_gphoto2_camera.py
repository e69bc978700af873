"""The camera driver through the real libgphoto2, against emulated bodies that misbehave on request."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import simplejpeg
from emulated_camera import NumberedPhotos, without_exif
from faults_page import OperatorReads

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
)
from drivers.gphoto2_camera import Gphoto2Camera
from drivers.protocols import Camera
from sim_backend.ptpip.process import EmulatedCamera, Model, emulate_camera

MODELS: tuple[Model, ...] = ("generic", "canon-eos-40d")
SHUTTER: dict[Model, dict[str, str]] = {
    "generic": {"shutterspeed": "0.1250s"},
    "canon-eos-40d": {"shutterspeed": "1/8"},
}


@dataclass(frozen=True)
class Rig:
    camera: Gphoto2Camera
    body: EmulatedCamera
    photos: NumberedPhotos

    def photograph(self, *, timeout_s: float = 20.0) -> bytes:
        self.camera.expose(timeout_s=timeout_s)
        (photo,) = self.camera.collect(timeout_s=timeout_s)
        return without_exif(photo.data)


@contextmanager
def opened(
    model: Model,
    *,
    attempt_s: float = 20.0,
    exposure_s: float = 0.0,
) -> Iterator[Rig]:
    photos = NumberedPhotos()
    with (
        emulate_camera(photos, model=model, exposure_s=exposure_s) as body,
        Gphoto2Camera(body.address, kind="emulated", attempt_s=attempt_s) as camera,
    ):
        yield Rig(camera, body, photos)


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> Model:
    return request.param


@pytest.fixture(scope="module")
def bench() -> Iterator[dict[Model, tuple[EmulatedCamera, NumberedPhotos]]]:
    """One emulator of each model, since starting a process takes longer than most tests."""
    with ExitStack() as stack:
        bodies: dict[Model, tuple[EmulatedCamera, NumberedPhotos]] = {}
        for model in MODELS:
            photos = NumberedPhotos()
            bodies[model] = (stack.enter_context(emulate_camera(photos, model=model)), photos)
        yield bodies


@pytest.fixture
def rig(model: Model, bench: dict[Model, tuple[EmulatedCamera, NumberedPhotos]]) -> Iterator[Rig]:
    """A new camera on the bench, opened by the driver."""
    body, photos = bench[model]
    body.replace()
    photos.given.clear()
    with Gphoto2Camera(body.address, kind="emulated") as camera:
        yield Rig(camera, body, photos)


def test_it_is_a_camera_to_the_type_checker_and_to_the_session(rig: Rig, model: Model) -> None:
    camera: Camera = rig.camera
    info = camera.info()
    assert info.kind == "emulated"
    assert info.model == {"generic": "Emulated PTP camera", "canon-eos-40d": "Canon EOS 40D"}[model]
    assert info.address == rig.body.address
    assert "libgphoto2 2.5" in info.version


def test_an_emulated_camera_is_never_taken_for_a_real_one(rig: Rig) -> None:
    with Gphoto2Camera(rig.body.address) as taken_for_real:
        assert taken_for_real.info().kind == "emulated"


def test_two_hundred_photos_arrive_byte_for_byte_and_in_order(rig: Rig) -> None:
    for _ in range(200):
        assert rig.photograph() == rig.photos.given[-1]
    assert len(rig.photos.given) == rig.body.photos_taken() == rig.camera.counts.photos == 200
    assert rig.camera.counts.strays == rig.camera.counts.recoveries == 0


def test_a_photo_of_four_megabytes_arrives_whole(model: Model) -> None:
    photos = NumberedPhotos(columns=2400, rows=2400)
    with emulate_camera(photos, model=model) as body, Gphoto2Camera(body.address) as camera:
        camera.expose(timeout_s=20.0)
        (photo,) = camera.collect(timeout_s=20.0)
    assert len(photo.data) > 4_000_000
    assert without_exif(photo.data) == photos.given[0]


def test_exposure_lasts_until_the_shutter_has_closed(model: Model) -> None:
    with opened(model, exposure_s=0.4) as rig:
        started_s = time.monotonic()
        rig.camera.expose(timeout_s=20.0)
        assert time.monotonic() - started_s >= 0.4
        assert rig.body.photos_taken() == 1


# Settings


def test_settings_are_frozen_and_read_back(rig: Rig, model: Model) -> None:
    before = rig.camera.settings()
    rig.camera.apply_settings(SHUTTER[model])
    assert rig.camera.settings() == before | SHUTTER[model]


def test_nothing_is_set_unless_all_of_it_can_be(operator_reads: OperatorReads, rig: Rig, model: Model) -> None:
    before = rig.camera.settings()
    with operator_reads.raised(DeviceProtocolError):
        rig.camera.apply_settings({**SHUTTER[model], "iso": "123"})
    assert rig.camera.settings() == before


def test_a_setting_that_does_not_take_is_an_error(operator_reads: OperatorReads, rig: Rig, model: Model) -> None:
    rig.body.set_faults(hidden_settings=5)
    with operator_reads.raised(DeviceProtocolError):
        rig.camera.apply_settings(SHUTTER[model])


@pytest.mark.parametrize(
    ("model", "wrong"),
    [
        pytest.param("generic", {"focusmode": "Automatic"}, id="generic focus"),
        pytest.param("generic", {"expprogram": "P"}, id="generic mode"),
        pytest.param("generic", {"whitebalance": "Automatic"}, id="generic white balance"),
        pytest.param("canon-eos-40d", {"focusmode": "One Shot"}, id="EOS focus"),
        pytest.param("canon-eos-40d", {"drivemode": "Continuous"}, id="EOS drive"),
        pytest.param("canon-eos-40d", {"whitebalance": "Auto"}, id="EOS white balance"),
    ],
)
def test_what_would_change_from_photo_to_photo_is_refused(
    operator_reads: OperatorReads, rig: Rig, wrong: dict[str, str]
) -> None:
    with operator_reads.raised(DeviceProtocolError):
        rig.camera.apply_settings(wrong)


def test_settings_survive_a_broken_link(rig: Rig, model: Model) -> None:
    rig.camera.apply_settings(SHUTTER[model])
    rig.body.pull_cable()
    rig.photograph()
    assert rig.camera.settings()["shutterspeed"] == SHUTTER[model]["shutterspeed"]


@pytest.mark.parametrize("model", ["canon-eos-40d"])
def test_photos_of_an_eos_go_straight_to_the_host_whatever_other_programs_have_chosen(
    model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = tmp_path / "gphoto" / "settings"
    settings.parent.mkdir()
    settings.write_text("ptp2=capturetarget=card\n", encoding="utf-8")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with opened(model) as rig:
        rig.body.set_faults(card_full=True)  # of no consequence when no photo goes there
        assert rig.photograph() == rig.photos.given[-1]
    assert settings.read_text(encoding="utf-8") == "ptp2=capturetarget=card\n"


@pytest.mark.parametrize("model", ["canon-eos-40d"])
def test_raw_and_jpeg_come_as_a_pair(rig: Rig) -> None:
    rig.camera.apply_settings({"imageformat": "RAW + L"})
    for _ in range(3):
        rig.camera.expose(timeout_s=20.0)
        raw, jpeg = rig.camera.collect(timeout_s=20.0)
        assert (raw.suffix, jpeg.suffix) == (".cr2", ".jpg")
        assert without_exif(jpeg.data) == rig.photos.given[-1]
        assert raw.data.endswith(jpeg.data)  # so the emulated body writes it
    assert len(rig.photos.given) == 3
    assert rig.camera.counts.strays == 0


@pytest.mark.parametrize("model", ["canon-eos-40d"])
def test_live_view_gives_a_picture_without_taking_a_photo(rig: Rig) -> None:
    assert simplejpeg.decode_jpeg(rig.camera.live_view(), colorspace="GRAY").shape == (240, 320, 1)
    assert rig.body.photos_taken() == 0


@pytest.mark.parametrize("model", ["generic"])
def test_a_camera_without_live_view_says_so(operator_reads: OperatorReads, rig: Rig) -> None:
    with operator_reads.raised(DeviceProtocolError):
        rig.camera.live_view()


# Faults


def test_a_busy_camera_is_asked_again(rig: Rig) -> None:
    rig.body.set_faults(busy=3)
    assert rig.photograph() == rig.photos.given[-1]
    assert len(rig.photos.given) == 1


def test_a_camera_that_stays_busy_is_an_error_after_the_time_asked(operator_reads: OperatorReads, rig: Rig) -> None:
    rig.body.set_faults(busy=1000)
    with operator_reads.raised(DeviceBusyError):
        rig.camera.expose(timeout_s=1.0)
    rig.body.set_faults(busy=0)
    assert rig.photograph() == rig.photos.given[-1]


def test_a_photo_that_somebody_took_before_is_counted_and_left_out(rig: Rig) -> None:
    rig.photograph()
    rig.body.set_faults(stray=2)
    time.sleep(0.1)
    assert rig.photograph() == rig.photos.given[-1]
    assert rig.camera.counts.strays == 2


def test_a_photo_that_somebody_took_at_the_same_moment_leads_to_another_one(rig: Rig) -> None:
    rig.body.set_faults(stray_in_capture=1)
    assert rig.photograph() == rig.photos.given[-1]
    assert len(rig.photos.given) == 3
    assert rig.camera.counts.strays == rig.camera.counts.retaken == 1


def test_a_photo_that_somebody_took_before_the_download_makes_both_uncertain(
    operator_reads: OperatorReads, rig: Rig
) -> None:
    rig.camera.expose(timeout_s=20.0)
    rig.body.set_faults(stray=1)
    time.sleep(0.1)
    with operator_reads.raised(DeviceProtocolError):
        rig.camera.collect(timeout_s=20.0)
    assert rig.photograph() == rig.photos.given[-1]


def test_the_file_of_the_photo_before_is_never_taken_for_a_new_one(operator_reads: OperatorReads, rig: Rig) -> None:
    rig.photograph()
    rig.body.set_faults(stale=1)
    with operator_reads.raised(DeviceProtocolError):
        rig.photograph()
    assert rig.photograph() == rig.photos.given[-1]


@pytest.mark.parametrize("model", ["generic"])
def test_a_download_that_was_cut_short_is_repeated(rig: Rig) -> None:
    rig.body.set_faults(truncated=1)
    assert rig.photograph() == rig.photos.given[-1]
    assert len(rig.photos.given) == 1


def test_a_file_that_is_cut_short_is_never_handed_on(operator_reads: OperatorReads, rig: Rig) -> None:
    rig.body.set_faults(truncated=2)
    with operator_reads.raised(DeviceProtocolError):
        rig.photograph()
    rig.body.set_faults(truncated=0)
    assert rig.photograph() == rig.photos.given[-1]


def test_a_photo_that_is_accepted_and_forgotten_is_taken_again(model: Model) -> None:
    with opened(model, attempt_s=1.0) as rig:
        rig.body.set_faults(lost=1)
        assert rig.photograph() == rig.photos.given[-1]
        assert rig.camera.counts.recoveries >= 1


def test_a_photo_that_comes_after_its_time_is_not_taken_for_the_next_one(
    operator_reads: OperatorReads, model: Model
) -> None:
    with opened(model, exposure_s=0.5) as rig:
        with operator_reads.raised(DeviceTimeoutError):
            rig.camera.expose(timeout_s=0.2)
        assert rig.photograph() == rig.photos.given[-1]
        assert len(rig.photos.given) == 2


def test_a_broken_link_is_set_up_again(rig: Rig) -> None:
    rig.body.set_faults(dropped_link=1)
    assert rig.photograph() == rig.photos.given[-1]
    assert rig.camera.counts.recoveries > 0


@pytest.mark.parametrize("model", ["generic"])
def test_a_photo_on_the_card_survives_a_link_that_breaks_before_its_download(rig: Rig) -> None:
    rig.camera.expose(timeout_s=20.0)
    rig.body.pull_cable()
    (photo,) = rig.camera.collect(timeout_s=20.0)
    assert without_exif(photo.data) == rig.photos.given[-1]
    assert len(rig.photos.given) == 1


@pytest.mark.parametrize("model", ["generic"])
def test_a_full_card_wants_a_person(operator_reads: OperatorReads, rig: Rig) -> None:
    rig.body.set_faults(card_full=True)
    with operator_reads.raised(DeviceAlarmError):
        rig.camera.expose(timeout_s=20.0)
    rig.body.set_faults(card_full=False)
    assert rig.photograph() == rig.photos.given[-1]


@pytest.mark.slow
@pytest.mark.parametrize("model", ["canon-eos-40d"])
def test_a_camera_that_falls_silent_wants_a_person_and_works_afterwards(
    operator_reads: OperatorReads, rig: Rig
) -> None:
    rig.photograph()
    rig.body.set_faults(silent=True)
    with operator_reads.raised(DeviceAlarmError):
        rig.camera.expose(timeout_s=60.0)
    rig.body.set_faults(silent=False)
    assert rig.photograph() == rig.photos.given[-1]


def test_a_camera_that_was_lost_between_photos_is_opened_again(rig: Rig) -> None:
    rig.camera.keep_awake()
    rig.body.pull_cable()
    rig.camera.keep_awake()
    assert rig.photograph() == rig.photos.given[-1]


def test_an_interrupted_call_does_not_answer_for_the_next(model: Model) -> None:
    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    with opened(model, exposure_s=0.5) as rig:
        before = signal.signal(signal.SIGALRM, interrupt)
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.2)
            with pytest.raises(KeyboardInterrupt):
                rig.camera.expose(timeout_s=20.0)
        finally:
            signal.signal(signal.SIGALRM, before)
        assert "shutterspeed" in rig.camera.settings()
        assert rig.photograph() == rig.photos.given[-1]


def test_nobody_at_the_address_is_said_in_one_sentence(operator_reads: OperatorReads) -> None:
    with emulate_camera(NumberedPhotos()) as body:
        address = body.address
    with operator_reads.raised(DeviceNotFoundError), Gphoto2Camera(address):
        pass


@pytest.mark.parametrize("address", ["/dev/ttyUSB0", "", "usb"])
def test_an_address_that_is_none_is_refused_before_anything_starts(operator_reads: OperatorReads, address: str) -> None:
    with operator_reads.raised(DeviceNotFoundError):
        Gphoto2Camera(address)


def test_an_unknown_profile_is_refused_with_those_that_exist(operator_reads: OperatorReads) -> None:
    with operator_reads.raised(DeviceNotFoundError):
        Gphoto2Camera("usb:", profile="polaroid")


def test_the_virtual_camera_of_libgphoto2_is_driven_when_it_is_asked_for_and_never_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = NumberedPhotos()()
    (tmp_path / "photo.jpg").write_bytes(picture)
    monkeypatch.setitem(os.environ, "VCAMERADIR", str(tmp_path))
    with pytest.raises(DeviceNotFoundError), Gphoto2Camera("usb:001,001"):
        pass
    asked_for = {"VCAMERADIR": str(tmp_path)}
    with Gphoto2Camera("usb:001,001", profile="generic", kind="simulated", environment=asked_for) as camera:
        assert camera.info().model == "VC"  # its own name; libgphoto2 takes it for a Nikon
        camera.expose(timeout_s=20.0)
        (photo,) = camera.collect(timeout_s=20.0)
    assert photo.data == picture
