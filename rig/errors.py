"""What can go wrong in a capture that is not a device's fault.

::

    RigError                 one sentence for the operator: what was asked, what was found, what to try
    ├── ConfigError          a value of the configuration, or an option, that cannot be used
    ├── CaptureError         the capture cannot go on as things stand
    │   ├── StageMovedError  the display does not stand where it was sent
    │   ├── TankAlarmError   pump or board report a leak, an over-fill, a stall, their dead-man's switch
    │   ├── WrongLevelError  the tank does not hold what it should after a flow
    │   ├── NotStoppedError  pump or stage did not obey a stop
    │   ├── WrongFrameError  a photo shows another frame than was commanded, or its tag cannot be read
    │   ├── InterlockError   something must not be done as things stand (rig.tank.interlocks)
    │   ├── LevelUnknownError nobody knows what the tank holds
    │   ├── SceneMovedError  camera, object, display, light or liquid did not stay as they were
    │   └── DiskLowError     there is no room for the next photo
    ├── LedgerError          what is known of the liquid cannot be read
    └── CaptureStopped       the operator asked to stop; the session is whole and can be resumed
"""


class RigError(Exception):
    """Anything the operator must know; the message is the whole story."""


class ConfigError(RigError):
    """A value of the configuration, or an option of a command, that cannot be used."""


class CaptureError(RigError):
    """The capture cannot go on as things stand."""


class StageMovedError(CaptureError):
    """The display does not stand where it was sent."""


class TankAlarmError(CaptureError):
    """The pump or its board stopped itself and says why."""


class WrongLevelError(CaptureError):
    """After a flow, the tank does not hold what it should."""


class NotStoppedError(CaptureError):
    """A pump or a stage did not obey a stop."""


class WrongFrameError(CaptureError):
    """A photo shows another frame than was commanded, or its frame tag cannot be read."""


class SceneMovedError(CaptureError):
    """Camera, object, display, light or liquid did not stay as they were."""


class DiskLowError(CaptureError):
    """The disk has no room for the next photo."""


class InterlockError(CaptureError):
    """Something must not be done as things stand; nothing was done."""


class LevelUnknownError(CaptureError):
    """Nobody knows what the tank holds, so that nothing may be pumped."""


class LedgerError(RigError):
    """The file that keeps what is known of the liquid cannot be read."""


class CaptureStopped(RigError):
    """The operator asked to stop. Nothing is wrong with the session."""
