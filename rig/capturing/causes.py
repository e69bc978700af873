"""What may interrupt a capture, and how it answers, as data.

*Suspend*: everything stands still, and the capture goes on by itself as soon as the cause is gone. *Latch*: water or motion
is in doubt; everything stands still until a person says that they have looked. *Stop*: waiting would not mend it;
the command ends and the session can be resumed. The table is printed in the documentation.
"""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DeviceError, DeviceProtocolError, OutOfTravelError, OutOfVolumeError
from recon.errors import SessionError
from rig.errors import (
    DiskLowError,
    NotStoppedError,
    SceneMovedError,
    StageMovedError,
    TankAlarmError,
    WrongLevelError,
)

Response = Literal["suspend", "latch", "stop"]
Part = Literal["camera", "display", "stage", "pump", "disk", "scene"]


@dataclass(frozen=True, slots=True)
class Cause:
    """Why a capture cannot go on at this moment; ``goes_on`` says what happens next."""

    name: str
    part: Part
    errors: tuple[type[Exception], ...]
    response: Response
    goes_on: str


AFTER_LOOKING = "it waits until a person has looked and says so; then the stage is homed and the level is asked anew"
ONCE_RESUMED = "the command ends; mend what it says, then resume"

# The first row that fits counts: the special errors of a part come before DeviceError, which is all of them.
CAUSES: tuple[Cause, ...] = (
    Cause("frame refused", "display", (DeviceProtocolError,), "stop", ONCE_RESUMED),
    Cause("display away", "display", (DeviceError,), "suspend", "it goes on when the display shows frames again"),
    Cause("photo refused", "camera", (DeviceProtocolError,), "stop", ONCE_RESUMED),
    Cause("camera away", "camera", (DeviceError,), "suspend", "it goes on when the camera answers again"),
    Cause("disk full", "disk", (DiskLowError, OSError), "suspend", "it goes on when there is room on the disk again"),
    Cause("position out of reach", "stage", (OutOfTravelError,), "stop", ONCE_RESUMED),
    Cause("stage lost", "stage", (DeviceError,), "latch", AFTER_LOOKING),
    Cause("stage moved", "stage", (StageMovedError,), "latch", AFTER_LOOKING),
    Cause("volume out of bounds", "pump", (OutOfVolumeError,), "stop", ONCE_RESUMED),
    Cause("pump lost", "pump", (DeviceError,), "latch", AFTER_LOOKING),
    Cause("alarm at the tank", "pump", (TankAlarmError,), "latch", AFTER_LOOKING),
    Cause("level wrong", "pump", (WrongLevelError,), "latch", AFTER_LOOKING),
    Cause("not stopped", "pump", (NotStoppedError,), "latch", AFTER_LOOKING),
    Cause("scene moved", "scene", (SceneMovedError,), "stop", ONCE_RESUMED),
)
DISK_IS_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def part_of_rig(part: Part) -> Iterator[None]:
    """Write on every device error that passes which part of the rig it came from."""
    try:
        yield
    except DeviceError as error:
        error.part = error.part or part
        raise


def cause_of(error: Exception) -> Cause | None:
    """Return the row of :data:`CAUSES` that fits; None for what is no matter of the rig, such as a bad configuration."""
    if isinstance(error, SessionError):
        reason = error.__cause__
        full = isinstance(reason, OSError) and reason.errno in DISK_IS_FULL
        return next(cause for cause in CAUSES if cause.part == "disk") if full else None
    part = error.part if isinstance(error, DeviceError) else None
    fitting = (cause for cause in CAUSES if isinstance(error, cause.errors) and (part is None or cause.part == part))
    return next(fitting, None)
