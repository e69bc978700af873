"""A whole session in closed form: a concave glass surface, and where each pixel looks on the display in the four sets.

Light of the camera comes through glass to a hollow sphere, leaves there into liquid or air by Snell's law, and meets the display
at its two positions. What lies beside the object is dark.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int

from recon.bench.bench_scene import ASPECT, STRIPE_WIDTH_PX, UNSEEN_PHOTOS
from recon.errors import ReconError
from recon.sessions.journal import now_text
from recon.sessions.manifest import (
    Axis,
    CameraBody,
    CaptureSet,
    DisplayPanel,
    Liquid,
    Manifest,
    Pose,
    Provenance,
    ScannedObject,
    StripePattern,
    Sweep,
)

# The hollow sphere opens towards the display; its rim is this far from its axis, where the normal leans by 24°.
RADIUS_MM, RIM_MM = 50.0, 20.0
N_GLASS, N_LIQUID, N_AIR = 1.5, 1.333, 1.0
CAMERA_MM = -600.0
DISPLAY_MM = (60.0, 120.0)
# Half of what the outermost pixel's light spans on the farther display, dry.
REACH_MM = 56.0
# Photos of fewer rows than this many times the object's radius in pixels would cut it.
ROOM = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class RunScene:
    """The session's manifest, the pixels of the object in the order of the photo, and their entry points and inner directions."""

    manifest: Manifest
    pixels: Int[np.ndarray, " pixels"]
    point_mm: Float64[np.ndarray, "pixels 3"]
    inner: Float64[np.ndarray, "pixels 3"]

    def place_px(self, capture_set: CaptureSet, axis: Axis) -> Float32[np.ndarray, " pixels"]:
        """Return where each pixel of the object looks, in device pixels along an axis."""
        display, pose = self.manifest.display, self.manifest.pose_of(capture_set)
        normal = (np.array([0.0, 0.0, RADIUS_MM]) - self.point_mm) / RADIUS_MM
        n_medium = N_LIQUID if capture_set.condition == "liquid" else N_AIR
        # Snell: what is across the normal goes with the indices, what is along it makes the direction a unit vector.
        across = N_GLASS / n_medium * (self.inner - (self.inner * normal).sum(axis=1, keepdims=True) * normal)
        outside = across + np.sqrt(1 - (across**2).sum(axis=1, keepdims=True)) * normal
        number = 0 if axis == "x" else 1
        distance = (pose.centre_mm[2] - self.point_mm[:, 2]) / outside[:, 2]
        count = display.columns if axis == "x" else display.rows
        place_mm = self.point_mm[:, number] + distance * outside[:, number]
        return (place_mm / display.pitch_mm + count / 2 - 0.5).astype(np.float32)


def run_scene(*, columns: int, photos: int, object_megapixels: float) -> RunScene:
    """Return a scene with ``photos`` stripes a sweep whose object has about so many pixels of the photo.

    Raises ``ReconError`` where the object is larger than the photo.
    """
    rows = round(columns * ASPECT)
    radius_px = math.sqrt(1e6 * object_megapixels / math.pi)
    if ROOM * radius_px > rows:
        raise ReconError(
            f"an object of {object_megapixels:g} megapixels was asked for, and a photo of {columns} x {rows} px holds one of "
            f"{math.pi * (rows / ROOM) ** 2 / 1e6:.2g}; ask for a smaller object or larger photos"
        )
    y, x = (RIM_MM / radius_px * (np.arange(size) - (size - 1) / 2) for size in (rows, columns))
    pixels = np.flatnonzero(np.hypot(x[None, :], y[:, None]) < RIM_MM)
    x, y = x[pixels % columns], y[pixels // columns]
    point_mm = np.stack([x, y, RADIUS_MM - np.sqrt(RADIUS_MM**2 - x**2 - y**2)], axis=1)
    # The glass is flat towards the camera: what comes from there is bent once.
    towards = point_mm - np.array([0.0, 0.0, CAMERA_MM])
    sideways = towards[:, :2] / np.linalg.norm(towards, axis=1, keepdims=True) / N_GLASS
    inner = np.concatenate([sideways, np.sqrt(1 - (sideways**2).sum(axis=1, keepdims=True))], axis=1)
    return RunScene(_manifest(columns, rows, photos), pixels, point_mm, inner)


def _manifest(columns: int, rows: int, photos: int) -> Manifest:
    pattern = StripePattern(profile="raised_cosine", width_px=STRIPE_WIDTH_PX, first_px=0.0, step_px=1.0, count=photos)
    sweeps = (Sweep(axis="x", pattern=pattern), Sweep(axis="y", pattern=pattern))

    def facing(z_mm: float) -> Pose:
        return Pose(centre_mm=(0, 0, z_mm), x_axis=(1, 0, 0), y_axis=(0, 1, 0))

    near, far = (facing(z_mm) for z_mm in DISPLAY_MM)
    return Manifest(
        schema_version=1,
        name="benchmark",
        created=now_text(),
        method="liquid",
        object=ScannedObject(name="hollow sphere", n=N_GLASS),
        n_air=N_AIR,
        liquid=Liquid(n=N_LIQUID),
        display=DisplayPanel(
            columns=photos, rows=photos, pitch_mm=2 * REACH_MM / (photos - 1 - 2 * UNSEEN_PHOTOS), continuous=True
        ),
        display_poses=(near, far),
        camera=CameraBody(columns=columns, rows=rows, pose=facing(CAMERA_MM)),
        sets=tuple(
            CaptureSet(position=position, condition=condition, sweeps=sweeps)
            for condition in ("air", "liquid")
            for position in (0, 1)
        ),
        provenance=Provenance(note="synthesised by recon bench run"),
    )


def radial_error_mm(point_mm: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, " points"]:
    """Return by how much points miss the hollow sphere."""
    return np.linalg.norm(point_mm - np.array([0.0, 0.0, RADIUS_MM]), axis=1) - RADIUS_MM
