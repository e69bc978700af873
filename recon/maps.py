"""The result on the camera grid: ``maps.npz``, one value a photo pixel, NaN where there is none."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from recon.errors import ReconError
from recon.status import PixelStatus

MAPS_NAME = "maps.npz"
NAMES = ("point_mm", "normal", "sd_mm", "gap_mm", "pbc_angle_rad", "status")


@dataclass(frozen=True, slots=True, eq=False)
class Maps:
    """Points and normals in the frame of the display poses; normals point into the liquid.

    ``sd_mm`` is the standard deviation of the point (root of the covariance's trace), ``gap_mm`` the distance by which the
    two light paths miss each other (signed), ``pbc_angle_rad`` the angle between them, ``status`` a
    :class:`~recon.status.PixelStatus`.
    """

    point_mm: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    sd_mm: Float32[np.ndarray, "rows cols"]
    gap_mm: Float32[np.ndarray, "rows cols"]
    pbc_angle_rad: Float32[np.ndarray, "rows cols"]
    status: UInt8[np.ndarray, "rows cols"]

    def valid(self) -> Bool[np.ndarray, "rows cols"]:
        """Return the pixels that have a point."""
        return self.status == PixelStatus.OK


def save_maps(maps: Maps, path: Path) -> None:
    """Write ``maps.npz``."""
    np.savez_compressed(path, **{name: getattr(maps, name) for name in NAMES})


def load_maps(path: Path) -> Maps:
    """Read ``maps.npz``; raises ``ReconError`` with one sentence where it cannot be used."""
    try:
        with np.load(path) as arrays:
            return Maps(**{name: arrays[name] for name in NAMES})
    except FileNotFoundError:
        raise ReconError(f"{path}: no such file; run `recon run` on the session first") from None
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ReconError(f"{path}: not the maps of a reconstruction ({error})") from None
