"""What a report shows of the result itself: the surface in space, and its maps. To draw them is most of a report's work."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer

from recon.maps import Maps
from recon.report.map_section import map_section
from recon.report.numbers import LengthUnit
from recon.report.panel import Section
from recon.report.point_scene import TriangleMesh
from recon.report.surface_section import surface_section
from recon.sessions.manifest import Manifest

# Samples along the longer side of a map.
LONGEST_PX = 900

# Vertices in mm, triangles as indices of vertices, and one normal a vertex.
Mesh = tuple[Float[np.ndarray, "vertices 3"], Integer[np.ndarray, "faces 3"], Float[np.ndarray, "vertices 3"]]


@dataclass(frozen=True, slots=True)
class ReportViews:
    """The sections of the surface and of the maps, which follow from the maps, the mesh and the manifest's geometry alone."""

    surface: Section
    maps: Section


def report_views(maps: Maps, manifest: Manifest, mesh: Mesh | None) -> ReportViews:
    """Draw the surface, whose mesh is in the frame of ``maps``, and the maps."""
    unit = LengthUnit.of(manifest.length_unit)
    triangles = None
    if mesh is not None:
        triangles = TriangleMesh(mesh[0].astype(np.float64), mesh[1].astype(np.int64), mesh[2].astype(np.float64))
    return ReportViews(
        surface_section(maps, manifest, triangles, unit=unit),
        map_section(maps, manifest, unit=unit, longest_px=LONGEST_PX),
    )
