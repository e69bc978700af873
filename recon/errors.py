"""What can be wrong with what recon is given.

::

    ReconError                 one sentence for a person: what was asked, what was found, what to try
    ├── SessionError           the session on disk cannot be used as it is
    └── MissingProgramError    a library or program that this command needs is not installed
"""


class ReconError(Exception):
    """Bad input; the message is written for the person at the keyboard."""


class SessionError(ReconError):
    """A session, or a folder to import, that cannot be used as it is."""


class MissingProgramError(ReconError):
    """A program or library that this command needs is not installed."""


def sentence(error: ReconError | MemoryError | OSError) -> str:
    """Return what a person reads of an error that bad input, a small machine or a disk can cause."""
    if isinstance(error, MemoryError):
        return "not enough memory for photos of this size; close other programs or use --threads 1"
    if isinstance(error, OSError):
        return f"{error.filename or 'disk'}: {error.strerror}; check the path, its permissions and the free space"
    return str(error)
