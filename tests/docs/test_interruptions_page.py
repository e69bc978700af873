"""The page about interruptions lists the causes that the program knows, in their order."""

from pathlib import Path

from rig.capturing.causes import CAUSES

PAGE = Path(__file__).parents[2] / "docs/explanation/interruptions.md"
WORDS = {"suspend": "suspends", "latch": "latches", "stop": "ends"}


def test_the_table_of_the_page_is_that_of_the_program() -> None:
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")][1:]
    assert rows == [f"| {cause.name} | {cause.part} | {WORDS[cause.response]} | {cause.goes_on} |" for cause in CAUSES]
