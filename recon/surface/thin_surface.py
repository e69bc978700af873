"""The surface of a thin object: by which form its normals are integrated along the rays that meet it.

Its triangulated points are poor, for the two rays of a pixel are nearly parallel. ``fused`` weighs them against the normals, all
in one system; the other forms integrate the normals alone, and take from the points one constant a connected part.
"""

import numpy as np

from recon.method import Method, ThinForm
from recon.surface.fusion import fuse_on_rays
from recon.surface.integration import integrate_on_rays
from recon.surface.ray_bundle import ScalarMap, VectorMap
from recon.surface.sparse_solver import SolverError

USUAL_FORM: dict[Method, ThinForm] = {"paper": "discrete", "full": "quadratic"}
NOTES: dict[ThinForm, str] = {
    "fused": "The surface joins triangulated points and normals, each by its own uncertainty.",
    "quadratic": "The surface is integrated from the normals by quadratic least squares; the points only say where it stands.",
    "discrete": "The surface is integrated from the normals by discrete geometry; the points only say where it stands.",
    "bilateral": "The surface is integrated from the normals with bilateral weights; the points only say where it stands.",
}


def thin_surface_points(
    form: ThinForm,
    *,
    origin_mm: VectorMap,
    direction: VectorMap,
    distance_mm: ScalarMap,
    distance_sd_mm: ScalarMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
) -> VectorMap:
    """Return where the surface meets each ray; NaN where there is no normal, or no point to hold a part by.

    ``distance_mm`` along the unit ``direction`` is what triangulation says, with its standard deviation.
    """
    mask = np.isfinite(normal).all(axis=2)
    if form == "fused":
        try:
            return fuse_on_rays(origin_mm, direction, distance_mm, distance_sd_mm, normal, normal_sd_rad, mask).point_mm
        except np.linalg.LinAlgError as error:
            raise SolverError(
                "--integration fused: the points are so poor beside the normals that their equations are singular; "
                "use --integration quadratic"
            ) from error
    return integrate_on_rays(
        normal,
        mask,
        origin_mm=origin_mm,
        direction=direction,
        anchor_distance_mm=distance_mm,
        anchor_sd_mm=distance_sd_mm,
        integration=form,
    ).point_mm
