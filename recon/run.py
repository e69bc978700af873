"""One session in, one folder of results out: the stages of ``recon run`` in order."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from recon.batch.cores import usable_cores
from recon.calibration.board_photos import has_board_photos
from recon.calibration.board_stage import BoardStage, board_stage
from recon.calibration.calibration_file import CALIBRATION_NAME, Calibration, read_calibration
from recon.calibration.session_calibration import calibrated_manifest, calibration_path, with_calibration
from recon.errors import ReconError
from recon.maps import MAPS_NAME, save_maps
from recon.memory import give_back_free_memory
from recon.metrics import METRICS_NAME, Metrics, StageTime, save_metrics
from recon.progress import progress_bar
from recon.report.calibration_page import CALIBRATION_PAGE_NAME, write_calibration_page
from recon.report.views import Mesh as ShownMesh
from recon.report.views import ReportViews, report_views
from recon.report.writer import write_report
from recon.running.kept_outcome import forget_outcome, keep_outcome, kept_outcome, outcome_key
from recon.running.kept_report import keep_report, report_is_kept
from recon.running.kept_scene import scene_of
from recon.running.outcome import Outcome, read_mask, reconstruct_taking
from recon.running.run_metrics import metrics_of
from recon.running.settings import Settings
from recon.running.sweep_findings import sweep_findings
from recon.sessions.journal import JOURNAL_NAME
from recon.sessions.session import MANIFEST_NAME, Session, open_session, parse_manifest
from recon.sessions.wholeness import check_whole
from recon.stage_timer import StageTimer
from recon.surface.files import CLOUD_NAME, GLB_NAME, MESH_NAME, write_cloud_ply, write_mesh_glb, write_mesh_ply
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.correspondence_store import stored_or_decoded
from recon.sweeps.decode_threads import decoding_threads


def run_session(
    session_folder: Path, out: Path, settings: Settings, *, on_stage: Callable[[StageTime], None] = lambda _: None
) -> Metrics:
    """Reconstruct one session into ``out`` and return its numbers; bad input is a one-sentence ``ReconError``.

    What an earlier run kept, in the session or in ``out``, is taken where nothing that it follows from has changed.
    ``on_stage`` hears of each stage as it ends.
    """
    timer = StageTimer(on_stage)
    session = open_session(session_folder)
    if settings.integration is not None and session.manifest.method != "thin":
        raise ReconError(
            f"{session_folder}: --integration {settings.integration} is for thin objects, and this session's method is "
            f"{session.manifest.method!r}; leave --integration out"
        )
    with timer.stage("check the session"):
        check_whole(session)
    calibration = calibration_path(session, settings.calibration)
    doubts: tuple[str, ...] = ()
    used = None if calibration is None else read_calibration(calibration)
    if calibration is not None:
        session, doubts = with_calibration(session, calibration)
    make_folder(out)
    threads = settings.threads or usable_cores()
    with timer.stage("decode the photos") as stage:
        kept: list[str] = []
        sweeps = decode_session(session, settings, on_kept=kept.append)
        stage.kept = len(kept) == len(sweeps)
        stage.detail = f"{len(kept)} of {len(sweeps)} sweeps kept" if kept and not stage.kept else ""
    board = _board(session, sweeps, settings, used, timer)
    session = board.corrected_session(session)
    with timer.stage("points, normals and surface") as stage:
        known = board.slip_covariance()
        key = outcome_key(session, sweeps, settings, known=known, threads=threads)
        found = None if settings.force else kept_outcome(out, key)
        stage.kept = found is not None
        findings = sweep_findings(sweeps, session.manifest)
        outcome = found or reconstruct_taking(session, sweeps, settings, known=known)
        sweeps.clear()
    views = None
    with timer.stage("write maps, cloud and mesh") as stage:
        stage.kept = found is not None
        if found is None:
            views = _write_and_draw(out, outcome, session, key=key, threads=threads)
    outcome = replace(outcome, warnings=(*doubts, *outcome.warnings))
    with timer.stage("compare the reference photos") as stage:
        scene, stage.kept = scene_of(session, outcome.maps, out=out, outcome_key=key, force=settings.force)
    metrics = metrics_of(session, findings, outcome, settings, timer, scene, board)
    save_metrics(metrics, out / METRICS_NAME)
    with timer.stage("report") as stage:
        stage.kept = not settings.force and report_is_kept(out, key, metrics, session.manifest)
        if not stage.kept:
            pages = [
                write_report(
                    out,
                    maps=outcome.maps,
                    metrics=metrics,
                    manifest=session.manifest,
                    mesh=_shown_mesh(outcome),
                    calibration=used,
                    views=views,
                )
            ]
            if used is not None:
                pages.append(out / CALIBRATION_PAGE_NAME)
                write_calibration_page(pages[-1], used)
            keep_report(out, key, metrics, session.manifest, pages=pages)
    _keep_manifest(session.folder, out, calibration, board)
    metrics = metrics.model_copy(update={"stages": timer.stages()})
    save_metrics(metrics, out / METRICS_NAME)
    return metrics


def make_folder(out: Path) -> None:
    """Create the output folder, or say in one sentence why it cannot be, or must not."""
    if (out / JOURNAL_NAME).exists():
        raise ReconError(
            f"{out}: --out is the folder of a session, whose manifest and photos stay as they are; choose another, such as "
            f"{out / 'recon'}"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".writable"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise ReconError(f"{out}: cannot be written ({error.strerror}); choose another folder with --out") from error


def _board(
    session: Session,
    sweeps: dict[tuple[str, str], SweepResult],
    settings: Settings,
    calibration: Calibration | None,
    timer: StageTimer,
) -> BoardStage:
    """Measure where the display stood, by the session's own photos of a board."""
    if not has_board_photos(session):
        return BoardStage()
    with timer.stage("measure the display's poses"):
        return board_stage(
            session,
            sweeps,
            calibration=calibration,
            object_mask=read_mask(session),
            wanted=settings.board,
            threads=settings.threads,
        )


def _keep_manifest(session_folder: Path, out: Path, calibration: Path | None, board: BoardStage) -> None:
    """Put a copy of the manifest beside the results: the folder can be moved, read and evaluated without the session."""
    source = session_folder / MANIFEST_NAME
    if calibration is None and board.poses is None:
        (out / MANIFEST_NAME).write_bytes(source.read_bytes())
        return
    if calibration is None:
        manifest = parse_manifest(source.read_text(encoding="utf-8"), source=str(source))
    else:
        manifest = calibrated_manifest(session_folder, calibration)
        (out / CALIBRATION_NAME).write_bytes(calibration.read_bytes())
    (out / MANIFEST_NAME).write_text(board.corrected(manifest).model_dump_json(indent=1))


def decode_session(
    session: Session, settings: Settings, *, on_kept: Callable[[str], None] = lambda _: None
) -> dict[tuple[str, str], SweepResult]:
    """Decode the eight sweeps, one a thread; those decoded before are only read, and ``on_kept`` hears of them.

    There are as many threads as the settings say, or as the cores and the free memory allow.
    """
    wanted = [(one, sweep) for one in session.manifest.sets for sweep in one.sweeps]
    total = sum(sweep.pattern.count for _, sweep in wanted)
    with (
        progress_bar("decoding photos", total) as step,
        ThreadPoolExecutor(
            settings.threads or decoding_threads(session, method=settings.method, cores=usable_cores())
        ) as pool,
    ):
        running = [
            pool.submit(
                stored_or_decoded,
                session,
                one,
                sweep.axis,
                method=settings.method,
                force=settings.force,
                on_photo=step,
                on_kept=on_kept,
            )
            for one, sweep in wanted
        ]
        try:
            return {(one.name, sweep.axis): job.result() for (one, sweep), job in zip(wanted, running, strict=True)}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _write_and_draw(out: Path, outcome: Outcome, session: Session, *, key: str, threads: int) -> ReportViews | None:
    """Write the arrays, and draw what the report shows of them meanwhile; with one thread that is left to the report."""
    if threads == 1:
        write_arrays(out, outcome, key=key, threads=threads)
        return None
    with ThreadPoolExecutor(1) as pool:
        drawing = pool.submit(report_views, outcome.maps, session.manifest, _shown_mesh(outcome))
        write_arrays(out, outcome, key=key, threads=threads)
        return drawing.result()


def _shown_mesh(outcome: Outcome) -> ShownMesh | None:
    """Return the mesh as a report takes it."""
    mesh = outcome.mesh
    return None if mesh is None else (mesh.vertices_mm, mesh.faces, mesh.normal)


def write_arrays(out: Path, outcome: Outcome, *, key: str, threads: int) -> None:
    """Write ``maps.npz``, ``cloud.ply``, ``mesh.ply`` and ``mesh.glb``, and keep them for the next run under ``key``.

    With several ``threads`` cloud and mesh are written while the maps are compressed.
    """
    # What was surface and mesh in the making is free, and the files need room of their own.
    give_back_free_memory()
    try:
        forget_outcome(out)
        with ThreadPoolExecutor(min(threads, 2)) as pool:
            jobs = [pool.submit(save_maps, outcome.maps, out / MAPS_NAME), pool.submit(_write_surface, out, outcome)]
        for job in jobs:
            job.result()
        keep_outcome(out, key, outcome, threads=threads)
    except OSError as error:
        raise ReconError(f"{out}: cannot be written ({error.strerror}); free some space") from error


def _write_surface(out: Path, outcome: Outcome) -> None:
    maps = outcome.maps
    known = maps.with_point()
    support = None if maps.support is None else maps.support[known]
    write_cloud_ply(out / CLOUD_NAME, maps.point_mm[known], maps.normal[known], maps.sd_mm[known], support=support)
    if outcome.mesh is not None:
        write_mesh_ply(out / MESH_NAME, outcome.mesh)
        give_back_free_memory()
        write_mesh_glb(out / GLB_NAME, outcome.mesh)
    else:  # the surface of an earlier run is not that of these maps
        (out / MESH_NAME).unlink(missing_ok=True)
        (out / GLB_NAME).unlink(missing_ok=True)
