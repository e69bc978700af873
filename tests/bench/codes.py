"""What a code with fewer photos costs in precision: ``python -m tests.bench.codes`` prints JSON.

Places: every pixel's footprint on the display is a Gaussian, integrated in closed form over device pixels; white stands 200
counts above black and every count has noise of a fiftieth of that. The photos are losslessly kept and decoded as ``recon run``
does. Points: the simulated hemisphere, photographed with each code and reconstructed; ``--columns`` of the photos,
``--display-columns`` of the display.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from scipy.special import erf

from drivers.protocols import Frame
from recon.patterns.pattern_frames import pattern_frame
from recon.patterns.phase_shift import periods_for
from recon.run import decode_session
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.disk import Disk
from recon.sessions.manifest import Manifest
from recon.sessions.pattern import GrayLinePattern, Pattern, PhaseShiftPattern, StripePattern
from recon.sessions.photos import decode_grey
from recon.sessions.session import TRUTH_NAME, SessionWriter, open_session
from recon.status import PixelStatus
from recon.sweeps.decode_pattern import decode_pattern
from recon.sweeps.phase_shift import PhaseTracker, unwrapped
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session
from sim_backend.photography import Photographer
from sim_backend.sensor import jpeg_bytes

DEVICE_PX, ROWS, COLS = 1024, 30, 40
BLACK, WHITE = 10.0, 210.0
NOISE = (WHITE - BLACK) / 50
LEAST_AMPLITUDE = 20.0
FOOTPRINTS_PX = (0.2, 0.6, 1.5, 3.0)
PATTERNS: dict[str, Pattern] = {
    "sweep, one pixel wide": StripePattern(profile="hard", width_px=1.0, first_px=0.0, step_px=1.0, count=DEVICE_PX),
    "sweep, smooth, 4 wide": StripePattern(
        profile="raised_cosine", width_px=4.0, first_px=0.0, step_px=1.0, count=DEVICE_PX
    ),
    "gray_line, smooth, 4 wide": GrayLinePattern(
        kind="gray_line",
        profile="raised_cosine",
        width_px=4.0,
        first_px=0.0,
        step_px=1.0,
        period_px=16.0,
        places=DEVICE_PX,
    ),
    "gray_line, sharp, 4 wide": GrayLinePattern(
        kind="gray_line", profile="hard", width_px=4.0, first_px=0.0, step_px=1.0, period_px=16.0, places=DEVICE_PX
    ),
    "phase_shift, 3 × 8": PhaseShiftPattern(
        kind="phase_shift",
        periods_px=periods_for(float(DEVICE_PX), finest_px=16.0, frequencies=3),
        steps=8,
        first_px=0.0,
        last_px=DEVICE_PX - 1.0,
    ),
}
# Options of the scene, by the name of the code; the sweeps are those of the paper and of the same line.
CAPTURES: dict[str, dict[str, object]] = {
    "sweep, one pixel wide": {"profile": "hard", "width_px": 1.0, "step_px": 1.0},
    "sweep, smooth, 4 wide": {"profile": "raised_cosine", "width_px": 4.0, "step_px": 1.0},
    "gray_line, smooth, 4 wide": {"code": "gray_line", "profile": "raised_cosine"},
    "gray_line, sharp, 4 wide": {"code": "gray_line", "profile": "hard"},
    "phase_shift, 3 × 8": {"code": "phase_shift"},
}


def place_map(footprint_px: float) -> np.ndarray:
    """Return where the pixels look: two boxes as wide as this map's slopes have the variance of the footprint."""
    slope_px = np.sqrt(6) * footprint_px
    row, col = np.mgrid[:ROWS, :COLS].astype(np.float64)
    return DEVICE_PX / 2 + slope_px * ((col - COLS / 2) + 0.97 * (row - ROWS / 2)) + 0.31


def manifest_of(pattern: Pattern) -> Manifest:
    """Return the manifest of a session whose sweeps all have this pattern."""
    axes = {"x_axis": [1, 0, 0], "y_axis": [0, 1, 0]}
    sweeps = [{"axis": axis, "pattern": pattern.model_dump()} for axis in ("x", "y")]
    return Manifest.model_validate(
        {
            "schema_version": 1,
            "name": "codes",
            "created": "",
            "method": "liquid",
            "object": {"name": "none"},
            "liquid": {"n": 1.33},
            "display": {"columns": DEVICE_PX, "rows": DEVICE_PX, "pitch_mm": 0.1},
            "display_poses": [{"centre_mm": [0, 0, z], **axes} for z in (10, 20)],
            "camera": {"columns": COLS, "rows": ROWS},
            "sets": [
                {"position": position, "condition": condition, "sweeps": sweeps}
                for condition in ("air", "liquid")
                for position in (0, 1)
            ],
        }
    )


def photos_of(pattern: Pattern, place_px: np.ndarray, footprint_px: float, *, seed: int) -> Iterator[np.ndarray]:
    """Yield the photos of one sweep, then that of the dark display."""
    edges = np.arange(DEVICE_PX + 1) - 0.5
    below = 0.5 * (1 + erf((edges - place_px.reshape(-1, 1)) / (np.sqrt(2) * footprint_px)))
    share = np.diff(below, axis=1)
    rng = np.random.default_rng(seed)
    for index in range(pattern.count + 1):
        light = np.zeros(place_px.size)
        if index < pattern.count:
            light = share @ (pattern_frame(pattern, "x", index, device_px=DEVICE_PX).levels / 255.0)
        counts = BLACK + (WHITE - BLACK) * light + NOISE * rng.standard_normal(light.shape)
        yield np.rint(np.clip(counts, 0, 255)).astype(np.uint8).reshape(place_px.shape)


def measure_places(pattern: Pattern, footprint_px: float) -> dict[str, float]:
    """Decode one simulated sweep and compare its places with the true ones."""
    true_px = place_map(footprint_px)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with SessionWriter.create(folder / "s", manifest_of(pattern), disk=Disk(durable=False)) as writer:
            for index, photo in enumerate(photos_of(pattern, true_px, footprint_px, seed=1)):
                sweep, number = ("x", index) if index < pattern.count else ("black", 0)
                data = cv2.imencode(".png", photo)[1].tobytes()
                writer.save_photo(data, set_name="pos0_air", sweep=sweep, index=number, suffix=".png")
        session = open_session(folder / "s")
        result = decode_pattern(session, session.manifest.set_named("pos0_air"), "x", method="full")
    fine = result.status == PixelStatus.OK
    error_px = result.place_px[fine] - true_px[fine]
    return {
        "rms_px": rounded(np.sqrt(np.mean(error_px**2))),
        "largest_px": rounded(np.abs(error_px).max()),
        "rms_over_sd": rounded(np.sqrt(np.mean((error_px / result.sd_px[fine]) ** 2))),
        "decoded_share": rounded(fine.mean()),
    }


def measure_points(options: dict[str, object], *, columns: int, display_columns: int) -> dict[str, float]:
    """Photograph and reconstruct the hemisphere with one code, and compare its points with the true ones."""
    wanted = SceneOptions(camera_columns=columns, display_columns=display_columns, **options)
    scene = open_scene("hemisphere", wanted)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "s"
        photos = simulate_session(scene, config_of_scene(scene, wanted), folder, workers=2, console=Console(quiet=True))
        session = open_session(folder)
        maps = reconstruct(session, decode_session(session, Settings()), Settings()).maps
        with np.load(folder / TRUTH_NAME) as truth:
            true_mm, true_normal = truth["point_mm"], truth["normal"]
    on_object = np.isfinite(true_mm).all(axis=2)
    fine = maps.valid() & on_object
    error_mm = np.linalg.norm(maps.point_mm[fine] - true_mm[fine], axis=1)
    cosine = np.clip(np.sum(maps.normal[fine] * true_normal[fine], axis=1), -1, 1)
    return {
        "photos": photos,
        "complete": rounded(fine.sum() / on_object.sum()),
        "median_mm": rounded(np.median(error_mm)),
        "rms_mm": rounded(np.sqrt(np.mean(error_mm**2))),
        "p95_mm": rounded(np.quantile(error_mm, 0.95)),
        "share_beyond_tenth_mm": rounded(np.mean(error_mm > 0.1)),
        "normal_median_deg": rounded(np.degrees(np.median(np.arccos(cosine)))),
    }


def measure_compression(*, columns: int, display_columns: int) -> dict[str, float]:
    """Compare fringes of the hemisphere rounded to whole counts with the same in JPEG: median error of the places."""
    wanted = SceneOptions(camera_columns=columns, display_columns=display_columns, code="phase_shift")
    scene = open_scene("hemisphere", wanted)
    photographer, pattern = Photographer(scene), config_of_scene(scene, wanted).pattern("x")
    assert isinstance(pattern, PhaseShiftPattern)
    view = {"stage_position_mm": scene.stage_positions_mm[0], "wet": False}
    true_px = photographer.pixel_coordinates(**view)[..., 0].ravel()
    trackers = {"whole counts": PhaseTracker(true_px.size, pattern), "JPEG": PhaseTracker(true_px.size, pattern)}
    for index in range(pattern.count):
        levels = pattern_frame(pattern, "x", index, device_px=scene.display.columns).levels
        counts = np.rint(photographer.expected(Frame(axis="x", levels=levels), **view)).astype(np.uint8)
        packed = decode_grey(jpeg_bytes(counts, quality=scene.camera.jpeg_quality), Path("fringes.jpg"))
        trackers["whole counts"].feed(counts.ravel().astype(np.float64))
        trackers["JPEG"].feed(packed.ravel().astype(np.float64))
    found = {}
    for name, tracker in trackers.items():
        phases = tracker.finish()
        places = unwrapped(phases.turns, np.full(phases.turns.shape, 1e-3), pattern)
        error_px = np.abs(places.place_px - true_px)
        lit = np.isfinite(error_px) & (phases.amplitude[-1] > LEAST_AMPLITUDE)
        found[f"median_px, {name}"] = rounded(np.median(error_px[lit]))
    return found


def rounded(value: float) -> float:
    """Return a number with three digits."""
    return float(f"{float(value):.3g}")


def main() -> None:
    """Measure every code and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--columns", type=int, default=96, help="columns of the photos of the hemisphere")
    parser.add_argument("--display-columns", type=int, default=512, help="columns of the simulated display")
    parser.add_argument("--places-only", action="store_true", help="leave the hemisphere out")
    asked = parser.parse_args()
    found: dict[str, object] = {
        "places": {
            name: {f"footprint {size:g} px": measure_places(pattern, size) for size in FOOTPRINTS_PX}
            for name, pattern in PATTERNS.items()
        }
    }
    if not asked.places_only:
        found["points"] = {
            name: measure_points(options, columns=asked.columns, display_columns=asked.display_columns)
            for name, options in CAPTURES.items()
        }
        found["fringes and compression"] = measure_compression(
            columns=asked.columns, display_columns=asked.display_columns
        )
    print(json.dumps(found, indent=2, ensure_ascii=False))


if __name__ == "__main__":
    main()
