"""The capture in tests/data that was made without our code, under the judge of its own README."""

from pathlib import Path

import numpy as np
import pytest
from povray_judge import DATA, judge

from recon.maps import Maps, load_maps
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions.importer import import_folder, read_layout
from recon.status import PixelStatus


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("povray")
    for stripe in ("hard", "smooth"):
        import_folder(DATA / stripe, folder / stripe, read_layout(DATA / f"{stripe}.toml"))
    return {stripe: folder / stripe for stripe in ("hard", "smooth")}


# Of the pixels that are judged, one in a thousand.
MOST_FALSE_POINTS = 37


def reconstructed(session: Path, method: str) -> Maps:
    out = session / f"recon-{method}"
    run_session(session, out, Settings(method=method))
    return load_maps(out / "maps.npz")


def test_the_papers_method_on_a_hard_stripe(sessions: dict[str, Path]) -> None:
    maps = reconstructed(sessions["hard"], "paper")
    result = judge(maps)
    assert result.complete >= 0.95
    assert result.distance_rms <= 1.8
    # A plain script with the same pipeline gets 0.47 (README).
    assert result.distance_median == pytest.approx(0.47, abs=0.05)


def test_what_lies_beside_the_object_is_told_apart_from_it(sessions: dict[str, Path]) -> None:
    truth = np.load(DATA / "truth.npz")
    maps = reconstructed(sessions["hard"], "paper")
    beside = maps.status == PixelStatus.BESIDE_OBJECT
    assert (beside & truth["judged"]).sum() <= 0.001 * truth["judged"].sum()
    # The liquid's surface beyond the ellipse is seen by thousands of pixels; next to none may pass for the object.
    outside = ~np.isfinite(truth["point"][..., 0])
    assert beside.sum() > 5000
    assert (maps.valid() & outside).sum() <= 0.05 * beside.sum()


def test_the_full_method_on_a_smooth_stripe(sessions: dict[str, Path]) -> None:
    result = judge(reconstructed(sessions["smooth"], "full"))
    assert result.complete >= 0.97
    assert result.point_rms <= 0.02
    assert result.point_median <= 0.007
    assert result.normal_median_deg <= 0.05
    assert result.false_points <= MOST_FALSE_POINTS
    names = {"maps.npz", "cloud.ply", "mesh.ply", "mesh.glb", "metrics.json", "report.html"}
    assert names <= {path.name for path in (sessions["smooth"] / "recon-full").iterdir()}


def test_the_full_method_on_a_hard_stripe(sessions: dict[str, Path]) -> None:
    result = judge(reconstructed(sessions["hard"], "full"))
    assert result.complete >= 0.97
    assert result.point_rms <= 0.08
    assert result.point_median <= 0.03
    assert result.false_points <= MOST_FALSE_POINTS


def test_the_import_makes_no_second_copy_of_a_photo(tmp_path: Path) -> None:
    source = tmp_path / "photos"
    source.mkdir()
    for path in (DATA / "hard").rglob("*.jpg"):
        target = source / path.relative_to(DATA / "hard")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    import_folder(source, tmp_path / "session", read_layout(DATA / "hard.toml"))
    one = "pos0_air/x/0010.jpg"
    assert (source / one).stat().st_ino == (tmp_path / "session" / "photos" / one).stat().st_ino
