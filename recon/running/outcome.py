"""From correspondences to maps, mesh and their statistics, by the session's method."""

from dataclasses import dataclass

import numpy as np

from recon.maps import Maps
from recon.metrics import Statistic
from recon.reconstruct import Crossing, cross_paths, maps_of
from recon.running.settings import Settings
from recon.sessions.manifest import Manifest
from recon.sessions.photos import read_grey
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.surface.mesh import Mesh
from recon.surface.surface_stage import surface_of
from recon.surface.thin_stage import thin_object
from recon.sweeps.correspondence import SweepResult
from recon.verdict import gap_ratio, statistic


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What the stages made before anything is written."""

    maps: Maps
    mesh: Mesh | None
    gap_ratio: float | None
    statistics: tuple[Statistic, ...]
    warnings: tuple[str, ...]


def read_mask(session: Session) -> np.ndarray | None:
    """Return the session's object mask [rows, cols] (non-zero is object), or None."""
    manifest = session.manifest
    if manifest.mask is None:
        return None
    counts = read_grey(session.folder / manifest.mask, rows=manifest.camera.rows, cols=manifest.camera.columns)
    return counts > 0


def reconstruct(session: Session, sweeps: dict[tuple[str, str], SweepResult], settings: Settings) -> Outcome:
    """Turn correspondences into maps and a mesh by the session's method."""
    manifest = session.manifest
    mask = read_mask(session)
    if manifest.method == "thin":
        thin = thin_object(sweeps, manifest, method=settings.method, inside_mask=mask)
        return Outcome(thin.maps, thin.mesh, None, _statistics(thin.maps, None), thin.warnings)
    status, crossing = cross_paths(sweeps, manifest, method=settings.method, limits=settings.limits, inside_mask=mask)
    shape = (manifest.camera.rows, manifest.camera.columns)
    maps = maps_of(status, crossing, shape=shape, method=settings.method)
    surface = surface_of(maps, crossing, manifest, method=settings.method)
    ratio = None
    if settings.method == "full":
        fine = crossing.status == PixelStatus.OK
        ratio = gap_ratio(crossing.points.gap_mm[fine], crossing.points.gap_sd_mm[fine])
    return Outcome(
        surface.maps,
        surface.mesh,
        ratio,
        _statistics(surface.maps, crossing),
        (*_warnings(manifest), *surface.warnings),
    )


def _statistics(maps: Maps, crossing: Crossing | None) -> tuple[Statistic, ...]:
    valid = maps.valid()
    found = [
        statistic(
            "gap", "mm", np.abs(maps.gap_mm[valid]), how="length of the shortest segment between the two light paths"
        ),
        statistic(
            "sd",
            "mm",
            maps.sd_mm[valid],
            how="root of the trace of each point's covariance, from the photos' own noise",
        ),
        statistic(
            "PBC angle",
            "deg",
            np.degrees(maps.pbc_angle_rad[valid]),
            how="angle between the paths in liquid and in air",
        ),
    ]
    if crossing is not None and np.isfinite(maps.sd_mm[valid]).any():
        fine = crossing.status == PixelStatus.OK
        found.append(
            statistic(
                "normal sd",
                "deg",
                np.degrees(crossing.normal_sd_rad[fine]),
                how="root of the summed variances of the normal's two tilts, from the photos' own noise",
            )
        )
    return tuple(one for one in found if one is not None)


def _warnings(manifest: Manifest) -> tuple[str, ...]:
    warnings = []
    if manifest.camera.pose is None:
        warnings.append(
            "The camera's place is not in the manifest: points beyond it, and what lies beside the object, were not told apart."
        )
    return tuple(warnings)
