"""How fast a session is looked through before it is resumed: ``python -m tests.bench.check_session`` prints JSON.

The photos are random bytes, since only their hashes matter; before each run they are dropped from the system's cache, so that
they come from the disk, and once more they are read from the cache.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import rig.capturing.session_check
from recon.sessions.disk import Disk
from recon.sessions.session import Session, SessionWriter, open_session
from rig.capturing.session_check import check_session
from rig.capturing.session_manifest import manifest_of
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene


def write_session(folder: Path, *, photos: int, photo_bytes: int) -> Session:
    """Write a session of photos that are no pictures."""
    options = SceneOptions(camera_columns=32, display_columns=32)
    scene = open_scene("semi_ellipsoid", options)
    manifest = manifest_of(config_of_scene(scene, options), devices={}, scene=scene)
    rng = np.random.default_rng(0)
    with SessionWriter.create(folder, manifest, disk=Disk(durable=False)) as writer:
        for index in range(photos):
            writer.save_photo(rng.bytes(photo_bytes), set_name="pos0_air", sweep="x", index=index)
    os.sync()
    return open_session(folder)


def drop_from_cache(session: Session) -> None:
    """Ask the system to forget the photos' bytes."""
    for record in session.photos.values():
        file = os.open(session.folder / record.file, os.O_RDONLY)
        os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
        os.close(file)


def timed_s(session: Session, *, threads: int) -> float:
    """Return how long the check takes on so many threads."""
    rig.capturing.session_check.MOST_THREADS = threads
    begun_s = time.perf_counter()
    found = check_session(session)
    if len(found.whole) != len(session.photos):
        raise SystemExit("the check found damage in a whole session")
    return time.perf_counter() - begun_s


def main() -> None:
    """Measure on one thread and on those that a resumed capture uses, from the disk and from the cache."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photos", type=int, default=200)
    parser.add_argument("--photo-mb", type=float, default=5.0)
    parser.add_argument("--folder", type=Path, help="on which disk")
    given = parser.parse_args()
    most = rig.capturing.session_check.MOST_THREADS
    result: dict[str, object] = {"photos": given.photos, "photo_mb": given.photo_mb, "cores": os.cpu_count()}
    with TemporaryDirectory(prefix="check-", dir=given.folder) as folder:
        session = write_session(Path(folder) / "session", photos=given.photos, photo_bytes=round(given.photo_mb * 1e6))
        for name, threads in (("one_thread", 1), ("as_resumed", most)):
            drop_from_cache(session)
            from_disk_s = timed_s(session, threads=threads)
            from_cache_s = timed_s(session, threads=threads)
            total_mb = given.photos * given.photo_mb
            result[name] = {
                "threads": min(threads, os.cpu_count() or 1),
                "mb_per_s_from_disk": round(total_mb / from_disk_s),
                "mb_per_s_from_cache": round(total_mb / from_cache_s),
                "seconds_for_2800_photos_of_5_mb": round(2800 * 5 * from_disk_s / total_mb),
            }
    sys.stdout.write(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
