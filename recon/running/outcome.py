"""From correspondences to maps, mesh and their statistics, by the session's method."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import UInt8

from recon.bands import side_by_side
from recon.batch.cores import usable_cores
from recon.calibration.calibration_file import read_calibration
from recon.calibration.session_calibration import calibration_path
from recon.checks.assumption_check import assumption_doubts
from recon.checks.shared_gaps import shared_gaps, with_gaps_of_area, with_shared_gaps
from recon.checks.wet_spots import spot_pixels
from recon.maps import Maps
from recon.media.liquid_index import (
    chosen_index,
    index_sentences,
    measured_index,
    with_index_uncertainty,
)
from recon.media.stated_index import provisional, stated_index, with_index
from recon.memory import give_back_free_memory
from recon.metrics import LiquidIndexRecord, RegistrationRecord, Statistic
from recon.reconstruct import cross_paths, maps_before_surface, maps_of, without_spots
from recon.registration.gap_fit import MotionCovariance
from recon.registration.known_slips import known_slips
from recon.registration.registration_stage import record_of, registration_of, with_carried
from recon.registration.session_slips import Registration, registered
from recon.running.map_statistics import map_statistics
from recon.running.object_part import ObjectPart
from recon.running.outcome_notes import camera_notes, covered_notes, drawn_mesh
from recon.running.settings import Settings
from recon.sessions.manifest import Manifest
from recon.sessions.photos import read_grey
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.surface.covering import COVERABLE
from recon.surface.mesh import Mesh
from recon.surface.own_paths import OwnPaths
from recon.surface.second_places import SecondPlaces
from recon.surface.surface_stage import surface_of
from recon.surface.thin_stage import thin_object
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.set_places import path_count
from recon.verdict import gap_ratio

PathCounts = UInt8[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What the stages made before anything is written; ``doubts``: the assumptions that the session contradicts."""

    maps: Maps
    mesh: Mesh | None
    gap_ratio: float | None
    statistics: tuple[Statistic, ...]
    warnings: tuple[str, ...]
    registration: RegistrationRecord | None = None
    liquid_index: LiquidIndexRecord | None = None
    doubts: tuple[str, ...] = ()


def read_mask(session: Session) -> np.ndarray | None:
    """Return the session's object mask [rows, cols] (non-zero is object), or None."""
    manifest = session.manifest
    if manifest.mask is None:
        return None
    counts = read_grey(session.folder / manifest.mask, rows=manifest.camera.rows, cols=manifest.camera.columns)
    return counts > 0


def reconstruct(
    session: Session,
    sweeps: Mapping[tuple[str, str], SweepResult],
    settings: Settings,
    *,
    known: MotionCovariance | None = None,
) -> Outcome:
    """Turn correspondences into maps and a mesh by the session's method.

    ``known`` is what the session's photos of a board leave unknown of the slips; without it, what its calibration does.
    """
    return reconstruct_taking(session, dict(sweeps), settings, known=known)


def reconstruct_taking(
    session: Session,
    sweeps: dict[tuple[str, str], SweepResult],
    settings: Settings,
    *,
    known: MotionCovariance | None = None,
) -> Outcome:
    """Reconstruct as :func:`reconstruct` does, and let the sweeps go as soon as their part with the object is cut out.

    ``sweeps`` may be empty afterwards: eight sweeps of a large photo take more memory than what is made of the object.
    """
    manifest = session.manifest
    mask = read_mask(session)
    if manifest.method == "thin":
        thin = thin_object(sweeps, manifest, method=settings.method, inside_mask=mask, integration=settings.integration)
        maps = _with_path_count(thin.maps, _path_count(sweeps, settings))
        mesh, doubt = drawn_mesh(thin.mesh)
        return Outcome(maps, mesh, None, map_statistics(maps, None), (*thin.warnings, *doubt))
    paths = _path_count(sweeps, settings)
    part = ObjectPart.of(sweeps, manifest, inside_mask=mask)
    sweeps.clear()
    give_back_free_memory()
    found = _reconstruct(session, part, settings, known=known)
    give_back_free_memory()
    on_photo = part.on_photo(found.maps, threads=settings.threads or usable_cores())
    return replace(found, maps=_with_path_count(on_photo, paths))


def _reconstruct(
    session: Session, part: ObjectPart, settings: Settings, *, known: MotionCovariance | None = None
) -> Outcome:
    """Reconstruct the part of the photo that holds the object."""
    sweeps, manifest, mask = part.sweeps, part.manifest, part.mask
    stated = stated_index(manifest)
    manifest = provisional(manifest)
    registration, manifest = _register(session, manifest, sweeps, settings, mask, known)
    threads = settings.threads or usable_cores()
    cross = partial(
        cross_paths, sweeps, method=settings.method, limits=settings.limits, inside_mask=mask, threads=threads
    )
    status, crossing = cross(manifest)
    index, spots = None, None
    if stated is None:
        index = chosen_index(None, measured_index(crossing, manifest))
        manifest = with_index(manifest, index.n)
        status, crossing = cross(manifest)
        crossing = with_index_uncertainty(crossing, manifest, sd=index.sd or 0.0)
    shape = (manifest.camera.rows, manifest.camera.columns)
    before = status.reshape(shape)
    look = partial(spot_pixels, sweeps, before, corner=part.corner) if settings.method == "full" else lambda: None
    if index is None:
        measured, spots = side_by_side(partial(measured_index, crossing, manifest), look, threads=threads)
        index = chosen_index(stated, measured)
    else:
        spots = look()
    if registration is not None:
        crossing = with_carried(crossing, registration, manifest)
    own, second, apart, shared, ratio = None, None, None, None, None
    if spots is not None:
        status, crossing = without_spots(status, crossing, spots)
        shared = shared_gaps(crossing, shape=shape)
        status, crossing = with_gaps_of_area(
            status, crossing, shared, manifest, sigma=settings.limits.gap_sigma, spots=spots
        )
        crossing = with_shared_gaps(crossing, shared, n_liquid=manifest.n_liquid(), n_air=manifest.n_air)
        apart = shared.area()
        own = OwnPaths.of(sweeps, manifest, np.flatnonzero(np.isin(status, COVERABLE)))
        second = SecondPlaces.of(sweeps, manifest)
        # Those that miss by too much count as well: left out, a session that is wrong would look sound.
        crossed = np.isin(crossing.status, (PixelStatus.OK, PixelStatus.GAP_TOO_LARGE))
        ratio = gap_ratio(crossing.points.gap_mm[crossed], crossing.points.gap_sd_mm[crossed])
        part.let_places_go()
        maps = maps_before_surface(status, crossing, shape=shape)
    else:
        maps = maps_of(status, crossing, shape=shape, method=settings.method)
    # What is not of the surface has been asked for the last time.
    crossing = crossing.on_surface()
    give_back_free_memory()
    surface = surface_of(
        maps,
        crossing,
        manifest,
        method=settings.method,
        own=own,
        second=second,
        apart=apart,
        threads=threads,
    )
    doubt: Callable[[], tuple[str, ...]] = tuple
    if shared is not None:
        doubt = partial(assumption_doubts, sweeps, crossing, surface.maps, before, shared, corner=part.corner)
    mesh, statistics, doubts = side_by_side(
        surface.mesh,
        partial(map_statistics, surface.maps, crossing),
        doubt,
        threads=threads,
    )
    told = registration.sentences(manifest.length_unit) if registration is not None else ()
    mesh, no_mesh = drawn_mesh(mesh)
    return Outcome(
        surface.maps,
        mesh,
        ratio,
        statistics,
        (
            *told,
            *index_sentences(index),
            *camera_notes(manifest),
            *surface.warnings,
            *covered_notes(surface.maps),
            *no_mesh,
        ),
        record_of(registration) if registration is not None else None,
        index,
        doubts,
    )


def _register(
    session: Session,
    manifest: Manifest,
    sweeps: dict[tuple[str, str], SweepResult],
    settings: Settings,
    mask: np.ndarray | None,
    known: MotionCovariance | None,
) -> tuple[Registration | None, Manifest]:
    """Measure how the display slipped, if that was asked for, and return the manifest with the poses to use."""
    if settings.method != "full" or not settings.registration:
        return None, manifest
    path = calibration_path(session, settings.calibration)
    if known is None and path is not None:
        known = known_slips(read_calibration(path))
    registration = registration_of(sweeps, manifest, known=known, inside_mask=mask)
    if registration is None:
        return None, manifest
    return registration, registered(manifest, registration.motions) if registration.applied else manifest


def _path_count(sweeps: Mapping[tuple[str, str], SweepResult], settings: Settings) -> PathCounts | None:
    """Return by how many paths each pixel sees the display, which only method ``full`` looks for."""
    return path_count(sweeps) if settings.method == "full" else None


def _with_path_count(maps: Maps, paths: PathCounts | None) -> Maps:
    return maps if paths is None else replace(maps, path_count=paths)
