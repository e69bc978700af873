"""The display's response, measured into a calibration's folder, with its report page."""

from collections.abc import Callable
from pathlib import Path

from recon.calibration.response_record import RESPONSE_NAME, write_response
from recon.report.response_page import RESPONSE_PAGE_NAME, response_verdict, write_response_page
from rig.calibrating.calibration_devices import open_camera_and_display
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.response_capture import ResponseCapture
from rig.config import RigConfig
from rig.rehearsing.rehearsal import Simulation

DRIFT_MIN = 5.0
RESPONSE_PREPARATIONS = (
    "The display has been on, bright, for half an hour; automatic brightness is off.",
    "The camera is set as for a capture and sees the display; the room is as dark as it will be.",
    "Nothing moves until this is done; liquid and object may stay as they are.",
)


def measure_response(
    folder: Path, config: RigConfig, *, minutes: float, simulation: Simulation | None, say: Callable[[str], None]
) -> None:
    """Measure, write record and page, and say the verdict."""
    with (
        open_camera_and_display(config, simulation=simulation) as devices,
        CalibrationFolder(folder, "response") as kept,
    ):
        found = ResponseCapture(devices, config, kept, say).run(minutes=minutes)
    write_response(folder / RESPONSE_NAME, found)
    write_response_page(folder / RESPONSE_PAGE_NAME, found)
    verdict = response_verdict(found)
    for reason in verdict.reasons:
        say(f"! {reason}")
    say(f"{verdict.grade.upper()}: {verdict.next_action}")
    say(f"{folder / RESPONSE_PAGE_NAME}: the report; {len(found.photos)} photos are kept beside it")
