"""How long one comparison of two reference photos takes at the paper's size of 3888 × 2592 pixels: JSON on standard output."""

import json
import time

import numpy as np

from recon.patterns.reference_frame import reference_levels
from recon.scene.scene_change import SceneLimits, SceneParts
from recon.scene.scene_check import SceneChecker

COLUMNS, ROWS = 3888, 2592
PARTS = SceneParts(
    object_px=((1000.0, 500.0), (2900.0, 500.0), (2900.0, 2100.0), (1000.0, 2100.0)),
    marks_px=((20.0, 20.0, 400.0, 400.0), (3480.0, 20.0, 3860.0, 400.0)),
)


def main() -> None:
    """Measure and print."""
    rng = np.random.default_rng(1)
    picture = reference_levels(columns=COLUMNS, rows=ROWS, finest_px=32.0).astype(np.float32)
    photos = [np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8) for _ in range(3)]
    checker = SceneChecker(PARTS, SceneLimits(0.05, 6.0, 0.02), rows=ROWS, columns=COLUMNS)
    checker.see("pos0_air", 0, photos[0], wet=False)
    begun_s = time.perf_counter()
    checker.see("pos0_air", 1, photos[1], wet=False)
    with_noise_s = time.perf_counter() - begun_s
    begun_s = time.perf_counter()
    found = checker.see("pos0_air", 2, photos[2], wet=False)
    assert found is not None
    seconds = time.perf_counter() - begun_s
    print(
        json.dumps(
            {
                "photo_px": [COLUMNS, ROWS],
                "first_comparison_s": round(with_noise_s, 2),
                "comparison_s": round(seconds, 2),
                "sd_px": {part: max(shift.sd_px) for part, shift in found.parts.items()},
            },
            indent=2,
        )
    )


if __name__ == "__main__":
    main()
