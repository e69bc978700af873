"""libgphoto2's error numbers, and what the operator reads instead.

Numbers from gphoto2-port-result.h and gphoto2-result.h.
"""

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
)

NO_MEMORY, IO, TIMEOUT, USB_CLAIM, BUSY, FILE_NOT_FOUND = -3, -7, -10, -53, -110, -108
# After these the camera may well work again once the link is set up anew.
OF_THE_LINK = frozenset({-1, -7, -10, -31, -34, -35, -37, -51, -52, -111})

_SENTENCES: dict[int, tuple[type[DeviceError], str]] = {
    -1: (DeviceProtocolError, "it failed without a reason; a body that hunts for focus does so: set the lens to MF"),
    -2: (DeviceProtocolError, "it refused a value; compare the settings with `gphoto2 --list-all-config`"),
    -3: (DeviceAlarmError, "its card or memory is full; put in an empty card"),
    -4: (DeviceNotFoundError, "libgphoto2 found none of its drivers; install the package gphoto2 anew"),
    -5: (DeviceNotFoundError, "libgphoto2 knows no such port; write usb:, usb:BUS,DEVICE or ptpip:ADDRESS"),
    -6: (
        DeviceProtocolError,
        "it cannot do this; look for its name in libgphoto2's list of cameras for remote control",
    ),
    -7: (DeviceTimeoutError, "the connection broke; look at cable, hub and battery"),
    -10: (DeviceTimeoutError, "it did not answer in time; look at cable and battery"),
    -31: (DeviceNotFoundError, "the port could not be opened; is it plugged in, and may you use it?"),
    -34: (DeviceTimeoutError, "nothing could be read from it; look at cable, hub and battery"),
    -35: (DeviceTimeoutError, "nothing could be written to it; look at cable, hub and battery"),
    -37: (DeviceTimeoutError, "its port does not take settings; plug it in again"),
    -51: (DeviceTimeoutError, "its USB port hangs; plug it in again"),
    -52: (DeviceNotFoundError, "it is not on the USB any more; switch it on, or plug it in again"),
    -53: (
        DeviceBusyError,
        "another program holds it; `gio mount -s gphoto2` takes it back until it is plugged in again",
    ),
    -60: (DeviceBusyError, "another program that uses libgphoto2 has locked it; close that program"),
    -102: (DeviceProtocolError, "it sent something corrupt; switch it off and on"),
    -105: (
        DeviceNotFoundError,
        "libgphoto2 knows no camera at this address; switch it on, and choose PTP in its USB menu",
    ),
    -108: (DeviceProtocolError, "the photo is not in the camera any more; take it again"),
    -110: (DeviceBusyError, "it is busy and stays so; put in a memory card, and wait a moment"),
    -111: (DeviceProtocolError, "it reported an error of its own; look at its display"),
    -112: (DeviceProtocolError, "the operation was cancelled; try again"),
    -114: (DeviceAlarmError, "there is no room left for a photo; put in an empty card"),
}


def device_error(code: int, *, doing: str, address: str, text: str = "", reason: str = "") -> DeviceError:
    """Return the error for number ``code``.

    Parameters
    ----------
    code
        What libgphoto2 returned; negative.
    doing
        What was asked, such as ``"a photo"``.
    address
        Where the camera is.
    text
        libgphoto2's own words, for a number that is not known here.
    reason
        What is known better than the number says: a program that holds the camera, a missing permission.
    """
    kind, sentence = _SENTENCES.get(
        code, (DeviceProtocolError, f"libgphoto2 says {text!r}; switch the camera off and on")
    )
    return kind(f"camera {address}: {doing} asked, {reason or sentence} (libgphoto2 {code})")
