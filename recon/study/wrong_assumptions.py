"""Scenes in which one assumption of the method does not hold, each beside the scene in which all do.

The twin of the paper's hemisphere (radius 27.99 mm, in water) for all but creases, which need an object that has some.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from recon.study.simulator import Scene

RADIUS_MM = 27.99
MOVED_MM = 0.3
# Places on the dome, as x and y; a bubble of this radius there has its centre outside the glass by a little less.
BUBBLES_XY_MM = ((9.0, 2.0), (-6.0, 11.0), (-11.0, -7.0), (3.0, -14.0), (0.0, 0.0))
BUBBLE_MM = 1.0
DISPLAY_BUBBLES_XY_MM = ((10.0, 3.0), (-7.0, 12.0), (-14.0, -9.0), (4.0, -17.0))


@dataclass(frozen=True, slots=True)
class WrongAssumption:
    """A scene with what is wrong in it; ``specimen`` and ``when_filled`` are tables of a scene file.

    ``about_creases``: what is wrong shows at edges of the object alone, in a scene where nothing is.
    """

    name: str
    specimen: Mapping[str, object] = field(default_factory=lambda: {"kind": "hemisphere", "radius_mm": RADIUS_MM})
    when_filled: Mapping[str, object] = field(default_factory=dict)
    about_creases: bool = False

    def scene(self, *, disturbed: bool = True) -> Scene:
        """Return the scene, or the same without what filling the tank did."""
        ornament = self.specimen["kind"] == "ornament"
        scene: dict[str, object] = {
            "name": str(self.specimen["kind"]),
            "method": "liquid",
            "n_object": 1.5195,
            "n_liquid": 1.3355,
            "liquid": "water",
            "liquid_level_mm": 0.5 if ornament else 1.0,
            "stage_positions_mm": [30.0, 70.0] if ornament else [53.0, 93.0],
            "specimen": self.specimen,
            "display": {"columns": 1024, "rows": 768, "pitch_mm": 0.1924},
            "camera": {
                "columns": 320,
                "rows": 320,
                "position_mm": [0.0, 0.0, -420.0],
                "focal_x_px": 2400.0 if ornament else 2100.0,
                "focal_y_px": 2400.0 if ornament else 2100.0,
                "centre_x_px": 159.5,
                "centre_y_px": 159.5,
            },
        }
        if self.when_filled and disturbed:
            scene["when_filled"] = self.when_filled
        return scene


def wrong_assumptions() -> tuple[WrongAssumption, ...]:
    """Return all of them; the first is none."""
    slotted = {
        "kind": "slotted_hemisphere",
        "radius_mm": RADIUS_MM,
        "slot_mm": 2.0,
        "slot_depth_mm": 8.0,
        "slot_tilt_deg": 10.0,
    }
    ornament = {"kind": "ornament", "radius_mm": 22.0, "facet_tilts_deg": [22.0, 26.0, 24.0, 28.0, 23.0, 25.0]}
    return (
        WrongAssumption("nothing wrong"),
        WrongAssumption("object moved aside by 0.3 mm", when_filled={"object_shift_mm": [MOVED_MM, 0.0, 0.0]}),
        WrongAssumption("object rose by 0.3 mm", when_filled={"object_shift_mm": [0.0, 0.0, -MOVED_MM]}),
        WrongAssumption("light enters again, in half of the object", specimen=slotted),
        WrongAssumption("bubbles on the object", when_filled={"bubbles_mm": bubbles_on_dome()}),
        WrongAssumption(
            "bubbles on the display",
            when_filled={"display_bubbles_mm": [[x, y, BUBBLE_MM] for x, y in DISPLAY_BUBBLES_XY_MM]},
        ),
        WrongAssumption("two paths in a pixel: creases and rim", specimen=ornament, about_creases=True),
    )


def bubbles_on_dome() -> list[list[float]]:
    """Return balls of air whose centres lie 0.8 radii outside the dome, so that each rests on a small face.

    Examples
    --------
    >>> [round(sum(part**2 for part in ball[:3]) ** 0.5, 6) for ball in bubbles_on_dome()]
    [28.79, 28.79, 28.79, 28.79, 28.79]
    """
    balls = []
    for x, y in BUBBLES_XY_MM:
        out = 1 + 0.8 * BUBBLE_MM / RADIUS_MM
        depth = (RADIUS_MM**2 - x**2 - y**2) ** 0.5
        balls.append([x * out, y * out, depth * out, BUBBLE_MM])
    return balls
