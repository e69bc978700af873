"""``rig doctor``: every fault has its line and the line says what mends it; nothing moves and no liquid flows."""

import logging
import re
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from doctor_bench import COLUMNS, DoctorBench, emulated_rig

import rig.checking.doctor_camera
from drivers.exposure_time import seconds_of
from drivers.usb_cameras import UsbCamera
from rig.checking.doctor import INSTALL, Check, Finding, failed, finding_of_sentence, run_checks
from rig.checking.doctor_camera import check_usb
from rig.checking.doctor_cli import Limits, plan_checks
from rig.checking.doctor_machine import check_disk, read_config, rig_packages

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DoctorBench]:
    folder = tmp_path_factory.mktemp("rig")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        with emulated_rig(folder) as bench:
            yield bench
    for thread in threading.enumerate():  # a check that was left behind ends with its device
        if thread.name.startswith("doctor"):
            thread.join(60)


@pytest.fixture
def bench(started: DoctorBench, monkeypatch: pytest.MonkeyPatch) -> Iterator[DoctorBench]:
    monkeypatch.setenv("XDG_STATE_HOME", str(started.file.parent / "state"))  # where the tablet's token is
    text = started.file.read_text(encoding="utf-8")
    yield started
    started.file.write_text(text, encoding="utf-8")


@pytest.fixture
def doctor(rig: Run) -> Run:
    return partial(rig, "doctor")


def findings_of(bench: DoctorBench, *names: str, photos: int = 0, limits: Limits | None = None) -> list[Finding]:
    """Run the named checks alone."""
    config, first = read_config(bench.file)
    assert config is not None, first
    checks = plan_checks(config, unread=False, folder=bench.file.parent, photos=photos, limits=limits or Limits())
    return list(run_checks(check for check in checks if check.name in names))


def lines_with(out: str, result: str) -> list[str]:
    return [line for line in out.splitlines() if line.startswith(result)]


def screen_of_the_page(number: int) -> str:
    """Return a screen that the how-to shows."""
    page = (Path(__file__).parents[2] / "docs/how-to/check-the-rig.md").read_text(encoding="utf-8")
    return str(re.findall(r"^```text\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[number])


def without_numbers(screen: str) -> list[str]:
    """Return the lines of a screen without what differs between two machines: versions, ports, times and room."""
    return [re.sub(r"[\d.:]*\d", "0", line) for line in screen.splitlines()]


def test_with_nothing_attached_every_failing_line_says_how_to_mend_it(doctor: Run, monkeypatch) -> None:
    monkeypatch.setattr(rig.checking.doctor_camera, "find_usb_cameras", lambda: ())
    code, out, err = doctor()
    assert (code, err) == (1, "")
    lines = out.splitlines()
    failing = [number for number, line in enumerate(lines) if line.startswith("fail")]
    named = [" ".join(lines[number][8:25].split()) for number in failing]
    assert named == ["configuration", "camera on USB", "camera", "display", "stage", "pump"]
    assert all(lines[number + 1].strip().startswith("-> ") for number in failing)
    assert "rig init rig.toml" in out
    assert "Traceback" not in out
    assert without_numbers(out) == without_numbers(screen_of_the_page(0))


def test_a_rig_of_emulators_passes_and_nothing_in_it_moves_or_flows(doctor: Run, bench: DoctorBench) -> None:
    before = bench.world.state()
    code, out, err = doctor("--config", str(bench.file))
    assert code == 0, out
    assert lines_with(out, "fail") == []
    assert (
        without_numbers(out)[1:] == without_numbers(screen_of_the_page(1))[1:]
    )  # the first line bears the file's path
    assert len(lines_with(out, "pass")) > 15
    assert [line for line in err.splitlines() if "Open this page" not in line] == []
    assert (bench.world.state().stage_mm, bench.world.state().tank_ml) == (before.stage_mm, before.tank_ml)
    assert bench.world.flow_direction() is None
    assert "RUN" not in bench.new_era.commands
    assert bench.camera.photos_taken() == 3


def test_a_stage_that_is_not_homed_is_no_reason_to_stop_and_says_how_to_home_it(bench: DoctorBench) -> None:
    found = findings_of(bench, "stage")
    (unhomed,) = [finding for finding in found if "not homed" in finding.found]
    assert unhomed.result == "warn"
    assert "rig stage home" in unhomed.mend


def test_what_could_be_better_in_the_controller_of_the_stage_is_a_warning(bench: DoctorBench) -> None:
    bench.stage.receive(b"$20=0\n")  # soft limits off
    try:
        found = findings_of(bench, "stage")
    finally:
        bench.stage.receive(b"$20=1\n")
    assert [finding.result for finding in found if "$20" in finding.found + finding.mend] == ["warn"]
    assert failed(found) == 0


def test_a_settling_time_shorter_than_two_refreshes_is_a_warning(bench: DoctorBench) -> None:
    bench.configure(settle_s="0.030")  # the emulated tablet refreshes 60 times a second: 2 / 60 s = 33 ms
    (short,) = [finding for finding in findings_of(bench, "display") if finding.result == "warn"]
    assert "settle_s is 0.03" in short.found
    assert "settle_s = 0.034" in short.mend  # rounded up: it must pass when it is followed


def test_a_value_that_a_driver_needs_and_lacks_is_named(bench: DoctorBench) -> None:
    text = bench.file.read_text(encoding="utf-8").replace("diameter_mm = 26.59", "")
    bench.file.write_text(text, encoding="utf-8")
    (missing,) = findings_of(bench, "pump")
    assert (missing.result, missing.found) == ("fail", "pump.diameter_mm: this value is missing")
    assert missing.mend.startswith("write it into the configuration")


def test_what_a_driver_warns_of_while_it_is_opened_becomes_a_line(bench: DoctorBench, caplog) -> None:
    bench.new_era.power_cycle()
    found = findings_of(bench, "pump")
    (power,) = [finding for finding in found if "power was interrupted" in finding.found]
    assert power.result == "warn"
    assert power.mend == "look at the tank before a fill"
    assert failed(found) == 0
    assert caplog.records == []  # said once, not twice
    assert logging.getLogger("drivers").propagate


def test_a_pump_whose_motor_stalled_fails(bench: DoctorBench) -> None:
    for command in (b"DIA26.59\r", b"RAT600MM\r", b"VOLML\r", b"VOL100\r", b"RUN\r"):
        bench.new_era.receive(command)
    bench.new_era.stall()
    found = findings_of(bench, "pump")
    (stalled,) = [finding for finding in found if finding.result == "fail"]
    assert "motor stalled" in stalled.found
    assert "look at the tank" in stalled.mend
    assert failed(findings_of(bench, "pump")) == 0  # acknowledged, so the second look is clean


def test_a_tank_board_with_an_open_contact_fails(bench: DoctorBench) -> None:
    bench.configure(pump=f'"tank_board:{bench.board_address}"', level_points="[[0, 0.0], [600, 6000.0]]")
    found = findings_of(bench, "pump")
    assert {finding.result for finding in found} == {"pass"}
    assert [finding.name for finding in found].count("level") == 1
    for contact, named in (("leak_open", "leak contact is open"), ("full_open", "over-fill contact is open")):
        setattr(bench.board, contact, True)
        bench.board.poll()
        time.sleep(0.1)  # the board takes a contact for open after 20 ms
        try:
            found = findings_of(bench, "pump")
        finally:
            setattr(bench.board, contact, False)
        (opened,) = [finding for finding in found if finding.result == "fail"]
        assert named in opened.found
        assert "tank" in opened.mend


def test_a_camera_that_never_answers_fails_in_time_and_the_checks_after_it_run(bench: DoctorBench) -> None:
    bench.camera.set_faults(silent=1)
    try:
        began_s = time.monotonic()
        found = findings_of(bench, "camera", "tank", limits=Limits(camera_s=1.0))
        assert time.monotonic() - began_s < 5.0
    finally:
        bench.camera.set_faults(silent=0)
    assert found[0].result == "fail"
    assert "no answer within 1 s" in found[0].found
    assert "switch it on" in found[0].mend
    assert {finding.name for finding in found[1:]} == {"tank"}


def test_a_photo_of_another_size_than_configured_fails_and_says_the_right_one(bench: DoctorBench) -> None:
    lines = bench.file.read_text(encoding="utf-8").replace("rows = 432", "rows = 433", 1)
    bench.file.write_text(lines, encoding="utf-8")
    (wrong,) = [finding for finding in findings_of(bench, "camera", photos=1) if finding.result == "fail"]
    assert "648 × 432 pixels, 648 × 433 configured" in wrong.found
    assert "rows = 432" in wrong.mend


def test_a_reservoir_that_could_flood_the_room_is_found_with_its_line(doctor: Run, bench: DoctorBench) -> None:
    bench.configure(reservoir_ml="7000.0")
    code, out, _ = doctor("--config", str(bench.file))
    assert code == 1
    (line,) = lines_with(out, "fail")
    number = (
        bench.file.read_text(encoding="utf-8")
        .splitlines()
        .index(next(text for text in bench.file.read_text(encoding="utf-8").splitlines() if text.startswith("[tank]")))
    )
    assert f"line {number + 1}" in line
    assert "reservoir_ml is 7000" in line
    assert "-> put less into the reservoir" in out
    assert "cannot be read" in lines_with(out, "skipped")[0]


def test_a_display_of_another_size_than_configured_fails(bench: DoctorBench) -> None:
    text = bench.file.read_text(encoding="utf-8").replace(f"columns = {COLUMNS} ", f"columns = {COLUMNS + 1} ", 1)
    bench.file.write_text(text, encoding="utf-8")
    (wrong,) = [finding for finding in findings_of(bench, "display") if finding.result == "fail"]
    assert "2048 × 1536 device pixels, 2049 × 1536 configured" in wrong.found
    assert "section [display]" in wrong.mend


def test_a_page_that_nobody_opens_fails_after_the_time_that_was_given(bench: DoctorBench) -> None:
    bench.configure(display='"browser:127.0.0.1:0"')
    (missing,) = findings_of(bench, "display", limits=Limits(page_wait_s=1.0))
    assert missing.result == "fail"
    assert "nobody opened" in missing.found
    assert "QR code" in missing.mend


def test_a_device_that_is_not_there_fails_with_the_advice_of_its_driver(bench: DoctorBench) -> None:
    bench.configure(stage='"grbl:/dev/nothing"', pump='"new_era:/dev/nothing"')
    found = findings_of(bench, "stage", "pump")
    assert [finding.result for finding in found] == ["fail", "fail"]
    assert all("/dev/nothing" in finding.found and finding.mend for finding in found)


def test_a_disk_that_is_too_small_for_the_plan_fails(bench: DoctorBench, tmp_path: Path) -> None:
    bench.configure(photo_mb="1e9")
    config, _ = read_config(bench.file)
    (found,) = check_disk(config, tmp_path / "not" / "there" / "yet")
    assert found.result == "fail"
    assert "--session" in found.mend


def test_a_camera_that_another_program_holds_is_named_with_the_program(monkeypatch) -> None:
    monkeypatch.setattr(rig.checking.doctor_camera, "find_usb_cameras", lambda: (UsbCamera(1, 5, 0x04A9, 0x3145),))
    monkeypatch.setattr(rig.checking.doctor_camera, "permission_fault", lambda _: None)
    monkeypatch.setattr(rig.checking.doctor_camera, "programs_holding", lambda _: ("gvfsd-gphoto2 (1234)",))
    (held,) = check_usb("usb:")
    assert (held.result, held.found) == ("fail", "usb:001,005 is held by gvfsd-gphoto2 (1234)")
    assert "gio mount -s gphoto2" in held.mend
    monkeypatch.setattr(rig.checking.doctor_camera, "programs_holding", lambda _: ())
    (free,) = check_usb("usb:001,005")
    assert free.result == "pass"
    monkeypatch.setattr(
        rig.checking.doctor_camera, "permission_fault", lambda _: "no right; install the rule: sudo cp A B"
    )
    (forbidden,) = check_usb("usb:")
    assert (forbidden.result, forbidden.mend) == ("fail", "install the rule: sudo cp A B")


def test_a_check_that_breaks_and_one_that_hangs_end_no_other() -> None:
    over = threading.Event()

    def breaks() -> Iterator[Finding]:
        yield Finding("first", "pass", "fine so far")
        raise ZeroDivisionError("oops")

    def hangs() -> Iterator[Finding]:
        over.wait(30)
        yield Finding("second", "pass", "too late")

    checks = [
        Check("first", breaks, 5.0, "report it"),
        Check("second", hangs, 0.2, "switch it off and on"),
        Check("third", lambda: (Finding("third", "pass", "well"),), 5.0, ""),
    ]
    found = list(run_checks(checks))
    over.set()
    assert [(finding.name, finding.result) for finding in found] == [
        ("first", "pass"),
        ("first", "fail"),
        ("second", "fail"),
        ("third", "pass"),
    ]
    assert "ZeroDivisionError: oops" in found[1].found
    assert found[2].mend == "switch it off and on"


def test_a_sentence_divides_where_its_advice_begins_and_not_within_parentheses() -> None:
    sentence = "pump: nothing answers (asked twice; silence); switch it on; look at the cable"
    found = finding_of_sentence("pump", "fail", sentence, mend="not this")
    assert found.found == "nothing answers (asked twice; silence)"
    assert found.mend == "switch it on; look at the cable"
    assert finding_of_sentence("pump", "fail", "pump: broken", mend="replace it").mend == "replace it"


def test_a_package_that_is_missing_is_named_with_the_command_that_installs_it() -> None:
    def needs_a_package() -> Iterator[Finding]:
        raise ModuleNotFoundError("No module named 'serial'", name="serial")
        yield

    (found,) = run_checks([Check("stage", needs_a_package, 5.0, "")])
    assert found == Finding("stage", "fail", "the Python package serial is not installed", INSTALL)


def test_the_packages_that_are_checked_are_those_of_the_extra() -> None:
    packages = dict(rig_packages())
    assert {"pyserial", "pyusb", "gphoto2"} <= packages.keys()
    assert "numpy" not in packages  # not of the extra
    assert "pytest" not in packages  # of another extra


@pytest.mark.parametrize(
    ("text", "seconds"), [("1/4", 0.25), ("0.3", 0.3), ("0.2500s", 0.25), ("2", 2.0), ("bulb", None), ("1/0", None)]
)
def test_shutter_speeds_are_read_as_cameras_write_them(text: str, seconds: float | None) -> None:
    assert seconds_of(text) == seconds
