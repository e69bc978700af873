"""The result on the camera grid: ``maps.npz``, one value a photo pixel, NaN where there is none."""

import zipfile
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from recon.errors import ReconError
from recon.status import PixelStatus

MAPS_NAME = "maps.npz"
NAMES = ("point_mm", "normal", "sd_mm", "gap_mm", "pbc_angle_rad", "status")
# Written only by methods that know them; older files lack them.
OPTIONAL_NAMES = ("normal_sd_rad", "across_sd_mm", "support", "path_count")
# Measured numbers hardly shrink, and what is empty does at any level: the quickest.
QUICK = 1


class Support(IntEnum):
    """What a pixel's point rests on."""

    NONE = 0
    OWN_CROSSING = 1
    NEIGHBOURS_ONLY = 2
    COVERED = 3


@dataclass(frozen=True, slots=True, eq=False)
class Maps:
    """Points and normals in the frame of the display poses; normals point into the liquid.

    ``sd_mm`` is the standard deviation of the point (root of the covariance's trace), ``gap_mm`` the distance by which the
    two light paths miss each other (signed), ``pbc_angle_rad`` the angle between them, ``status`` a
    :class:`~recon.status.PixelStatus`. Method ``full`` adds ``normal_sd_rad``, the root of the summed variances of the normal's
    two tilts, ``across_sd_mm``, the standard deviation of the point across the surface, ``support``, a :class:`Support`, and
    ``path_count``, by how many light paths the pixel sees the display.
    """

    point_mm: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    sd_mm: Float32[np.ndarray, "rows cols"]
    gap_mm: Float32[np.ndarray, "rows cols"]
    pbc_angle_rad: Float32[np.ndarray, "rows cols"]
    status: UInt8[np.ndarray, "rows cols"]
    normal_sd_rad: Float32[np.ndarray, "rows cols"] | None = None
    across_sd_mm: Float32[np.ndarray, "rows cols"] | None = None
    support: UInt8[np.ndarray, "rows cols"] | None = None
    path_count: UInt8[np.ndarray, "rows cols"] | None = None

    def valid(self) -> Bool[np.ndarray, "rows cols"]:
        """Return the pixels that have a point, and measured it themselves."""
        return self.status == PixelStatus.OK

    def with_point(self) -> Bool[np.ndarray, "rows cols"]:
        """Return the pixels that have a point: their own, or that of the surface about them."""
        return self.valid() | (self.status == PixelStatus.COVERED)


def save_maps(maps: Maps, path: Path) -> None:
    """Write ``maps.npz``, one array after the other, as ``numpy.savez_compressed`` would but for the level of compression."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=QUICK) as archive:
        for name in (*NAMES, *OPTIONAL_NAMES):
            values = getattr(maps, name)
            if values is not None:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, values, allow_pickle=False)


def load_maps(path: Path) -> Maps:
    """Read ``maps.npz``; raises ``ReconError`` with one sentence where it cannot be used."""
    try:
        with np.load(path) as arrays:
            optional = {name: arrays[name] for name in OPTIONAL_NAMES if name in arrays}
            return Maps(**{name: arrays[name] for name in NAMES}, **optional)
    except FileNotFoundError:
        raise ReconError(f"{path}: no such file; run `recon run` on the session first") from None
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ReconError(f"{path}: not the maps of a reconstruction ({error})") from None
