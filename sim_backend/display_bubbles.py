"""Bubbles that sit on the display's glass under the liquid: light passes them last, wherever the stage has carried them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from sim_backend.light_paths import SubRays
from sim_backend.optics.shapes import half_space, sphere
from sim_backend.optics.solids import Quadric
from sim_backend.optics.tracer import Body, OpticalWorld, trace
from sim_backend.scene import Scene

EVERYWHERE = half_space((0.0, 0.0, -1e6), (0.0, 0.0, -1.0))


def display_bubbles(scene: Scene, stage_position_mm: float) -> tuple[Quadric, ...]:
    """Return the balls of air that touch the display's glass when the stage is at this position."""
    if scene.when_filled is None:
        return ()
    pose, glass = scene.display_pose_at(stage_position_mm), scene.display.cover_glass
    towards_camera = -pose.away()
    front = pose.centre_mm + (glass.thickness_mm if glass else 0.0) * towards_camera
    return tuple(
        sphere(front + x * pose.x_axis + y * pose.y_axis + radius * towards_camera, radius)
        for x, y, radius in scene.when_filled.display_bubbles_mm
    )


def through_display_bubbles(scene: Scene, rays: SubRays, stage_position_mm: float) -> SubRays:
    """Follow the last pieces of wet paths through the bubbles on the display, where they meet one."""
    bubbles = display_bubbles(scene, stage_position_mm)
    if not bubbles:
        return rays
    wet = (rays.transmission > 0) & (rays.n != scene.n_air)
    met = np.flatnonzero(wet & _meets_any(bubbles, rays))
    out = replace(
        rays,
        origin=rays.origin.copy(),
        direction=rays.direction.copy(),
        transmission=rays.transmission.copy(),
        route=rays.route.copy(),
    )
    for n in np.unique(rays.n[met]):
        mine = met[rays.n[met] == n]
        # A path's last piece runs in liquid as far as the display: to it the liquid has no end.
        bodies = (
            Body(EVERYWHERE, float(n), of_object=False),
            *(Body(one, scene.n_air, of_object=False) for one in bubbles),
        )
        found = trace(OpticalWorld(bodies, scene.n_air), rays.origin[mine], rays.direction[mine])
        out.origin[mine], out.direction[mine] = found.origin, found.direction
        kept = found.transmission if scene.fresnel else np.ones(len(mine))
        out.transmission[mine] *= np.where(found.trapped, 0.0, kept).astype(np.float32)
        # Below nought: no footprint reaches from a path through a bubble to one beside it.
        out.route[mine] = -1 - (rays.route[mine] * 61 + found.route) % (1 << 40)
    return out


def _meets_any(bubbles: tuple[Quadric, ...], rays: SubRays) -> Bool[np.ndarray, " rays"]:
    """Tell which rays have a bubble ahead of them."""
    met = np.zeros(len(rays.origin), bool)
    for bubble in bubbles:
        found = bubble.crossings(rays.origin, rays.direction).distance
        met |= np.isfinite(found[:, -1]) & (found[:, -1] > 0)
    return met
