"""The photos of a sweep, one at a time, each with its line in the strip of capture quality."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from recon.errors import SessionError
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


class SweepPhotos:
    """The photos of one sweep, some of which are wanted before they are streamed: each is decoded once.

    Those are kept until they come, as many as there are: a few.
    """

    def __init__(self, session: Session, capture_set: CaptureSet, axis: Axis) -> None:
        self._session, self._set, self._axis = session, capture_set.name, axis
        self.numbers = session.photo_numbers(capture_set, axis)
        self._kept: dict[int, Counts] = {}

    def early(self, index: int) -> Counts:
        """Return a photo [rows, cols] that will be streamed later."""
        if index not in self._kept:
            self._kept[index] = read_session_photo(self._session, self._set, self._axis, index)
        return self._kept[index]

    def take(self, index: int, *, buffer: Counts | None) -> Counts:
        """Return a photo for the last time; what has to be decoded may be written into ``buffer``."""
        if index in self._kept:
            return self._kept.pop(index)
        return read_session_photo(self._session, self._set, self._axis, index, buffer=buffer)


def photo_stream(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    numbers: Iterable[int],
    *,
    like: np.ndarray | None,
    quality: list[PhotoQuality],
    on_photo: Callable[[], None],
) -> Iterator[Counts]:
    """Yield the photos with these numbers [rows, cols]; their quality is added to ``quality``.

    All must be as deep as ``like``, or as the first of them. A photo may be kept or changed by whoever takes it.
    """
    for index in numbers:
        counts = read_session_photo(session, capture_set.name, axis, index)
        like = counts if like is None else like
        check_depth(session, capture_set, axis, index, counts, like=like)
        quality.append(
            photo_quality(
                counts, capture_set, axis, index, brightest=int(counts.max()), clipped=saturation_count(counts)
            )
        )
        yield counts
        on_photo()


def check_depth(
    session: Session, capture_set: CaptureSet, axis: Axis, index: int, counts: Counts, *, like: np.ndarray
) -> None:
    """Refuse a photo of a sweep that has another depth than ``like``, the set's photo of the dark display where it has one."""
    if counts.dtype == like.dtype:
        return
    name = capture_set.name
    others = (
        f"{session.photo_file(name, 'black')} has"
        if has_black(session, capture_set)
        else "other photos of the set have"
    )
    raise SessionError(
        f"{session.photo_file(name, axis, index)}: {8 * counts.itemsize} bits a sample, but {others} {8 * like.itemsize}; "
        "convert them to the same depth, or take them again"
    )


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
