"""The 3-D view's numbers: what is left of points, normals and meshes after thinning and packing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from report_example import CENTRE_MM, RADIUS_MM, example_manifest, example_maps, example_mesh

from recon.report.display_frame import frame_from_world, rotate, transform_points
from recon.report.map_pictures import positive_limits
from recon.report.point_scene import (
    Box,
    TriangleMesh,
    box_of,
    cluster_mesh,
    packed_normals,
    packed_places,
)
from recon.report.surface_section import cloud_of
from recon.sessions.manifest import Manifest


def unpacked_normals(packed: np.ndarray) -> np.ndarray:
    """The octahedral map backwards, as the page's shader does it (Cigolle et al., JCGT 2014)."""
    flat = np.maximum(packed / 127.0, -1.0)
    normal = np.column_stack([flat, 1 - np.abs(flat).sum(axis=1)])
    fold = np.maximum(-normal[:, 2:], 0)
    normal[:, :2] -= np.sign(normal[:, :2]) * fold
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_packed_normals_come_back_within_a_degree(seed: int) -> None:
    normal = np.random.default_rng(seed).normal(size=(200, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    back = unpacked_normals(packed_normals(normal))
    # Rounding moves x and y of the octahedron by h = 1/254 at most, hence its point by (h, h, -2h): sqrt(6) h across, seen from
    # the middle at the least distance, 1/sqrt(3), of a face from the centre.
    assert np.degrees(np.arccos(np.clip((normal * back).sum(axis=1), -1, 1))).max() < np.degrees(np.sqrt(18) / 254)


def test_packed_places_come_back_within_half_a_step_of_the_box() -> None:
    rng = np.random.default_rng(5)
    point_mm = rng.uniform((-20, 0, 30), (20, 10, 90), (500, 3))
    box = Box(point_mm.min(axis=0), point_mm.max(axis=0))
    packed = packed_places(point_mm, np.full(500, 0.1), box, sd_limits_mm=(0.01, 1.0))
    back_mm = box.low_mm + packed[:, :3] / 65_535 * (box.high_mm - box.low_mm)
    assert (np.abs(back_mm - point_mm) <= 0.5001 * (box.high_mm - box.low_mm) / 65_535).all()
    # 0.1 is the middle of 0.01 and 1 on a logarithmic scale.
    assert np.abs(packed[:, 3] / 65_535 - 0.5).max() < 1e-4


def test_a_handful_of_outliers_does_not_shrink_the_object() -> None:
    rng = np.random.default_rng(6)
    point_mm = rng.uniform(-10, 10, (20_000, 3))
    point_mm[:5] = 1e5
    box = box_of(point_mm)
    assert (box.high_mm - box.low_mm < 30).all()
    assert box.inside(point_mm).sum() == 19_995


def test_the_points_shown_come_from_everywhere_and_none_twice() -> None:
    maps = example_maps()
    cloud = cloud_of(maps, frame_from_world(example_manifest()), most=4000)
    assert len(np.unique(cloud.point_mm, axis=0)) == 4000
    # As large a part of the draws lies left of the middle as of all points, within four sd of a binomial count.
    point_mm = maps.point_mm[maps.valid()]
    share = (point_mm[:, 0] < CENTRE_MM[0]).mean()
    count = (cloud.point_mm[:, 0] < CENTRE_MM[0]).sum()
    assert abs(count - 4000 * share) < 4 * np.sqrt(4000 * 0.25)


def test_a_clustered_mesh_is_small_and_stays_on_the_ball() -> None:
    maps = example_maps(rows=360, cols=480, radius_px=170)
    vertex_mm, face, normal = example_mesh(maps)
    small = cluster_mesh(TriangleMesh(vertex_mm, face.astype(np.int64), normal), most=4000)
    assert 1500 < len(small.vertex_mm) < 6000
    assert (small.face[:, 0] != small.face[:, 1]).all()
    cell_mm = np.sqrt(1.5 * 2 * np.pi * RADIUS_MM**2 / 4000)
    # A mean over a cell of side c lies inside the ball by at most the sagitta of the cell's diagonal, 3 c² / 8 R.
    depth_mm = RADIUS_MM - np.linalg.norm(small.vertex_mm - CENTRE_MM, axis=1)
    assert depth_mm.min() > -1e-9
    assert depth_mm.max() < 3 * cell_mm**2 / (8 * RADIUS_MM)
    assert np.linalg.norm(small.normal, axis=1) == pytest.approx(1.0)


def test_depth_is_the_distance_in_front_of_the_display_wherever_the_display_stands() -> None:
    # A display that faces along world +x: its z axis (into the screen) is -x.
    data = example_manifest().model_dump()
    axes = {"x_axis": (0.0, 0.0, 1.0), "y_axis": (0.0, -1.0, 0.0)}
    data["display_poses"] = [{"centre_mm": (10.0, 0, 0), **axes}, {"centre_mm": (-20.0, 0, 0), **axes}]
    manifest = Manifest.model_validate(data)
    into_screen = np.cross(axes["x_axis"], axes["y_axis"])
    frame = frame_from_world(manifest)
    seven_in_front = np.array([[10.0, 3.0, -4.0]]) - 7 * into_screen
    # The pose's y points down in the world's -y, so up on the display is +y of the world.
    assert transform_points(frame, seven_in_front)[0] == pytest.approx([-4.0, 3.0, 7.0])
    assert rotate(frame, into_screen[None])[0] == pytest.approx([0, 0, -1])


def test_one_point_that_rests_on_nothing_does_not_set_the_scale_of_sd() -> None:
    sd_mm = np.full(1000, 0.01)
    sd_mm[:200] = np.geomspace(1, 1e15, 200)
    low, high = positive_limits(sd_mm)
    assert low == pytest.approx(0.01)
    # A hundred medians.
    assert high == pytest.approx(1.0)


def test_a_scale_of_sd_is_usable_when_nothing_has_an_sd_or_all_have_the_same() -> None:
    for values in (np.full(5, np.nan), np.zeros(5), np.full(5, 0.3)):
        low, high = positive_limits(values)
        assert 0 < low < high
