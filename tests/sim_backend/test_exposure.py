"""What a sensor sees while its shutter is open, and when the photo is there."""

import threading
import time

import numpy as np
import pytest
import simplejpeg
from ptpip_host import Host

from drivers.protocols import Frame
from sim_backend.camera import SimulatedCamera
from sim_backend.clock import RealClock, SimulatedClock
from sim_backend.disturbance import QUIET, Disturbance
from sim_backend.exposure import WorldExposure
from sim_backend.ptpip.generic import GenericBody
from sim_backend.ptpip.responder import Responder
from sim_backend.world import TankSize, World, WorldState

DARK, BRIGHT = 40, 200


def frame(level: int) -> Frame:
    return Frame(axis="x", levels=np.full(8, level, np.uint8))


def world_of(clock: SimulatedClock | RealClock) -> World:
    return World(clock=clock, tank=TankSize(2.0, 1.0), dark_frame=frame(0), state=WorldState())


class FlatOptics:
    """A photo as grey as the first level of the frame."""

    def photograph(
        self,
        frame: Frame,
        *,
        stage_position_mm: float,  # noqa: ARG002
        wet: bool,  # noqa: ARG002
        object_present: bool = True,  # noqa: ARG002
        disturbance: Disturbance = QUIET,  # noqa: ARG002
        light: float = 1.0,  # noqa: ARG002
    ) -> bytes:
        assert frame.levels is not None
        return simplejpeg.encode_jpeg(np.full((16, 16, 1), frame.levels[0], np.uint8), quality=100, colorspace="GRAY")


def grey(photo: bytes) -> float:
    return float(simplejpeg.decode_jpeg(photo, colorspace="GRAY").mean())


def test_a_frame_that_changes_while_the_shutter_is_open_is_in_the_photo_with_half_of_the_light() -> None:
    world = world_of(SimulatedClock())
    exposure = WorldExposure(world, FlatOptics())
    world.show(frame(DARK), frame_id=1)
    exposure.open_shutter()
    world.show(frame(BRIGHT), frame_id=2)
    exposure.close_shutter()
    world.show(frame(0), frame_id=3)  # too late to be seen
    assert grey(exposure.develop()) == pytest.approx((DARK + BRIGHT) / 2, abs=1)
    assert world.disturbed_photos == 1


def test_a_frame_that_is_sent_again_disturbs_nothing() -> None:
    world = world_of(SimulatedClock())
    exposure = WorldExposure(world, FlatOptics())
    world.show(frame(DARK), frame_id=1)
    exposure.open_shutter()
    world.show(frame(DARK), frame_id=2)
    exposure.close_shutter()
    assert grey(exposure.develop()) == pytest.approx(DARK, abs=1)
    assert world.disturbed_photos == 0


def test_a_photo_by_hand_during_an_exposure_leaves_it_alone() -> None:
    world = world_of(SimulatedClock())
    exposure = WorldExposure(world, FlatOptics())
    world.show(frame(DARK), frame_id=1)
    exposure.open_shutter()
    assert grey(exposure.snap()) == pytest.approx(DARK, abs=1)
    exposure.close_shutter()
    assert grey(exposure.develop()) == pytest.approx(DARK, abs=1)


def test_a_simulated_camera_sees_the_display_change_during_its_exposure() -> None:
    world = world_of(RealClock())
    world.show(frame(DARK), frame_id=1)
    change = threading.Timer(0.15, world.show, [frame(BRIGHT)], {"frame_id": 2})
    with SimulatedCamera(world, FlatOptics(), exposure_s=0.3, download_s=0.0) as camera:
        change.start()
        camera.expose(timeout_s=5.0)
        (photo,) = camera.collect(timeout_s=5.0)
    assert grey(photo.data) == pytest.approx((DARK + BRIGHT) / 2, abs=1)


def test_an_emulated_body_exposes_then_reads_out_then_transfers() -> None:
    times_s: dict[str, float] = {}

    class Watched:
        def open_shutter(self) -> None:
            times_s["opened"] = time.monotonic()

        def close_shutter(self) -> None:
            times_s["closed"] = time.monotonic()

        def develop(self) -> bytes:
            return b"\xff\xd8\xff\xd9"

        def __call__(self) -> bytes:
            raise AssertionError("nobody pressed the shutter by hand")

    responder = Responder(GenericBody(Watched(), exposure_s=0.2, download_s=0.4))
    threading.Thread(target=responder.serve, daemon=True).start()
    with Host(responder.port) as host:
        host.say_hello()
        host.ask(0x1002, 1)
        asked_s = time.monotonic()
        host.ask(0x100E)
        _added, (handle,) = host.next_event()
        announced_s = time.monotonic()
        host.ask(0x1009, handle)
        arrived_s = time.monotonic()
    responder.close()
    assert asked_s <= times_s["opened"] < times_s["closed"] <= announced_s
    assert announced_s - asked_s >= 0.2 + 0.2  # the exposure, and half of the download, which is the body's own
    assert arrived_s - announced_s >= 0.2
