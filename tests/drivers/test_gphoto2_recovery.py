"""A camera that fails is brought back in rungs, the mildest first, and a person is asked above the last one."""

from typing import Any

import pytest
from faults_page import OperatorReads

from drivers import camera_link
from drivers.camera_link import RUNGS, CameraLink
from drivers.camera_process import CameraFault
from drivers.errors import DeviceAlarmError, DeviceError, DeviceNotFoundError, DeviceTimeoutError
from drivers.gphoto2_camera import Gphoto2Camera
from drivers.usb_cameras import UsbCamera

BROKEN_LINK = -7


class FailingProcess:
    """Answers the first ``failures`` questions for a photo with a broken link."""

    def __init__(self, failures: int) -> None:
        self.failures = failures

    def call(self, operation: str, *, limit_s: float, **_arguments: Any) -> Any:
        assert limit_s > 0
        if operation == "expose" and self.failures:
            self.failures -= 1
            raise CameraFault("broken", code=BROKEN_LINK)
        return {"paths": [("/", "photo.jpg")], "strays": 0, "mixed": False}


class RecordedLink(CameraLink):
    """Records the rungs instead of climbing them; those in ``useless`` do not help."""

    def __init__(self, address: str, *, failures: int, useless: tuple[int, ...] = ()) -> None:
        super().__init__(address, profile="generic", environment=None)
        self.climbed: list[int] = []
        self.process: Any = FailingProcess(failures)
        self._useless = useless

    def opened(self) -> Any:
        return self.process

    def close(self) -> None:
        pass

    def recover(self, rung: int) -> None:
        self.climbed.append(rung)
        if rung in self._useless:
            raise DeviceTimeoutError("that did not help")


def camera_on(link: RecordedLink) -> Gphoto2Camera:
    camera = Gphoto2Camera(link.address)
    camera._recovery._link = camera._photos._link = link
    return camera


@pytest.mark.parametrize("failures", [1, 2, 3, 4])
def test_each_failure_in_a_row_climbs_one_rung(failures: int) -> None:
    link = RecordedLink("usb:001,005", failures=failures)
    camera_on(link).expose(timeout_s=10.0)
    assert link.climbed == list(range(failures))


def test_a_rung_that_does_not_help_leads_to_the_next() -> None:
    link = RecordedLink("usb:001,005", failures=1, useless=(0, 1, 2))
    camera_on(link).expose(timeout_s=10.0)
    assert link.climbed == [0, 1, 2, 3]


def test_a_success_begins_anew_at_the_mildest_rung() -> None:
    link = RecordedLink("usb:001,005", failures=2)
    camera = camera_on(link)
    camera.expose(timeout_s=10.0)
    camera._photos.forget()
    link.process.failures = 1
    camera.expose(timeout_s=10.0)
    assert link.climbed == [0, 1, 0]


@pytest.mark.parametrize(("address", "rungs"), [("usb:001,005", RUNGS), ("ptpip:127.0.0.1", RUNGS[:2])])
def test_above_the_last_rung_a_person_is_asked_to_switch_the_camera_off_and_on(
    operator_reads: OperatorReads, address: str, rungs: tuple[str, ...]
) -> None:
    link = RecordedLink(address, failures=1000)
    with pytest.raises(DeviceAlarmError, match="Switch it off and on") as found:
        camera_on(link).expose(timeout_s=10.0)
    assert link.climbed == list(range(len(rungs)))
    operator_reads(found.value)


def test_what_is_not_the_links_fault_climbs_nothing() -> None:
    link = RecordedLink("usb:001,005", failures=0)

    def full(_operation: str, **_arguments: Any) -> Any:
        raise CameraFault("full", code=-3)

    link.process.call = full
    with pytest.raises(DeviceAlarmError, match="empty card"):
        camera_on(link).expose(timeout_s=10.0)
    assert link.climbed == []


def test_a_camera_that_comes_back_from_its_reset_with_another_address_is_followed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, after = UsbCamera(1, 5, 0x04A9, 0x3146), UsbCamera(1, 6, 0x04A9, 0x3146)
    opened: list[str] = []
    monkeypatch.setattr(camera_link, "find_usb_cameras", lambda: (before,))
    monkeypatch.setattr(camera_link, "reset_usb_camera", lambda camera, **_: after if camera == before else None)
    link = CameraLink("usb:001,005", profile="generic", environment=None)
    monkeypatch.setattr(CameraLink, "opened", lambda self: opened.append(self.address))
    link.recover(3)
    assert opened == ["usb:001,006"]


def test_a_reset_of_a_camera_that_is_gone_asks_to_switch_it_on(
    operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_link, "find_usb_cameras", lambda: ())
    with operator_reads.raised(DeviceNotFoundError):
        CameraLink("usb:001,005", profile="generic", environment=None).recover(3)


@pytest.mark.parametrize(
    ("code", "holders", "permission", "sentence"),
    [
        (-53, ("gvfsd-gphoto2 (42)",), None, "gvfsd-gphoto2 (42) holds it"),
        (-53, (), "may not be read", "may not be read"),
        (-7, (), "may not be read", "may not be read"),
        (-53, (), None, "another program holds it"),
    ],
)
def test_what_the_bus_knows_is_what_the_operator_reads(
    code: int, holders: tuple[str, ...], permission: str | None, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_link, "find_usb_cameras", lambda: (UsbCamera(1, 5, 0x04A9, 0x3146),))
    monkeypatch.setattr(camera_link, "programs_holding", lambda _camera: holders)
    monkeypatch.setattr(camera_link, "permission_fault", lambda _camera: permission)
    link = CameraLink("usb:", profile="generic", environment=None)
    error: DeviceError = link.error(CameraFault("", code=code), doing="to open it")
    assert sentence in str(error)
