"""The numbers that judge a sweep while the capture goes on."""

import numpy as np
import pytest
from session_example import manifest as fields

from recon.geometry.entry_point import entry_points
from recon.geometry.light_paths import light_paths
from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel
from recon.sweeps.sweep_quality import predicted_entry_sd_mm, sweep_quality


def result(
    status: list[list[int]],
    *,
    shares: tuple[float, ...],
    curves: tuple[tuple[float, ...], ...],
    brightest: tuple[int, ...] | None = None,
) -> SweepResult:
    states = np.array(status, dtype=np.uint8)
    fine = states == PixelStatus.OK
    return SweepResult(
        place_px=np.where(fine, 1.0, np.nan),
        sd_px=np.where(fine, 0.02, np.nan).astype(np.float32),
        status=states,
        noise=NoiseModel(1.0),
        misfit=1.25,
        photos=tuple(
            PhotoQuality(
                set="pos0_air", sweep="x", index=k, brightest=brightest[k] if brightest else 255, saturated_share=share
            )
            for k, share in enumerate(shares)
        ),
        curves=tuple(
            SampleCurve(
                row=0, col=0, set="pos0_air", axis="x", place_px=(0.0,), intensity=one, model=(), peak_px=0, sd_px=None
            )
            for one in curves
        ),
    )


def test_coverage_counts_lit_pixels_and_clipped_samples_are_set_against_them() -> None:
    ok, unlit, bad = PixelStatus.OK, PixelStatus.UNLIT, PixelStatus.BAD_FIT
    # 8 pixels, 4 of them lit, 3 matched; two photos with one clipped pixel each.
    one = result([[ok, ok, ok, bad], [unlit] * 4], shares=(1 / 8, 1 / 8), curves=((10.0, 90.0), (0.0, 50.0)))
    found = sweep_quality(one, set_name="pos0_air", axis="x")
    assert (found.lit_pixels, found.coverage, found.saturated_share) == (4, 0.75, 0.5)
    assert found.contrast == pytest.approx((0.8 + 1.0) / 2)
    assert (found.misfit, found.photos) == (1.25, 2)
    assert found.sd_px == pytest.approx(0.02)


def test_a_dark_sweep_has_no_numbers_rather_than_zeros() -> None:
    found = sweep_quality(result([[PixelStatus.UNLIT]], shares=(0.0,), curves=()), set_name="pos0_air", axis="x")
    assert found.lit_pixels == 0
    assert np.isnan([found.coverage, found.saturated_share, found.contrast, found.sd_px]).all()


@pytest.mark.parametrize("distance_mm", [5.0, 20.0])
def test_the_predicted_error_is_that_of_noisy_paths_that_cross(distance_mm: float) -> None:
    """Trace two paths to the object by Snell's law, disturb where they meet the displays, and cross them again."""
    manifest = Manifest.model_validate(fields())  # displays at z = 10 and 20, pitch 1 mm, water 1.333
    rng, count, sd_mm = np.random.default_rng(3), 40_000, 0.003
    object_mm = np.array([0.0, 0.0, 10.0 - distance_mm])
    in_air = np.radians(30.0)
    in_liquid = np.arcsin(np.sin(in_air) / 1.333)
    paths = []
    # The face is tilted so that both paths leave it about along z, as the formula has them.
    for angle in (in_air - in_liquid, 0.0):
        slope = np.array([np.tan(angle), 0.0])
        screens = [object_mm[:2] + slope * (z - object_mm[2]) + rng.normal(0, sd_mm, (count, 2)) for z in (10.0, 20.0)]
        sds = np.full((count, 2), sd_mm)
        first, second = manifest.display_poses
        paths.append(light_paths((screens[0], screens[1]), (sds, sds), (first, second), cover_glass=None, n_medium=1.0))
    points = entry_points(paths[1], paths[0], weighted=True).point_mm
    scatter = np.sqrt(((points - object_mm) ** 2).sum(axis=1).mean())
    predicted = predicted_entry_sd_mm(sd_mm / 1.0, manifest, object_distance_mm=distance_mm)
    assert predicted == pytest.approx(scatter, rel=0.03)


def test_without_a_liquid_nothing_crosses() -> None:
    data = {**fields(), "method": "thin", "object": {"name": "plate", "n": 1.5}, "liquid": None}
    for one in data["sets"]:
        one["condition"] = {"air": "without", "liquid": "with"}[one["condition"]]
    assert np.isnan(predicted_entry_sd_mm(0.02, Manifest.model_validate(data), object_distance_mm=10.0))


def test_photos_without_a_stripe_count_only_between_photos_with_one() -> None:
    counts = (9, 9, 9, 200, 180, 8, 9, 200, 12, 9, 7, 210, 9, 9)
    one = result([[PixelStatus.OK]], shares=(0.0,) * len(counts), curves=(), brightest=counts)
    assert sweep_quality(one, set_name="pos0_air", axis="x").dark_gap == 3


def test_a_sweep_whose_photos_are_all_lit_has_no_gap_however_they_vary() -> None:
    counts = (120, 230, 180, 210, 150, 240)
    one = result([[PixelStatus.OK]], shares=(0.0,) * len(counts), curves=(), brightest=counts)
    assert sweep_quality(one, set_name="pos0_air", axis="x").dark_gap == 0
