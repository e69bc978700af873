"""The photos of a sweep, one at a time, each with its line in the strip of capture quality."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from recon.metrics import PhotoQuality
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.photos import Counts, saturation_count
from recon.sessions.session import Session
from recon.sweeps.correspondence import read_session_photo


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
        clipped = saturation_count(counts)
        brightest = int(counts.max())
        share = np.count_nonzero(counts >= clipped) / counts.size if brightest >= clipped else 0.0
        quality.append(
            PhotoQuality(set=capture_set.name, sweep=axis, index=index, brightest=brightest, saturated_share=share)
        )
        yield counts
        on_photo()


def has_black(session: Session, capture_set: CaptureSet) -> bool:
    """Whether the set has a photo of the dark display."""
    return (capture_set.name, "black", 0) in session.photos


def black_photo(session: Session, capture_set: CaptureSet) -> np.ndarray:
    """Return the set's photo of the dark display as counts [rows, cols]."""
    return read_session_photo(session, capture_set.name, "black", 0)
