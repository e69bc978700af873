"""The surface in space: a view that a person can turn, and a still picture for paper."""

import matplotlib
import numpy as np
from jaxtyping import Float64

from recon.maps import Maps
from recon.report import still
from recon.report.display_frame import frame_from_world, rotate, screen_corners, transform_points
from recon.report.map_pictures import limits, positive_limits
from recon.report.numbers import LengthUnit, number
from recon.report.panel import Panel, Section
from recon.report.point_scene import (
    MESH_VERTICES_SHOWN,
    POINTS_SHOWN,
    SEED,
    Box,
    Cloud,
    TriangleMesh,
    as_text,
    box_of,
    cluster_mesh,
    packed_faces,
    packed_normals,
    packed_places,
    sd_at,
)
from recon.sessions.manifest import Manifest

STOPS = 16


def surface_section(maps: Maps, manifest: Manifest, mesh: TriangleMesh | None, *, unit: LengthUnit) -> Section:
    """Return the section with the 3-D view; ``mesh`` is in the frame of ``maps``."""
    return Section("surface", "Surface", (surface_panel(maps, manifest, mesh, unit),))


def cloud_of(maps: Maps, frame: Float64[np.ndarray, "4 4"], *, most: int) -> Cloud:
    """Return at most ``most`` of the pixels that have a point, in random order and in the frame of the report."""
    pixels = np.flatnonzero(maps.valid())
    known = np.unravel_index(np.random.default_rng(SEED).permutation(pixels)[:most], maps.status.shape)
    return Cloud(
        transform_points(frame, maps.point_mm[known]),
        rotate(frame, maps.normal[known]),
        maps.sd_mm[known],
    )


def surface_panel(maps: Maps, manifest: Manifest, mesh: TriangleMesh | None, unit: LengthUnit) -> Panel:
    """Return the 3-D view of the points and, where there is one, the mesh."""
    frame = frame_from_world(manifest)
    cloud = cloud_of(maps, frame, most=still.POINTS_DRAWN)
    what = "Points and mesh as the display sees them at first. Everything is in the frame of the display at position 0."
    good = "A closed, smooth surface with the object's proportions."
    bad = "A surface that is torn, doubled or bent where the object is not."
    if not len(cloud.point_mm):
        return Panel("view", "3-D view", "viewer.html.j2", {}, what, good, bad, "No pixel has a point.")
    box = box_of(cloud.point_mm)
    inside = cloud[box.inside(cloud.point_mm)]
    depth_limits_mm = limits(inside.point_mm[:, 2])
    shown = inside[np.arange(min(POINTS_SHOWN, len(inside.point_mm)))]
    size = box.high_mm - box.low_mm
    text = " × ".join(number(float(side)) for side in size)
    data: dict[str, object] = {
        "still": still.still_png(inside, depth_limits_mm=depth_limits_mm),
        "still_size": (still.WIDTH_PX, still.HEIGHT_PX),
        "scene": scene_header(inside, box, depth_limits_mm, manifest, unit),
        "blocks": {},
        "points": len(shown.point_mm),
        "of_points": int(maps.valid().sum()),
        "outside": len(inside.point_mm) < len(cloud.point_mm),
        "mesh_note": "The run made no mesh, so only points are shown.",
        "size": f"{text} {unit.label}",
    }
    sd_limits_mm = positive_limits(inside.sd_mm)
    blocks = {
        "points-place": packed_places(shown.point_mm, shown.sd_mm, box, sd_limits_mm=sd_limits_mm),
        "points-normal": packed_normals(shown.normal),
    }
    if mesh is not None and len(mesh.face):
        small = cluster_mesh(_mesh_in_frame(mesh, frame, box), most=MESH_VERTICES_SHOWN)
        sd_mm = sd_at(small.vertex_mm, shown)
        blocks |= {
            "mesh-place": packed_places(small.vertex_mm, sd_mm, box, sd_limits_mm=sd_limits_mm),
            "mesh-normal": packed_normals(small.normal),
            "mesh-face": packed_faces(small.face, len(small.vertex_mm)),
        }
        data["mesh_note"] = (
            f"The mesh is shown with {number(len(small.face))} of its {number(len(mesh.face))} triangles; its colour for sd is "
            "that of the nearest point."
            if len(small.face) < len(mesh.face)
            else f"The mesh has {number(len(mesh.face))} triangles; its colour for sd is that of the nearest point."
        )
    data["blocks"] = {name: as_text(values) for name, values in blocks.items()}
    return Panel("view", "3-D view", "viewer.html.j2", data, what, good, bad)


def scene_header(
    cloud: Cloud, box: Box, depth_limits_mm: tuple[float, float], manifest: Manifest, unit: LengthUnit
) -> dict[str, object]:
    """Return what the view must know besides the blocks of numbers: box, colours, first direction, screens."""
    frame = frame_from_world(manifest)
    width_mm = manifest.display.columns * manifest.display.pitch_mm
    height_mm = manifest.display.rows * manifest.display.pitch_mm
    corners = [
        screen_corners(frame, pose, width_mm=width_mm, height_mm=height_mm).round(4).tolist()
        for pose in manifest.display_poses
    ]
    has_sd = bool(np.isfinite(cloud.sd_mm).any())
    return {
        "low": box.low_mm.tolist(),
        "high": box.high_mm.tolist(),
        "unit": unit.label,
        "azimuth": still.AZIMUTH_DEG,
        "elevation": still.ELEVATION_DEG,
        "screens": corners,
        "depth": _ramp("viridis", depth_limits_mm, unit),
        "sd": _ramp("magma", positive_limits(cloud.sd_mm), unit) if has_sd else None,
    }


def _ramp(colours: str, ends: tuple[float, float], unit: LengthUnit) -> dict[str, object]:
    """Return a colour scale as a few stops, with the words at its ends."""
    stops = matplotlib.colormaps[colours](np.linspace(0, 1, STOPS))[:, :3]
    return {
        "low": ends[0],
        "high": ends[1],
        "low_text": f"{number(float(ends[0]))} {unit.label}",
        "high_text": f"{number(float(ends[1]))} {unit.label}",
        "stops": stops.round(3).tolist(),
    }


def _mesh_in_frame(mesh: TriangleMesh, frame: Float64[np.ndarray, "4 4"], box: Box) -> TriangleMesh:
    """Return the part of the mesh inside the box, in the frame of the report."""
    vertex_mm = transform_points(frame, mesh.vertex_mm)
    face = mesh.face[box.inside(vertex_mm)[mesh.face].all(axis=1)]
    used = np.zeros(len(vertex_mm), dtype=bool)
    used[face.ravel()] = True
    return TriangleMesh(vertex_mm[used], (np.cumsum(used) - 1)[face], rotate(frame, mesh.normal[used]))
