"""What can go wrong in a capture that is not a device's fault.

::

    RigError                 one sentence for the operator: what was asked, what was found, what to try
    ├── ConfigError          a value of the configuration, or an option, that cannot be used
    ├── CaptureError         the capture cannot go on as things stand
    └── CaptureStopped       the operator asked to stop; the session is whole and can be resumed
"""


class RigError(Exception):
    """Anything the operator must know; the message is the whole story."""


class ConfigError(RigError):
    """A value of the configuration, or an option of a command, that cannot be used."""


class CaptureError(RigError):
    """The capture cannot go on as things stand."""


class CaptureStopped(RigError):
    """The operator asked to stop. Nothing is wrong with the session."""
