"""``rig pump`` with real drivers: the pumps are emulated on pseudo terminals, the rest is what an operator runs."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.protocols import Frame
from rig.cli import main
from sim_backend.clock import RealClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import TankSize, World, WorldState

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def world() -> World:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    return World(
        clock=RealClock(), tank=TankSize(6000.0, 4500.0), dark_frame=dark, state=WorldState(reservoir_ml=5000.0)
    )


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Return ``rig(arguments…)`` → exit code, what it printed, what it complained."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rig", *arguments])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        printed = capfd.readouterr()
        return code, printed.out, printed.err

    return run


def configure(rig: Run, *, pump: str, section: str = "") -> None:
    """Write the commented configuration with these values filled in."""
    rig("init")
    path = Path("rig.toml")
    text = path.read_text(encoding="utf-8")
    text = text.replace('pump = ""', f'pump = "{pump}"', 1).replace("[pump] ", f"[pump]\n{section}\n#", 1)
    path.write_text(text, encoding="utf-8")


def test_a_tank_board_fills_and_says_what_the_tank_holds(rig: Run, world: World) -> None:
    board = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=10.0, full_at_ml=5500.0)
    with PtyServer(board) as wire:
        configure(rig, pump=f"tank_board:{wire.address}", section="level_points = [[0, 0.0], [600, 6000.0]]")
        assert rig("pump", "fill", "20") == (0, "pump: 20 ml counted; the tank holds 20 ml of 6000 ml\n", "")
        assert world.state().tank_ml == pytest.approx(20.0, abs=0.2)
        code, out, err = rig("pump", "fill", "5990")
        assert (code, out) == (1, "")
        assert err.startswith("rig: pump: a fill of 5990 ml asked, the tank holds 20 ml and may hold 6000 ml")
        board.leak_open = True
        code, out, err = rig("pump", "drain", "20")
        assert (code, out) == (1, "")
        assert "there is liquid beside the tank" in err
        assert err.count("\n") == 1


def test_a_new_era_pump_stands_still_on_request_and_says_so(rig: Run, world: World) -> None:
    with PtyServer(NewEraEmulator(world)) as wire:
        configure(rig, pump=f"new_era:{wire.address}", section="diameter_mm = 26.59")
        assert rig("pump", "stop") == (0, "pump: stands still; no level sensor: look at the tank\n", "")
        assert rig("pump", "state")[1] == "pump: stands still; no level sensor: look at the tank\n"


@pytest.mark.parametrize(
    ("pump", "section", "told"),
    [
        ("new_era:/dev/nowhere", "", "rig: pump.diameter_mm: this value is missing"),
        ("new_era:/dev/nowhere", "diameter_mm = 3.1", "rig: pump: nothing at /dev/nowhere"),
        (
            "tank_board:",
            "",
            "rig: devices.pump: no driver answers to 'tank_board:'; write new_era:PORT or tank_board:PORT",
        ),
        ("hose", "", "rig: devices.pump: no driver answers to 'hose'"),
        ("tank_board:/dev/nowhere", "level_points = [[3, 4.0]]", "rig: rig.toml"),
    ],
)
def test_a_pump_that_cannot_be_is_told_in_one_sentence(rig: Run, pump: str, section: str, told: str) -> None:
    configure(rig, pump=pump, section=section)
    code, out, err = rig("pump", "stop")
    assert (code, out) == (1, "")
    assert err.startswith(told)
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "told"),
    # The simulated pump counts 1200 ml a minute; a cylinder that shows a tenth less asks for a tenth less.
    [
        ((), "write pump_rate_ml_per_min = 1080.0 in section [tank]"),
        (("--drain",), "write drain_rate_ml_per_min = 1080.0"),
    ],
)
def test_calibrating_says_which_value_to_write(
    rig: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, options: tuple[str, ...], told: str
) -> None:
    state = str(tmp_path / "state.json")
    assert rig("pump", "prime", "400", "--sim", "--state", state)[0] == 0
    monkeypatch.setattr("typer.prompt", lambda *_args, **_settings: 180.0)
    code, out, err = rig("pump", "calibrate", "10", *options, "--sim", "--state", state)
    assert (code, err) == (0, "")
    assert out.startswith("pump: 200.0 ml counted, 180.0 ml measured; ")
    assert told in out


def test_calibrating_a_new_era_pump_changes_its_diameter_by_the_square_root(
    rig: Run, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    with PtyServer(NewEraEmulator(world)) as wire:
        configure(rig, pump=f"new_era:{wire.address}", section="diameter_mm = 20.0")
        monkeypatch.setattr("rig.operators.ConsoleOperator.tank_ml", lambda *_args, **_settings: 0.0)
        monkeypatch.setattr("typer.prompt", lambda *_args, **_settings: 12.1)  # 10 ml counted: 1.1 times the diameter
        code, out, err = rig("pump", "calibrate", "1")
    assert (code, err) == (0, "")
    assert out.endswith("write diameter_mm = 22.00 in section [pump]\n")
