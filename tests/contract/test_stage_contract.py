"""What every stage owes the rig."""

import math

import pytest

from drivers.errors import DeviceTimeoutError, OutOfTravelError, UnknownPositionError


def test_a_stage_that_was_not_homed_refuses_to_move_and_stays_where_it_is(open_stage) -> None:
    with open_stage() as bench:
        before_mm = bench.world.stage_mm()
        assert not bench.device.is_homed()
        with pytest.raises(UnknownPositionError, match="home"):
            bench.device.move_to_mm(20.0, timeout_s=60.0)
        assert bench.world.stage_mm() == before_mm


@pytest.mark.parametrize("target_mm", [0.0, 12.345, 100.0])
def test_a_homed_stage_arrives_and_says_so(open_stage, target_mm: float) -> None:
    with open_stage() as bench:
        bench.device.home(timeout_s=60.0)
        assert bench.device.is_homed()
        bench.device.move_to_mm(target_mm, timeout_s=60.0)
        assert bench.world.stage_mm() == pytest.approx(target_mm, abs=0.01)
        assert bench.device.position_mm() == pytest.approx(target_mm, abs=0.01)
        assert not bench.world.is_moving()


@pytest.mark.parametrize("target_mm", [-0.1, 100.1, math.inf, -math.inf, math.nan])
def test_refuses_to_leave_its_travel_before_moving(open_stage, target_mm: float) -> None:
    with open_stage() as bench:
        bench.device.home(timeout_s=60.0)
        bench.device.move_to_mm(50.0, timeout_s=60.0)
        now_s = bench.world.clock.now_s()
        with pytest.raises(OutOfTravelError, match="travel is 0 to 100 mm"):
            bench.device.move_to_mm(target_mm, timeout_s=60.0)
        assert bench.world.stage_mm() == pytest.approx(50.0, abs=0.01)
        assert bench.world.clock.now_s() - now_s < 1.0


def test_the_position_is_asked_from_the_hardware_and_not_remembered(open_stage) -> None:
    with open_stage() as bench:
        bench.device.home(timeout_s=60.0)
        bench.device.move_to_mm(50.0, timeout_s=60.0)
        bench.world.start_motion(48.0, velocity_mm_per_s=1000.0)
        bench.world.clock.sleep_s(1.0)
        assert bench.device.position_mm() == pytest.approx(48.0, abs=0.01)


def test_a_move_that_takes_too_long_ends_with_the_stage_still(open_stage) -> None:
    with open_stage() as bench:
        bench.device.home(timeout_s=60.0)
        with pytest.raises(DeviceTimeoutError):
            bench.device.move_to_mm(100.0, timeout_s=1.0)
        stopped_mm = bench.world.stage_mm()
        bench.world.clock.sleep_s(10.0)
        assert bench.world.stage_mm() == stopped_mm < 100.0


@pytest.mark.without_world
def test_stopping_twice_is_harmless(open_stage) -> None:
    with open_stage() as bench:
        bench.device.home(timeout_s=60.0)
        bench.device.stop()
        bench.device.stop()
        middle_mm = sum(bench.device.travel_mm()) / 2
        bench.device.move_to_mm(middle_mm, timeout_s=60.0)
        assert bench.device.position_mm() == pytest.approx(middle_mm, abs=0.01)


@pytest.mark.without_world
def test_a_stage_says_who_it_is_and_whether_it_is_real(open_stage) -> None:
    with open_stage() as bench:
        assert bench.device.info().kind in ("simulated", "emulated", "real")
        assert bench.device.info().model


def test_a_stage_knows_its_travel(open_stage) -> None:
    with open_stage() as bench:
        assert bench.device.travel_mm() == (0.0, 100.0)


@pytest.mark.without_world
def test_a_place_beyond_the_travel_is_refused_and_the_stage_says_that_it_has_not_moved(open_stage) -> None:
    with open_stage() as bench:
        bench.device.home(timeout_s=60.0)
        low_mm, high_mm = bench.device.travel_mm()
        before_mm = bench.device.position_mm()
        for target_mm in (low_mm - 0.1, high_mm + 0.1):
            with pytest.raises(OutOfTravelError, match="travel is"):
                bench.device.move_to_mm(target_mm, timeout_s=60.0)
        assert bench.device.position_mm() == pytest.approx(before_mm, abs=0.01)
