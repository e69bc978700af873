"""What can go wrong with a device.

::

    DeviceError
    ├── DeviceNotFoundError      nothing answers at this address
    ├── DeviceTimeoutError       it answered before, and no longer does in time
    ├── DeviceProtocolError      it answers something the manual does not know
    ├── DeviceBusyError          it asks to be left alone for a moment; try again
    ├── DeviceAlarmError         it stopped itself and waits for a person
    ├── OutOfTravelError         a stage was asked to leave its travel; nothing moved
    ├── UnknownPositionError     a stage that was not homed was asked to move
    └── OutOfVolumeError         a pump was asked for more than it or the tank may take

Every message says what was asked, what was found and what to try.
"""


class DeviceError(Exception):
    """Any failure of a device; the message is written for the operator.

    ``part`` is the part of the rig that failed (``"camera"``, ``"pump"``, ...), filled in by whoever asked it.
    """

    part: str = ""


class DeviceNotFoundError(DeviceError):
    """Nothing answers at the configured address."""


class DeviceTimeoutError(DeviceError):
    """The device did not answer before the deadline of the call."""


class DeviceProtocolError(DeviceError):
    """The device answered something that its manual does not know."""


class DeviceBusyError(DeviceError):
    """The device asks to be left alone for a moment; the same call may work later."""


class DeviceAlarmError(DeviceError):
    """The device stopped itself and wants a person to look."""


class OutOfTravelError(DeviceError):
    """The target lies outside the stage's travel; raised before any motion."""


class UnknownPositionError(DeviceError):
    """The stage does not know where it is and must be homed first."""


class OutOfVolumeError(DeviceError):
    """The volume asked for exceeds what the pump or the tank may take; raised before any flow."""
