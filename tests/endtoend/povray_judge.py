"""The judge of tests/data/povray-semi-ellipsoid/README.md; run on result folders it prints one line each.

python tests/endtoend/povray_judge.py RUN...
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.maps import Maps, load_maps

DATA = Path(__file__).parents[1] / "data" / "povray-semi-ellipsoid"
SEMI_AXES = np.array([12.5, 12.5, 5.0])


@dataclass(frozen=True, slots=True)
class Judgement:
    """The figures of the README's judge, in scene units and degrees."""

    complete: float
    false_points: int
    distance_rms: float
    distance_median: float
    point_rms: float
    point_median: float
    normal_rms_deg: float
    normal_median_deg: float


def judge(maps: Maps) -> Judgement:
    truth = np.load(DATA / "truth.npz")
    judged = truth["judged"]
    found = maps.valid() & judged
    point, normal = maps.point_mm[found], maps.normal[found]
    level = ((point / SEMI_AXES) ** 2).sum(1) - 1
    gradient = 2 * np.linalg.norm(point / SEMI_AXES**2, axis=1)
    distance = level / gradient
    error = np.linalg.norm(point - truth["point"][found], axis=1)
    cosine = (normal * truth["normal"][found]).sum(1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return Judgement(
        complete=float(found.sum() / judged.sum()),
        false_points=int((maps.valid() & ~truth["lit_in_all_sets"]).sum()),
        distance_rms=float(np.sqrt((distance**2).mean())),
        distance_median=float(np.median(np.abs(distance))),
        point_rms=float(np.sqrt((error**2).mean())),
        point_median=float(np.median(error)),
        normal_rms_deg=float(np.sqrt((angle**2).mean())),
        normal_median_deg=float(np.median(angle)),
    )


def main() -> None:
    """Judge every result folder named on the command line."""
    for name in sys.argv[1:]:
        result = judge(load_maps(Path(name) / "maps.npz"))
        print(
            f"{name}: complete {result.complete:.4f}, false {result.false_points}, "
            f"distance rms {result.distance_rms:.4f} median {result.distance_median:.4f}, "
            f"point rms {result.point_rms:.4f} median {result.point_median:.4f}, "
            f"normal rms {result.normal_rms_deg:.3f} median {result.normal_median_deg:.4f} deg"
        )


if __name__ == "__main__":
    main()
