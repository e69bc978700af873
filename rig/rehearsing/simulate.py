"""A simulated session written straight from the optics: the photos of ``rig capture --sim``, without its devices.

Photos are pure functions of scene and plan, so that both roads lead to the same bytes.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from recon.calibration.board import BOARD
from recon.sessions.disk import Disk
from recon.sessions.session import TRUTH_NAME, SessionWriter
from rig.capturing.frames import frame_of
from rig.capturing.progress import CaptureProgress
from rig.capturing.session_manifest import SIMULATED_DEVICE, manifest_of
from rig.config import RigConfig
from rig.planning.plan import all_photos, set_name, set_order
from rig.planning.steps import SetPlace, TakePhoto
from sim_backend.camera import DEFAULT_SETTINGS, developed
from sim_backend.disturbance import QUIET, Disturbance
from sim_backend.photography import Photographer, save_truth
from sim_backend.scene import Scene


def simulate_session(
    scene: Scene,
    config: RigConfig,
    folder: Path,
    *,
    workers: int,
    console: Console,
    disturbances: Mapping[str, Disturbance] | None = None,
) -> int:
    """Write a whole session with its truth into ``folder`` and return the number of photos.

    ``disturbances`` says by the name of a set what is not as the scene says while it is photographed; neither manifest nor truth
    know of it. The files are not flushed one by one: what a power cut takes can be simulated again.
    """
    photographer = Photographer(scene)
    photos = all_photos(config)
    manifest = manifest_of(config, devices={"simulator": SIMULATED_DEVICE}, scene=scene)
    with (
        SessionWriter.create(folder, manifest, disk=Disk(durable=False)) as writer,
        CaptureProgress(console) as progress,
        worker_pool(workers) as pool,
    ):
        progress.plan(len(photos))
        progress.tell("tracing light")
        truth = pool.submit(photographer.truth)
        for photo, data in develop(
            photos, photographer, config, pool=pool, ahead=2 * workers, disturbances=disturbances or {}
        ):
            progress.tell(f"{photo.set_name} {photo.sweep} {photo.index}")
            writer.save_photo(
                data,
                set_name=photo.set_name,
                sweep=photo.sweep,
                index=photo.index,
                place_px=photo.place_px,
                device={"frame_id": photo.frame_id},
            )
            progress.advance(1)
        save_truth(truth.result(), folder / TRUTH_NAME)
        writer.journal.append("capture_finished", photos=len(photos))
    return len(photos)


def simulate_truth(scene: Scene, config: RigConfig, folder: Path) -> None:
    """Write manifest and truth of a session into ``folder``, without a single photo: what studies of geometry need."""
    manifest = manifest_of(config, devices={"simulator": SIMULATED_DEVICE}, scene=scene)
    with SessionWriter.create(folder, manifest, disk=Disk(durable=False)):
        save_truth(Photographer(scene).truth(), folder / TRUTH_NAME)


@contextmanager
def worker_pool(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Give a pool of threads that drops what is not begun when an error or Ctrl-C ends the work."""
    pool = ThreadPoolExecutor(workers)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def develop(
    photos: tuple[TakePhoto, ...],
    photographer: Photographer,
    config: RigConfig,
    *,
    pool: ThreadPoolExecutor,
    ahead: int,
    disturbances: Mapping[str, Disturbance],
) -> Iterator[tuple[TakePhoto, bytes]]:
    """Yield every photo in order; at most ``ahead`` photos wait in memory for the disk."""
    places = {set_name(place): place for place in set_order(config)}
    waiting: deque[tuple[TakePhoto, Future[bytes]]] = deque()
    for photo in photos:
        disturbance = disturbances.get(photo.set_name, QUIET)
        if photo.sweep == BOARD:  # several photos of one frame are several exposures, not one file twice
            disturbance = replace(disturbance, exposure=photo.index)
        waiting.append((photo, pool.submit(take, photo, places[photo.set_name], photographer, config, disturbance)))
        if len(waiting) > ahead:
            done, future = waiting.popleft()
            yield done, future.result()
    for done, future in waiting:
        yield done, future.result()


def take(
    photo: TakePhoto, place: SetPlace, photographer: Photographer, config: RigConfig, disturbance: Disturbance = QUIET
) -> bytes:
    """Return one photo as the simulated camera would take it at this point of the plan."""
    position, condition = place
    data = photographer.photograph(
        frame_of(photo, config),
        stage_position_mm=config.stage.position_mm(position),
        wet=condition == "liquid",
        object_present=condition != "without",
        disturbance=disturbance,
    )
    return developed(data, DEFAULT_SETTINGS)
