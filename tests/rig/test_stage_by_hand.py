"""``rig stage`` with a stage that is not simulated: the real drivers, on the port of an emulated controller."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from drivers.protocols import Frame
from rig.tank.ledger import FlowBegun
from rig.tank.ledger_book import LedgerBook
from sim_backend.clock import FastClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.grbl_homing import GrblFaults
from sim_backend.wire import PtyServer, TcpServer
from sim_backend.world import TankSize, World, WorldState
from sim_backend.zaber_emulator import ZaberEmulator

Run = Callable[..., tuple[int, str, str]]
MICROSTEP_MM = 0.000047625


@pytest.fixture
def world() -> World:
    """A world in which a minute takes a second, with a stage that nobody homed."""
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    return World(clock=FastClock(60.0), tank=TankSize(1.0, 1.0), dark_frame=dark, state=WorldState(stage_mm=37.0))


def configure(folder: Path, stage: str, *, microstep_mm: float | None = None) -> None:
    text = (resources.files("rig") / "template.toml").read_text(encoding="utf-8")
    text = text.replace('\nstage = ""', f'\nstage = "{stage}"')
    if microstep_mm is not None:
        text = text.replace("# microstep_mm = 0.000047625", f"microstep_mm = {microstep_mm}")
    (folder / "rig.toml").write_text(text, encoding="utf-8")


def test_a_grbl_stage_is_homed_and_moved_by_hand(rig: Run, world: World, tmp_path: Path) -> None:
    with PtyServer(GrblEmulator(world, travel_mm=(0.0, 100.0))) as wire:
        configure(tmp_path, f"grbl:{wire.address}")
        code, out, err = rig("stage", "move", "42.5", "--home")
        assert (code, out, err) == (0, "stage: 42.500 mm of 0 to 100 mm\n", "")
        assert world.stage_mm() == pytest.approx(42.5, abs=0.005)
        code, out, err = rig("stage", "move", "20")
        assert (code, out) == (1, "")
        assert "not homed since its port was opened" in err
        assert err.count("\n") == 1


def test_a_failed_homing_is_one_sentence_and_not_a_traceback(rig: Run, world: World, tmp_path: Path) -> None:
    emulator = GrblEmulator(world, travel_mm=(0.0, 100.0))
    emulator.faults = GrblFaults(pull_off_is_stuck=True)
    with PtyServer(emulator) as wire:
        configure(tmp_path, f"grbl:{wire.address}")
        code, out, err = rig("stage", "home")
    assert (code, out) == (1, "")
    assert err == (
        "rig: stage: the controller stopped with ALARM:8: the carriage did not come free of the homing switch; check the "
        "switch and $27, then home the stage\n"
    )


def test_a_zaber_stage_stays_homed_from_command_to_command(rig: Run, world: World, tmp_path: Path) -> None:
    emulator = ZaberEmulator(world, travel_mm=(0.0, 100.0), microstep_mm=MICROSTEP_MM, velocity_mm_per_s=25.0)
    with TcpServer(emulator) as wire:
        configure(tmp_path, f"zaber:{wire.address}", microstep_mm=MICROSTEP_MM)
        assert rig("stage", "home") == (0, "stage: 0.000 mm of 0 to 100 mm\n", "")
        assert rig("stage", "move", "60") == (0, "stage: 60.000 mm of 0 to 100 mm\n", "")
        assert world.stage_mm() == pytest.approx(60.0, abs=0.001)
        code, out, _ = rig("stage", "repeat", "20", "--away", "30", "--times", "3")
        assert code == 0
        assert out == "stage: 20.0000, 20.0000, 20.0000 mm by the stage's own count; spread 0.0000 mm, sd 0.0000 mm\n"


def test_repeatability_can_be_read_from_a_gauge(rig: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    readings = iter([0.012, 0.016, 0.014])
    monkeypatch.setattr("typer.prompt", lambda *_, **__: next(readings))
    code, out, err = rig("stage", "repeat", "20", "--away", "25", "--times", "3", "--gauge", "--sim")
    # Three readings 0.002 apart: spread 0.004, standard deviation 0.002.
    assert (code, err) == (0, "")
    assert out == "stage: 0.0120, 0.0160, 0.0140 mm by dial gauge; spread 0.0040 mm, sd 0.0020 mm\n"


@pytest.mark.parametrize(
    ("stage", "says"),
    [
        ("zaber:/dev/ttyUSB0", "stage.microstep_mm: this value is missing"),
        ("/dev/ttyUSB0", "no driver answers to '/dev/ttyUSB0'; write grbl:PORT or zaber:PORT"),
        ("grbl:", "no driver answers to 'grbl:'"),
        ("grbl:/dev/there-is-no-such-port", "nothing at /dev/there-is-no-such-port"),
    ],
)
def test_a_stage_that_cannot_be_opened_is_one_sentence(rig: Run, tmp_path: Path, stage: str, says: str) -> None:
    configure(tmp_path, stage)
    code, out, err = rig("stage", "where")
    assert (code, out) == (1, "")
    assert says in err
    assert err.count("\n") == 1


def test_two_places_that_are_the_same_are_refused(rig: Run) -> None:
    code, _, err = rig("stage", "repeat", "20", "--away", "20", "--sim")
    assert code == 1
    assert "name two places that differ" in err


@pytest.mark.parametrize("asked", [("home",), ("move", "5", "--home"), ("repeat", "5", "--away", "6")])
def test_the_stage_stands_still_while_a_flow_has_no_end_on_record(
    rig: Run, tmp_path: Path, asked: tuple[str, ...]
) -> None:
    kept = ("--sim", "--state", "bench.json")
    before = rig("stage", "where", *kept)[1]
    LedgerBook(tmp_path / "bench.json.liquid.jsonl", total_ml=5000.0).note(FlowBegun("fill", 300.0))
    code, out, err = rig("stage", *asked, *kept)
    assert (code, out) == (1, "")
    assert "it is not safe to move the stage; stop it (`rig pump stop`)" in err
    assert rig("stage", "where", *kept)[1] == before
    rig("pump", "stop", *kept)
    assert rig("stage", "home", *kept)[0] == 0
