"""The photos of a sweep, one at a time, each with its line in the strip of capture quality."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from recon.metrics import PhotoQuality
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.photos import Counts, read_grey, saturation_count
from recon.sessions.session import Session


def read_session_photo(
    session: Session, set_name: str, sweep: str, index: int, *, buffer: np.ndarray | None = None
) -> np.ndarray:
    """Return one photo of a session as grey counts [rows, cols]."""
    camera = session.manifest.camera
    return read_grey(
        session.photo_file(set_name, sweep, index),
        rows=camera.rows,
        cols=camera.columns,
        primary=session.manifest.display.primary,
        buffer=buffer,
    )


def photo_stream(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    numbers: Iterable[int],
    *,
    quality: list[PhotoQuality],
    on_photo: Callable[[], None],
) -> Iterator[Counts]:
    """Yield the photos with these numbers [rows, cols]; their quality is added to ``quality``.

    A photo may be kept or changed by whoever takes it.
    """
    for index in numbers:
        counts = read_session_photo(session, capture_set.name, axis, index)
        quality.append(
            photo_quality(
                counts, capture_set, axis, index, brightest=int(counts.max()), clipped=saturation_count(counts)
            )
        )
        yield counts
        on_photo()


def photo_quality(
    counts: Counts, capture_set: CaptureSet, axis: Axis, index: int, *, brightest: int, clipped: int
) -> PhotoQuality:
    """Return a photo's line in the strip of capture quality; ``clipped`` is the first clipped count."""
    share = np.count_nonzero(counts >= clipped) / counts.size if brightest >= clipped else 0.0
    return PhotoQuality(set=capture_set.name, sweep=axis, index=index, brightest=brightest, saturated_share=share)


def has_black(session: Session, capture_set: CaptureSet) -> bool:
    """Whether the set has a photo of the dark display."""
    return (capture_set.name, "black", 0) in session.photos


def black_photo(session: Session, capture_set: CaptureSet) -> np.ndarray:
    """Return the set's photo of the dark display as counts [rows, cols]."""
    return read_session_photo(session, capture_set.name, "black", 0)
