"""A plan for people: a table of what happens in which order, and what it costs."""

from collections.abc import Iterator, Mapping, Sequence

from rich.console import Console
from rich.table import Table

from recon.scene.scene_check import REFERENCE
from rig.capture_sections import GrayLineCode, PhaseShiftCode
from rig.config import RigConfig
from rig.planning.plan import all_photos, summarise
from rig.planning.steps import StartSweep, Step, TakePhoto, step_duration_s, step_text

# What suits a Gray code whose lines are 16 device pixels apart.
FINE_LINE = {"width_px": 4.0, "step_px": 1.0}


def rows_of(plan: Sequence[Step], config: RigConfig) -> Iterator[tuple[str, int, float]]:
    """Yield what happens, its number of photos and its seconds, with the photos of a sweep taken together."""
    text, photos, duration_s = "", 0, 0.0
    singles = _singles(config)
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


def _singles(config: RigConfig) -> str:
    """Name the single photos that a set begins with."""
    capture = config.capture
    *first, last = ["white", "black", *(["board"] if capture.board else []), *(["scan"] if capture.scan else [])]
    return f"{', '.join(first)} and {last}"


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
    console.print(codes_text(config), markup=False)
    summary = summarise(plan, config)
    bound = "at most " if config.capture.scan else ""
    console.print(
        f"{summary.sets} sets, {bound}{summary.photos} photos, {summary.moves} moves of the stage, {summary.fills} fills and "
        f"{summary.drains} drains ({summary.litres:.1f} l pumped), {summary.questions} questions to the operator, "
        f"about {summary.gigabytes:.2g} GB and {clock_text(summary.minutes * 60)} (h:min:s)",
        markup=False,
    )


def codes_text(config: RigConfig) -> str:
    """Say how many photos the capture takes with each code over the same area, without scan and reference photos."""
    step_px = config.capture.stripe.step_px
    swept = photos_with(None, config)
    lines = photos_with(GrayLineCode(kind="gray_line"), config, stripe=FINE_LINE)
    fringes = photos_with(PhaseShiftCode(kind="phase_shift"), config)
    return (
        f"the same area by code: stripe every {step_px:g} px {swept} photos, gray_line {lines}, phase_shift {fringes}"
    )


def photos_with(
    code: GrayLineCode | PhaseShiftCode | None, config: RigConfig, *, stripe: Mapping[str, float] | None = None
) -> str:
    """Return how many photos the capture takes with this code; a dash where the area is too small for it."""
    capture = config.capture.model_copy(
        update={"code": code, "scan": None, "stripe": config.capture.stripe.model_copy(update=dict(stripe or {}))}
    )
    try:
        return f"{len(all_photos(config.model_copy(update={'capture': capture}))):,}"
    except ValueError:
        return "—"


def clock_text(duration_s: float) -> str:
    """Write seconds as h:min:s."""
    seconds = round(duration_s)
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
