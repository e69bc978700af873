"""How large gaps, standard deviations and angles of a run's maps are."""

import numpy as np

from recon.maps import Maps
from recon.metrics import Statistic
from recon.reconstruct import Crossing
from recon.status import PixelStatus
from recon.verdict import statistic


def map_statistics(maps: Maps, crossing: Crossing | None) -> tuple[Statistic, ...]:
    """Return the statistics of the pixels that have points, and of the normalised gaps where noise is known."""
    valid = maps.valid()
    found = [
        statistic(
            "gap", "mm", np.abs(maps.gap_mm[valid]), how="length of the shortest segment between the two light paths"
        ),
        statistic(
            "sd",
            "mm",
            maps.sd_mm[valid],
            how="root of the trace of each point's covariance, from the photos' own noise and the registration",
        ),
        statistic(
            "PBC angle",
            "deg",
            np.degrees(maps.pbc_angle_rad[valid]),
            how="angle between the paths in liquid and in air",
        ),
    ]
    if maps.normal_sd_rad is not None:
        found.append(
            statistic(
                "normal sd",
                "deg",
                np.degrees(maps.normal_sd_rad[valid]),
                how="root of the summed variances of the normal's two tilts, from the photos' own noise and the registration",
            )
        )
    if crossing is not None and np.isfinite(maps.sd_mm[valid]).any():
        fine = crossing.status == PixelStatus.OK
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = np.abs(crossing.points.gap_mm[fine]) / crossing.points.gap_sd_mm[fine]
        found.append(
            statistic(
                "normalised gap", "sd", normalised, how="gap over the sd that noise alone gives it; its rms is about 1"
            )
        )
    return tuple(one for one in found if one is not None)
