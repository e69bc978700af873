"""What a wrong assumption does to both methods, where, and what their reports say of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.evaluation.spread import spread_of
from recon.maps import MAPS_NAME, load_maps
from recon.method import Method
from recon.metrics import Metrics
from recon.run import run_session
from recon.running.settings import Settings
from recon.status import PixelStatus
from recon.study.assumption_judge import Errors, MaskMap, RightUpTo, Truths, errors_of, truths_of
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.photographed import METHODS
from recon.study.simulator import simulated
from recon.study.study_result import Cell, StudyTable
from recon.study.wrong_assumptions import RADIUS_MM, WrongAssumption, wrong_assumptions

COLUMNS = 160
STRIPE = ("--profile", "raised_cosine", "--width-px", "24", "--step-px", "8")
FAR_SD = 3.0
# A point is right up to this many times the median errors of method `paper`, of points and normals, where nothing is wrong.
RIGHT_FACTOR = 3.0
LEFT_OUT = tuple(status for status in PixelStatus if status not in (PixelStatus.OK, PixelStatus.MASKED_OUT))
# Method ``full`` is judged by what pixels measured themselves, and with those that the surface about them covers.
COVERED_TOO = "full, covered too"
SERIES = (*METHODS, COVERED_TOO)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One wrong assumption with what both methods made of it; ``errors`` by the name of a series."""

    name: str
    truth: Truths
    errors: dict[str, Errors]
    status: dict[Method, np.ndarray]
    metrics: dict[Method, Metrics]

    def parts(self) -> Iterator[tuple[str, MaskMap]]:
        """Give the judged pixels that are reached by what is wrong, then the others, as far as there are any."""
        for name, where in (("reached", self.truth.reached), ("elsewhere", self.truth.judged & ~self.truth.reached)):
            if where.any():
                yield name, where


def assumptions(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """An object that moved, light that enters again, bubbles, two paths in a pixel: one wrong assumption after the other."""
    columns = size.columns_or(COLUMNS)
    cases = [
        _case(wrong, folder / f"assumptions-{number}", columns, size.seed, tell)
        for number, wrong in enumerate(wrong_assumptions())
    ]
    setting = (
        f"{columns} × {columns} camera pixels, a display of 1,024 × 768 pixels, photos with noise and JPEG; raised cosine of 24 "
        "pixels in steps of 8. The twin of the hemisphere in water; for creases, that of the ornament. Errors in mm and degrees "
        "against truth, pixel by pixel, of the object as it stood dry. Light that enters again has no one first point: points "
        "there are judged by their distance from the dome."
    )
    return Findings(setting, (errors_table(cases), common_table(cases), left_out_table(cases), sentences_table(cases)))


def _case(wrong: WrongAssumption, folder: Path, columns: int, seed: int, tell: Tell) -> Case:
    tell(f"{wrong.name}: simulating the photos")
    words = ["--size", str(columns), "--seed", str(seed), *STRIPE]
    session = simulated(wrong.scene(), folder, options=words)
    ideal = session
    if wrong.when_filled:
        ideal = simulated(wrong.scene(disturbed=False), folder / "ideal", options=[*words, "--truth-only"])
    truth = truths_of(session, ideal, about_creases=wrong.about_creases, radius_mm=RADIUS_MM)
    case = Case(wrong.name, truth, {}, {}, {})
    for method in METHODS:
        tell(f"{wrong.name}: recon run --method {method}")
        out = folder / f"recon-{method}"
        case.metrics[method] = run_session(session, out, Settings(method=method))
        maps = load_maps(out / MAPS_NAME)
        case.errors[method], case.status[method] = errors_of(maps, truth, covered=False), maps.status
        if method == "full":
            case.errors[COVERED_TOO] = errors_of(maps, truth, covered=True)
    return case


def errors_table(cases: Sequence[Case]) -> StudyTable:
    """Return the errors of each method's own points."""
    headings = (
        "wrong assumption",
        "pixels",
        "number",
        "method",
        "complete (%)",
        "right (%)",
        "position median (mm)",
        "RMS (mm)",
        "95 % (mm)",
        "normal median (°)",
        "RMS (°)",
        "95 % (°)",
        "beyond 3 sd (%)",
    )
    rows: list[tuple[Cell, ...]] = []
    right_up_to = right_up_to_of(cases)
    for case in cases:
        for part, where in case.parts():
            for series in SERIES:
                each = case.errors[series]
                found = where & each.found()
                point, normal = spread_of(each.point_mm[found]), spread_of(each.normal_deg[found])
                rows.append(
                    (
                        case.name,
                        part,
                        int(where.sum()),
                        series,
                        100 * float(found.sum() / where.sum()),
                        100 * float((where & each.right(right_up_to)).sum() / where.sum()),
                        *(point.median, point.rms, point.p95),
                        *(normal.median, normal.rms, normal.p95),
                        None if series == "paper" else _far_percent(each, found),
                    )
                )
    note = (
        "Reached: pixels whose wet path differs from that of the scene without what is wrong; for creases, pixels at a turn of "
        "the true normal by more than 3°, or at the rim. Complete: pixels with a point. Right: those whose point is within "
        f"{RIGHT_FACTOR:g} times the median error of method `paper` with nothing wrong, {right_up_to.mm:.3g} mm, and whose "
        f"normal is within as many of its median, {right_up_to.deg:.3g}°. Covered too: with the pixels whose own measurement "
        "was left out, and whose point is that of the surface about them. Beyond 3 sd: points whose error exceeds three of "
        "their own standard deviations."
    )
    return StudyTable(title="Each method's own points", headings=headings, rows=tuple(rows), note=note)


def right_up_to_of(cases: Sequence[Case]) -> RightUpTo:
    """Return the errors up to which a point counts as right; the first case is the one with nothing wrong."""
    paper = cases[0].errors["paper"]
    return RightUpTo(
        RIGHT_FACTOR * float(np.nanmedian(paper.point_mm)), RIGHT_FACTOR * float(np.nanmedian(paper.normal_deg))
    )


def _far_percent(errors: Errors, found: MaskMap) -> float:
    return 100 * float((errors.point_mm[found] > FAR_SD * errors.sd_mm[found]).mean()) if found.any() else np.nan


def common_table(cases: Sequence[Case]) -> StudyTable:
    """Return both methods' errors on the pixels where both have a point, and what only ``paper`` has right."""
    headings = (
        "wrong assumption",
        "pixels",
        "beside paper",
        "both have",
        "position median paper (mm)",
        "full",
        "RMS paper (mm)",
        "full",
        "normal median paper (°)",
        "full",
        "RMS paper (°)",
        "full",
        "right in paper, none in full (%)",
    )
    right_up_to = right_up_to_of(cases)
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        paper = case.errors["paper"]
        for part, where in case.parts():
            for series in SERIES[1:]:
                full = case.errors[series]
                both = where & paper.found() & full.found()
                pairs = [
                    (spread_of(getattr(paper, name)[both]), spread_of(getattr(full, name)[both]))
                    for name in ("point_mm", "normal_deg")
                ]
                figures = [
                    value for first, second in pairs for value in (first.median, second.median, first.rms, second.rms)
                ]
                lost = where & paper.right(right_up_to) & ~full.found()
                rows.append((case.name, part, series, int(both.sum()), *figures, 100 * float(lost.sum() / where.sum())))
    note = f"Right: within {right_up_to.mm:.3g} mm and {right_up_to.deg:.3g}°, as above."
    return StudyTable(title="On the pixels that both have", headings=headings, rows=tuple(rows), note=note)


def left_out_table(cases: Sequence[Case]) -> StudyTable:
    """Return why judged pixels have no point, each method."""
    headings = (
        "wrong assumption",
        "pixels",
        "method",
        "points",
        *(one.name.lower().replace("_", " ") for one in LEFT_OUT),
    )
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        for part, where in case.parts():
            for method in METHODS:
                status = case.status[method][where]
                counts = [int((status == one).sum()) for one in (PixelStatus.OK, *LEFT_OUT)]
                rows.append((case.name, part, method, *counts))
    return StudyTable(title="What was left out, and why", headings=headings, rows=tuple(rows))


def sentences_table(cases: Sequence[Case]) -> StudyTable:
    """Return what each report says."""
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        for method in METHODS:
            metrics = case.metrics[method]
            said = " ".join([*metrics.verdict.reasons, *(f"Note: {one}" for one in metrics.warnings)])
            rows.append((case.name, method, metrics.verdict.grade, said))
    return StudyTable(
        title="What the reports say", headings=("wrong assumption", "method", "grade", "sentences"), rows=tuple(rows)
    )
