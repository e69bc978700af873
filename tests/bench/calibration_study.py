"""What a calibration is worth: simulated calibrations with known truth, their errors beside what they say of themselves.

``python -m tests.bench.calibration_study STUDY [--runs N]`` prints a table in markdown, and the same as JSON. STUDY is

``variance``   mean squares of normalised errors (1 where covariances are right): lens, poses, pitch, slips, cover glass
``pitch``      the same of lens, dry poses and pitch alone
``place``      errors of points and normals that follow from the calibration alone, actual beside predicted, by procedure
``slip``       a display that slipped 0.3 mm in its plane at position 1, in the liquid set only
``glass``      cover glass of 1.5 mm: ignored, modelled, estimated
"""

import argparse
import json
from collections.abc import Callable, Sequence

import numpy as np

from recon.calibration.board import Board
from recon.calibration.bundle import BundleResult
from recon.calibration.display_poses import AIR_PANELS
from recon.calibration.fep_error import Geometry, entry_points_of, fep_error
from recon.calibration.sight_line import PanelPose
from recon.calibration.wet_pose import WET_PANELS, SlipKnowledge
from recon.sessions.manifest import CoverGlass
from tests.bench._calibration_rig import (
    GLASS_INDEX,
    Procedure,
    Rig,
    calibrate,
    chi_square,
    pose_errors,
    slipped_twice,
)
from tests.recon.calibration.seen_corners import slipped_scene, true_pose
from tests.recon.calibration.seen_object import errors, in_frame_of, pixels_of, shape_error_mm

COARSE, USUAL, FINE = Board(7, 6, 25.0), Board(17, 12, 11.5), Board(24, 18, 8.0)
PITCH_SHARE = 1.003
GLASS_MM = 1.5
SLIP_MM = 0.3
FIRM_LEAN_RAD = 5e-5
MAY_SLIP = SlipKnowledge(in_plane_mm=0.5, in_plane_rad=0.005, along_normal_mm=0.05, lean_rad=0.0005)
Rows = list[dict[str, object]]


class Squares:
    """Squares of normalised errors by what they are errors of."""

    def __init__(self) -> None:
        self._of: dict[tuple[str, int], list[float]] = {}

    def add(self, name: str, error: np.ndarray, covariance: np.ndarray) -> None:
        """Add the errors of one run."""
        self._of.setdefault((name, len(error)), []).append(chi_square(error, covariance))

    def rows(self) -> Rows:
        """Return the mean square of a number, and how far chance spreads it."""
        return [
            {
                "errors of": name,
                "numbers": numbers,
                "mean square": float(np.mean(each)) / numbers,
                "spread by chance": float(np.sqrt(2 / (numbers * len(each)))),
            }
            for (name, numbers), each in self._of.items()
        ]


def _add_dry(squares: Squares, rig: Rig, procedure: Procedure, rng: np.random.Generator) -> None:
    made = calibrate(rig, procedure, rng, pitch_share=PITCH_SHARE)
    squares.add("lens", made.lens.lens - rig.lens, made.lens.covariance)
    squares.add("dry poses, pitch free", pose_errors(rig.poses, made.dry), made.dry.covariance_of(*AIR_PANELS))
    squares.add("pitch", np.array([made.dry.state.scale - PITCH_SHARE]), made.dry.covariance_of("scale"))


def variance(runs: int, seed: int) -> Rows:
    """Return the mean square, a number, of the normalised errors, and how far chance spreads it."""
    procedure = Procedure(9, COARSE, photos=1, corner_sd_px=0.1)
    plain, covered = Rig(squares_along=6), Rig(squares_along=6, glass_mm=GLASS_MM)
    rng = np.random.default_rng(seed)
    squares = Squares()
    add = squares.add
    for _ in range(runs):
        _add_dry(squares, plain, procedure, rng)
        slipped = slipped_twice(plain, MAY_SLIP, rng)
        wet = calibrate(plain, procedure, rng, slipped=slipped, slipping=MAY_SLIP).wet
        assert wet is not None
        add("dry and wet poses", _wet_errors(plain, slipped, wet), wet.covariance_of(*AIR_PANELS, *WET_PANELS))
        guess = CoverGlass(thickness_mm=float(np.clip(rng.normal(GLASS_MM, 0.3), 0.1, None)), n=GLASS_INDEX)
        slipped = slipped_twice(covered, MAY_SLIP, rng)
        made = calibrate(
            covered,
            procedure,
            rng,
            slipped=slipped,
            slipping=MAY_SLIP,
            cover_glass=guess,
            glass_sd_mm=0.3,
            oblique=True,
        )
        assert made.wet is not None
        add("cover glass, dry", np.array([made.dry.state.glass_mm - GLASS_MM]), made.dry.covariance_of("glass"))
        add("cover glass, dry and wet", np.array([made.wet.state.glass_mm - GLASS_MM]), made.wet.covariance_of("glass"))
        together = np.append(_wet_errors(covered, slipped, made.wet), made.wet.state.glass_mm - GLASS_MM)
        names = (*AIR_PANELS, *WET_PANELS, "glass")
        add("dry and wet poses with glass", together, made.wet.covariance_of(*names))
    return squares.rows()


def pitch(runs: int, seed: int) -> Rows:
    """Return the same of lens, dry poses and pitch alone, which takes a fraction of the time."""
    rig, squares = Rig(squares_along=6), Squares()
    rng = np.random.default_rng(seed)
    for _ in range(runs):
        _add_dry(squares, rig, Procedure(9, COARSE, photos=1, corner_sd_px=0.1), rng)
    return squares.rows()


def place(runs: int, seed: int) -> Rows:
    """Return actual and predicted errors of the points of a hemisphere that follow from the calibration alone, rms over runs."""
    rig = Rig()
    geometry, point_mm, normal = pixels_of(rig.scene, rig.scene, rng=np.random.default_rng(0), sd_px=0.0)
    rows = []
    usual, firm = SlipKnowledge(), SlipKnowledge(lean_rad=FIRM_LEAN_RAD)
    for words, procedure, slipping in (
        ("15 views of 63 corners", Procedure(15, Board(10, 8, 15.0)), None),
        ("30 views of 176 corners", Procedure(30, USUAL), None),
        ("60 views of 176 corners", Procedure(60, USUAL), None),
        ("30 views of 391 corners", Procedure(30, FINE), None),
        ("45 views of 391 corners", Procedure(45, FINE), None),
        ("the same, and again under liquid", Procedure(45, FINE), usual),
        ("… with 16 photos of the display in each set", Procedure(45, FINE, photos=16), usual),
        ("… or a holder that keeps its lean to 0.00005 rad", Procedure(45, FINE), firm),
    ):
        rng = np.random.default_rng(seed)
        actual, predicted, focal_sd_px = [], [], []
        for _ in range(runs):
            still = (rig.scene, rig.scene) if slipping else None
            made = calibrate(rig, procedure, rng, slipped=still, slipping=slipping)
            focal_sd_px.append(made.lens.sd()["focal_x_px"])
            found = made.wet or made.dry
            actual.append(_actual(geometry, found, rig.poses, point_mm, normal))
            error = fep_error(geometry, found)
            predicted.append(
                [error.rms_mm, error.display_rms_mm, error.shape_rms_mm, float(np.degrees(error.normal_rms_rad))]
            )
        mean_square, said = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (actual, predicted))
        row: dict[str, object] = {"procedure": words}
        for name, got, told in zip(("place", "place from display", "shape", "normals"), mean_square, said, strict=True):
            row |= {f"{name}, actual": float(got), f"{name}, predicted": float(told)}
        rows.append(
            row | {"largest place": float(np.max(actual, axis=0)[0]), "focal length, sd px": np.mean(focal_sd_px)}
        )
    return rows


def slip(runs: int, seed: int) -> Rows:
    """Return mean errors of points and normals with 0.1 px of noise: undisturbed, slipped, and slipped but measured again."""
    rig = Rig()
    moved = np.array([0, 0, 0, 0.8 * SLIP_MM, 0.6 * SLIP_MM, 0])
    slipped = slipped_scene(rig.scene, rig.stage_mm[1], moved)
    found: dict[str, list[tuple[float, float]]] = {}
    for run in range(runs):
        rng = np.random.default_rng((seed, run))
        made = calibrate(rig, Procedure(15, Board(10, 8, 15.0)), rng, slipped=(rig.scene, slipped))
        assert made.wet is not None
        dry = {name: made.dry.state.panels[name] for name in AIR_PANELS}
        still = pixels_of(rig.scene, rig.scene, rng=np.random.default_rng((seed, run, 1)))
        shifted = pixels_of(rig.scene, slipped, rng=np.random.default_rng((seed, run, 1)))
        for name, seen, panels in (
            ("undisturbed", still, dry),
            ("slipped, not corrected", shifted, dry),
            ("slipped, measured again", shifted, made.wet.state.panels),
        ):
            one = errors(seen[0], panels, seen[1], seen[2])
            found.setdefault(name, []).append((one.point_mm, one.normal_deg))
    return _beside_the_first(found)


def glass(runs: int, seed: int) -> Rows:
    """Return mean errors of points and normals, without other noise, of calibrations that know more or less of the glass."""
    rig = Rig(squares_along=12, glass_mm=GLASS_MM)
    seen, point_mm, normal = pixels_of(rig.scene, rig.scene, rng=np.random.default_rng(0), sd_px=0.0)
    procedure = Procedure(30, USUAL)
    truth = CoverGlass(thickness_mm=GLASS_MM, n=GLASS_INDEX)
    guess = CoverGlass(thickness_mm=1.0, n=GLASS_INDEX)
    found: dict[str, list[tuple[float, float]]] = {}
    thickness: list[tuple[float, float]] = []
    for run in range(runs):
        rng = np.random.default_rng((seed, run))
        ignored = calibrate(rig, procedure, rng, oblique=True).dry
        modelled = calibrate(rig, procedure, rng, cover_glass=truth, oblique=True).dry
        estimated = calibrate(rig, procedure, rng, cover_glass=guess, glass_sd_mm=1.0, oblique=True).dry
        together = calibrate(
            rig,
            procedure,
            rng,
            cover_glass=guess,
            glass_sd_mm=1.0,
            oblique=True,
            slipped=(rig.scene, rig.scene),
        ).wet
        assert together is not None
        for name, result in (
            ("modelled, thickness known", modelled),
            ("ignored", ignored),
            ("thickness estimated, dry", estimated),
            ("thickness estimated, dry and wet", together),
        ):
            mm = result.state.glass_mm
            geometry = Geometry(
                seen.screen_mm,
                seen.n_liquid,
                cover_glass=CoverGlass(thickness_mm=mm, n=GLASS_INDEX) if mm > 0 else None,
            )
            one = errors(geometry, result.state.panels, point_mm, normal)
            found.setdefault(name, []).append((one.point_mm, one.normal_deg))
        thickness.append((estimated.state.glass_mm - GLASS_MM, together.state.glass_mm - GLASS_MM))
    rows = _beside_the_first(found)
    for row, off in zip(rows[2:], np.sqrt(np.mean(np.square(thickness), axis=0)), strict=True):
        row["thickness, rms mm"] = float(off)
    return rows


def _wet_errors(rig: Rig, slipped: Sequence[object], found: BundleResult) -> np.ndarray:
    wet = {
        name: true_pose(one, stage)  # type: ignore[arg-type]  # scenes
        for name, one, stage in zip(WET_PANELS, slipped, rig.stage_mm, strict=True)
    }
    return pose_errors({**rig.poses, **wet}, found)


def _actual(
    geometry: Geometry, found: BundleResult, truth: dict[str, PanelPose], point_mm: np.ndarray, normal: np.ndarray
) -> list[float]:
    """Return rms errors of points in the camera's frame, in the display's, of the shape (mm), and of normals (deg)."""
    panels = found.state.panels
    found_mm, found_normal = entry_points_of(geometry, panels)
    first = AIR_PANELS[0]
    in_display = in_frame_of(panels[first], found_mm) - in_frame_of(truth[first], point_mm)
    across = np.linalg.norm(np.cross(found_normal, normal), axis=1)
    return [
        float(np.sqrt(((found_mm - point_mm) ** 2).sum(axis=1).mean())),
        float(np.sqrt((in_display**2).sum(axis=1).mean())),
        shape_error_mm(found_mm, point_mm),
        float(np.degrees(np.sqrt((across**2).mean()))),
    ]


def _beside_the_first(found: dict[str, list[tuple[float, float]]]) -> Rows:
    """Return the means over runs, and how often that of the first they are."""
    means = {name: np.mean(each, axis=0) for name, each in found.items()}
    first = next(iter(means.values()))
    return [
        {
            "display": name,
            "points, mean mm": float(mean[0]),
            "normals, mean °": float(mean[1]),
            "points, times the first": float(mean[0] / first[0]),
            "normals, times the first": float(mean[1] / first[1]),
        }
        for name, mean in means.items()
    ]


def markdown(rows: Rows) -> str:
    """Return the rows as a table."""
    headings = list(dict.fromkeys(name for row in rows for name in row))
    lines = ["| " + " | ".join(headings) + " |", "|---" * len(headings) + "|"]
    for row in rows:
        cells = [f"{value:.3g}" if isinstance(value, float) else str(value) for value in map(row.get, headings)]
        lines.append("| " + " | ".join("" if cell == "None" else cell for cell in cells) + " |")
    return "\n".join(lines)


STUDIES: dict[str, tuple[Callable[[int, int], Rows], int]] = {
    "variance": (variance, 50),
    "pitch": (pitch, 500),
    "place": (place, 30),
    "slip": (slip, 10),
    "glass": (glass, 10),
}


def main() -> None:
    """Run a study and print it."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("study", choices=STUDIES)
    asked.add_argument("--runs", type=int, help="simulated calibrations of each kind")
    asked.add_argument("--seed", type=int, default=2018)
    given = asked.parse_args()
    study, runs = STUDIES[given.study]
    rows = study(given.runs or runs, given.seed)
    print(markdown(rows))
    print(json.dumps({"study": given.study, "runs": given.runs or runs, "seed": given.seed, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
