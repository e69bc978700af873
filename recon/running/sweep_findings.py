"""What a run's numbers tell of its sweeps, gathered before their places are let go."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from recon.metrics import DoubtfulRange, PhotoQuality, SampleCurve
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.doubtful_ranges import doubtful_ranges


@dataclass(frozen=True, slots=True, eq=False)
class SweepFindings:
    """How many pixels are lit in any sweep and have a place in all, all photos, curves by sweep, and noise by name."""

    lit: int
    matched: int
    photos: tuple[PhotoQuality, ...]
    doubtful_ranges: tuple[DoubtfulRange, ...]
    curves: tuple[tuple[SampleCurve, ...], ...]
    noise: dict[str, dict[str, object]]


def sweep_findings(sweeps: Mapping[tuple[str, str], SweepResult], manifest: Manifest) -> SweepFindings:
    """Gather them from the decoded sweeps of a session."""
    results = list(sweeps.values())
    lit, matched = results[0].status != PixelStatus.UNLIT, results[0].known()
    for one in results[1:]:
        lit |= one.status != PixelStatus.UNLIT
        matched &= one.known()
    return SweepFindings(
        lit=int(np.count_nonzero(lit)),
        matched=int(np.count_nonzero(matched)),
        photos=tuple(photo for one in results for photo in one.photos),
        doubtful_ranges=_doubtful_ranges(sweeps, manifest),
        curves=tuple(one.curves for one in results),
        noise={
            f"noise_{name}_{axis}": {**asdict(one.noise), "misfit": None if np.isnan(one.misfit) else one.misfit}
            for (name, axis), one in sweeps.items()
        },
    )


def _doubtful_ranges(sweeps: Mapping[tuple[str, str], SweepResult], manifest: Manifest) -> tuple[DoubtfulRange, ...]:
    found: list[DoubtfulRange] = []
    for each in manifest.sets:
        for sweep in each.sweeps:
            device_px = manifest.display.columns if sweep.axis == "x" else manifest.display.rows
            result = sweeps[each.name, sweep.axis]
            found += doubtful_ranges(result, sweep.pattern, set_name=each.name, axis=sweep.axis, device_px=device_px)
    return tuple(found)
