"""Sentences that go with a reconstruction's maps and mesh: what no pixel measured, and what could not be made or told apart."""

import numpy as np

from recon.maps import Maps
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.surface.mesh import Mesh


def drawn_mesh(mesh: Mesh | None) -> tuple[Mesh | None, tuple[str, ...]]:
    """Return the mesh, or None with a sentence where no three neighbouring pixels make a triangle of it."""
    if mesh is None or len(mesh.faces):
        return mesh, ()
    return None, (
        "No three neighbouring pixels have points, so there is no mesh; the status map shows what was left out.",
    )


def covered_notes(maps: Maps) -> tuple[str, ...]:
    """Return what is to be told of points that no pixel measured itself."""
    covered = int(np.count_nonzero(maps.status == PixelStatus.COVERED))
    if covered == 0:
        return ()
    return (
        f"{covered} pixels whose own measurement was left out are covered by the surface about them: status COVERED and "
        "support 3 in the maps, support 3 in the cloud, and part of the mesh.",
    )


def camera_notes(manifest: Manifest) -> tuple[str, ...]:
    """Return what was not told apart without the camera's place."""
    if manifest.camera.pose is not None:
        return ()
    return (
        "The camera's place is not in the manifest: points beyond it, and what lies beside the object, were not told apart.",
    )
