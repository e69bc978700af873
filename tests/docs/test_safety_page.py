"""The page on safety names tests that exist, and each fault has one or tells the builder what to do."""

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
PAGE = (TESTS.parent / "docs/explanation/safety.md").read_text(encoding="utf-8")
FAULTS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.partition("## One fault at a time")[2].splitlines()
    if line.startswith("| ") and not line.startswith("| fault |")
]


def test_every_test_that_the_page_names_exists() -> None:
    existing = {
        name for path in TESTS.rglob("test_*.py") for name in re.findall(r"def (test_\w+)\(", path.read_text("utf-8"))
    }
    named = set(re.findall(r"`(test_\w+)`", PAGE))
    assert len(named) > len(FAULTS)
    assert named <= existing


def test_every_fault_has_a_test_or_tells_the_builder_what_to_do() -> None:
    assert len(FAULTS) >= 9
    for fault, stops, shown in FAULTS:
        assert stops, fault
        assert "`test_" in shown or "Builder: " in shown, fault
