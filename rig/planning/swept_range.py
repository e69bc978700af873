"""From the photos of a set's scan to the part of its sweeps that is worth photographing."""

from recon.errors import ReconError
from recon.patterns.coarse_scan import read_scan
from recon.sessions.journal import SweepRange
from recon.sessions.session import SessionWriter, open_session
from rig.capturing.known import Known
from rig.config import RigConfig
from rig.errors import CaptureError


def find_swept_range(set_name: str, writer: SessionWriter, config: RigConfig, known: Known) -> None:
    """Read the scan of each sweep of a set, and put what it found into the journal and into ``known``.

    Raises
    ------
    CaptureError
        No pixel sees the swept area: a sweep would be photographed for nothing.
    """
    scan = config.capture.scan
    session = open_session(writer.folder)
    capture_set = session.manifest.set_named(set_name)
    for sweep in capture_set.sweeps:
        axis = sweep.axis
        if scan is None or not config.scan_bits(axis) or (set_name, axis) in known.ranges:
            continue
        try:
            found = read_scan(session, capture_set, axis, pattern=config.stripe_pattern(axis), region=scan.seen_px)
        except ReconError as error:
            raise CaptureError(f"scan of {set_name} along {axis}: {error}") from error
        if found is None:
            where = "the photos" if scan.seen_px is None else f"capture.scan.seen_px {list(scan.seen_px)}"
            raise CaptureError(
                f"scan of {set_name} along {axis}: no pixel of {where} sees the swept area; look at {set_name}'s white "
                "photo: is the display on, the lens open, the exposure long enough?"
            )
        writer.journal.append(
            "sweep_range",
            set=set_name,
            axis=axis,
            first_index=found.first_index,
            last_index=found.last_index,
        )
        known.ranges[set_name, axis] = SweepRange(
            set=set_name, axis=axis, first_index=found.first_index, last_index=found.last_index
        )
