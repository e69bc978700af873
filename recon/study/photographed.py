"""Sessions with photos, reconstructed by both methods and judged: what the experiments with rendered and real objects share."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from recon.evaluation.evaluate import evaluate
from recon.evaluation.published import Primitive
from recon.evaluation.table import KnownSize, Row
from recon.method import Method
from recon.run import run_session
from recon.running.settings import Settings
from recon.study.experiment import Tell
from recon.study.simulator import Scene, simulated
from recon.study.study_result import Cell, StudyTable, cell_text

METHODS: tuple[Method, Method] = ("paper", "full")
SMOOTH = ("--profile", "raised_cosine", "--width-px", "6", "--step-px", "1")
# The same stripes, drawn on a display with four device pixels to a stripe of the paper's.
PIXELS_A_STRIPE = 4
FINE = ("--profile", "raised_cosine", "--width-px", str(6 * PIXELS_A_STRIPE), "--step-px", str(PIXELS_A_STRIPE))
HARD = ("--profile", "hard", "--width-px", "1", "--step-px", "1")


@dataclass(frozen=True, slots=True)
class Judge:
    """What results are compared with beside truth: only a ring of it, and a primitive of known size."""

    ring: tuple[float, float] | None = None
    primitive: Primitive | None = None
    known: KnownSize = field(default_factory=KnownSize)


def judged_runs(
    scene: Scene | str, folder: Path, *, options: Sequence[str], judge: Judge, tell: Tell
) -> dict[Method, tuple[Row, ...]]:
    """Simulate a scene with photos, run both methods, and return the figures of each."""
    tell("simulating the photos")
    session = simulated(scene, folder, options=options)
    found = {}
    for method in METHODS:
        tell(f"recon run --method {method}")
        out = folder / f"recon-{method}"
        run_session(session, out, Settings(method=method))
        found[method] = evaluate(
            out,
            primitive=judge.primitive,
            truth=session,
            ring_mm=judge.ring,
            known=judge.known,
        ).rows
    return found


def comparison(title: str, found: dict[Method, tuple[Row, ...]], *, note: str = "") -> StudyTable:
    """Return one row a figure: the published value, then both methods'."""
    by_method = {method: {(row.of, row.quantity): row for row in rows} for method, rows in found.items()}
    keys = dict.fromkeys(key for rows in by_method.values() for key in rows)
    rows: list[tuple[Cell, ...]] = []
    for of, quantity in keys:
        either = [by_method[method].get((of, quantity)) for method in METHODS]
        one = next(row for row in either if row is not None)
        rows.append(
            (
                of,
                quantity,
                one.unit,
                None if one.published is None else span_text(one.published),
                *(None if row is None else row.ours for row in either),
            )
        )
    return StudyTable(
        title=title, headings=("of", "figure", "unit", "published", "paper", "full"), rows=tuple(rows), note=note
    )


def span_text(span: tuple[float, float]) -> str:
    """Return a published range, or the figure where its ends are equal."""
    low, high = (cell_text(value) for value in span)
    return low if low == high else f"{low} … {high}"
