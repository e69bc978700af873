"""Follow rays through bodies of different index until they leave for good.

The world is air with bodies in it; where bodies overlap, the later one displaces the earlier. Liquid is therefore a
half-space, a piece of glass a body after it, and a hole in the glass a body of air after that. Each ray is followed
through every boundary where the index changes; beyond the critical angle it is reflected and followed on. Partial
reflections carry no ray of their own: they only take light from the transmitted one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sim_backend.optics.media import IndexVariation
from sim_backend.optics.refraction import facing, fresnel_transmission, refract
from sim_backend.optics.solids import Leaf, Solid, contains

Vectors = Float64[np.ndarray, "rays 3"]
Numbers = Float64[np.ndarray, " rays"]
Labels = Int64[np.ndarray, " rays"]

# Two boundaries closer than this along a ray are one: a face that lies in the liquid's level, or the point that the
# ray has just left. Rounding at 500 mm is 1e-13 mm, a grazing sphere makes it 1e-8 mm.
TOUCH_MM = 1e-7

AIR = 0

# A ray in glass of varying index is given up after this many steps.
MAX_STEPS = 20000


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A solid filled with one medium; ``of_object`` is false for the liquid, ``variation`` bends rays inside."""

    solid: Solid
    n: float
    of_object: bool = True
    variation: IndexVariation | None = None


@dataclass(frozen=True, slots=True, eq=False)
class OpticalWorld:
    """Air, and the bodies in it; medium 0 is the air, medium i + 1 fills ``bodies[i]``."""

    bodies: tuple[Body, ...]
    n_air: float = 1.0

    def indices(self) -> Float64[np.ndarray, " media"]:
        """Return the refractive index of each medium."""
        return np.array([self.n_air, *(body.n for body in self.bodies)], dtype=np.float64)

    def index_at(self, medium: Labels, points: Vectors) -> Numbers:
        """Return the index of the given media at the given places."""
        index = self.indices()[medium]
        for number, body in enumerate(self.bodies, start=1):
            if body.variation is not None:
                index = index + np.where(medium == number, body.variation.added(points), 0.0)
        return index

    def of_object(self) -> Bool[np.ndarray, " media"]:
        """Tell which media belong to the object."""
        return np.array([False, *(body.of_object for body in self.bodies)])

    def leaves(self) -> tuple[Leaf, ...]:
        """Return every surface, numbered as in :class:`Boundary`."""
        return tuple(leaf for body in self.bodies for leaf in body.solid.leaves())


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """The next change of medium on each ray: how far, which surface, what lies beyond (infinity: none)."""

    distance: Numbers
    surface: Labels
    medium: Labels


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Where rays went.

    ``origin``, ``direction``, ``n``: the last straight piece and the index it runs in. ``exit_point`` and
    ``exit_normal``: where the ray last left the object, the normal out of it (NaN for a ray that never touched it).
    ``transmission``: share of light kept. ``trapped``: still inside after all the boundaries that were allowed.
    ``route``: equal for rays that met the same surfaces in the same order. ``exits``: how often the ray left the object, more
    than once where it entered it again.
    """

    origin: Vectors
    direction: Vectors
    n: Numbers
    exit_point: Vectors
    exit_normal: Vectors
    transmission: Numbers
    trapped: Bool[np.ndarray, " rays"]
    route: Labels
    exits: Labels

    def touched_object(self) -> Bool[np.ndarray, " rays"]:
        """Tell which rays passed through the object and left it."""
        return np.isfinite(self.exit_point[:, 0])


def media_at(world: OpticalWorld, points: Vectors) -> Labels:
    """Return the medium that fills each point."""
    medium = np.full(len(points), AIR, np.int64)
    for number, body in enumerate(world.bodies, start=1):
        medium[contains(body.solid, points)] = number
    return medium


def next_boundary(world: OpticalWorld, origin: Vectors, direction: Vectors, medium: Labels) -> Boundary:
    """Find the first place ahead of each ray where the medium differs from the one it is in."""
    if not world.bodies:
        nothing = np.zeros(len(origin), np.int64)
        return Boundary(np.full(len(origin), np.inf), nothing, nothing)
    distances, surfaces, owners, starts = [], [], [], []
    offset = 0
    for number, body in enumerate(world.bodies):
        found = body.solid.crossings(origin, direction)
        distances.append(found.distance)
        surfaces.append(found.surface + offset)
        owners.append(np.full(found.distance.shape[1], number))
        starts.append(found.starts_inside)
        offset += len(body.solid.leaves())
    distance = np.concatenate(distances, axis=1)
    order = np.argsort(distance, axis=1, kind="stable")
    distance = np.take_along_axis(distance, order, 1)
    owner = np.concatenate(owners)[order]
    beyond = np.full(distance.shape, AIR, np.int64)
    for number, start in enumerate(starts):
        inside = start[:, None] ^ (np.cumsum(owner == number, axis=1) % 2 == 1)
        beyond[inside] = number + 1
    last_of_touching = np.ones(distance.shape, bool)
    with np.errstate(invalid="ignore"):
        last_of_touching[:, :-1] = distance[:, 1:] - distance[:, :-1] > TOUCH_MM
    ahead = last_of_touching & np.isfinite(distance) & (distance > TOUCH_MM) & (beyond != medium[:, None])
    column = np.argmax(ahead, axis=1)
    ray = np.arange(len(origin))
    place = order[ray, column]
    return Boundary(
        np.where(ahead[ray, column], distance[ray, column], np.inf),
        np.concatenate(surfaces, axis=1)[ray, place],
        beyond[ray, column],
    )


def normals_at(leaves: tuple[Leaf, ...], surface: Labels, points: Vectors) -> Vectors:
    """Return the gradient of each point's own surface."""
    if len(leaves) == 1:
        return leaves[0].gradient(points)
    normals = np.empty_like(points)
    for number, leaf in enumerate(leaves):
        mine = surface == number
        if mine.any():
            normals[mine] = leaf.gradient(points[mine])
    return normals


def bend_inside(world: OpticalWorld, origin: Vectors, direction: Vectors, medium: Labels) -> tuple[Vectors, Vectors]:
    """Follow rays through a medium of varying index until a straight line leads to its boundary.

    The ray equation d(n t)/ds = ∇n (Born and Wolf, 3.2.1), stepped by the midpoint rule: half a step straight, turn
    by the gradient there, half a step straight. The last step ends at its midpoint, already turned.
    """
    origin, direction = origin.copy(), direction.copy()
    for number, body in enumerate(world.bodies, start=1):
        if body.variation is None:
            continue
        active = np.flatnonzero(medium == number)
        for _ in range(MAX_STEPS):
            if not len(active):
                break
            here, along = origin[active], direction[active]
            room = next_boundary(world, here, along, medium[active]).distance
            step = np.minimum(room, body.variation.step_mm)
            middle = here + 0.5 * step[:, None] * along
            n_here = world.index_at(medium[active], here)
            turned = n_here[:, None] * along + step[:, None] * body.variation.gradient(middle)
            turned /= np.sqrt(np.einsum("ij,ij->i", turned, turned))[:, None]
            goes_on = room > body.variation.step_mm
            origin[active] = middle + np.where(goes_on, 0.5 * step, 0.0)[:, None] * turned
            direction[active] = turned
            active = active[goes_on]
    return origin, direction


def trace(world: OpticalWorld, origin: Vectors, direction: Vectors, *, max_boundaries: int = 16) -> Paths:
    """Follow each ray until nothing lies ahead of it.

    Parameters
    ----------
    origin, direction : start and unit direction of each ray, in the world's frame.
    max_boundaries : a ray that has met this many boundaries and still meets another is given up as trapped.
    """
    of_object, leaves = world.of_object(), world.leaves()
    bends = any(body.variation is not None for body in world.bodies)
    origin, direction = origin.copy(), direction.copy()
    medium = media_at(world, origin)
    exit_point, exit_normal = np.full_like(origin, np.nan), np.full_like(origin, np.nan)
    transmission = np.ones(len(origin))
    route, exits = np.zeros(len(origin), np.int64), np.zeros(len(origin), np.int64)
    active = np.arange(len(origin))
    for _ in range(max_boundaries):
        if bends:
            origin[active], direction[active] = bend_inside(world, origin[active], direction[active], medium[active])
        ahead = next_boundary(world, origin[active], direction[active], medium[active])
        meets = np.isfinite(ahead.distance)
        active = active[meets]
        if not len(active):
            break
        incoming, here, beyond = direction[active], medium[active], ahead.medium[meets]
        point = origin[active] + ahead.distance[meets, None] * incoming
        surface = ahead.surface[meets]
        normal = facing(incoming, normals_at(leaves, surface, point))
        n_here, n_beyond = world.index_at(here, point), world.index_at(beyond, point)
        outgoing, reflected = refract(incoming, normal, n_here, n_beyond)
        leaves_object = of_object[here] & ~of_object[beyond] & ~reflected
        exit_point[active[leaves_object]] = point[leaves_object]
        exit_normal[active[leaves_object]] = -normal[leaves_object]
        exits[active] += leaves_object
        kept = fresnel_transmission(-np.einsum("ij,ij->i", incoming, normal), n_here, n_beyond)
        transmission[active] *= np.where(reflected, 1.0, kept)
        route[active] = (route[active] * 61 + 2 * surface + reflected + 1) % (1 << 40)
        origin[active], direction[active] = point, outgoing
        medium[active] = np.where(reflected, here, beyond)
    trapped = np.zeros(len(origin), bool)
    trapped[active] = True
    n = world.indices()[medium]
    return Paths(origin, direction, n, exit_point, exit_normal, transmission, trapped, route, exits)
