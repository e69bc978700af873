"""What every camera owes the rig."""

import numpy as np
import pytest
import simplejpeg

from drivers.errors import DeviceBusyError, DeviceProtocolError, DeviceTimeoutError
from drivers.protocols import Frame, Photo

WHITE = Frame(axis="x", levels=np.full(64, 255, np.uint8))
BLACK = Frame(axis="x", levels=np.zeros(64, np.uint8))


def brightness(photo: Photo) -> float:
    return float(simplejpeg.decode_jpeg(photo.data, colorspace="GRAY").mean())


@pytest.mark.without_world
def test_a_photo_is_a_whole_file(open_camera) -> None:
    with open_camera() as bench:
        bench.device.expose(timeout_s=10.0)
        (photo,) = bench.device.collect(timeout_s=10.0)
        assert photo.suffix == ".jpg"
        assert photo.data.startswith(b"\xff\xd8")
        assert photo.data.rstrip(b"\0").endswith(b"\xff\xd9")


def test_a_photo_shows_what_was_on_the_glass_when_the_shutter_closed(open_camera) -> None:
    with open_camera() as bench:
        bench.world.show(WHITE, frame_id=1)
        bench.device.expose(timeout_s=10.0)
        bench.world.show(BLACK, frame_id=2)
        (white,) = bench.device.collect(timeout_s=10.0)
        bench.device.expose(timeout_s=10.0)
        (black,) = bench.device.collect(timeout_s=10.0)
        assert brightness(white) > brightness(black) + 10
        assert bench.world.disturbed_photos == 0  # no frame changed while the shutter was open


@pytest.mark.without_world
def test_a_photo_that_was_not_taken_cannot_be_collected(open_camera) -> None:
    with open_camera() as bench:
        with pytest.raises(DeviceProtocolError, match="expose"):
            bench.device.collect(timeout_s=10.0)
        bench.device.expose(timeout_s=10.0)
        bench.device.collect(timeout_s=10.0)
        with pytest.raises(DeviceProtocolError, match="expose"):
            bench.device.collect(timeout_s=10.0)


@pytest.mark.without_world
def test_a_second_exposure_does_not_overwrite_a_photo_that_was_not_collected(open_camera) -> None:
    with open_camera() as bench:
        bench.device.expose(timeout_s=10.0)
        with pytest.raises(DeviceBusyError, match="collect"):
            bench.device.expose(timeout_s=10.0)


@pytest.mark.without_world
def test_settings_are_read_back_and_unknown_ones_refused(open_camera) -> None:
    with open_camera() as bench:
        name = next(iter(bench.device.settings()))
        bench.device.apply_settings({name: bench.device.settings()[name]})
        before = bench.device.settings()
        with pytest.raises(DeviceProtocolError, match="colour of the strap"):
            bench.device.apply_settings({"colour of the strap": "red"})
        assert bench.device.settings() == before


@pytest.mark.without_world
def test_a_deadline_that_is_too_short_is_an_error_and_not_a_photo(open_camera) -> None:
    with open_camera() as bench:
        with pytest.raises(DeviceTimeoutError):
            bench.device.expose(timeout_s=0.01)
        bench.device.expose(timeout_s=10.0)
        with pytest.raises(DeviceTimeoutError):
            bench.device.collect(timeout_s=0.01)
        bench.device.keep_awake()


@pytest.mark.without_world
def test_a_time_that_the_body_offers_can_be_set_and_what_it_does_not_know_has_no_choices(open_camera) -> None:
    with open_camera() as bench:
        name = next((one for one in ("shutterspeed", "shutter") if bench.device.setting_choices(one)), None)
        assert bench.device.setting_choices("colour of the strap") == ()
        if name is None:  # a body whose dial alone sets the time
            return
        choices = bench.device.setting_choices(name)
        assert bench.device.settings()[name] in choices
        other = next(choice for choice in choices if choice not in (bench.device.settings()[name], "auto", "bulb"))
        bench.device.apply_settings({name: other})
        assert bench.device.settings()[name] == other
