"""What is wrong with a rig, as data: findings, the checks that make them, and how checks run.

Checks read and ask; none of them moves the stage or lets liquid flow. Each one runs on a thread of its own with a limit
of time, so that a device that hangs ends its own check and no other. What the drivers warn of meanwhile becomes a
finding too.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DeviceError
from recon.errors import ReconError
from rig.errors import RigError

INSTALL = "`pip install 'refractive-scan[rig]'`"
Result = Literal["pass", "fail", "warn", "skipped", "look"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor.

    Attributes
    ----------
    name
        What was looked at.
    result
        ``warn`` stops no capture; ``skipped`` could not be looked at; ``look`` is for a person, because no program can see it.
    found
        What it is like.
    mend
        The command or action that mends it; empty where nothing needs mending.
    """

    name: str
    result: Result
    found: str
    mend: str = ""


@dataclass(frozen=True, slots=True)
class Check:
    """A check: what it looks at, what yields its findings, how long that may take, and what to do when it does not end."""

    name: str
    examine: Callable[[], Iterable[Finding]]
    limit_s: float
    mend: str


def run_checks(checks: Iterable[Check]) -> Iterator[Finding]:
    """Run one check after the other and yield what they find, as they find it; no check's failure ends another."""
    drivers = logging.getLogger("drivers")
    propagated, drivers.propagate = drivers.propagate, False  # what becomes a finding need not be said twice
    try:
        for check in checks:
            yield from _run(check)
    finally:
        drivers.propagate = propagated


def failed(findings: Iterable[Finding]) -> int:
    """Count what must be mended before a capture."""
    return sum(finding.result == "fail" for finding in findings)


def _run(check: Check) -> Iterator[Finding]:
    """Run one check on a thread that is left behind when its time is over."""
    found: queue.SimpleQueue[Finding | None] = queue.SimpleQueue()
    threading.Thread(target=_examine, args=(check, found), name=f"doctor: {check.name}", daemon=True).start()
    end_s = time.monotonic() + check.limit_s
    while True:
        try:
            finding = found.get(timeout=max(0.0, end_s - time.monotonic()))
        except queue.Empty:
            yield Finding(check.name, "fail", f"no answer within {check.limit_s:g} s", check.mend)
            return
        if finding is None:
            return
        yield finding


def _examine(check: Check, found: "queue.SimpleQueue[Finding | None]") -> None:
    hears = _DriverWarnings(check, found)
    drivers = logging.getLogger("drivers")
    drivers.addHandler(hears)
    try:
        for finding in check.examine():
            found.put(finding)
    except (DeviceError, RigError, ReconError) as error:
        found.put(finding_of_sentence(check.name, "fail", str(error), mend=check.mend))
    except ImportError as error:
        found.put(Finding(check.name, "fail", f"the Python package {error.name} is not installed", INSTALL))
    except Exception as error:  # a fault of one check, even one of this program, must not hide what others find
        text = f"the check itself failed ({type(error).__name__}: {error})"
        found.put(Finding(check.name, "fail", text, check.mend))
    finally:
        drivers.removeHandler(hears)
        found.put(None)


def finding_of_sentence(name: str, result: Result, sentence: str, *, mend: str) -> Finding:
    """Divide a sentence of ours, whose part after the first semicolon says what to try; ``mend`` is for one without it."""
    text = sentence.removeprefix(f"{name}: ")
    # A semicolon in parentheses belongs to another sentence that is quoted there.
    ends = [at for at in range(len(text)) if text.startswith("; ", at) and text[:at].count("(") == text[:at].count(")")]
    if not ends:
        return Finding(name, result, text, mend)
    found, advice = text[: ends[0]], text[ends[0] + 2 :]
    if found.endswith("this value is missing"):
        advice = f"write it into the configuration: {advice}"
    return Finding(name, result, found, advice)


class _DriverWarnings(logging.Handler):
    """Turns what drivers warn of on the check's own thread into findings."""

    def __init__(self, check: Check, found: "queue.SimpleQueue[Finding | None]") -> None:
        super().__init__(logging.WARNING)
        self._check = check
        self._found = found
        self._thread = threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        """Put one finding into the queue."""
        if record.thread == self._thread:
            result: Result = "fail" if record.levelno >= logging.ERROR else "warn"
            sentence = record.getMessage()
            self._found.put(finding_of_sentence(self._check.name, result, sentence, mend=self._check.mend))
