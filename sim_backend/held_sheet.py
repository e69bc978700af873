"""What a hand holds before the camera: a printed sheet in the room's light, or the display, taken off its stage.

Light comes straight from it: neither liquid nor object is in the way, and what is behind it is dark.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from drivers.protocols import Frame
from sim_backend.footprint import image_light, light_of
from sim_backend.light_paths import ScreenMap, look
from sim_backend.optics.screen import ScreenPose, hit_screen
from sim_backend.scene import Scene, SceneCamera, SceneDisplay

Values = Float32[np.ndarray, "rows columns"]
Directions = Float64[np.ndarray, "rays 3"]
# A hand that does not keep still is seen at so many places while the shutter is open.
SWING_PLACES = 7


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """A printed picture: ``levels`` [rows, cols] uint8, white paper 255; the side of its pixels; the light of white paper.

    ``light`` is the share of full scale that white paper sends to the camera.
    """

    levels: UInt8[np.ndarray, "rows cols"]
    pitch_mm: float
    light: float = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class HeldSheet:
    """Where the hand holds it, in the scene's frame; ``printed`` is None for the display, which shows its frame.

    ``swing_mm`` is how far it moves along x, y and z while the shutter is open.
    """

    pose: ScreenPose
    printed: Print | None = None
    swing_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def key(self) -> tuple[object, ...]:
        """Return what tells this from any other, for the noise of its photos."""
        pose = self.pose
        picture = b"" if self.printed is None else self.printed.levels.tobytes()
        digest = hashlib.blake2b(picture, digest_size=16).hexdigest()
        return (*pose.centre_mm.tolist(), *pose.x_axis.tolist(), *pose.y_axis.tolist(), self.swing_mm, digest)


def straight_rays(camera: SceneCamera) -> Directions:
    """Return the directions in which a camera looks through evenly placed sub-rays of its pixels, row by row."""
    fold = camera.supersampling
    row, column = np.indices((camera.rows * fold, camera.columns * fold)).reshape(2, -1)
    return look(camera, (column + 0.5) / fold - 0.5, (row + 0.5) / fold - 0.5)


def sheet_light(scene: Scene, held: HeldSheet, frame: Frame, direction: Directions) -> Values:
    """Return the share of full scale that the sheet sends to each pixel, before the lens blurs it.

    ``direction`` is that of :func:`straight_rays`.
    """
    if held.printed is not None:
        picture, pitch_mm, glass = light_of(held.printed.levels, 1.0), held.printed.pitch_mm, None
        picture = picture * np.float32(held.printed.light)
    else:
        panel = scene.display
        picture, pitch_mm, glass = light_of(frame_levels(frame, panel), panel.gamma), panel.pitch_mm, panel.cover_glass
        picture = picture * np.float32(scene.camera.signal)
    still = held.swing_mm == (0.0, 0.0, 0.0)
    shares = [0.0] if still else np.linspace(-0.5, 0.5, SWING_PLACES).tolist()
    total = np.zeros((scene.camera.rows, scene.camera.columns), np.float32)
    for share in shares:
        pose = replace(held.pose, centre_mm=held.pose.centre_mm + share * np.array(held.swing_mm))
        places = _places(
            scene,
            pose,
            direction,
            picture.shape,
            pitch_mm=pitch_mm,
            glass=(glass.thickness_mm, glass.n) if glass else (0.0, 1.0),
        )
        total += image_light(places, picture, supersampling=scene.camera.supersampling)
    return total / np.float32(len(shares))


def frame_levels(frame: Frame, panel: SceneDisplay) -> UInt8[np.ndarray, "rows cols"]:
    """Return the drive level of every device pixel of a frame without patches."""
    if frame.image is not None:
        return frame.image
    if frame.levels is None:
        raise ValueError("a frame holds either levels along an axis or a whole image, and this one does not")
    across = frame.levels if frame.axis == "x" else frame.levels[:, None]
    return np.array(np.broadcast_to(across, (panel.rows, panel.columns)))


def _places(
    scene: Scene,
    pose: ScreenPose,
    direction: Directions,
    shape: tuple[int, ...],
    *,
    pitch_mm: float,
    glass: tuple[float, float],
) -> ScreenMap:
    """Return where every sub-ray of the camera meets the sheet, in its pixels."""
    camera = scene.camera
    fine = (camera.rows * camera.supersampling, camera.columns * camera.supersampling)
    origin = np.broadcast_to(np.array(camera.position_mm), direction.shape)
    n_air = np.full(len(direction), scene.n_air)
    hits = hit_screen(pose, origin, direction, n_air, glass_thickness_mm=glass[0], glass_n=glass[1])
    rows, columns = shape
    met = hits.transmission > 0
    column_px = np.where(met, hits.x_mm / pitch_mm + columns / 2 - 0.5, np.nan)
    row_px = np.where(met, hits.y_mm / pitch_mm + rows / 2 - 0.5, np.nan)
    kept = np.where(met, hits.transmission if scene.fresnel else 1.0, 0.0).astype(np.float32)
    return ScreenMap(column_px.reshape(fine), row_px.reshape(fine), kept.reshape(fine), np.zeros(fine, np.int64))
