"""How tables of a study are printed."""

import io

from rich.console import Console

from recon.study.command import show_table
from recon.study.study_result import StudyTable

WIDE = StudyTable(
    title="Errors",
    headings=[f"measured quantity {number}" for number in range(12)],
    rows=[[f"0.00{number}" for number in range(12)]],
)


def printed(*, width: int, terminal: bool) -> str:
    file = io.StringIO()
    show_table(WIDE, Console(file=file, width=width, force_terminal=terminal, no_color=True))
    return file.getvalue()


def test_in_a_file_no_number_is_broken_however_many_columns_there_are() -> None:
    text = printed(width=80, terminal=False)
    assert all(f"0.00{number}" in text for number in range(12))
    assert "measured" in text


def test_a_terminal_that_is_too_narrow_gets_a_sentence_and_a_wide_one_the_table() -> None:
    assert "12 columns do not fit" in printed(width=80, terminal=True)
    assert "0.0011" in printed(width=200, terminal=True)
