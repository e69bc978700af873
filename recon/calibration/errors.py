"""What can be wrong with the photos or the file of a calibration: one sentence for a person."""

from recon.errors import ReconError


class CalibrationError(ReconError):
    """A calibration that cannot be made, or not be used; the message says what was found and what to try."""
