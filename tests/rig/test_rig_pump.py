"""``rig pump`` with real drivers: the pumps are emulated on pseudo terminals, the rest is what an operator runs."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.protocols import Frame
from rig.tank.ledger import FlowBegun
from rig.tank.ledger_book import LedgerBook
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
        code, out, err = rig("pump", "fill", "20")
        assert (code, err) == (0, "")
        counted, tank, reservoir = out.splitlines()
        assert counted == "pump: 20 ml counted"
        assert tank.startswith("tank: 20 ml of 6000 ml (measured at ")
        assert reservoir.startswith("reservoir: 4980 ml of 5000 ml (counted at ")
        assert world.state().tank_ml == pytest.approx(20.0, abs=0.2)
        code, out, err = rig("pump", "fill", "5990")
        assert (code, out) == (1, "")
        assert err.startswith("rig: pump: a fill of 5990 ml asked, the tank holds 20 ml (measured at ")
        board.leak_open = True
        code, out, err = rig("pump", "drain", "20")
        assert (code, out) == (1, "")
        assert "there is liquid beside the tank" in err
        assert err.count("\n") == 1


def test_a_new_era_pump_stands_still_on_request_and_says_so(rig: Run, world: World) -> None:
    with PtyServer(NewEraEmulator(world)) as wire:
        configure(rig, pump=f"new_era:{wire.address}", section="diameter_mm = 26.59")
        unknown = "tank: unknown: nobody has said yet\nreservoir: unknown: nobody has said yet\n"
        assert rig("pump", "stop") == (0, f"pump: stands still\n{unknown}", "")
        assert rig("pump", "status") == (0, f"pump: stands still\n{unknown}", "")


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
        assert rig("pump", "level", "0")[0] == 0
        monkeypatch.setattr("typer.prompt", lambda *_args, **_settings: 12.1)  # 10 ml counted: 1.1 times the diameter
        code, out, err = rig("pump", "calibrate", "1")
    assert (code, err) == (0, "")
    assert out.endswith("write diameter_mm = 22.00 in section [pump]\n")


# What is remembered from command to command


@pytest.fixture
def told_empty(rig: Run, world: World) -> Iterator[Run]:
    """Return ``rig`` with a New Era pump, which has no level sensor, and a tank that was told to be empty."""
    with PtyServer(NewEraEmulator(world)) as wire:
        configure(rig, pump=f"new_era:{wire.address}", section="diameter_mm = 26.59")
        assert rig("pump", "level", "0")[0] == 0
        yield rig


def tank_line(told: tuple[int, str, str]) -> str:
    return next(line for line in told[1].splitlines() if line.startswith("tank: "))


def test_without_a_sensor_the_ledger_counts_from_command_to_command(told_empty: Run, world: World) -> None:
    assert tank_line(told_empty("pump", "fill", "20")).startswith("tank: 20 ml of 6000 ml (counted at ")
    code, out, _ = told_empty("pump", "fill", "--to", "30")
    assert (code, out.splitlines()[0]) == (0, "pump: 10 ml counted")
    assert world.state().tank_ml == pytest.approx(30.0)
    assert told_empty("pump", "fill", "--to", "30")[1].startswith("pump: 0 ml counted")
    told_empty("pump", "drain", "--to", "5")
    assert world.state().tank_ml == pytest.approx(5.0)
    assert tank_line(told_empty("pump", "status")).startswith("tank: 5 ml of 6000 ml (counted at ")


@pytest.mark.parametrize(
    "asked", [("fill", "10"), ("fill", "--to", "10"), ("drain", "10"), ("prime", "10"), ("calibrate",)]
)
def test_after_a_crash_nothing_is_pumped_until_somebody_says_what_the_tank_holds(
    told_empty: Run, world: World, own_state_folder: Path, asked: tuple[str, ...]
) -> None:
    (path,) = own_state_folder.glob("refractive-scan/liquid/*.jsonl")
    LedgerBook(path, total_ml=5000.0).note(FlowBegun("fill", 300.0))  # and then the program was killed
    code, out, err = told_empty("pump", *asked)
    assert (code, out) == (1, "")
    assert err.startswith("rig: what the tank holds is unknown: a fill of 300 ml began at ")
    assert err.endswith("before you measure it and say so with `rig pump level ML`\n")
    assert "unknown" in tank_line(told_empty("pump", "status"))
    assert world.state().tank_ml == 0.0
    told_empty("pump", "level", "7")
    assert told_empty("pump", "fill", "10")[0] == 0
    assert tank_line(told_empty("pump", "status")).startswith("tank: 17 ml")


def test_an_alarm_in_mid_fill_leaves_the_tank_unknown(rig: Run, world: World) -> None:
    board = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=10.0, full_at_ml=10.0)
    with PtyServer(board) as wire:
        configure(rig, pump=f"tank_board:{wire.address}")
        rig("pump", "level", "0")
        code, _, err = rig("pump", "fill", "40")
        assert code == 1
        assert "over-fill contact is open" in err
        assert tank_line(rig("pump", "status")).startswith("tank: unknown: a fill of 40 ml ended with: pump: alarm")


def test_a_level_sensor_that_contradicts_the_ledger_is_not_believed_until_a_person_has_looked(
    rig: Run, world: World
) -> None:
    board = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=10.0)
    with PtyServer(board) as wire:
        configure(rig, pump=f"tank_board:{wire.address}", section="level_points = [[0, 0.0], [600, 6000.0]]")
        assert rig("pump", "level", "4000")[0] == 0
        for _ in range(2):  # asking again does not make the sensor right
            code, _, err = rig("pump", "fill", "10")
            assert code == 1
            assert err.startswith(
                "rig: the level sensor says that the tank holds 0 ml, the ledger says 4000 ml (told at "
            )
            assert "then say what the tank holds with `rig pump level`" in err
        assert rig("pump", "level", "0")[0] == 0
        assert rig("pump", "fill", "10")[0] == 0


@pytest.mark.parametrize("asked", [("fill",), ("fill", "10", "--to", "20"), ("drain",)])
def test_a_flow_without_one_clear_end_is_refused(rig: Run, asked: tuple[str, ...]) -> None:
    code, _, err = rig("pump", *asked, "--sim")
    assert code == 1
    assert err.startswith(f"rig: a {asked[0]} needs either how much to pump (ML) or what the tank shall hold (--to ML)")


@pytest.mark.parametrize("told", [("7000",), ("100", "--reservoir", "5001")])
def test_a_level_that_cannot_be_is_refused(told_empty: Run, told: tuple[str, ...]) -> None:
    code, _, err = told_empty("pump", "level", *told)
    assert code == 1
    assert "it can hold" in err


def test_a_level_below_nothing_is_refused_as_a_volume_and_not_as_an_option(told_empty: Run) -> None:
    code, _, err = told_empty("pump", "level", "-5")
    assert code == 1
    assert err == "rig: -5 ml in the tank told, none holds less than nothing; measure again\n"


def test_a_rehearsal_remembers_beside_its_state_and_forgets_with_it(rig: Run, tmp_path: Path) -> None:
    state = tmp_path / "bench.json"
    assert tank_line(rig("pump", "fill", "--to", "300", "--sim", "--state", str(state))).startswith("tank: 300 ml")
    assert (tmp_path / "bench.json.liquid.jsonl").exists()
    state.unlink()
    assert tank_line(rig("pump", "status", "--sim", "--state", str(state))).startswith("tank: 0 ml of ")


def test_a_fill_to_a_level_is_ended_by_the_sensor_when_the_pump_is_faster_than_its_rate_says(
    rig: Run, world: World
) -> None:
    # 600 ml/min are configured, so 20 ml are 2 s; the pump moves 8 per cent more than that.
    board = TankBoardEmulator(world, fill_ml_per_s=10.8, drain_ml_per_s=10.0, counts_per_ml=10.0)
    with PtyServer(board) as wire:
        configure(rig, pump=f"tank_board:{wire.address}", section="level_points = [[0, 0.0], [1000, 100.0]]")
        code, _, err = rig("pump", "fill", "--to", "20")
        assert (code, err) == (0, "")
    # Between two questions lie 20 ms or more, and the pump stops after the second.
    assert 20.0 <= world.state().tank_ml <= 21.5
