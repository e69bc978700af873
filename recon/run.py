"""One session in, one folder of results out: the stages of ``recon run`` in order."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from recon.calibration.calibration_file import CALIBRATION_NAME, read_calibration
from recon.calibration.session_calibration import calibrated_manifest, calibration_path, with_calibration
from recon.errors import ReconError
from recon.maps import MAPS_NAME, save_maps
from recon.metrics import METRICS_NAME, Metrics, save_metrics
from recon.progress import progress_bar
from recon.report.calibration_page import CALIBRATION_PAGE_NAME, write_calibration_page
from recon.report.writer import write_report
from recon.running.outcome import Outcome, reconstruct
from recon.running.run_metrics import metrics_of
from recon.running.settings import Settings
from recon.scene.scene_stage import scene_stage
from recon.sessions.session import MANIFEST_NAME, Session, open_session
from recon.sessions.wholeness import check_whole
from recon.stage_timer import StageTimer
from recon.surface.files import write_cloud_ply, write_mesh_glb, write_mesh_ply
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.correspondence_store import stored_or_decoded


def run_session(session_folder: Path, out: Path, settings: Settings) -> Metrics:
    """Reconstruct one session into ``out`` and return its numbers; bad input is a one-sentence ``ReconError``."""
    timer = StageTimer()
    session = open_session(session_folder)
    with timer.stage("check the session"):
        check_whole(session)
    calibration = calibration_path(session, settings.calibration)
    doubts: tuple[str, ...] = ()
    used = None if calibration is None else read_calibration(calibration)
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
    metrics = metrics_of(session, sweeps, outcome, settings, timer, scene)
    save_metrics(metrics, out / METRICS_NAME)
    with timer.stage("report"):
        mesh = outcome.mesh
        write_report(
            out,
            maps=outcome.maps,
            metrics=metrics,
            manifest=session.manifest,
            mesh=None if mesh is None else (mesh.vertices_mm, mesh.faces, mesh.normal),
            calibration=used,
        )
        if used is not None:
            write_calibration_page(out / CALIBRATION_PAGE_NAME, used)
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
