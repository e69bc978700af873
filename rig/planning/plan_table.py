"""A plan for people: a table of what happens in which order, and what it costs."""

from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.table import Table

from recon.scene.scene_check import REFERENCE
from rig.config import RigConfig
from rig.planning.plan import summarise
from rig.planning.steps import StartSweep, Step, TakePhoto, step_duration_s, step_text


def rows_of(plan: Sequence[Step], config: RigConfig) -> Iterator[tuple[str, int, float]]:
    """Yield what happens, its number of photos and its seconds, with the photos of a sweep taken together."""
    text, photos, duration_s = "", 0, 0.0
    singles = "white, black and scan" if config.capture.scan else "white and black"
    for step in plan:
        if isinstance(step, TakePhoto):
            single = step.sweep not in ("x", "y")
            title = f"{'reference' if step.sweep == REFERENCE else singles} of {step.set_name}"
            if single and text != title:
                if text:
                    yield text, photos, duration_s
                text, photos, duration_s = title, 0, 0.0
            photos += 1
            duration_s += step_duration_s(step, config)
            continue
        if text:
            yield text, photos, duration_s
        text, photos, duration_s = step_text(step), 0, step_duration_s(step, config)
        if isinstance(step, StartSweep):
            text = f"sweep {step.set_name} along {step.axis}"
    if text:
        yield text, photos, duration_s


def print_plan(plan: tuple[Step, ...], config: RigConfig, console: Console) -> None:
    """Print the plan: as a table on a terminal, as plain lines elsewhere."""
    rows = [(text, str(photos) if photos else "", clock_text(s)) for text, photos, s in rows_of(plan, config)]
    if console.is_terminal:
        table = Table(title=f"{config.name}: {config.method} method, order {config.capture.order}")
        table.add_column("step")
        table.add_column("photos", justify="right")
        table.add_column("time", justify="right")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    else:
        for text, photos, time in rows:
            console.print(f"{text:60} {photos:>6} {time:>8}", markup=False)
    summary = summarise(plan, config)
    bound = "at most " if config.capture.scan else ""
    console.print(
        f"{summary.sets} sets, {bound}{summary.photos} photos, {summary.moves} moves of the stage, {summary.fills} fills and "
        f"{summary.drains} drains ({summary.litres:.1f} l pumped), {summary.questions} questions to the operator, "
        f"about {summary.gigabytes:.2g} GB and {clock_text(summary.minutes * 60)} (h:min:s)",
        markup=False,
    )


def clock_text(duration_s: float) -> str:
    """Write seconds as h:min:s."""
    seconds = round(duration_s)
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
