"""The numbers of a run, gathered from its stages."""

import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from recon.calibration.board_stage import BoardStage
from recon.maps import Maps
from recon.metrics import Funnel, Metrics, SampleCurve, TwoPathCount
from recon.running.input_hashes import input_hashes
from recon.running.outcome import Outcome
from recon.running.settings import Settings
from recon.running.sweep_findings import SweepFindings
from recon.scene.scene_stage import SceneStage
from recon.sessions.session import Session
from recon.stage_timer import StageTimer
from recon.status import PixelStatus
from recon.verdict import verdict

LIBRARIES = ("refractive-scan", "numpy", "scipy", "opencv-contrib-python-headless", "simplejpeg", "pyamg")
CURVES_SHOWN = 8


def metrics_of(
    session: Session,
    sweeps: SweepFindings,
    outcome: Outcome,
    settings: Settings,
    timer: StageTimer,
    scene: SceneStage,
    board: BoardStage,
) -> Metrics:
    """Return all that is to be known of a run, its verdict first."""
    maps, manifest = outcome.maps, session.manifest
    valid = maps.valid()
    funnel = Funnel(
        pixels=maps.status.size,
        lit=sweeps.lit,
        matched=sweeps.matched,
        entry_points=int(np.count_nonzero(valid)),
        normals=int(np.isfinite(maps.normal[valid]).all(axis=1).sum()),
    )
    return Metrics(
        session=manifest.name,
        method=settings.method,
        length_unit=manifest.length_unit,
        verdict=verdict(
            funnel,
            maps,
            gap_ratio=outcome.gap_ratio,
            photos=sweeps.photos,
            scene=scene.warnings,
            doubts=outcome.doubts,
            unwatched=manifest.method == "liquid" and not scene.comparisons,
        ),
        funnel=funnel,
        status_counts={one.name: int(np.count_nonzero(maps.status == one)) for one in PixelStatus},
        statistics=outcome.statistics,
        parameters=_parameters(settings, sweeps, outcome.gap_ratio),
        warnings=(*scene.warnings, *board.warnings, *outcome.warnings),
        versions=_versions(),
        hashes=input_hashes(session.folder, calibration=settings.calibration),
        stages=timer.stages(),
        curves=_chosen_curves(sweeps.curves, maps),
        photos=sweeps.photos,
        scene=scene.comparisons,
        scene_note=scene.note,
        registration=outcome.registration,
        doubtful_ranges=sweeps.doubtful_ranges,
        board=board.result(),
        board_note=board.note,
        liquid_index=outcome.liquid_index,
        two_paths=_two_paths(maps),
    )


def _two_paths(maps: Maps) -> TwoPathCount | None:
    if maps.path_count is None:
        return None
    two = maps.path_count == 2
    return TwoPathCount(pixels=int(np.count_nonzero(two)), points=int(np.count_nonzero(two & maps.valid())))


def _parameters(settings: Settings, sweeps: SweepFindings, ratio: float | None) -> dict[str, object]:
    return {"method": settings.method, **asdict(settings.limits), "normalised_gap": ratio, **sweeps.noise}


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a checkout that was never installed
            found[name] = "not installed"
    return found


def _chosen_curves(by_sweep: tuple[tuple[SampleCurve, ...], ...], maps: Maps) -> tuple[SampleCurve, ...]:
    """Return a few curves of pixels that became points, spread over the sweeps and over the image."""
    chosen = []
    per_sweep = max(CURVES_SHOWN // len(by_sweep), 1)
    for number, curves in enumerate(by_sweep):
        fine = [curve for curve in curves if maps.status[curve.row, curve.col] == PixelStatus.OK]
        if fine:
            places = np.linspace(0, len(fine) - 1, per_sweep + 2).astype(int)[1:-1]
            chosen += [fine[(int(place) + number * 5) % len(fine)] for place in places]
    return tuple(chosen)
