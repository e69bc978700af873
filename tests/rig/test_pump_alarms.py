"""An alarm in the middle of a fill by hand: the emulated pumps ring, and this is the line that the operator is left with."""

import sys
import threading
import time
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from faults_page import OperatorReads

from drivers.protocols import Frame
from rig.cli import main
from sim_backend.clock import RealClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import TankSize, World, WorldState

Fill = Callable[[str, str, Callable[[], None]], tuple[int, str]]


@pytest.fixture
def world() -> World:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    return World(
        clock=RealClock(), tank=TankSize(6000.0, 4500.0), dark_frame=dark, state=WorldState(reservoir_ml=5000.0)
    )


@pytest.fixture
def fill(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path, world: World) -> Fill:
    """Return ``fill(pump, section, happening)`` → exit code and complaint of a fill in which something happens."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    def rig(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["rig", *arguments])
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0

    def run(pump: str, section: str, happening: Callable[[], None]) -> tuple[int, str]:
        text = (resources.files("rig") / "template.toml").read_text(encoding="utf-8")
        text = text.replace('pump = ""', f'pump = "{pump}"', 1).replace("[pump] ", f"[pump]\n{section}\n#", 1)
        Path("rig.toml").write_text(text, encoding="utf-8")
        assert rig("pump", "level", "0") == 0
        capfd.readouterr()

        def watch() -> None:
            while world.flow_direction() is None:
                time.sleep(0.01)
            time.sleep(0.3)
            happening()

        threading.Thread(target=watch, daemon=True).start()
        code = rig("pump", "fill", "500")
        return code, capfd.readouterr().err

    return run


def test_a_new_era_pump_whose_motor_stalls(operator_reads: OperatorReads, fill: Fill, world: World) -> None:
    check_new_era(operator_reads, fill, world, lambda pump: pump.ring("S"))


@pytest.mark.parametrize("alarm", ["E", "O"])
def test_a_new_era_pump_whose_program_is_wrong(
    operator_reads: OperatorReads, fill: Fill, world: World, alarm: str
) -> None:
    check_new_era(operator_reads, fill, world, lambda pump: pump.ring(alarm))


def test_a_new_era_pump_that_loses_its_power(operator_reads: OperatorReads, fill: Fill, world: World) -> None:
    check_new_era(operator_reads, fill, world, lambda pump: pump.power_cycle())


def test_a_new_era_pump_that_somebody_stops_at_its_keys(
    operator_reads: OperatorReads, fill: Fill, world: World
) -> None:
    check_new_era(operator_reads, fill, world, lambda pump: pump.press_stop_key())


def check_new_era(
    operator_reads: OperatorReads, fill: Fill, world: World, happening: Callable[[NewEraEmulator], None]
) -> None:
    emulator = NewEraEmulator(world)
    with PtyServer(emulator) as wire:
        code, said = fill(f"new_era:{wire.address}", "diameter_mm = 26.59", lambda: happening(emulator))
    assert code == 1
    operator_reads(said)
    assert world.flow_direction() is None
    assert world.state().tank_ml < 100.0


@pytest.mark.parametrize("happening", ["leak", "full", "reset"])
def test_a_tank_board_that_stops_by_itself(
    operator_reads: OperatorReads, fill: Fill, world: World, happening: str
) -> None:
    board = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=10.0)
    happenings: dict[str, Callable[[], None]] = {
        "leak": lambda: setattr(board, "leak_open", True),
        "full": lambda: setattr(board, "full_open", True),
        "reset": board.power_cycle,
    }
    with PtyServer(board) as wire:
        code, said = fill(f"tank_board:{wire.address}", "", happenings[happening])
    assert code == 1
    operator_reads(said)
    assert world.flow_direction() is None
    assert world.state().tank_ml < 100.0
