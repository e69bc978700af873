"""Where the display should stand: the expected uncertainty of points and normals, for the positions configured and for others.

An object is guessed, half a ball or a plane; the formulas are those by which a reconstruction states its own uncertainty.
"""

from dataclasses import dataclass

import numpy as np
from rich.console import Console

from recon.geometry.prediction import Guess, Indices, Prediction, dome, facet, predicted
from recon.media.stated_index import PROVISIONAL_N, index_of
from recon.sessions.manifest import Pose
from rig.config import RigConfig
from rig.errors import ConfigError

ORDINARY_GLASS_N = 1.5
GAP_FACTORS = (0.5, 1.0, 2.0)
SEPARATION_FACTORS = (0.5, 1.0, 1.5, 2.0)
# A place of the display that shows clearly less of the object than another is not recommended for its smaller errors.
SHARE_KEPT = 0.95


@dataclass(frozen=True, slots=True)
class Alternative:
    """Two places of the display on the stage, how far they are from the object, and what they would give."""

    stage_mm: tuple[float, float]
    gap_mm: float
    separation_mm: float
    configured: bool
    prediction: Prediction


def alternatives(config: RigConfig, guessed: str, *, place_sd_px: float) -> tuple[Alternative, ...]:
    """Return the prediction for the configured positions and for a grid of others within the stage's travel.

    ``guessed`` is "sphere RADIUS" or "plane SIZE TILT" (mm, degrees). Its place is before the nearer display, by the gap of the
    section [calibrate].
    """
    if config.method != "liquid" or config.liquid is None:
        raise ConfigError("--predict needs the method 'liquid': a thin object's two paths cross nowhere")
    first, second = (np.array(pose.centre_mm) for pose in config.display_poses)
    frame = config.display_poses[0].world_from_screen()
    away = frame[:3, 2]
    near = 0 if (second - first) @ away > 0 else 1
    gap_mm = config.calibrate.object_gap_mm
    apex = (first, second)[near] - gap_mm * away
    guess = _guess(guessed, apex, away, n=config.object.n or ORDINARY_GLASS_N)
    stated = index_of(config.liquid, primary=config.display.primary)
    indices = Indices(stated.n if stated else PROVISIONAL_N, config.n_air)
    camera = None if config.camera.pose is None else np.array(config.camera.pose.centre_mm)
    separation_mm = float(np.linalg.norm(second - first))
    found = []
    for gap_factor in GAP_FACTORS:
        for separation_factor in SEPARATION_FACTORS:
            gap, separation = gap_factor * gap_mm, separation_factor * separation_mm
            # Shares of the way from position 0 to position 1, of the nearer and of the farther place.
            nearer = near + (1 - 2 * near) * (gap - gap_mm) / separation_mm
            farther = nearer + (1 - 2 * near) * separation / separation_mm
            shares = (nearer, farther) if near == 0 else (farther, nearer)
            stage = tuple(
                config.stage.position_0_mm + share * (config.stage.position_1_mm - config.stage.position_0_mm)
                for share in shares
            )
            if not all(config.stage.travel_mm[0] <= place <= config.stage.travel_mm[1] for place in stage):
                continue
            poses = tuple(_moved(config.display_poses[0], share * (second - first)) for share in shares)
            prediction = predicted(
                guess,
                (poses[0], poses[1]),
                config.display,
                camera_mm=camera,
                towards_display=away,
                indices=indices,
                place_sd_px=place_sd_px,
            )
            configured = gap_factor == 1.0 and separation_factor == 1.0
            found.append(Alternative((stage[0], stage[1]), gap, separation, configured, prediction))
    return tuple(found)


def recommended(found: tuple[Alternative, ...]) -> Alternative | None:
    """Return the places with the surest normals among those that show nearly as much of the object as any; None of none."""
    seen = [one for one in found if one.prediction.share > 0]
    if not seen:
        return None
    most = max(one.prediction.share for one in seen)
    return min(
        (one for one in seen if one.prediction.share >= SHARE_KEPT * most), key=lambda one: one.prediction.normal_sd_rad
    )


def print_prediction(found: tuple[Alternative, ...], config: RigConfig, console: Console) -> None:
    """Print a table of all places, and which of them to take."""
    unit = config.length_unit
    best = recommended(found)
    console.print("  stage 0 and 1    gap  apart  seen off panel  angle  sd point sd normal")
    for one in found:
        given = one.prediction
        marks = (("configured", one.configured), ("best", one is best))
        console.print(
            f"{one.stage_mm[0]:7.1f} {one.stage_mm[1]:7.1f} {one.gap_mm:6.1f} {one.separation_mm:6.1f} {given.share:5.0%} "
            f"{given.off_panel_share:9.0%} {np.degrees(given.angle_rad):5.1f}° {given.point_sd_mm:9.3f} "
            f"{np.degrees(given.normal_sd_rad):8.3f}° {', '.join(name for name, true in marks if true)}".rstrip(),
            markup=False,
        )
    console.print(f"lengths in {unit}; medians over the points seen, of single pixels before the surface is fused")
    console.print(_advice(found, best, unit), markup=False)


def _advice(found: tuple[Alternative, ...], best: Alternative | None, unit: str) -> str:
    if best is None:
        return "No place within the stage's travel shows this object: bring the display nearer, or check the object's size."
    if best.configured:
        return "The display stands well where it is."
    now = next((one.prediction for one in found if one.configured), None)
    better = f"at stage {best.stage_mm[0]:.1f} and {best.stage_mm[1]:.1f} {unit}"
    if now is None or not now.share > 0:
        return f"Let the display stand {better}; where it is configured it shows nothing of the object."
    return (
        f"Let the display stand {better}: normals {np.degrees(best.prediction.normal_sd_rad):.3f}° instead of "
        f"{np.degrees(now.normal_sd_rad):.3f}°, points {best.prediction.point_sd_mm:.3f} instead of "
        f"{now.point_sd_mm:.3f} {unit}, {best.prediction.share:.0%} of the object instead of {now.share:.0%}."
    )


def _guess(text: str, apex: np.ndarray, away: np.ndarray, *, n: float) -> Guess:
    words = text.split()
    try:
        numbers = [float(word) for word in words[1:]]
    except ValueError:
        numbers = []
    if words[:1] == ["sphere"] and len(numbers) == 1 and numbers[0] > 0:
        return dome(apex_mm=apex, towards_display=away, radius_mm=numbers[0], n=n)
    if words[:1] == ["plane"] and len(numbers) == 2 and numbers[0] > 0 and abs(numbers[1]) < 90:
        return facet(
            middle_mm=apex, towards_display=away, size_mm=numbers[0], tilt_rad=float(np.radians(numbers[1])), n=n
        )
    raise ConfigError(f"--predict {text!r}: give 'sphere RADIUS' in mm, or 'plane SIZE TILT' in mm and degrees")


def _moved(pose: Pose, shift_mm: np.ndarray) -> Pose:
    x, y, z = (float(number) for number in np.array(pose.centre_mm) + shift_mm)
    return pose.model_copy(update={"centre_mm": (x, y, z)})
