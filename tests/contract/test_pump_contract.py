"""What every pump owes the rig. The bench's pump moves 600 ml a minute, 10 ml a second.

A real pump has a dead-man timer: it goes on only while somebody asks for its status. So these tests watch their flows,
as the rig does.
"""

import math

import pytest

from drivers.errors import DeviceBusyError, OutOfVolumeError

WATCH_EVERY_S = 0.5


def watch(bench, duration_s: float) -> None:
    """Let time pass, asking for the status often enough for any dead-man timer."""
    for _ in range(round(duration_s / WATCH_EVERY_S)):
        bench.world.clock.sleep_s(WATCH_EVERY_S)
        bench.device.status()


def test_a_fill_ends_by_itself_when_its_volume_is_moved(open_pump) -> None:
    with open_pump() as bench:
        bench.device.start("fill", volume_ml=300.0, max_run_s=60.0)
        assert bench.device.status().running
        assert bench.device.status().direction == "fill"
        watch(bench, 31.0)
        bench.world.clock.sleep_s(3600.0)
        assert bench.world.state().tank_ml == pytest.approx(300.0)
        assert not bench.device.status().running
        assert bench.device.status().moved_ml == pytest.approx(300.0)
        assert bench.device.status().alarm == ""


def test_the_longest_run_time_ends_the_flow(open_pump) -> None:
    with open_pump() as bench:
        bench.device.start("fill", volume_ml=300.0, max_run_s=5.0)
        watch(bench, 10.0)
        assert bench.world.state().tank_ml == pytest.approx(50.0)
        assert not bench.device.status().running


def test_a_flow_that_nobody_watches_ends_at_the_longest_run_time_or_before(open_pump) -> None:
    with open_pump() as bench:
        bench.device.start("fill", volume_ml=300.0, max_run_s=5.0)
        bench.world.clock.sleep_s(3600.0)
        assert 0.0 < bench.world.state().tank_ml <= 50.0 + 1e-6
        assert not bench.device.status().running


def test_a_drain_returns_the_liquid_to_the_reservoir(open_pump) -> None:
    with open_pump() as bench:
        bench.device.start("fill", volume_ml=300.0, max_run_s=60.0)
        watch(bench, 31.0)
        bench.device.start("drain", volume_ml=100.0, max_run_s=60.0)
        assert bench.device.status().direction == "drain"
        watch(bench, 11.0)
        assert bench.world.state().tank_ml == pytest.approx(200.0)
        assert bench.world.state().reservoir_ml == pytest.approx(4800.0)


@pytest.mark.parametrize("volume_ml", [0.0, -1.0, math.nan, math.inf])
def test_refuses_a_volume_that_is_not_positive_before_anything_flows(open_pump, volume_ml: float) -> None:
    with open_pump() as bench:
        with pytest.raises(OutOfVolumeError):
            bench.device.start("fill", volume_ml=volume_ml, max_run_s=60.0)
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == 0.0


@pytest.mark.without_world
@pytest.mark.parametrize("max_run_s", [0.0, -1.0, math.nan, math.inf])
def test_refuses_to_run_without_a_time_limit(open_pump, max_run_s: float) -> None:
    with open_pump() as bench:
        with pytest.raises(OutOfVolumeError):
            bench.device.start("fill", volume_ml=100.0, max_run_s=max_run_s)
        assert not bench.device.status().running


def test_a_stop_stops_and_a_second_one_is_harmless(open_pump) -> None:
    with open_pump() as bench:
        bench.device.start("fill", volume_ml=300.0, max_run_s=60.0)
        watch(bench, 10.0)
        bench.device.stop()
        bench.device.stop()
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == pytest.approx(100.0)
        assert bench.device.status().moved_ml == pytest.approx(100.0)


@pytest.mark.without_world
def test_a_second_start_is_refused_while_the_pump_runs(open_pump) -> None:
    with open_pump() as bench:
        bench.device.start("fill", volume_ml=300.0, max_run_s=60.0)
        with pytest.raises(DeviceBusyError):
            bench.device.start("drain", volume_ml=300.0, max_run_s=60.0)


def test_the_pump_is_off_after_any_way_out(open_pump) -> None:
    worlds = []

    def fall_over() -> None:
        with open_pump() as bench:
            worlds.append(bench.world)
            bench.device.start("fill", volume_ml=300.0, max_run_s=60.0)
            watch(bench, 10.0)
            raise RuntimeError("the sequencer fell over")

    with pytest.raises(RuntimeError, match="fell over"):
        fall_over()
    (world,) = worlds
    world.clock.sleep_s(60.0)
    assert world.state().tank_ml == pytest.approx(100.0)
