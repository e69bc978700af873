"""Evaluation of a run folder: truth, ellipsoid, primitives, table and command."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from recon.errors import ReconError
from recon.evaluation.command import register
from recon.evaluation.ellipsoid import ellipsoid_distance_mm
from recon.evaluation.evaluate import EVALUATION_NAME, EvaluationResult, evaluate
from recon.evaluation.published import PUBLISHED
from recon.evaluation.table import KnownSize
from recon.evaluation.truth import Truth, TruthStatus, compare_with_truth, load_truth
from recon.maps import MAPS_NAME, Maps, save_maps
from recon.status import PixelStatus

SIZE = 40
RADIUS_MM = 27.99


def cap() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and pixels of a spherical cap about the origin."""
    axis = np.linspace(-20, 20, SIZE)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) < 18
    z = np.sqrt(RADIUS_MM**2 - x**2 - y**2, where=inside, out=np.full_like(x, np.nan))
    point = np.stack([x, y, z], axis=2)
    point[~inside] = np.nan
    return point, point / RADIUS_MM, inside


def maps_of(point: np.ndarray, normal: np.ndarray, valid: np.ndarray, sd_mm: float = 0.1) -> Maps:
    nothing = np.full(valid.shape, np.nan, np.float32)
    return Maps(
        point_mm=point,
        normal=normal,
        sd_mm=np.where(valid, np.float32(sd_mm), np.float32(np.nan)).astype(np.float32),
        gap_mm=nothing,
        pbc_angle_rad=nothing,
        status=np.where(valid, PixelStatus.OK, PixelStatus.UNLIT).astype(np.uint8),
    )


def truth_of(point: np.ndarray, normal: np.ndarray, judged: np.ndarray) -> Truth:
    return Truth(point, normal, judged, judged)


def write_run(folder: Path, maps: Maps) -> Path:
    folder.mkdir(parents=True)
    save_maps(maps, folder / MAPS_NAME)
    return folder


def ours(result: EvaluationResult, quantity: str, of: str | None = None) -> float:
    return next(row.ours for row in result.rows if row.quantity == quantity and of in (None, row.of))


def test_shifted_points_err_by_the_shift() -> None:
    point, normal, inside = cap()
    found = compare_with_truth(
        maps_of(point + np.array([0.3, 0.0, 0.4]), normal, inside), truth_of(point, normal, inside)
    )
    assert found.complete == 1.0
    assert (found.point_mm.rms, found.point_mm.median) == pytest.approx((0.5, 0.5))
    assert found.normal_rad.rms < 1e-7
    assert found.normalised_rms == pytest.approx(5.0)


def test_flipped_normals_err_by_half_a_turn() -> None:
    point, normal, inside = cap()
    found = compare_with_truth(maps_of(point, -normal, inside), truth_of(point, normal, inside))
    assert found.normal_rad.median == pytest.approx(np.pi)


def test_complete_is_the_share_of_judged_pixels_with_a_point() -> None:
    point, normal, inside = cap()
    kept = inside.copy()
    kept[:20] = False
    found = compare_with_truth(maps_of(point, normal, kept), truth_of(point, normal, inside))
    assert found.complete == pytest.approx(0.5)
    assert found.judged == inside.sum()


def test_point_where_no_light_arrives_is_false() -> None:
    point, normal, inside = cap()
    filled, filled_normal = np.nan_to_num(point), np.nan_to_num(normal)
    valid = inside.copy()
    valid[0, :3] = True
    found = compare_with_truth(maps_of(filled, filled_normal, valid), truth_of(point, normal, inside))
    assert found.false_points == 3
    assert found.complete == 1.0


def test_honest_standard_deviations_give_normalised_errors_of_one() -> None:
    point, normal, inside = cap()
    noise = np.random.default_rng(1).standard_normal(point.shape)
    # sd_mm is the root of the covariance's trace: three axes of 0.2 mm.
    maps = maps_of(point + 0.2 * noise, normal, inside, sd_mm=0.2 * np.sqrt(3))
    found = compare_with_truth(maps, truth_of(point, normal, inside))
    assert found.normalised_rms == pytest.approx(1.0, abs=4 / np.sqrt(6 * inside.sum()))


def test_truth_of_another_size_is_one_sentence() -> None:
    point, normal, inside = cap()
    with pytest.raises(ReconError, match="40 rows of 40 pixels"):
        compare_with_truth(maps_of(point[:10], normal[:10], inside[:10]), truth_of(point, normal, inside))


def test_truth_file_tells_judged_and_lit_pixels_by_status(tmp_path: Path) -> None:
    point, normal, inside = cap()
    status = np.where(inside, TruthStatus.JUDGED, TruthStatus.MISSES_OBJECT).astype(np.uint8)
    status[0, 0], status[0, 1] = TruthStatus.LOST_INSIDE, TruthStatus.OFF_PANEL
    np.savez(tmp_path / "truth.npz", point_mm=point, normal=normal, status=status)
    truth = load_truth(tmp_path)  # the folder of a session
    assert np.array_equal(truth.judged, inside)
    assert (~truth.lit).sum() == 2


def test_truth_file_of_another_program_is_read(tmp_path: Path) -> None:
    point, normal, inside = cap()
    lit = np.ones_like(inside)
    lit[0, 0] = False
    np.savez(tmp_path / "other.npz", point=point, normal=normal, judged=inside, lit_in_all_sets=lit)
    truth = load_truth(tmp_path / "other.npz")
    assert np.array_equal(truth.judged, inside)
    assert np.array_equal(truth.lit, lit)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04"], ids=["empty", "text", "torn"])
def test_damaged_truth_file_is_one_sentence(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "truth.npz").write_bytes(content)
    with pytest.raises(ReconError, match="not a truth file"):
        load_truth(tmp_path / "truth.npz")


def test_truth_file_whose_maps_differ_in_size_is_one_sentence(tmp_path: Path) -> None:
    point, normal, inside = cap()
    np.savez(tmp_path / "truth.npz", point_mm=point[1:], normal=normal, status=inside.astype(np.uint8))
    with pytest.raises(ReconError, match="differ in size"):
        load_truth(tmp_path / "truth.npz")


def test_missing_truth_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match="no such file"):
        load_truth(tmp_path / "truth.npz")


def test_distance_to_an_ellipsoid_is_exact_on_its_axes_to_first_order() -> None:
    axes = (12.5, 12.5, 5.0)
    point = np.array([[12.51, 0, 0], [0, -12.49, 0], [0, 0, 5.01], [7.5, 0, 4.0]])
    # On the semi-axis a, f/|∇f| of a point at a + e is e + e²/(2a) − …; the last point lies on the surface.
    assert ellipsoid_distance_mm(point, axes) == pytest.approx([0.01, -0.01, 0.01, 0.0], abs=0.01**2 / 5)


def test_sphere_of_a_run_stands_beside_the_published_hemisphere(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", maps_of(*cap()))
    result = evaluate(run, primitive="sphere", known=KnownSize(radius_mm=RADIUS_MM))
    assert ours(result, "radius") == pytest.approx(RADIUS_MM, abs=1e-6)
    assert ours(result, "radius off by") == pytest.approx(0.0, abs=1e-6)
    radius = next(row for row in result.rows if row.quantity == "radius")
    assert radius.published == (26.95, 26.95)
    assert radius.unit == "mm"


def test_published_deviations_follow_from_the_published_sizes() -> None:
    for shape, sizes in (("sphere", ("radius",)), ("cylinder", ("radius", "height"))):
        for size in sizes:
            figures = PUBLISHED[shape]
            off = 100 * abs(figures[size][0] / figures[f"known {size}"][0] - 1)
            assert off == pytest.approx(figures[f"{size} off by"][0], abs=0.05)


def test_every_primitive_fills_its_published_rows(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", maps_of(*cap()))
    known = KnownSize(radius_mm=RADIUS_MM, height_mm=40.0)
    for primitive, figures in PUBLISHED.items():
        rows = evaluate(run, primitive=primitive, known=known).rows
        assert {row.quantity for row in rows if row.published} == set(figures), primitive


def test_ellipsoid_is_measured_over_judged_pixels_only(tmp_path: Path) -> None:
    point, normal, inside = cap()
    run = write_run(tmp_path / "run", maps_of(point, normal, inside))
    judged = inside.copy()
    judged[:20] = False
    np.savez(tmp_path / "truth.npz", point=point, normal=normal, judged=judged, lit_in_all_sets=inside)
    result = evaluate(run, truth=tmp_path / "truth.npz", ellipsoid_mm=(RADIUS_MM,) * 3)
    assert ours(result, "points", "ellipsoid") == judged.sum()
    assert ours(result, "distance, rms") < 1e-9
    assert ours(result, "complete") == 100.0


def test_run_inside_a_simulated_session_finds_its_truth(tmp_path: Path) -> None:
    point, normal, inside = cap()
    run = write_run(tmp_path / "session" / "recon-full", maps_of(point, normal, inside))
    status = (~inside).astype(np.uint8)
    np.savez(tmp_path / "session" / "truth.npz", point_mm=point, normal=normal, status=status)
    assert ours(evaluate(run), "complete") == 100.0


def test_nothing_to_compare_with_is_one_sentence(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", maps_of(*cap()))
    with pytest.raises(ReconError, match="give --primitive, --truth or --ellipsoid"):
        evaluate(run)


def test_run_without_any_point_is_one_sentence(tmp_path: Path) -> None:
    point, normal, inside = cap()
    run = write_run(tmp_path / "run", maps_of(point, normal, np.zeros_like(inside)))
    for primitive in ("sphere", "cylinder", "planes"):
        with pytest.raises(ReconError):
            evaluate(run, primitive=primitive)


def command(*arguments: str) -> str:
    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    result = CliRunner().invoke(app, ["evaluate", *arguments], env={"COLUMNS": "120"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def test_command_prints_both_columns_and_writes_json(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run [1]", maps_of(*cap()))
    printed = command(str(run), "--primitive", "sphere", "--known-radius", str(RADIUS_MM))
    assert "run [1]" in " ".join(printed.split())  # a long path is broken over lines
    assert "27.99" in printed
    assert "26.95" in printed
    saved = json.loads((run / EVALUATION_NAME).read_text())
    assert saved["schema_version"] == 1
    assert {row["quantity"] for row in saved["rows"]} >= {"radius", "normal error, median"}


def test_command_evaluates_every_run_of_a_session(tmp_path: Path) -> None:
    for method in ("full", "paper"):
        write_run(tmp_path / f"recon-{method}", maps_of(*cap()))
    command(str(tmp_path), "--primitive", "sphere")
    assert len(list(tmp_path.glob(f"*/{EVALUATION_NAME}"))) == 2


def test_figure_that_cannot_be_formed_is_null_and_none(tmp_path: Path) -> None:
    point, normal, inside = cap()
    run = write_run(tmp_path / "run", maps_of(point, np.full_like(normal, np.nan), inside))
    printed = command(str(run), "--primitive", "sphere")
    assert "none" in printed
    saved = json.loads((run / EVALUATION_NAME).read_text())
    assert next(row for row in saved["rows"] if row["quantity"] == "normal error, mean")["ours"] is None


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "1,2,-3", "1,2,nan"])
def test_bad_semi_axes_are_one_sentence(tmp_path: Path, text: str) -> None:
    run = write_run(tmp_path / "run", maps_of(*cap()))
    with pytest.raises(ReconError, match="--ellipsoid"):
        command(str(run), "--ellipsoid", text)


def test_folder_without_results_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match="recon run"):
        command(str(tmp_path), "--primitive", "sphere")
