"""One session in, one folder of results out: the stages of ``recon run`` in order."""

import hashlib
import os
import platform
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from recon.calibration.calibration_file import CALIBRATION_NAME
from recon.calibration.session_calibration import calibrated_manifest, calibration_path, with_calibration
from recon.errors import ReconError
from recon.maps import MAPS_NAME, Maps, save_maps
from recon.metrics import (
    METRICS_NAME,
    Funnel,
    Metrics,
    SampleCurve,
    Statistic,
    save_metrics,
)
from recon.progress import progress_bar
from recon.reconstruct import Crossing, Limits, cross_paths, maps_of
from recon.report.writer import write_report
from recon.scene.scene_stage import SceneStage, scene_stage
from recon.sessions.journal import JOURNAL_NAME
from recon.sessions.manifest import Manifest
from recon.sessions.photos import read_grey
from recon.sessions.session import MANIFEST_NAME, Session, open_session
from recon.sessions.wholeness import check_whole
from recon.stage_timer import StageTimer
from recon.status import PixelStatus
from recon.surface.files import write_cloud_ply, write_mesh_glb, write_mesh_ply
from recon.surface.mesh import Mesh
from recon.surface.surface_stage import surface_of
from recon.surface.thin_stage import thin_object
from recon.sweeps.correspondence import Method, SweepResult
from recon.sweeps.correspondence_store import stored_or_decoded
from recon.verdict import gap_ratio, statistic, verdict

LIBRARIES = ("refractive-scan", "numpy", "scipy", "opencv-contrib-python-headless", "simplejpeg", "pyamg")
CURVES_SHOWN = 8


@dataclass(frozen=True, slots=True)
class Settings:
    """What ``recon run`` may be told.

    ``threads`` = 0 takes every core; without a ``calibration`` the session's own ``calibration.json`` counts, if it has one.
    """

    method: Method = "full"
    limits: Limits = field(default_factory=Limits)
    threads: int = 0
    calibration: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What the stages made before anything is written."""

    maps: Maps
    mesh: Mesh | None
    gap_ratio: float | None
    statistics: tuple[Statistic, ...]
    warnings: tuple[str, ...]


def run_session(session_folder: Path, out: Path, settings: Settings) -> Metrics:
    """Reconstruct one session into ``out`` and return its numbers; bad input is a one-sentence ``ReconError``."""
    timer = StageTimer()
    session = open_session(session_folder)
    with timer.stage("check the session"):
        check_whole(session)
    calibration = calibration_path(session, settings.calibration)
    doubts: tuple[str, ...] = ()
    if calibration is not None:
        session, doubts = with_calibration(session, calibration)
    make_folder(out)
    with timer.stage("decode the photos"):
        sweeps = decode_session(session, settings)
    with timer.stage("points, normals and surface"):
        outcome = reconstruct(session, sweeps, settings)
        outcome = replace(outcome, warnings=(*doubts, *outcome.warnings))
    with timer.stage("write maps, cloud and mesh"):
        write_arrays(out, outcome)
    with timer.stage("compare the reference photos"):
        scene = scene_stage(session, outcome.maps)
    metrics = _metrics(session, sweeps, outcome, settings, timer, scene)
    save_metrics(metrics, out / METRICS_NAME)
    with timer.stage("report"):
        mesh = outcome.mesh
        write_report(
            out,
            maps=outcome.maps,
            metrics=metrics,
            manifest=session.manifest,
            mesh=None if mesh is None else (mesh.vertices_mm, mesh.faces, mesh.normal),
        )
    # A copy of the manifest makes the folder whole: it can be moved, read and evaluated without the session.
    if calibration is None:
        (out / MANIFEST_NAME).write_bytes((session.folder / MANIFEST_NAME).read_bytes())
    else:
        (out / MANIFEST_NAME).write_text(calibrated_manifest(session.folder, calibration).model_dump_json(indent=1))
        (out / CALIBRATION_NAME).write_bytes(calibration.read_bytes())
    metrics = metrics.model_copy(update={"stages": timer.stages()})
    save_metrics(metrics, out / METRICS_NAME)
    return metrics


def make_folder(out: Path) -> None:
    """Create the output folder, or say in one sentence why it cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".writable"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise ReconError(f"{out}: cannot be written ({error.strerror}); choose another folder with --out") from error


def decode_session(session: Session, settings: Settings) -> dict[tuple[str, str], SweepResult]:
    """Decode the eight sweeps, one a thread; those that were decoded during the capture are only read."""
    wanted = [(one, sweep) for one in session.manifest.sets for sweep in one.sweeps]
    total = sum(sweep.pattern.count for _, sweep in wanted)
    with (
        progress_bar("decoding photos", total) as step,
        ThreadPoolExecutor(settings.threads or os.cpu_count()) as pool,
    ):
        running = [
            pool.submit(stored_or_decoded, session, one, sweep.axis, method=settings.method, on_photo=step)
            for one, sweep in wanted
        ]
        try:
            return {(one.name, sweep.axis): job.result() for (one, sweep), job in zip(wanted, running, strict=True)}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def read_mask(session: Session) -> np.ndarray | None:
    """Return the session's object mask [rows, cols] (non-zero is object), or None."""
    manifest = session.manifest
    if manifest.mask is None:
        return None
    counts = read_grey(session.folder / manifest.mask, rows=manifest.camera.rows, cols=manifest.camera.columns)
    return counts > 0


def reconstruct(session: Session, sweeps: dict[tuple[str, str], SweepResult], settings: Settings) -> Outcome:
    """Turn correspondences into maps and a mesh by the session's method."""
    manifest = session.manifest
    mask = read_mask(session)
    if manifest.method == "thin":
        thin = thin_object(sweeps, manifest, method=settings.method, inside_mask=mask)
        return Outcome(thin.maps, thin.mesh, None, _statistics(thin.maps, None), thin.warnings)
    status, crossing = cross_paths(sweeps, manifest, method=settings.method, limits=settings.limits, inside_mask=mask)
    shape = (manifest.camera.rows, manifest.camera.columns)
    maps = maps_of(status, crossing, shape=shape, method=settings.method)
    surface = surface_of(maps, crossing, manifest, method=settings.method)
    ratio = None
    if settings.method == "full":
        fine = crossing.status == PixelStatus.OK
        ratio = gap_ratio(crossing.points.gap_mm[fine], crossing.points.gap_sd_mm[fine])
    return Outcome(
        surface.maps,
        surface.mesh,
        ratio,
        _statistics(surface.maps, crossing),
        (*_warnings(manifest), *surface.warnings),
    )


def _statistics(maps: Maps, crossing: Crossing | None) -> tuple[Statistic, ...]:
    valid = maps.valid()
    found = [
        statistic(
            "gap", "mm", np.abs(maps.gap_mm[valid]), how="length of the shortest segment between the two light paths"
        ),
        statistic(
            "sd",
            "mm",
            maps.sd_mm[valid],
            how="root of the trace of each point's covariance, from the photos' own noise",
        ),
        statistic(
            "PBC angle",
            "deg",
            np.degrees(maps.pbc_angle_rad[valid]),
            how="angle between the paths in liquid and in air",
        ),
    ]
    if crossing is not None and np.isfinite(maps.sd_mm[valid]).any():
        fine = crossing.status == PixelStatus.OK
        found.append(
            statistic(
                "normal sd",
                "deg",
                np.degrees(crossing.normal_sd_rad[fine]),
                how="root of the summed variances of the normal's two tilts, from the photos' own noise",
            )
        )
    return tuple(one for one in found if one is not None)


def _warnings(manifest: Manifest) -> tuple[str, ...]:
    warnings = []
    if manifest.camera.pose is None:
        warnings.append(
            "The camera's place is not in the manifest: points beyond it, and what lies beside the object, were not told apart."
        )
    return tuple(warnings)


def write_arrays(out: Path, outcome: Outcome) -> None:
    """Write ``maps.npz``, ``cloud.ply``, ``mesh.ply`` and ``mesh.glb``."""
    maps = outcome.maps
    valid = maps.valid()
    try:
        save_maps(maps, out / MAPS_NAME)
        write_cloud_ply(out / "cloud.ply", maps.point_mm[valid], maps.normal[valid], maps.sd_mm[valid])
        if outcome.mesh is not None:
            write_mesh_ply(out / "mesh.ply", outcome.mesh)
            write_mesh_glb(out / "mesh.glb", outcome.mesh)
    except OSError as error:
        raise ReconError(f"{out}: cannot be written ({error.strerror}); free some space") from error


def _metrics(
    session: Session,
    sweeps: dict[tuple[str, str], SweepResult],
    outcome: Outcome,
    settings: Settings,
    timer: StageTimer,
    scene: SceneStage,
) -> Metrics:
    maps, manifest = outcome.maps, session.manifest
    lit = ~np.stack([one.status == PixelStatus.UNLIT for one in sweeps.values()]).all(axis=0)
    matched = np.stack([one.status == PixelStatus.OK for one in sweeps.values()]).all(axis=0)
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
        verdict=verdict(funnel, maps, gap_ratio=outcome.gap_ratio, photos=photos, scene=scene.warnings),
        funnel=funnel,
        status_counts={one.name: int((maps.status == one).sum()) for one in PixelStatus},
        statistics=outcome.statistics,
        parameters=_parameters(settings, sweeps, outcome.gap_ratio),
        warnings=(*scene.warnings, *outcome.warnings),
        versions=_versions(),
        hashes=_hashes(session, calibration_path(session, settings.calibration)),
        stages=timer.stages(),
        curves=_chosen_curves(sweeps, maps),
        photos=photos,
        scene=scene.comparisons,
        scene_note=scene.note,
    )


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


def _hashes(session: Session, calibration: Path | None) -> dict[str, str]:
    files = {name: session.folder / name for name in (MANIFEST_NAME, JOURNAL_NAME)}
    if calibration is not None:
        files[CALIBRATION_NAME] = calibration
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}


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
