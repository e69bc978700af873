"""Exposure and download apart: the next frame may be shown while a photo is on its way, and no photo is taken for another."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import pytest
from emulated_camera import NumberedPhotos, without_exif

from drivers.camera_profiles import PROFILES
from drivers.errors import DeviceAlarmError, DeviceBusyError, DeviceProtocolError, DeviceTimeoutError
from drivers.gphoto2_camera import Gphoto2Camera
from sim_backend.ptpip.process import EmulatedCamera, Model, emulate_camera

MODELS: tuple[Model, ...] = ("generic", "canon-eos-40d")
# What the emulated bodies have set, and can be set to.
SHUTTER: dict[Model, dict[str, str]] = {
    "generic": {"shutterspeed": "0.0625s"},
    "canon-eos-40d": {"shutterspeed": "1/15"},
}
EXPOSURE_S = 0.0625
MARGIN_S = PROFILES["generic"].exposure_margin_s


@dataclass(frozen=True)
class Rig:
    camera: Gphoto2Camera
    body: EmulatedCamera
    photos: NumberedPhotos

    def photograph(self) -> bytes:
        self.camera.expose(timeout_s=20.0)
        (photo,) = self.camera.collect(timeout_s=20.0)
        return without_exif(photo.data)

    def refused(self, sentence: str) -> None:
        """Take a photo that the driver must refuse, so that the caller shows its frame anew; then one that is right."""
        self.camera.expose(timeout_s=20.0)
        with pytest.raises(DeviceProtocolError, match=sentence):
            self.camera.collect(timeout_s=20.0)
        assert self.photograph() == self.photos.given[-1]


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> Model:
    return request.param


@contextmanager
def opened(model: Model, *, attempt_s: float = 20.0, download_s: float = 0.0) -> Iterator[Rig]:
    photos = NumberedPhotos()
    with (
        emulate_camera(photos, model=model, exposure_s=EXPOSURE_S, download_s=download_s) as body,
        Gphoto2Camera(body.address, kind="emulated", attempt_s=attempt_s, overlap=True) as camera,
    ):
        camera.apply_settings(SHUTTER[model])
        yield Rig(camera, body, photos)


@pytest.fixture
def rig(model: Model) -> Iterator[Rig]:
    with opened(model) as rig:
        yield rig


def test_the_exposure_is_over_long_before_the_photo_has_arrived(model: Model) -> None:
    with opened(model, download_s=2.0) as rig:
        started_s = time.monotonic()
        rig.camera.expose(timeout_s=20.0)
        exposed_s = time.monotonic() - started_s
        (photo,) = rig.camera.collect(timeout_s=20.0)
        assert time.monotonic() - started_s >= EXPOSURE_S + 2.0
        assert exposed_s < 1.5
        assert without_exif(photo.data) == rig.photos.given[-1]


def test_the_exposure_lasts_at_least_the_shutters_time_and_the_margin(model: Model) -> None:
    with opened(model, download_s=2.0) as rig:
        started_s = time.monotonic()
        rig.camera.expose(timeout_s=20.0)
        assert time.monotonic() - started_s >= EXPOSURE_S + MARGIN_S


def test_the_margin_is_not_waited_for_when_the_photo_is_there(rig: Rig) -> None:
    rig.photograph()
    started_s = time.monotonic()
    for _ in range(5):
        rig.photograph()
    assert time.monotonic() - started_s < 5 * (EXPOSURE_S + MARGIN_S)


@pytest.mark.parametrize("model", ["generic"])
def test_a_camera_whose_release_lag_nobody_knows_stays_strict(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PROFILES, "generic", replace(PROFILES["generic"], exposure_margin_s=None))
    with opened(model, download_s=1.0) as rig:
        started_s = time.monotonic()
        rig.camera.expose(timeout_s=20.0)
        # The file is announced after half of the download: only then the display may change.
        assert time.monotonic() - started_s >= EXPOSURE_S + 0.5
        (photo,) = rig.camera.collect(timeout_s=20.0)
        assert without_exif(photo.data) == rig.photos.given[-1]


def test_a_hundred_photos_arrive_byte_for_byte_and_in_order(rig: Rig) -> None:
    for _ in range(100):
        assert rig.photograph() == rig.photos.given[-1]
    assert len(rig.photos.given) == rig.camera.counts.photos == 100
    assert rig.camera.counts.strays == rig.camera.counts.recoveries == 0


def test_a_download_that_is_not_over_can_be_asked_for_again(model: Model) -> None:
    with opened(model, download_s=1.5) as rig:
        rig.camera.expose(timeout_s=20.0)
        with pytest.raises(DeviceTimeoutError, match="it is not over"):
            rig.camera.collect(timeout_s=0.1)
        (photo,) = rig.camera.collect(timeout_s=20.0)
        assert without_exif(photo.data) == rig.photos.given[-1]


def test_while_a_photo_is_on_its_way_the_camera_is_not_asked_for_anything_else(model: Model) -> None:
    with opened(model, download_s=1.0) as rig:
        rig.camera.expose(timeout_s=20.0)
        rig.camera.keep_awake()
        with pytest.raises(DeviceBusyError, match="collect it first"):
            rig.camera.settings()
        with pytest.raises(DeviceBusyError, match="collect it first"):
            rig.camera.expose(timeout_s=20.0)
        (photo,) = rig.camera.collect(timeout_s=20.0)
        assert without_exif(photo.data) == rig.photos.given[-1]
        assert "shutterspeed" in rig.camera.settings()


def test_a_deadline_shorter_than_the_exposure_is_refused_before_the_shutter_opens(rig: Rig) -> None:
    with pytest.raises(DeviceTimeoutError, match="its exposure takes"):
        rig.camera.expose(timeout_s=0.1)
    assert rig.body.photos_taken() == 0


# What goes wrong after the exposure is over spoils the photo: its frame may be gone already.


def test_a_photo_that_never_comes_is_refused(model: Model) -> None:
    with opened(model, attempt_s=2.0) as rig:
        rig.body.set_faults(lost=1)
        rig.refused("no photo came")
        assert rig.camera.counts.recoveries == 1


def test_a_photo_that_comes_after_its_time_is_not_taken_for_the_next_one(model: Model) -> None:
    with opened(model, attempt_s=0.5, download_s=1.0) as rig:
        rig.camera.expose(timeout_s=20.0)
        with pytest.raises(DeviceProtocolError, match="expose again"):
            rig.camera.collect(timeout_s=20.0)
    with opened(model, attempt_s=3.0, download_s=1.0) as rig:
        assert rig.photograph() == rig.photos.given[-1]


def test_a_photo_that_somebody_took_at_the_same_moment_spoils_ours(rig: Rig) -> None:
    rig.body.set_faults(stray_in_capture=1)
    rig.refused("somebody took one at the same moment")
    assert rig.camera.counts.strays == rig.camera.counts.retaken == 1


def test_a_file_that_is_the_one_before_is_refused(rig: Rig) -> None:
    rig.photograph()
    rig.body.set_faults(stale=1)
    rig.refused("byte for byte the photo before")


def test_a_file_that_is_cut_short_twice_is_refused(rig: Rig) -> None:
    rig.body.set_faults(truncated=2)
    rig.camera.expose(timeout_s=20.0)
    with pytest.raises(DeviceProtocolError, match="expose again"):
        rig.camera.collect(timeout_s=20.0)
    rig.body.set_faults(truncated=0)
    assert rig.photograph() == rig.photos.given[-1]


def test_a_link_that_breaks_during_the_download_is_set_up_again_and_the_photo_refused(model: Model) -> None:
    with opened(model, download_s=1.0) as rig:
        rig.camera.expose(timeout_s=20.0)
        rig.body.pull_cable()
        with pytest.raises(DeviceProtocolError, match="expose again"):
            rig.camera.collect(timeout_s=20.0)
        time.sleep(1.0)  # the body has forgotten the photo that nobody fetched
        assert rig.photograph() == rig.photos.given[-1]


def test_a_link_that_breaks_before_the_exposure_is_set_up_again_and_the_photo_taken(rig: Rig) -> None:
    rig.body.set_faults(dropped_link=1)
    assert rig.photograph() == rig.photos.given[-1]
    assert rig.camera.counts.recoveries > 0


def test_a_library_that_is_killed_during_the_download_is_started_again(model: Model) -> None:
    with opened(model, download_s=1.0) as rig:
        rig.camera.expose(timeout_s=20.0)
        rig.camera._link._process._process.kill()
        with pytest.raises(DeviceProtocolError, match="ended"):
            rig.camera.collect(timeout_s=20.0)
        time.sleep(1.0)
        assert rig.photograph() == rig.photos.given[-1]


@pytest.mark.parametrize("model", ["generic"])
def test_a_camera_that_is_gone_during_the_download_wants_a_person(model: Model) -> None:
    photos = NumberedPhotos()
    with emulate_camera(photos, model=model, exposure_s=EXPOSURE_S, download_s=2.0) as body:
        camera = Gphoto2Camera(body.address, kind="emulated", overlap=True).__enter__()
        camera.apply_settings(SHUTTER[model])
        camera.expose(timeout_s=20.0)
    with camera, pytest.raises(DeviceAlarmError, match="Switch it off and on"):
        camera.collect(timeout_s=30.0)
