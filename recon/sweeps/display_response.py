"""The response of display and camera, undone: photos that follow drive levels, where ``response.json`` is in the session."""

import numpy as np
from jaxtyping import Float64

from recon.calibration.level_response import drive_levels
from recon.calibration.response_record import RESPONSE_NAME, LevelRecord, read_response
from recon.errors import SessionError
from recon.sessions.photos import Counts
from recon.sessions.session import Session


def response_of(session: Session) -> LevelRecord | None:
    """Return how the photos of a session follow drive levels, where that was measured."""
    path = session.folder / RESPONSE_NAME
    return read_response(path).levels if path.is_file() else None


def response_undone(counts: Counts, response: LevelRecord | None) -> Float64[np.ndarray, " pixels"]:
    """Return counts as they would follow the pattern: as drive levels where the response is known, else as they are."""
    values = counts.ravel().astype(np.float64)
    if response is None:
        return values
    if response.full_scale != np.iinfo(counts.dtype).max:
        raise SessionError(
            f"{RESPONSE_NAME}: it was measured with counts up to {response.full_scale:g}, these photos have up to "
            f"{np.iinfo(counts.dtype).max}; measure it with photos of the same kind, or remove it from the session"
        )
    return drive_levels(values, level=np.array(response.level), value=np.array(response.value))
