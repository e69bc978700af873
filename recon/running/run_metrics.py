"""The numbers of a run, gathered from its stages."""

import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from recon.calibration.board_stage import BoardStage
from recon.maps import Maps
from recon.metrics import DoubtfulRange, Funnel, Metrics, SampleCurve, TwoPathCount
from recon.running.input_hashes import input_hashes
from recon.running.outcome import Outcome
from recon.running.settings import Settings
from recon.scene.scene_stage import SceneStage
from recon.sessions.session import Session
from recon.stage_timer import StageTimer
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.doubtful_ranges import doubtful_ranges
from recon.verdict import verdict

LIBRARIES = ("refractive-scan", "numpy", "scipy", "opencv-contrib-python-headless", "simplejpeg", "pyamg")
CURVES_SHOWN = 8


def metrics_of(
    session: Session,
    sweeps: dict[tuple[str, str], SweepResult],
    outcome: Outcome,
    settings: Settings,
    timer: StageTimer,
    scene: SceneStage,
    board: BoardStage,
) -> Metrics:
    """Return all that is to be known of a run, its verdict first."""
    maps, manifest = outcome.maps, session.manifest
    lit = ~np.stack([one.status == PixelStatus.UNLIT for one in sweeps.values()]).all(axis=0)
    matched = np.stack([one.known() for one in sweeps.values()]).all(axis=0)
    valid = maps.valid()
    funnel = Funnel(
        pixels=maps.status.size,
        lit=int(lit.sum()),
        matched=int(matched.sum()),
        entry_points=int(valid.sum()),
        normals=int((valid & np.isfinite(maps.normal).all(axis=2)).sum()),
    )
    photos = tuple(photo for one in sweeps.values() for photo in one.photos)
    return Metrics(
        session=manifest.name,
        method=settings.method,
        length_unit=manifest.length_unit,
        verdict=verdict(
            funnel,
            maps,
            gap_ratio=outcome.gap_ratio,
            photos=photos,
            scene=scene.warnings,
            doubts=outcome.doubts,
            unwatched=manifest.method == "liquid" and not scene.comparisons,
        ),
        funnel=funnel,
        status_counts={one.name: int((maps.status == one).sum()) for one in PixelStatus},
        statistics=outcome.statistics,
        parameters=_parameters(settings, sweeps, outcome.gap_ratio),
        warnings=(*scene.warnings, *board.warnings, *outcome.warnings),
        versions=_versions(),
        hashes=input_hashes(session.folder, calibration=settings.calibration),
        stages=timer.stages(),
        curves=_chosen_curves(sweeps, maps),
        photos=photos,
        scene=scene.comparisons,
        scene_note=scene.note,
        registration=outcome.registration,
        doubtful_ranges=_doubtful_ranges(session, sweeps),
        board=board.result(),
        board_note=board.note,
        liquid_index=outcome.liquid_index,
        two_paths=_two_paths(maps),
    )


def _two_paths(maps: Maps) -> TwoPathCount | None:
    if maps.path_count is None:
        return None
    two = maps.path_count == 2
    return TwoPathCount(pixels=int(two.sum()), points=int((two & maps.valid()).sum()))


def _doubtful_ranges(session: Session, sweeps: dict[tuple[str, str], SweepResult]) -> tuple[DoubtfulRange, ...]:
    manifest = session.manifest
    found: list[DoubtfulRange] = []
    for each in manifest.sets:
        for sweep in each.sweeps:
            device_px = manifest.display.columns if sweep.axis == "x" else manifest.display.rows
            result = sweeps[each.name, sweep.axis]
            found += doubtful_ranges(result, sweep.pattern, set_name=each.name, axis=sweep.axis, device_px=device_px)
    return tuple(found)


def _parameters(
    settings: Settings, sweeps: dict[tuple[str, str], SweepResult], ratio: float | None
) -> dict[str, object]:
    parameters: dict[str, object] = {"method": settings.method, **asdict(settings.limits)}
    parameters["normalised_gap"] = ratio
    for (name, axis), one in sweeps.items():
        parameters[f"noise_{name}_{axis}"] = {
            **asdict(one.noise),
            "misfit": None if np.isnan(one.misfit) else one.misfit,
        }
    return parameters


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a checkout that was never installed
            found[name] = "not installed"
    return found


def _chosen_curves(sweeps: dict[tuple[str, str], SweepResult], maps: Maps) -> tuple[SampleCurve, ...]:
    """Return a few curves of pixels that became points, spread over the sweeps and over the image."""
    chosen = []
    per_sweep = max(CURVES_SHOWN // len(sweeps), 1)
    for number, one in enumerate(sweeps.values()):
        fine = [curve for curve in one.curves if maps.status[curve.row, curve.col] == PixelStatus.OK]
        if fine:
            places = np.linspace(0, len(fine) - 1, per_sweep + 2).astype(int)[1:-1]
            chosen += [fine[(int(place) + number * 5) % len(fine)] for place in places]
    return tuple(chosen)
