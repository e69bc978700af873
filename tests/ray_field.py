"""Correspondences straight from the simulator's optics: no photos, but the exact places of the display with noise of a known sd.

They stand for perfect photos of a given noise, so that the geometry and the surface can be judged alone, and at sizes for which
photos would take hours.
"""

import numpy as np

from recon.maps import Maps
from recon.method import Limits, Method
from recon.reconstruct import Crossing, cross_paths, maps_of
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel
from rig.capturing.session_manifest import SIMULATED_DEVICE, manifest_of
from rig.rehearsing.scene_config import SceneOptions, config_of_scene
from sim_backend.light_paths import meet_display, on_panel, pixel_centre_paths
from sim_backend.scene import Scene


def scene_manifest(scene: Scene) -> Manifest:
    """Return the manifest that a simulated capture of the scene would carry."""
    return manifest_of(config_of_scene(scene, SceneOptions()), devices={"simulator": SIMULATED_DEVICE}, scene=scene)


def exact_places(scene: Scene) -> dict[tuple[str, str], np.ndarray]:
    """Return where the centre of each pixel looks, in device pixels, NaN where it misses the panel; keys as of sweeps."""
    shape = (scene.camera.rows, scene.camera.columns)
    places = {}
    for condition in ("air", "liquid"):
        paths = pixel_centre_paths(scene, scene.world(wet=condition == "liquid"))
        for position, stage_mm in enumerate(scene.stage_positions_mm):
            hits = meet_display(scene, stage_mm, paths.origin, paths.direction, paths.n)
            seen = ~paths.trapped & (hits.transmission > 0) & on_panel(scene, hits.x_mm, hits.y_mm)
            for axis, place in (("x", hits.x_mm), ("y", hits.y_mm)):
                places[f"pos{position}_{condition}", axis] = np.where(seen, place, np.nan).reshape(shape)
    return places


def noisy_sweeps(
    places: dict[tuple[str, str], np.ndarray], *, sd_px: float, rng: np.random.Generator
) -> dict[tuple[str, str], SweepResult]:
    """Return the places with independent Gaussian noise, as the decoder would hand them over."""
    return {
        key: SweepResult(
            place_px=place + sd_px * rng.standard_normal(place.shape),
            sd_px=np.where(np.isfinite(place), sd_px, np.nan).astype(np.float32),
            status=np.where(np.isfinite(place), PixelStatus.OK, PixelStatus.UNLIT).astype(np.uint8),
            noise=NoiseModel(1.0),
            misfit=np.nan,
            photos=(),
            curves=(),
        )
        for key, place in places.items()
    }


def crossed(sweeps: dict[tuple[str, str], SweepResult], manifest: Manifest, method: Method) -> tuple[Maps, Crossing]:
    """Cross the paths and lay them out, before any surface."""
    status, crossing = cross_paths(sweeps, manifest, method=method, limits=Limits())
    shape = (manifest.camera.rows, manifest.camera.columns)
    return maps_of(status, crossing, shape=shape, method=method), crossing
