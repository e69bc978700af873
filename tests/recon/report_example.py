"""A reconstruction whose answer is known in closed form, to make reports of: the display side of a glass ball."""

import numpy as np

from recon.maps import Maps
from recon.metrics import Funnel, Metrics, PhotoQuality, SampleCurve, StageTime, Statistic, Verdict
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus

RADIUS_MM = 28.0
# The world is the frame of the display at position 0, z into the screen: the object stands at negative z.
CENTRE_MM = np.array([1.5, -2.0, -(25.0 + RADIUS_MM)])
SEED = 20180


def example_maps(*, rows: int = 180, cols: int = 240, radius_px: float = 80.0) -> Maps:
    """Return the cap as an orthographic camera would see it, with a rim of failures and a little noise in the gap."""
    rng = np.random.default_rng(SEED)
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    across = (col - cols / 2) / radius_px * RADIUS_MM
    down = (row - rows / 2) / radius_px * RADIUS_MM
    distance = np.hypot(across, down)
    inside = distance < 0.92 * RADIUS_MM
    height = np.sqrt(np.where(inside, RADIUS_MM**2 - distance**2, np.nan))
    from_centre = np.stack([np.where(inside, across, np.nan), np.where(inside, down, np.nan), height], axis=-1)
    incidence = np.arcsin(np.where(inside, distance / RADIUS_MM, np.nan))
    pbc_angle_rad = incidence - np.arcsin(np.sin(incidence) / 1.33)
    status = np.full((rows, cols), PixelStatus.UNLIT, dtype=np.uint8)
    status[distance < 1.25 * RADIUS_MM] = PixelStatus.BESIDE_OBJECT
    status[(distance < RADIUS_MM) & ~inside] = PixelStatus.PARTLY_LIT
    status[inside] = PixelStatus.OK
    parallel = inside & (pbc_angle_rad < np.radians(1.0))
    clipped = inside & (np.hypot(across - 8, down + 9) < 2.5)
    status[parallel], status[clipped] = PixelStatus.PARALLEL_PATHS, PixelStatus.BAD_FIT
    failed = parallel | clipped
    from_centre[failed] = np.nan
    sd_mm = np.where(inside & ~failed, 0.01 / np.sin(np.maximum(pbc_angle_rad, 1e-3)), np.nan)
    gap_mm = np.where(inside & ~clipped, rng.normal(0, 0.02, inside.shape), np.nan)
    return Maps(
        point_mm=CENTRE_MM + from_centre,
        normal=from_centre / RADIUS_MM,
        sd_mm=sd_mm.astype(np.float32),
        gap_mm=gap_mm.astype(np.float32),
        pbc_angle_rad=np.where(clipped, np.nan, pbc_angle_rad).astype(np.float32),
        status=status,
    )


def example_mesh(maps: Maps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the grid's pixels with a point as vertices, and two triangles for each square of four of them."""
    valid = maps.valid()
    number = np.where(valid, np.cumsum(valid).reshape(valid.shape) - 1, -1)
    corner = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    square = corner[(corner >= 0).all(axis=-1)]
    return maps.point_mm[valid], np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]]), maps.normal[valid]


def example_manifest(*, name: str = "glass ball", kind: str = "simulated", length_unit: str = "mm") -> Manifest:
    """Return a manifest of the liquid method with a display 40 mm and 80 mm from the object's centre."""
    stripe = {"profile": "raised_cosine", "width_px": 6.0, "first_px": 200.0, "step_px": 1.0, "count": 350}
    sweeps = [{"axis": axis, "pattern": stripe} for axis in ("x", "y")]
    axes = {"x_axis": (1, 0, 0), "y_axis": (0, 1, 0)}
    devices = ("camera", "display", "stage", "pump")
    return Manifest.model_validate(
        {
            "schema_version": 1,
            "name": name,
            "created": "2024-05-02T09:31:00Z",
            "method": "liquid",
            "object": {"name": name, "n": 1.52},
            "n_air": 1.00027,
            "liquid": {"name": "water", "n": 1.3355, "temperature_c": 20.0},
            "length_unit": length_unit,
            "display": {"columns": 1024, "rows": 768, "pitch_mm": 0.12, "primary": "green"},
            "display_poses": [{"centre_mm": (0, 0, 0), **axes}, {"centre_mm": (0.1, 0, 40), **axes}],
            "camera": {"columns": 240, "rows": 180, "model": "example body"},
            "sets": [
                {"position": position, "condition": condition, "sweeps": sweeps}
                for position in (0, 1)
                for condition in ("air", "liquid")
            ],
            "provenance": {
                "software": {"rig": "0.1.0"},
                "devices": {device: {"kind": kind, "model": f"example {device}"} for device in devices},
            },
        }
    )


def example_curve(*, row: int, col: int, axis: str, centre_px: float, second: float = 0.0) -> SampleCurve:
    """Return a noisy raised cosine, six steps wide; ``second`` adds another peak of that height 14 steps further on."""
    rng = np.random.default_rng(SEED + row + col)
    place = np.arange(200.0, 550.0)

    def stripe(centre: float) -> np.ndarray:
        offset = place - centre
        return np.where(np.abs(offset) < 3, 0.5 + 0.5 * np.cos(np.pi * offset / 3), 0.0)

    model = 8 + 190 * stripe(centre_px)
    seen = np.clip(np.round(model + second * stripe(centre_px + 14) + rng.normal(0, 1.5, place.size)), 0, 255)
    return SampleCurve(
        row=row,
        col=col,
        set="pos0_air" if axis == "x" else "pos1_liquid",
        axis=axis,
        place_px=tuple(place),
        intensity=tuple(seen),
        model=tuple(model),
        peak_px=centre_px,
        sd_px=0.02,
    )


def example_metrics(maps: Maps, *, session: str = "glass ball", grade: str = "check", **changes: object) -> Metrics:
    """Return the numbers of the example; ``changes`` replaces fields."""
    valid = maps.valid()
    counts = {status.name: int((maps.status == status).sum()) for status in PixelStatus}
    lit = int((maps.status != PixelStatus.UNLIT).sum())
    gap = np.abs(maps.gap_mm[valid]).astype(np.float64)
    rng = np.random.default_rng(SEED)
    photos = tuple(
        PhotoQuality(
            set=f"pos{position}_{condition}",
            sweep=axis,
            index=index,
            brightest=float(np.clip((205 if condition == "air" else 190) + rng.normal(0, 2), 0, 255)),
            saturated_share=max(0.0, float(rng.normal(0.0002, 0.0002))) if condition == "air" else 0.0,
        )
        for position in (0, 1)
        for condition in ("air", "liquid")
        for axis in ("x", "y")
        for index in range(350)
    )
    whites = tuple(
        PhotoQuality(set="pos0_air", sweep=name, index=0, brightest=value, saturated_share=0.0)
        for name, value in (("white", 231.0), ("black", 9.0))
    )
    fields: dict[str, object] = {
        "session": session,
        "method": "full",
        "length_unit": "mm",
        "verdict": Verdict(
            grade=grade,  # type: ignore[arg-type]
            reasons=("4.1 % of the lit pixels have a curve that is not that of one stripe",),
            next_action="Look at the status map: a bubble on the glass leaves a round hole in all sets.",
        ),
        "funnel": Funnel(
            pixels=maps.status.size,
            lit=lit,
            matched=lit - counts["PARTLY_LIT"] - counts["BAD_FIT"],
            entry_points=int(valid.sum()),
            normals=int(valid.sum()),
        ),
        "status_counts": counts,
        "statistics": (
            Statistic(
                name="gap between the paths",
                unit="mm",
                mean=float(gap.mean()),
                median=float(np.median(gap)),
                rms=float(np.sqrt((gap**2).mean())),
                p95=float(np.percentile(gap, 95)),
                how="length of the shortest segment between the path in air and the path in liquid",
            ),
        ),
        "parameters": {"gap": {"largest_in_sd": 4.0}, "smallest_angle_deg": 1.0},
        "warnings": ("pos1_liquid/y: photo 17 was taken again",),
        "versions": {"recon": "0.1.0", "numpy": "2.4.6"},
        "hashes": {"manifest.json": "9f" * 32},
        "stages": (
            StageTime(name="decode", wall_s=61.2, peak_mb=820.0),
            StageTime(name="correspondences", wall_s=7.9, peak_mb=910.0),
            StageTime(name="entry points", wall_s=0.84, peak_mb=1320.0),
            StageTime(name="surface", wall_s=12.1, peak_mb=1750.0),
        ),
        "curves": (
            example_curve(row=60, col=80, axis="x", centre_px=311.3),
            example_curve(row=60, col=80, axis="y", centre_px=402.7),
            example_curve(row=95, col=150, axis="x", centre_px=366.1, second=90.0),
            example_curve(row=120, col=130, axis="y", centre_px=288.9),
        ),
        "photos": photos + whites,
    }
    return Metrics.model_validate(fields | changes)
