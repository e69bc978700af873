"""One fault at a time, with the real drivers on emulated pumps: which layer keeps the water in the tank.

The tank has 6000 ml of room and 5000 ml of liquid exist. The pump moves 150 ml a second; the simulated clock moves only while
the rig waits, so that a silence of ten minutes is ten minutes to the pump and nothing to the test.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.errors import OutOfVolumeError
from drivers.new_era_pump import NewEraPump
from drivers.protocols import Frame, LevelSensor, Pump
from drivers.tank_board import TankBoard
from rig.capturing.operators import ConsoleOperator
from rig.config import RigConfig
from rig.devices import TankDevices
from rig.errors import CaptureError, TankAlarmError, WrongLevelError
from rig.tank.flow import check_level_after, learn_level, run_flow
from rig.tank.guard import Guard
from rig.tank.ledger import Known, LevelLearnt, Unknown
from rig.tank.ledger_book import LedgerBook
from sim_backend.clock import SimulatedClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import TankSize, World, WorldState

RATE_ML_PER_MIN = 9000.0
LIQUID_ML, ROOM_ML, FILL_ML = 5000.0, 6000.0, 4500.0
TEN_MINUTES_S = 600.0
DARK = Frame(axis="x", levels=np.zeros(8, np.uint8))


@dataclass
class Bench:
    """A tank, its pump, and what the rig believes; ``emulator`` and ``world`` take faults."""

    world: World
    emulator: NewEraEmulator | TankBoardEmulator
    devices: TankDevices
    config: RigConfig
    after_each_poll: Callable[[float], None] = lambda _moved_ml: None  # nobody asks to stop

    def flow(self, direction="fill", *, volume_ml: float = FILL_ML, to_ml: float | None = None) -> float:
        """Do what `rig pump` and the capture do."""
        learn_level(self.devices, self.config)
        guard = Guard(pump=self.devices.pump, book=self.devices.book, tank=self.config.tank)
        guard.check(direction, volume_ml=volume_ml)
        on_poll = self.after_each_poll
        moved_ml = run_flow(self.devices, self.config, direction, volume_ml=volume_ml, to_ml=to_ml, on_poll=on_poll)
        check_level_after(self.devices, self.config, moved_ml=moved_ml)
        return moved_ml

    @property
    def believed(self) -> Known | Unknown:
        return self.devices.book.ledger.tank


def bench_of(world: World, emulator, pump: Pump, sensor: LevelSensor | None, config: RigConfig) -> Bench:
    assert config.tank is not None
    tank = config.tank.model_copy(
        update={
            "free_volume_ml": ROOM_ML,
            "fill_ml": FILL_ML,
            "reservoir_ml": LIQUID_ML,
            "pump_rate_ml_per_min": RATE_ML_PER_MIN,
        }
    )
    book = LedgerBook(None, total_ml=LIQUID_ML)
    book.note(LevelLearnt("tank", world.state().tank_ml, "told"))
    devices = TankDevices(pump, sensor, ConsoleOperator(), world.clock, book)
    return Bench(world, emulator, devices, config.model_copy(update={"tank": tank}))


def world_with(tank_ml: float = 0.0) -> World:
    state = WorldState(tank_ml=tank_ml, reservoir_ml=LIQUID_ML - tank_ml)
    return World(clock=SimulatedClock(), tank=TankSize(ROOM_ML, FILL_ML), dark_frame=DARK, state=state)


@contextmanager
def board_bench(config: RigConfig, *, sensor: bool = False, full_at_ml: float = 5500.0) -> Iterator[Bench]:
    world, rate_ml_per_s = world_with(), RATE_ML_PER_MIN / 60
    emulator = TankBoardEmulator(
        world, fill_ml_per_s=rate_ml_per_s, drain_ml_per_s=rate_ml_per_s, full_at_ml=full_at_ml, counts_per_ml=0.17
    )
    rates = {"fill_ml_per_min": RATE_ML_PER_MIN, "drain_ml_per_min": RATE_ML_PER_MIN}
    points = [(0, 0.0), (1020, 6000.0)]
    with PtyServer(emulator) as wire, TankBoard(wire.address, **rates, level_points=points, kind="emulated") as board:
        yield bench_of(world, emulator, board, board if sensor else None, config)


@contextmanager
def new_era_bench(config: RigConfig) -> Iterator[Bench]:
    world = world_with()
    emulator = NewEraEmulator(world, max_rate_ml_per_min=RATE_ML_PER_MIN)
    with (
        PtyServer(emulator) as wire,
        NewEraPump(wire.address, rate_ml_per_min=RATE_ML_PER_MIN, diameter_mm=26.59, kind="emulated") as pump,
    ):
        yield bench_of(world, emulator, pump, None, config)


@pytest.fixture(params=[board_bench, new_era_bench], ids=["tank board", "new era"])
def bench(request: pytest.FixtureRequest, config: RigConfig) -> Iterator[Bench]:
    with request.param(config) as opened:
        yield opened


# Level switch


def test_a_float_that_hangs_costs_one_layer_and_the_volume_still_ends_the_fill(config: RigConfig) -> None:
    with board_bench(config, full_at_ml=float("inf")) as bench:
        bench.flow()
        bench.world.clock.sleep_s(TEN_MINUTES_S)
        assert bench.world.state().tank_ml == pytest.approx(FILL_ML, rel=1e-3)
        assert bench.world.state().overflow_ml == 0


def test_a_float_whose_wire_broke_lets_nothing_in(config: RigConfig) -> None:
    with board_bench(config) as bench:
        bench.emulator.full_open = True
        with pytest.raises((TankAlarmError, OutOfVolumeError), match="over-fill contact is open"):
            bench.flow()
        assert bench.world.state().tank_ml <= RATE_ML_PER_MIN / 60  # the contact is believed after 20 ms


# Relay and hose


@pytest.mark.parametrize("sensor", [False, True])
def test_a_welded_relay_empties_the_reservoir_and_does_not_fill_the_tank_over(config: RigConfig, sensor: bool) -> None:
    with board_bench(config, sensor=sensor) as bench:
        bench.world.faults.welded = True
        bench.flow(volume_ml=1500.0)
        bench.world.clock.sleep_s(TEN_MINUTES_S)
        assert bench.world.flow_direction() == "fill"  # it turns, whatever the board says
        assert bench.world.state().tank_ml == LIQUID_ML
        assert bench.world.state().overflow_ml == 0
        if sensor:
            with pytest.raises(
                WrongLevelError, match=r"sensor says that the tank holds (4999|5000) ml, the ledger says 15"
            ):
                learn_level(bench.devices, bench.config)


@pytest.mark.parametrize("siphon_ml_per_s", [5.0, -5.0], ids=["into the tank", "out of it"])
def test_a_siphon_moves_what_there_is_and_the_sensor_tells(config: RigConfig, siphon_ml_per_s: float) -> None:
    with board_bench(config, sensor=True) as bench:
        bench.flow(volume_ml=2500.0)
        bench.world.faults.siphon_ml_per_s = siphon_ml_per_s
        bench.world.clock.sleep_s(TEN_MINUTES_S)
        assert bench.world.state().overflow_ml == 0
        with pytest.raises(WrongLevelError, match="the ledger says 25"):
            learn_level(bench.devices, bench.config)


# What the rig believes


def test_a_ledger_that_is_wrong_by_a_whole_fill_floods_nothing(bench: Bench) -> None:
    bench.world.pour_by_hand(FILL_ML)
    bench.devices.book.note(LevelLearnt("tank", 0.0, "told"))
    bench.flow()
    assert bench.world.state().tank_ml == LIQUID_ML
    assert bench.world.state().overflow_ml == 0


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_pump_that_is_wrong_by_a_fifth_floods_nothing(bench: Bench, factor: float) -> None:
    bench.world.faults.pump_factor = factor
    bench.flow()
    assert bench.world.state().tank_ml == pytest.approx(min(factor * FILL_ML, LIQUID_ML), rel=1e-3)
    assert bench.world.state().overflow_ml == 0


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_sensor_finds_a_pump_that_is_wrong_by_a_fifth(config: RigConfig, factor: float) -> None:
    with board_bench(config, sensor=True) as bench:
        bench.world.faults.pump_factor = factor
        with pytest.raises(WrongLevelError, match="look for a leak, an empty reservoir, a worn tube or a stuck sensor"):
            bench.flow(to_ml=FILL_ML)
        # Fast: the sensor ends it. Slow: a tenth more than is missing does.
        expected_ml = FILL_ML if factor > 1 else 1.1 * factor * FILL_ML
        assert bench.world.state().tank_ml == pytest.approx(expected_ml, abs=20.0)


def test_a_sensor_ends_every_fill_below_the_rim_even_from_a_reservoir_that_could_flood_the_room(
    config: RigConfig,
) -> None:
    """Three faults: a refilled reservoir, a float that hangs, and a pump that moves a fifth more than it counts."""
    with board_bench(config, sensor=True, full_at_ml=float("inf")) as bench:
        bench.world._state = WorldState(reservoir_ml=20_000.0)
        bench.devices.book.note(LevelLearnt("reservoir", 20_000.0, "told"))
        bench.world.faults.pump_factor = 1.2
        with pytest.raises(WrongLevelError, match="worn tube"):
            bench.flow(volume_ml=5900.0)
        assert 0.99 * ROOM_ML < bench.world.state().tank_ml <= ROOM_ML
        assert bench.world.state().overflow_ml == 0


@pytest.mark.parametrize("stuck", [0, 300])
def test_a_sensor_that_is_stuck_does_not_keep_the_pump_going(config: RigConfig, stuck: int) -> None:
    with board_bench(config, sensor=True) as bench:
        learn_level(bench.devices, bench.config)
        on_stuck = iter([None] * 3 + [stuck] * 10**6)
        read = bench.devices.level_sensor.volume_ml

        def sticks_in_mid_fill() -> float:
            bench.emulator.stuck_level = next(on_stuck)
            return read()

        bench.devices.level_sensor.volume_ml = sticks_in_mid_fill
        with pytest.raises(WrongLevelError, match="stuck sensor"):
            bench.flow(to_ml=FILL_ML)
        assert bench.world.flow_direction() is None
        assert bench.world.state().tank_ml <= 1.1 * FILL_ML + 1.0
        assert bench.world.state().overflow_ml == 0
        with pytest.raises(WrongLevelError):  # and it is not believed the next time either
            bench.flow(to_ml=FILL_ML)


# The computer


def test_a_computer_that_is_silent_for_ten_minutes_finds_the_pump_off_and_the_tank_unknown(bench: Bench) -> None:
    def falls_asleep(moved_ml: float) -> None:
        if moved_ml > 1000.0:
            bench.world.clock.sleep_s(TEN_MINUTES_S)

    bench.after_each_poll = falls_asleep
    with pytest.raises(TankAlarmError, match="nobody asked for"):
        bench.flow()
    assert bench.world.flow_direction() is None
    assert bench.world.state().tank_ml < 2000.0  # one second of silence for the board, five for the New Era pump
    assert isinstance(bench.believed, Unknown)
    with pytest.raises(TankAlarmError, match="not safe to start a fill"):
        bench.flow()
    # Opened anew, as after a person has looked, the pump has nothing more to complain of. The ledger has.
    bench.devices.pump.__exit__(None, None, None)
    bench.devices.pump.__enter__()
    bench.after_each_poll = lambda _moved_ml: None
    with pytest.raises(CaptureError, match="what the tank holds is unknown"):
        bench.flow()
    bench.devices.book.note(LevelLearnt("tank", bench.world.state().tank_ml, "told"))
    bench.flow(volume_ml=100.0)


def test_a_dead_man_timer_that_never_comes_leaves_the_volume_to_end_the_flow(config: RigConfig) -> None:
    with new_era_bench(config) as bench:
        bench.devices.pump.start("fill", volume_ml=FILL_ML, max_run_s=36.0)
        bench.emulator.break_dead_man()
        bench.world.clock.sleep_s(TEN_MINUTES_S)  # and nobody is alive
        assert bench.world.flow_direction() is None
        assert bench.world.state().tank_ml == pytest.approx(FILL_ML, rel=1e-3)
        assert bench.world.state().overflow_ml == 0
