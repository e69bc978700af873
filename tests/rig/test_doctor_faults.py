"""What ``rig doctor`` says of faults that only show in a value: each line as the operator reads it, with what mends it."""

from collections.abc import Iterator
from pathlib import Path

import doctor_bench
import pytest
from doctor_bench import DoctorBench, emulated_rig
from faults_page import OperatorReads

import rig.checking.doctor_camera
import rig.checking.doctor_machine
from drivers.gphoto2_camera import Gphoto2Camera
from drivers.usb_cameras import UsbCamera
from rig.checking.doctor import Finding, run_checks
from rig.checking.doctor_camera import check_usb
from rig.checking.doctor_cli import Limits, plan_checks
from rig.checking.doctor_machine import check_libgphoto2, read_config


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DoctorBench]:
    folder = tmp_path_factory.mktemp("rig")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        with emulated_rig(folder) as bench:
            yield bench


@pytest.fixture
def bench(started: DoctorBench, monkeypatch: pytest.MonkeyPatch) -> Iterator[DoctorBench]:
    monkeypatch.setenv("XDG_STATE_HOME", str(started.file.parent / "state"))  # where the tablet's token is
    text = started.file.read_text(encoding="utf-8")
    yield started
    started.file.write_text(text, encoding="utf-8")


def line_of(finding: Finding) -> str:
    return f"{finding.name}: {finding.found} -> {finding.mend}"


def warnings_of(bench: DoctorBench, name: str, *, photos: int = 0) -> list[Finding]:
    config, first = read_config(bench.file)
    assert config is not None, first
    checks = plan_checks(config, unread=False, folder=bench.file.parent, photos=photos, limits=Limits())
    found = run_checks(check for check in checks if check.name == name)
    return [finding for finding in found if finding.result in ("warn", "fail")]


@pytest.mark.parametrize(
    ("seen", "value"),
    [("fullscreen", False), ("wake_lock", False), ("refresh_hz", 30)],
    ids=["window", "sleep", "slow"],
)
def test_a_page_that_is_not_as_it_should_be_is_a_warning(
    bench: DoctorBench, operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch, seen: str, value: float
) -> None:
    bench.configure(settle_s="0.1")
    monkeypatch.setitem(doctor_bench.REPORT, seen, value)
    (warning,) = warnings_of(bench, "display")
    operator_reads(line_of(warning))


def test_a_settling_time_that_is_too_short_comes_with_one_that_is_not(
    bench: DoctorBench, operator_reads: OperatorReads
) -> None:
    bench.configure(settle_s="0.030")
    (warning,) = warnings_of(bench, "display")
    operator_reads(line_of(warning))


def test_an_exposure_shorter_than_two_refreshes_is_a_warning(bench: DoctorBench, operator_reads: OperatorReads) -> None:
    bench.configure(shutterspeed='"1/60"')
    (warning,) = warnings_of(bench, "camera")
    operator_reads(line_of(warning))


def test_a_setting_that_the_camera_does_not_have_comes_with_those_that_it_has(
    bench: DoctorBench, operator_reads: OperatorReads
) -> None:
    bench.configure(shutterspeed='"1/40"')
    (fault,) = warnings_of(bench, "camera")
    operator_reads(line_of(fault))


def test_photos_that_take_longer_or_are_larger_than_planned_are_warnings(
    bench: DoctorBench, operator_reads: OperatorReads
) -> None:
    bench.configure(photo_s="0.0001", photo_mb="0.0001")
    slow, large = warnings_of(bench, "camera", photos=1)
    operator_reads(line_of(slow))
    operator_reads(line_of(large))


def test_a_battery_that_is_nearly_empty_is_a_warning(
    bench: DoctorBench, operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Gphoto2Camera, "battery", lambda _: "20%")
    (warning,) = warnings_of(bench, "camera")
    operator_reads(line_of(warning))


def test_a_libgphoto2_that_is_too_old_fails(operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig.checking.doctor_machine, "library_version", lambda: "2.5.27")
    found = check_libgphoto2()
    assert found.result == "fail"
    operator_reads(line_of(found))


CANON, NIKON = UsbCamera(1, 5, 0x04A9, 0x3146), UsbCamera(1, 7, 0x04B0, 0x0437)


@pytest.mark.parametrize(
    ("wanted", "there"),
    [("usb:", ()), ("usb:", (CANON, NIKON)), ("usb:001,006", (CANON,))],
    ids=["none", "two", "another"],
)
def test_a_camera_that_is_not_the_only_one_or_not_there_fails(
    operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch, wanted: str, there: tuple[UsbCamera, ...]
) -> None:
    monkeypatch.setattr(rig.checking.doctor_camera, "find_usb_cameras", lambda: there)
    found = next(iter(check_usb(wanted)))
    assert found.result == "fail"
    operator_reads(line_of(found))


def test_a_disk_that_the_plan_nearly_fills_is_a_warning(
    bench: DoctorBench, operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config, _ = read_config(bench.file)
    assert config is not None
    needed_gb = rig.checking.doctor_machine.summarise(
        rig.checking.doctor_machine.plan_capture(config), config
    ).gigabytes
    usage = rig.checking.doctor_machine.shutil.disk_usage(tmp_path)
    for free_gb in (0.9 * needed_gb, 1.1 * needed_gb):
        nearly_full = usage._replace(free=int(free_gb * 1e9))
        monkeypatch.setattr(rig.checking.doctor_machine.shutil, "disk_usage", lambda _, usage=nearly_full: usage)
        (found,) = rig.checking.doctor_machine.check_disk(config, Path("/data"))
        operator_reads(line_of(found))
