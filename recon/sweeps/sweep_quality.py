"""How good a decoded sweep is, in a handful of numbers that can be read while the capture goes on."""

from dataclasses import dataclass

import numpy as np

from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult

# The incidence that a prediction is made for: half-way between face on, where nothing is bent, and grazing.
# Water, where the manifest leaves the index to the session.
TYPICAL_N_LIQUID = 1.333
TYPICAL_INCIDENCE_RAD = np.radians(30.0)


@dataclass(frozen=True, slots=True)
class SweepQuality:
    """The quality of one sweep; a number that cannot be formed is NaN.

    ``coverage`` is the share of lit pixels that have a place; ``saturated_share`` the clipped samples over the lit pixels, no
    less than the share of pixels that are clipped; ``contrast`` the median (max − min) / (max + min) of the sample curves;
    ``misfit`` the median χ² over degrees of freedom; ``sd_px`` the median standard deviation of a place in device pixels;
    ``dark_gap`` the longest run of photos without a stripe between two photos with one.
    """

    set: str
    axis: str
    photos: int
    lit_pixels: int
    coverage: float
    saturated_share: float
    contrast: float
    misfit: float
    sd_px: float
    dark_gap: int


def sweep_quality(result: SweepResult, *, set_name: str, axis: str) -> SweepQuality:
    """Sum up a decoded sweep."""
    lit = int(np.count_nonzero(result.status != PixelStatus.UNLIT))
    fine = result.known()
    clipped = sum(photo.saturated_share for photo in result.photos) * result.status.size
    curves = [np.array(curve.intensity) for curve in result.curves if curve.intensity]
    contrasts = [
        float((curve.max() - curve.min()) / (curve.max() + curve.min())) for curve in curves if curve.max() > 0
    ]
    return SweepQuality(
        set=set_name,
        axis=axis,
        photos=len(result.photos),
        lit_pixels=lit,
        coverage=float(fine.sum() / lit) if lit else float("nan"),
        saturated_share=min(clipped / lit, 1.0) if lit else float("nan"),
        contrast=float(np.median(contrasts)) if contrasts else float("nan"),
        misfit=result.misfit,
        sd_px=float(np.median(result.sd_px[fine])) if fine.any() else float("nan"),
        dark_gap=_dark_gap(np.array([photo.brightest for photo in result.photos])),
    )


def _dark_gap(brightest: np.ndarray) -> int:
    """Return the longest run of dark photos between two lit ones; dark is below a quarter of the brightest photo."""
    bright = np.flatnonzero(brightest > brightest.max() / 4)
    return int(np.diff(bright).max() - 1) if len(bright) > 1 else 0


def predicted_entry_sd_mm(sd_px: float, manifest: Manifest, *, object_distance_mm: float) -> float:
    """Predict the standard deviation of an entry point from that of one set's places, before the other sets exist.

    Parameters
    ----------
    sd_px
        Standard deviation of a place on the display along one axis, device pixels; taken as that of all four sets.
    manifest
        Gives pixel pitch, display poses and indices.
    object_distance_mm
        From the nearer display position to the object's wet side.

    Returns
    -------
    float
        Root of the trace of the point's covariance in mm; NaN without a liquid, whose paths cross nothing.

    Notes
    -----
    With σ the place's sd in mm, λ = object distance / distance of the display positions, and Δθ the angle between the
    paths in air and in liquid, a path's place at the object has variance σ²[(1+λ)² + λ²] in each direction across it. Its
    part in the plane of the two paths moves the crossing along the other path by 1/sin Δθ, and half of its part across
    that plane counts (``entry_point``), so that the trace is ``σ²[(1+λ)² + λ²](2/sin²Δθ + ½)``. Δθ follows from Snell's
    law for an incidence of 30° in air.
    """
    if manifest.liquid is None:
        return float("nan")
    n_liquid = manifest.liquid.n or TYPICAL_N_LIQUID
    first, second = (np.array(pose.centre_mm) for pose in manifest.display_poses)
    lever = object_distance_mm / float(np.linalg.norm(second - first))
    bent = np.arcsin(min(manifest.n_air / n_liquid * np.sin(TYPICAL_INCIDENCE_RAD), 1.0))
    sine = np.sin(TYPICAL_INCIDENCE_RAD - bent)
    variance = (sd_px * manifest.display.pitch_mm) ** 2 * ((1 + lever) ** 2 + lever**2)
    return float(np.sqrt(variance * (2 / sine**2 + 0.5))) if sine != 0 else float("inf")
