"""``rig stage``: the stage by hand."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from drivers.protocols import Stage
from drivers.repeatability import measure_repeatability
from rig import options
from rig.devices import open_stage
from rig.errors import ConfigError
from rig.options import Rig, choose_rig
from rig.rehearsing.rehearsal import ledger_file
from rig.rehearsing.scene_config import SceneOptions
from rig.tank.guard import Guard
from rig.tank.ledger_book import book_of, real_book

app = typer.Typer(
    help="The stage by hand: home, move, where, repeat. With --sim and --state FILE it remembers from command to command.",
    no_args_is_help=True,
)
TIMEOUT_S = 300.0


def _open(sim: bool, config: Path | None, scene: str | None) -> Rig:
    return choose_rig(sim, config, scene, SceneOptions())


@contextmanager
def _stage_to_move(rig: Rig, *, real_time: bool, state: Path | None) -> Iterator[Stage]:
    """Open the stage, unless the pump may turn; the pump itself is not opened, so the ledger is asked."""
    simulation = rig.simulation(real_time=real_time, state_file=state)
    book = real_book(rig.config) if simulation is None else book_of(rig.config, ledger_file(simulation))
    Guard(pump=None, book=book, tank=rig.config.tank).check("move")
    with open_stage(rig.config, simulation=simulation) as stage:
        yield stage


def _where(stage: Stage) -> str:
    low_mm, high_mm = stage.travel_mm()
    homed = "" if stage.is_homed() else ", but it was not homed, so this cannot be trusted"
    return f"stage: {stage.position_mm():.3f} mm of {low_mm:g} to {high_mm:g} mm{homed}"


@app.command()
def home(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Find the reference switch. Look first: the stage drives along its whole travel."""
    rig = _open(sim, config, scene)
    with _stage_to_move(rig, real_time=real_time, state=state) as stage:
        stage.home(timeout_s=TIMEOUT_S)
        print(_where(stage))


@app.command(context_settings=options.NUMBERS_BELOW_ZERO)
def move(
    position_mm: Annotated[float, typer.Argument(metavar="MM", help="Where to go, in mm from the reference.")],
    home_first: Annotated[bool, typer.Option("--home", help="Home the stage first.")] = False,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Drive to a position; anything outside the travel is refused before the stage moves."""
    rig = _open(sim, config, scene)
    with _stage_to_move(rig, real_time=real_time, state=state) as stage:
        if home_first:
            stage.home(timeout_s=TIMEOUT_S)
        stage.move_to_mm(position_mm, timeout_s=TIMEOUT_S)
        print(_where(stage))


@app.command()
def repeat(
    position_mm: Annotated[float, typer.Argument(metavar="MM", help="Where to come back to, in mm.")],
    away_mm: Annotated[float, typer.Option("--away", metavar="MM", help="Where to go between.")],
    times: Annotated[int, typer.Option("--times", min=2, help="How often.")] = 5,
    gauge: Annotated[bool, typer.Option("--gauge", help="Ask for the reading of a dial gauge each time.")] = False,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Home, then move away and back several times, and report how far the readings spread.

    A stage without encoder only knows what it counts: use --gauge to see lost steps and backlash.
    """
    if position_mm == away_mm:
        raise ConfigError(f"--away is {away_mm:g} mm, the place to come back to as well; name two places that differ")
    rig = _open(sim, config, scene)
    with _stage_to_move(rig, real_time=real_time, state=state) as stage:
        stage.home(timeout_s=TIMEOUT_S)
        found = measure_repeatability(
            stage, at_mm=position_mm, away_mm=away_mm, times=times, timeout_s=TIMEOUT_S, read_mm=_ask if gauge else None
        )
    readings = ", ".join(f"{reading_mm:.4f}" for reading_mm in found.readings_mm)
    source = "dial gauge" if gauge else "the stage's own count"
    print(f"stage: {readings} mm by {source}; spread {found.spread_mm:.4f} mm, sd {found.sd_mm:.4f} mm")


def _ask() -> float:
    reading_mm: float = typer.prompt("dial gauge, mm", type=float)
    return reading_mm


@app.command()
def where(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Ask the stage where it stands."""
    rig = _open(sim, config, scene)
    with open_stage(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as stage:
        print(_where(stage))
