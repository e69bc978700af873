"""The synthetic scenes of Han, Wong, Liu (IJCV 2018), in the paper's own scene units.

All share a display of 32 × 32 units with stripes of 1/32 unit and a perspective camera of 1,024 × 1,024 pixels. Where the
paper gives no place for camera or display, ours are named in the function's docstring.
"""

from dataclasses import dataclass

from recon.study.simulator import Scene

DISPLAY_UNITS = 32.0
DISPLAY_PIXELS = 1024  # stripes of 1/32 unit


@dataclass(frozen=True, slots=True)
class HalfBall:
    """The half ball of the study of total reflection, in scene units; it is ours, the paper gives only its critical angle."""

    radius: float = 10.0
    n_object: float = 1.5
    distance: float = 60.0  # of the camera from the flat face
    half_field: float = 10.5


HALF_BALL = HalfBall()


def semi_ellipsoid(*, size: int, stage: tuple[float, float], n_liquid: float) -> Scene:
    """Return x²/12.5² + y²/12.5² + z²/5² = 1, z > 0, of index 1.5; the camera, ours, 60 from its flat face."""
    return {
        **_common("semi_ellipsoid", method="liquid", n_object=1.5, stage=stage),
        "n_liquid": n_liquid,
        "liquid": f"liquid of index {n_liquid}",
        "liquid_level_mm": 0.0,
        "specimen": {"kind": "semi_ellipsoid", "semi_axes_mm": [12.5, 12.5, 5.0]},
        "camera": _camera(size, distance=60.0, half_field=12.8),
    }


def concave_cone(*, size: int, pixels_a_stripe: int = 1) -> Scene:
    """Return the rod hollowed by a cone: camera 70 from the display-side face, display 6 and 16 beyond it.

    A rendered stripe knows no device pixels; several of them a stripe come near that.
    """
    return {
        **_common(
            "concave_cone", method="liquid", n_object=1.7, stage=(6.0, 16.0), pixels=pixels_a_stripe * DISPLAY_PIXELS
        ),
        "n_liquid": 1.33,
        "liquid": "water",
        "liquid_level_mm": -5.0,
        "specimen": {
            "kind": "concave_cone",
            "radius_mm": 5.0,
            "height_mm": 10.0,
            "cone_height_mm": 4.0,
            "cone_radius_mm": 10.0,
        },
        "camera": _camera(size, distance=70.0, half_field=6.4),
    }


def half_ball(*, size: int) -> Scene:
    """Return the half ball with its flat face to the camera, in water, the display 14 and 22 beyond the face."""
    ball = HALF_BALL
    return {
        **_common("half_ball", method="liquid", n_object=ball.n_object, stage=(14.0, 22.0)),
        "n_liquid": 1.33,
        "liquid": "water",
        "liquid_level_mm": 0.0,
        "specimen": {"kind": "hemisphere", "radius_mm": ball.radius},
        "camera": _camera(size, distance=ball.distance, half_field=ball.half_field),
    }


def thin_cone(*, size: int, padding: float) -> Scene:
    """Return the right circular cone of height 1 and radius 4 on a cylinder; the camera, ours, 60 away."""
    return {
        **_common("thin_cone", method="thin", n_object=1.7, stage=(20.0, 30.0)),
        "specimen": {"kind": "thin_cone", "height_mm": 1.0, "radius_mm": 4.0, "padding_mm": padding},
        "camera": _camera(size, distance=60.0, half_field=4.8),
    }


def thin_shell(*, size: int, shift: float) -> Scene:
    """Return a ball of radius 10 less the same ball shifted along z; the camera, ours, 60 away."""
    return {
        **_common("thin_shell", method="thin", n_object=1.7, stage=(20.0, 30.0)),
        "specimen": {"kind": "thin_shell", "radius_mm": 10.0, "shift_mm": shift},
        "camera": _camera(size, distance=60.0, half_field=11.0),
    }


def _common(
    name: str, *, method: str, n_object: float, stage: tuple[float, float], pixels: int = DISPLAY_PIXELS
) -> dict[str, object]:
    return {
        "name": name,
        "method": method,
        "length_unit": "scene unit",
        "n_object": n_object,
        "stage_positions_mm": list(stage),
        "display": {
            "columns": pixels,
            "rows": pixels,
            "pitch_mm": DISPLAY_UNITS / pixels,
        },
    }


def _camera(size: int, *, distance: float, half_field: float) -> dict[str, object]:
    """Return a square camera that sees ``half_field`` to each side of the axis at z = 0."""
    focal_px = size / 2 * distance / half_field
    return {
        "columns": size,
        "rows": size,
        "position_mm": [0.0, 0.0, -distance],
        "focal_x_px": focal_px,
        "focal_y_px": focal_px,
        "centre_x_px": (size - 1) / 2,
        "centre_y_px": (size - 1) / 2,
    }
