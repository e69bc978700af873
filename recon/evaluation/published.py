"""The published figures that ours stand beside.

Source: Han, Wong, Liu, "Dense Reconstruction of Transparent Objects by Altering Incident Light Paths Through
Refraction", International Journal of Computer Vision 126 (2018), the experiments with real objects: a glass hemisphere
(sphere), an ornament (planes) and a bottle (cylinder). Figures are a range where the paper has one a facet.
"""

from typing import Literal

Primitive = Literal["sphere", "planes", "cylinder"]

CITATION = "Han, Wong, Liu, IJCV 2018, real objects"
# Section "Real experiments": how far an inlier may be from a plane, and how many facets the ornament shows.
THRESHOLD_MM = 0.5
MOST_FACETS = 6

PUBLISHED: dict[Primitive, dict[str, tuple[float, float]]] = {
    "sphere": {
        "points": (1_115_748.0, 1_115_748.0),
        "radius": (26.95, 26.95),
        "known radius": (27.99, 27.99),
        "radius off by": (3.7, 3.7),
        "position error, mean": (0.5903, 0.5903),
        "position error, median": (0.4179, 0.4179),
        "normal error, mean": (6.97, 6.97),
        "normal error, median": (6.92, 6.92),
    },
    "planes": {
        "points": (519_162.0, 519_162.0),
        "facets": (6.0, 6.0),
        "inliers": (40.3, 49.0),
        "position error, mean": (0.59, 1.04),
        "position error, median": (0.51, 0.63),
        "normal error, mean": (3.7, 10.0),
        "normal error, median": (3.5, 9.8),
    },
    "cylinder": {
        "points": (471_874.0, 471_874.0),
        "radius": (15.32, 15.32),
        "known radius": (14.18, 14.18),
        "radius off by": (8.0, 8.0),  # from the two lines above
        "height": (46.26, 46.26),
        "known height": (44.73, 44.73),
        "height off by": (3.4, 3.4),  # from the two lines above
        "inliers": (41.17, 41.17),
        "position error, mean": (0.6356, 0.6356),
        "position error, median": (0.6278, 0.6278),
        "normal error, mean": (6.13, 6.13),
        "normal error, median": (5.92, 5.92),
    },
}
