"""Experiments that need photos: the concave object, total reflection, and twins of the paper's real objects."""

from pathlib import Path

from recon.evaluation.table import KnownSize
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.photographed import FINE, HARD, PIXELS_A_STRIPE, SMOOTH, Judge, comparison, judged_runs
from recon.study.scenes import concave_cone

CONCAVE_COLUMNS, TWIN_COLUMNS = 256, 320
CONCAVE_RING = (0.1, 4.9)
CONCAVE_NOTE = "Published: FEP RMS 0.141 units, normal RMS 1.58°; places of camera and display are ours."


def concave(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """The rod hollowed by a cone, concave side in water, with a hard and with a smooth stripe; the latter on two displays."""
    columns = size.columns_or(CONCAVE_COLUMNS)
    tables = []
    for stripe, pixels_a_stripe, words in (
        ("hard", 1, HARD),
        ("smooth", 1, SMOOTH),
        ("fine", PIXELS_A_STRIPE, FINE),
    ):
        found = judged_runs(
            concave_cone(size=columns, pixels_a_stripe=pixels_a_stripe),
            folder / f"concave-{stripe}",
            options=[*words, "--seed", str(size.seed)],
            judge=Judge(ring=CONCAVE_RING),
            tell=told_of(f"{stripe} stripe", tell),
        )
        tables.append(comparison(f"{stripe} stripe", found, note=CONCAVE_NOTE))
    setting = (
        f"{columns} × {columns} camera pixels, 1,024 stripes of 1/32 unit along each axis; apex on the axis 4 inside the "
        f"display-side face, judged at {CONCAVE_RING[0]:g} < r < {CONCAVE_RING[1]:g}. Photos with noise and JPEG. The "
        f"display has a device pixel for each stripe; for the fine stripe, which is the smooth one drawn finely, it has "
        f"{PIXELS_A_STRIPE}: the published stripe was rendered, and knows no device pixels."
    )
    return Findings(setting, tuple(tables))


def told_of(what: str, tell: Tell) -> Tell:
    """Return ``tell`` with the name of what is being done in front."""
    return lambda text: tell(f"{what}: {text}")


def hemisphere(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """The glass hemisphere of radius 27.99 mm."""
    return _twin("hemisphere", Judge(primitive="sphere", known=KnownSize(radius_mm=27.99)), folder, size, tell)


def ornament(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """The ornament of six facets."""
    return _twin("ornament", Judge(primitive="planes"), folder, size, tell)


def bottle(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """The hollow bottle of radius 14.18 mm."""
    known = KnownSize(radius_mm=14.18, height_mm=44.73)
    return _twin("bottle", Judge(primitive="cylinder", known=known), folder, size, tell)


def plates(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """The two glass plates of the second method, 3 mm thick, judged against truth: the paper shows only pictures of them."""
    tables = []
    for name in ("plate_round", "plate_fish"):
        columns = size.columns_or(TWIN_COLUMNS)
        found = judged_runs(
            name,
            folder / name,
            options=["--size", str(columns), "--seed", str(size.seed)],
            judge=Judge(),
            tell=told_of(name, tell),
        )
        tables.append(comparison(name, found))
    return Findings(f"{columns} camera columns; against truth, pixel by pixel.", tuple(tables))


def _twin(name: str, judge: Judge, folder: Path, size: StudySize, tell: Tell) -> Findings:
    columns = size.columns_or(TWIN_COLUMNS)
    words = ["--size", str(columns), "--seed", str(size.seed)]
    found = judged_runs(name, folder / name, options=words, judge=judge, tell=tell)
    setting = (
        f"{columns} camera columns (the paper: 3,888), photos with noise and JPEG. Rows of `truth` are pixel by pixel; the "
        "fitted shape flatters, since it is fitted to the points that it judges."
    )
    return Findings(setting, (comparison("Truth and fitted shape", found),))
