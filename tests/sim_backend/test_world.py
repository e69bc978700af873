"""The simulated world: liquid is neither made nor lost, and asking does not change what happens."""

import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceProtocolError
from drivers.protocols import FlowDirection, Frame
from sim_backend.clock import SimulatedClock
from sim_backend.world import Flow, Motion, TankSize, World, WorldState, wait_until
from sim_backend.world_file import WorldFile, after_restart, load_state, save_state

DARK = Frame(axis="x", levels=np.zeros(8, np.uint8))
FREE_ML, FILL_ML = 6000.0, 4000.0
finite = st.floats(allow_nan=False, allow_infinity=False)


def world_with(*, tank_ml: float = 0.0, reservoir_ml: float = 5000.0) -> World:
    state = WorldState(tank_ml=tank_ml, reservoir_ml=reservoir_ml)
    return World(clock=SimulatedClock(), tank=TankSize(FREE_ML, FILL_ML), dark_frame=DARK, state=state)


flows = st.lists(
    st.tuples(
        st.sampled_from(["fill", "drain"]),
        st.floats(0.1, 100.0),  # rate, ml/s
        st.floats(0.1, 20000.0),  # volume, ml
        st.floats(0.1, 500.0),  # longest run, s
        st.floats(0.0, 500.0),  # what is waited, s
    ),
    max_size=12,
)


@given(flows, st.floats(0.0, 20000.0))
def test_no_liquid_is_made_or_lost_and_the_tank_holds_no_more_than_it_can(flows, reservoir_ml: float) -> None:
    world = world_with(reservoir_ml=reservoir_ml)
    for direction, rate, volume_ml, longest_s, waited_s in flows:
        world.start_flow(direction, rate_ml_per_s=rate, volume_ml=volume_ml, max_run_s=longest_s)
        world.clock.sleep_s(waited_s)
        state = world.state()
        assert state.tank_ml + state.reservoir_ml + state.overflow_ml == pytest.approx(reservoir_ml, abs=1e-6)
        assert 0 <= state.tank_ml <= FREE_ML
        assert min(state.reservoir_ml, state.overflow_ml) >= -1e-9
        assert world.moved_ml() <= min(volume_ml, rate * longest_s) * (1 + 1e-12)


@given(st.lists(st.floats(0.0, 60.0), max_size=20))
def test_asking_often_does_not_change_what_flows(waits_s: list[float]) -> None:
    asked, left_alone = world_with(), world_with()
    for world in (asked, left_alone):
        world.start_flow("fill", rate_ml_per_s=7.0, volume_ml=1234.5, max_run_s=150.0)
    for wait_s in waits_s:
        asked.clock.sleep_s(wait_s)
        asked.state()
    left_alone.clock.sleep_s(math.fsum(waits_s))
    assert asked.state().tank_ml == pytest.approx(left_alone.state().tank_ml, abs=1e-9)
    assert asked.moved_ml() == pytest.approx(min(7.0 * min(math.fsum(waits_s), 150.0), 1234.5))


def test_what_does_not_fit_into_the_tank_runs_over_its_rim() -> None:
    world = world_with(reservoir_ml=10_000.0)
    world.start_flow("fill", rate_ml_per_s=100.0, volume_ml=7000.0, max_run_s=1000.0)
    world.clock.sleep_s(1000.0)
    assert world.state().tank_ml == pytest.approx(6000.0)
    assert world.state().overflow_ml == pytest.approx(1000.0)


def test_an_empty_reservoir_lets_the_pump_count_without_moving_anything() -> None:
    world = world_with(reservoir_ml=100.0)
    world.start_flow("fill", rate_ml_per_s=10.0, volume_ml=500.0, max_run_s=1000.0)
    world.clock.sleep_s(1000.0)
    assert world.moved_ml() == pytest.approx(500.0)
    assert world.state().tank_ml == pytest.approx(100.0)


@pytest.mark.parametrize(("tank_ml", "wet"), [(0.0, False), (3900.0, False), (4000.0, True), (6000.0, True)])
def test_the_object_is_wet_once_the_fill_is_in(tank_ml: float, wet: bool) -> None:
    assert world_with(tank_ml=tank_ml).is_wet() is wet


def test_the_stage_is_under_way_in_between_and_exactly_there_in_the_end() -> None:
    world = world_with()
    world.start_motion(0.3, velocity_mm_per_s=0.1)
    world.clock.sleep_s(1.0)
    assert world.is_moving()
    assert world.stage_mm() == pytest.approx(0.1)
    world.clock.sleep_s(10.0)
    assert not world.is_moving()
    assert world.stage_mm() == 0.3
    world.start_motion(0.1, velocity_mm_per_s=0.1)
    world.clock.sleep_s(1.0)
    world.stop_motion()
    world.clock.sleep_s(10.0)
    assert world.stage_mm() == pytest.approx(0.2)


@pytest.mark.parametrize("direction", ["fill", "drain"])
def test_a_photo_taken_while_something_moves_is_counted(direction: FlowDirection) -> None:
    world = world_with(tank_ml=1000.0)
    assert not world.look().disturbed
    world.start_flow(direction, rate_ml_per_s=10.0, volume_ml=500.0, max_run_s=1000.0)
    assert world.look().disturbed
    world.stop_flow()
    world.start_motion(5.0, velocity_mm_per_s=1.0)
    assert world.look().disturbed
    world.stop_motion()
    assert not world.look().disturbed
    assert world.disturbed_photos == 2


flow_states = st.builds(
    Flow, direction=st.sampled_from(["fill", "drain"]), rate_ml_per_s=finite, started_s=finite, runs_s=finite
)
motions = st.builds(Motion, from_mm=finite, to_mm=finite, velocity_mm_per_s=finite, started_s=finite)
states = st.builds(
    WorldState,
    tank_ml=finite,
    stage_mm=finite,
    stage_homed=st.booleans(),
    flow=st.none() | flow_states,
    motion=st.none() | motions,
    at_s=finite,
)


@given(states, finite)
def test_the_state_of_a_rig_survives_its_file_and_time_goes_on_in_it(state: WorldState, later_s: float) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.json"
        save_state(state, path)
        assert load_state(path) == state
        file = WorldFile(path)
        file.keep(state)
        file.keep_time(later_s)
        file.close()
        assert load_state(path) == replace(state, at_s=later_s)


@pytest.mark.parametrize("gone_s", [0.0, 12.0, 10_000.0])
def test_a_pump_and_a_stage_under_way_go_on_when_their_program_is_gone(tmp_path: Path, gone_s: float) -> None:
    file = WorldFile(tmp_path / "rig.json")
    clock = SimulatedClock(on_move=file.keep_time)
    world = World(
        clock=clock,
        tank=TankSize(FREE_ML, FILL_ML),
        dark_frame=DARK,
        state=WorldState(reservoir_ml=5000.0),
        on_change=file.keep,
    )
    world.start_flow("fill", rate_ml_per_s=10.0, volume_ml=4000.0, max_run_s=60.0)
    clock.sleep_s(7.0)
    world.start_motion(100.0, velocity_mm_per_s=5.0)
    clock.sleep_s(3.0)
    # Killed here: nothing is saved on the way out.
    left = load_state(tmp_path / "rig.json")
    again = World(
        clock=SimulatedClock(left.at_s + gone_s), tank=TankSize(FREE_ML, FILL_ML), dark_frame=DARK, state=left
    )
    assert again.state().tank_ml == pytest.approx(10.0 * min(10.0 + gone_s, 60.0))
    assert again.stage_mm() == pytest.approx(min(5.0 * (3.0 + gone_s), 100.0))


def test_after_a_restart_of_the_machine_what_was_under_way_has_ended() -> None:
    flow, motion = Flow("fill", 10.0, started_s=5000.0, runs_s=60.0), Motion(0.0, 8.0, 1.0, started_s=5000.0)
    state = WorldState(reservoir_ml=5000.0, flow=flow, motion=motion, at_s=5010.0)
    world = World(
        clock=SimulatedClock(1.0), tank=TankSize(FREE_ML, FILL_ML), dark_frame=DARK, state=after_restart(state, 1.0)
    )
    assert world.state().tank_ml == pytest.approx(600.0)
    assert world.flow_direction() is None
    assert world.stage_mm() == 8.0


@pytest.mark.parametrize("text", ["", "{}", "[1, 2]", '{"tank_ml": 3}'])
def test_a_file_that_is_no_state_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "rig.json").write_text(text)
    with pytest.raises(DeviceProtocolError, match="not the state of a simulated rig"):
        load_state(tmp_path / "rig.json")


def test_waiting_gives_up_at_its_deadline() -> None:
    clock = SimulatedClock()
    assert not wait_until(clock, lambda: False, timeout_s=3.0)
    assert clock.now_s() == pytest.approx(3.0)
    assert wait_until(clock, lambda: True, timeout_s=3.0)
