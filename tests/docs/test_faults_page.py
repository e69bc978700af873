"""The page of faults names tests that exist, each sentence on it is read in one, and no alarm that a driver knows is missing."""

import ast
import functools
import subprocess
import sys
from collections.abc import Iterable

import pytest
from faults_page import PAGE, REPOSITORY, WILDCARD, read_faults

from drivers import gphoto2_errors, grbl_protocol, new_era_wire, tank_board_line, zaber_protocol

FAULTS = read_faults()
FILES = sorted({file for fault in FAULTS for file in fault.files})
# What each driver's tables say to a person: the page must tell all of it.
TABLES = {
    "GRBL's alarms": grbl_protocol.ALARMS,
    "GRBL's refusals": {**grbl_protocol.ERRORS, **grbl_protocol.STANDSTILLS},
    "Zaber's flags": zaber_protocol.FAULTS,
    "Zaber's concerns": zaber_protocol.CONCERNS,
    "Zaber's rejections": zaber_protocol.REJECTIONS,
    "New Era's alarms": new_era_wire.ALARMS,
    "the tank board's faults": tank_board_line.FAULTS,
    "libgphoto2's errors": {code: sentence for code, (_kind, sentence) in gphoto2_errors._SENTENCES.items()},
}


@functools.cache
def collected() -> frozenset[tuple[str, str]]:
    """Return file and name, with and without its parameters, of every test in the files that the page names."""
    # Names alone are asked for: without the checks of shapes, which would be put into every module first.
    options = ("--collect-only", "-q", "-o", "addopts=", "-p", "no:cacheprovider")
    command = [sys.executable, "-m", "pytest", *options, *FILES]
    ran = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return with_and_without_parameters(line for line in ran.stdout.splitlines() if "::" in line)


def with_and_without_parameters(tests: Iterable[str]) -> frozenset[tuple[str, str]]:
    """Return file and name of tests, each name also without its parameters."""
    found = [test.partition("::") for test in tests]
    return frozenset((file, part) for file, _, name in found for part in (name, name.partition("[")[0]))


@functools.cache
def comparing(file: str) -> frozenset[str]:
    """Return the tests of ``file`` that compare what they read with the page."""
    tree = ast.parse((REPOSITORY / file).read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    return frozenset(
        node.name for node in functions if "operator_reads" in {argument.arg for argument in node.args.args}
    )


def test_every_row_names_tests_that_exist(request: pytest.FixtureRequest) -> None:
    assert FAULTS
    assert [fault.what for fault in FAULTS if not (fault.files and fault.tests)] == []
    # Where all tests run they are known; where few do, the others are looked for.
    missing = named_beside(with_and_without_parameters(item.nodeid for item in request.session.items))
    assert not missing or named_beside(collected()) == []


def named_beside(tests: frozenset[tuple[str, str]]) -> list[str]:
    """Return the tests that the page names and that are not among these files and names."""
    return [name for fault in FAULTS for name in fault.tests if not {(f, name) for f in fault.files} & tests]


def test_every_sentence_is_read_in_a_test_of_its_row() -> None:
    unread = []
    for fault in FAULTS:
        functions = {name.partition("[")[0] for name in fault.tests}
        if fault.sentences and not functions & set().union(*(comparing(file) for file in fault.files)):
            unread.append(fault.what)
    assert unread == []


def test_what_may_vary_in_a_sentence_is_little() -> None:
    for sentence in (sentence for fault in FAULTS for sentence in fault.sentences):
        fixed = len(sentence.replace(WILDCARD, ""))
        assert fixed > 40 * sentence.count(WILDCARD) / 2, sentence
        assert fixed > 30, sentence


@pytest.mark.parametrize("table", TABLES)
def test_no_alarm_that_a_driver_knows_is_missing(table: str) -> None:
    told = PAGE.read_text(encoding="utf-8")
    assert [number for number, words in TABLES[table].items() if words not in told] == []
