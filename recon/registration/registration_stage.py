"""Registration as a stage of a run: from decoded sweeps to motions, and their uncertainty carried into points and normals."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from recon.geometry.entry_point import crossing_by_liquid
from recon.metrics import DisplayMotion, RegistrationRecord
from recon.reconstruct import Crossing
from recon.registration.gap_fit import MotionCovariance
from recon.registration.session_slips import (
    MeasuredPlaces,
    Registration,
    motion_shifts,
    register,
    sample_of,
    wet_poses,
)
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.set_places import combined_status, correspondences

# Pixels whose derivatives are held at once: 36 numbers each.
CHUNK_PIXELS = 100_000


def registration_of(
    sweeps: Mapping[tuple[str, str], SweepResult],
    manifest: Manifest,
    *,
    known: MotionCovariance | None = None,
    inside_mask: np.ndarray | None = None,
) -> Registration | None:
    """Measure from decoded sweeps how the display slipped between air and liquid.

    Pixels beside the object take part: where they look through the liquid's flat surface their two paths meet there.
    """
    matched = combined_status(sweeps, manifest.sets) == PixelStatus.OK
    if inside_mask is not None:
        matched &= inside_mask.ravel()
    pixels = np.flatnonzero(matched)
    pixels = pixels[sample_of(len(pixels))]
    by_name = {one.name: correspondences(sweeps, one, manifest, pixels) for one in manifest.sets}
    places = MeasuredPlaces(
        pixels,
        {name: one.screen_mm for name, one in by_name.items()},
        {name: one.sd_mm for name, one in by_name.items()},
    )
    return register(places, manifest, known=known)


def with_carried(crossing: Crossing, registration: Registration, manifest: Manifest) -> Crossing:
    """Return the crossings with the uncertainty of the registration in the variances that all pixels share.

    ``manifest`` has the poses in which the paths were crossed.
    """
    n_liquid = manifest.n_liquid()
    if not registration.covariance.any():
        return crossing
    carried_mm2, carried_rad2 = np.empty(len(crossing.pixels)), np.empty(len(crossing.pixels))
    poses = wet_poses(manifest)
    for start in range(0, len(crossing.pixels), CHUNK_PIXELS):
        part = slice(start, start + CHUNK_PIXELS)
        liquid, air, points = crossing.liquid.some(part), crossing.air.some(part), crossing.points.some(part)
        near, far = motion_shifts(liquid, poses)
        lever = (points.distance_liquid_mm / liquid.baseline_mm)[:, None, None]
        point = crossing_by_liquid(liquid, air, points) @ ((1 + lever) * near - lever * far)
        turn = (near - far) / liquid.baseline_mm[:, None, None]
        turn = turn - liquid.direction[:, :, None] * np.einsum("pi,pim->pm", liquid.direction, turn)[:, None]
        along = n_liquid * liquid.direction - manifest.n_air * air.direction
        normal = crossing.normal[part]
        tilt = n_liquid * (turn - normal[:, :, None] * np.einsum("pi,pim->pm", normal, turn)[:, None])
        tilt = tilt / np.linalg.norm(along, axis=1)[:, None, None]
        for derivative, out in ((point, carried_mm2), (tilt, carried_rad2)):
            out[part] = np.einsum("pim,mn,pin->p", derivative, registration.covariance, derivative, optimize=True)
    return replace(
        crossing,
        carried_mm2=crossing.carried_mm2 + carried_mm2,
        carried_rad2=crossing.carried_rad2 + carried_rad2,
    )


def record_of(registration: Registration) -> RegistrationRecord:
    """Return what ``metrics.json`` tells of a registration: the motions measured, whether they were taken over or not."""
    fit = registration.fit
    sd = np.sqrt(np.diag(fit.covariance))
    motions = [
        DisplayMotion(
            position=position,  # type: ignore[arg-type]  # 0 or 1
            x_mm=fit.motions[first],
            x_sd_mm=sd[first],
            y_mm=fit.motions[first + 1],
            y_sd_mm=sd[first + 1],
            turn_deg=np.degrees(fit.motions[first + 2]),
            turn_sd_deg=np.degrees(sd[first + 2]),
        )
        for position, first in ((0, 0), (1, 3))
    ]
    return RegistrationRecord(
        applied=registration.applied,
        sigma=registration.sigma,
        conflict_sigma=registration.conflict_sigma,
        directions=fit.directions.shape[1],
        gap_before=fit.gap_before,
        gap_after=fit.gap_after,
        motions=(motions[0], motions[1]),
    )
