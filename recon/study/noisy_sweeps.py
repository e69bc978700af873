"""Correspondences as a perfect decoder would find them, with Gaussian noise of a known size: the paper's noise experiments."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from recon.errors import ReconError
from recon.evaluation.truth import Truth, load_truth
from recon.sessions.manifest import Manifest
from recon.sessions.session import MANIFEST_NAME, TRUTH_NAME
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel

PLACE = "place_px_"
AXES = ("x", "y")
NO_NOISE = NoiseModel(read_variance=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class TrueSession:
    """A simulated session without photos: its manifest, true points, and the true display place of each pixel in each set.

    ``place_px`` maps a set's name to device pixels (column, row), NaN where the pixel's centre sees nothing of the panel.
    """

    manifest: Manifest
    truth: Truth
    place_px: Mapping[str, Float64[np.ndarray, "rows cols 2"]]


def load_true_session(folder: Path) -> TrueSession:
    """Read what ``rig simulate --truth-only`` wrote; raises ``ReconError`` where it cannot be used."""
    manifest = Manifest.model_validate_json((folder / MANIFEST_NAME).read_text(encoding="utf-8"))
    truth = load_truth(folder / TRUTH_NAME)
    try:
        with np.load(folder / TRUTH_NAME) as arrays:
            places = {name.removeprefix(PLACE): arrays[name] for name in arrays.files if name.startswith(PLACE)}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise ReconError(f"{folder / TRUTH_NAME}: not a truth file ({error})") from None
    missing = [one.name for one in manifest.sets if one.name not in places]
    if missing:
        raise ReconError(
            f"{folder / TRUTH_NAME}: has no true places of {', '.join(missing)}; it was written by an older simulator"
        )
    return TrueSession(manifest, truth, places)


def noisy_sweeps(session: TrueSession, *, sd_px: float, rng: np.random.Generator) -> dict[tuple[str, str], SweepResult]:
    """Return all sweeps with independent Gaussian noise of ``sd_px`` device pixels on each coordinate, which they state."""
    sweeps = {}
    for one in session.manifest.sets:
        true_px = session.place_px[one.name]
        seen = np.isfinite(true_px).all(axis=2)
        status = np.where(seen, np.uint8(PixelStatus.OK), np.uint8(PixelStatus.UNLIT))
        for number, axis in enumerate(AXES):
            place_px = true_px[..., number] + rng.normal(0.0, sd_px, seen.shape)
            sweeps[one.name, axis] = SweepResult(
                place_px=np.where(seen, place_px, np.nan),
                sd_px=np.where(seen, sd_px, np.nan).astype(np.float32),
                status=status,
                noise=NO_NOISE,
                misfit=np.nan,
                photos=(),
                curves=(),
            )
    return sweeps
