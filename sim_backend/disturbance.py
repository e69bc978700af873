"""What is not as the scene says: a pushed object, a display that slipped, dimmed light, ripples; all of them light paths.

Nothing here touches a finished photo: displays and cameras are placed elsewhere, rays are traced again or bent again at
the liquid's surface, and the sensor makes its photo of what arrives.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from sim_backend.light_paths import SubRays
from sim_backend.optics.refraction import facing, refract
from sim_backend.scene import Scene

# Three waves of a tank that was just filled: length, direction of travel and phase.
WAVE_LENGTHS_MM = np.array([71.0, 43.0, 27.0])
WAVE_DIRECTIONS = np.array([[1.0, 0.0], [-0.6, 0.8], [0.28, -0.96]])
WAVE_PHASES_RAD = np.array([0.4, 2.1, 4.4])
GRAVITY_MM_PER_S2 = 9810.0
# Surface tension over density of water at 20 °C, 0.0728 N/m over 998 kg/m³.
TENSION_MM3_PER_S2 = 72900.0

# The route of a ray that met the liquid's surface and nothing else (see sim_backend.optics.tracer: surface 0, refracted).
ROUTE_THROUGH_SURFACE = 1


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What differs from the scene at the moment of one photo; the default is that nothing does.

    ``object_shift_mm`` (x, y) moves the object in its holder's plane, and with it marks that are printed on the holder;
    ``camera_shift_mm`` is in the scene's frame, ``display_shift_mm`` along the panel's own x and y. ``light`` is the display's
    brightness as a share of what it was. ``ripple_slope`` is the largest slope of the liquid's surface, and ``ripple_time_s``
    how long its waves have been running. ``exposure`` numbers photos whose noise is to differ although all else is equal.
    """

    object_shift_mm: tuple[float, float] = (0.0, 0.0)
    camera_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    display_shift_mm: tuple[float, float] = (0.0, 0.0)
    light: float = 1.0
    ripple_slope: float = 0.0
    ripple_time_s: float = 0.0
    exposure: int = 0

    def of_paths(self) -> "Disturbance":
        """Return the part that changes where light goes, without brightness and noise."""
        return replace(self, light=1.0, exposure=0)

    def before_the_surface(self) -> "Disturbance":
        """Return the part for which rays must be traced again."""
        return Disturbance(object_shift_mm=self.object_shift_mm, camera_shift_mm=self.camera_shift_mm)


QUIET = Disturbance()


def disturbed_scene(scene: Scene, disturbance: Disturbance) -> Scene:
    """Return the scene with camera and display where the disturbance has put them."""
    if disturbance == QUIET:
        return scene
    camera, panel = scene.camera, scene.display
    position = np.array(camera.position_mm) + disturbance.camera_shift_mm
    across, down = disturbance.display_shift_mm
    centre = np.array(panel.centre_mm) + across * np.array(panel.x_axis) + down * np.array(panel.y_axis)
    return scene.model_copy(
        update={
            "camera": camera.model_copy(update={"position_mm": tuple(map(float, position))}),
            "display": panel.model_copy(update={"centre_mm": tuple(map(float, centre))}),
        }
    )


def surface_slope(
    x_mm: Float64[np.ndarray, " rays"], y_mm: Float64[np.ndarray, " rays"], *, slope: float, time_s: float
) -> Float64[np.ndarray, "rays 2"]:
    """Return dz/dx and dz/dy of three travelling waves whose slopes add up to ``slope`` at most.

    Deep-water gravity and capillary waves: ω² = g k + (σ/ρ) k³ (Lamb, *Hydrodynamics*, § 267).
    """
    wave_number = 2 * np.pi / WAVE_LENGTHS_MM
    frequency = np.sqrt(GRAVITY_MM_PER_S2 * wave_number + TENSION_MM3_PER_S2 * wave_number**3)
    along = x_mm[:, None] * WAVE_DIRECTIONS[:, 0] + y_mm[:, None] * WAVE_DIRECTIONS[:, 1]
    each = slope / len(WAVE_LENGTHS_MM) * np.cos(wave_number * along - frequency * time_s + WAVE_PHASES_RAD)
    return each @ WAVE_DIRECTIONS


def rippled(rays: SubRays, disturbance: Disturbance, *, camera_mm: np.ndarray, n_air: float) -> SubRays:
    """Bend the rays that came straight through the liquid's surface again, at the slope that it has where they met it.

    The waves' height is left out: at a slope of 0.01 and a length of 70 mm it is 0.1 mm, and moves a ray by a hundredth of
    what the slope does.
    """
    direct = rays.route == ROUTE_THROUGH_SURFACE
    if disturbance.ripple_slope == 0 or not direct.any():
        return rays
    met = rays.origin[direct]
    incoming = met - camera_mm
    incoming /= np.linalg.norm(incoming, axis=1)[:, None]
    slopes = surface_slope(met[:, 0], met[:, 1], slope=disturbance.ripple_slope, time_s=disturbance.ripple_time_s)
    normal = facing(incoming, np.column_stack([slopes, np.full(len(met), -1.0)]))
    bent, _ = refract(incoming, normal, np.full(len(met), n_air), rays.n[direct])
    direction = rays.direction.copy()
    direction[direct] = bent
    return replace(rays, direction=direction)
