"""What every test may ask for."""

import importlib
import os
import shutil
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import NoReturn

import pytest
from faults_page import PAGE, OperatorReads, sentences_of

# The continuous integration promises to have everything: there a test that cannot run is a failure, not a skip.
EVERYTHING_IS_INSTALLED = os.environ.get("CI", "").lower() in ("1", "true")


def skip_or_fail(reason: str) -> NoReturn:
    """Skip with ``reason`` on a person's machine; fail with it under ``CI=true``."""
    if EVERYTHING_IS_INSTALLED:
        pytest.fail(f"{reason} (under CI=true this is a failure)", pytrace=False)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def require_program() -> Callable[[str, str], str]:
    """Return ``require_program(name, package)``: the program's path, or a skip that says how to install it."""

    def require(name: str, package: str) -> str:
        path = shutil.which(name)
        if path is None:
            skip_or_fail(f"{name} is not installed; on Debian: apt-get install {package}")
        return path

    return require


@pytest.fixture(scope="session")
def require_module() -> Callable[[str, str], ModuleType]:
    """Return ``require_module(name, package)``: another project's module, or a skip that says how to install it."""

    def require(name: str, package: str) -> ModuleType:
        try:
            return importlib.import_module(name)
        except ImportError:
            skip_or_fail(f"{name} is not installed; pip install {package}")

    return require


@pytest.fixture
def operator_reads(request: pytest.FixtureRequest) -> Iterator[OperatorReads]:
    """Compare what an operator reads in this test with what the page of faults says of it, all of it."""
    file, _, name = request.node.nodeid.partition("::")
    sentences = sentences_of(file, name)
    assert sentences, f"{PAGE.name} names no sentence that {name} in {file} holds; give it a row"
    reads = OperatorReads(sentences)
    yield reads
    unread = "\n".join(reads.unread())
    assert not unread, f"{PAGE.name} promises what nobody read in this test:\n{unread}"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let somebody with devices on the bench ask them the questions of ``tests/contract`` too."""
    text = (
        "run the tests of tests/contract that need no simulated world on the real devices of this configuration as well"
    )
    parser.addoption("--hardware", metavar="rig.toml", help=text)


def pytest_configure(config: pytest.Config) -> None:
    """Declare the one reason to skip that stands everywhere: a device that is not on the bench."""
    config.addinivalue_line("markers", "hardware: needs a real device; skipped without one, also under CI=true")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item):
    """Under ``CI=true`` turn any other skip into a failure, unless the test needs real hardware."""
    report = yield
    skipped = report.skipped and not hasattr(report, "wasxfail")
    if EVERYTHING_IS_INSTALLED and skipped and item.get_closest_marker("hardware") is None:
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid}: skipped under CI=true: {report.longrepr}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    """Under ``CI=true`` a module that skips as a whole, for want of a library, fails as well."""
    report = yield
    if EVERYTHING_IS_INSTALLED and report.skipped:
        report.outcome = "failed"
        report.longrepr = f"{report.nodeid}: skipped under CI=true: {report.longrepr}"
    return report
