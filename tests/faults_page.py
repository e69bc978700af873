"""The page of faults, ``docs/reference/faults.md``, as data: each row of its tables, and what an operator reads there.

The page is written by hand and kept true by the tests that it names. A test that provokes a fault asks for the fixture
``operator_reads`` and hands it what the device said; the fixture compares that with the sentence on the page, word by word.
"""

import functools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
PAGE = REPOSITORY / "docs/reference/faults.md"
COLUMNS = ["what happens", "what the program does", "what you read", "the test that holds it"]
# What changes from rig to rig and from moment to moment: an address, a number.
WILDCARD = "…"
NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class Fault:
    """One row. ``files`` are those that the section names; ``tests`` are names, with their parameters where those matter."""

    what: str
    sentences: tuple[str, ...]
    files: tuple[str, ...]
    tests: tuple[str, ...]


@functools.cache
def read_faults() -> tuple[Fault, ...]:
    """Return every row of the page, in its order."""
    faults: list[Fault] = []
    files: tuple[str, ...] = ()
    for section in re.split(r"^(?=## )", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE):
        files = tuple(re.findall(r"`(tests/\S+?\.py)`", section))
        rows = [_cells(line) for line in section.splitlines() if line.startswith("|")]
        if rows and rows[0] == COLUMNS:
            faults += [_fault(cells, files) for cells in rows[2:]]
    return tuple(faults)


def _cells(line: str) -> list[str]:
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def _fault(cells: list[str], files: tuple[str, ...]) -> Fault:
    what, _does, reads, tests = cells
    sentences = () if reads.startswith(NOTHING) else tuple(reads.split("<br>"))
    return Fault(what, sentences, files, tuple(_name(test) for test in tests.split("<br>")))


def _name(sentence: str) -> str:
    """Return the name of the test that the page tells as a sentence: ``a pump stops [tank board]``."""
    words, bracket, parameters = sentence.strip().partition(" [")
    return "test_" + words.replace(" ", "_") + (f"[{parameters}" if bracket else "")


def pattern_of(sentence: str) -> re.Pattern[str]:
    """Return what matches a sentence of the page."""
    return re.compile(".*?".join(re.escape(part) for part in sentence.split(WILDCARD)))


class OperatorReads:
    """What an operator reads in one test, against the page. Call it with an error or a text; see also :meth:`raised`."""

    def __init__(self, sentences: tuple[str, ...]) -> None:
        self._sentences = sentences
        self._read: set[str] = set()

    def __call__(self, said: object) -> None:
        """Compare ``said`` with the page; the command line's own ``rig:`` before it does not count."""
        text = str(said).strip().removeprefix("rig: ")
        matching = [sentence for sentence in self._sentences if pattern_of(sentence).fullmatch(text)]
        on_page = "\n".join(self._sentences)
        assert matching, f"the operator reads\n{text}\nbut {PAGE.name} says\n{on_page}"
        self._read.update(matching)

    @contextmanager
    def raised(self, kind: type[Exception]) -> Iterator[None]:
        """Expect an error of this kind, with the sentence on the page."""
        with pytest.raises(kind) as found:
            yield
        assert type(found.value) is kind
        self(found.value)

    def unread(self) -> list[str]:
        """Return the sentences that the page promises and nobody read."""
        return [sentence for sentence in self._sentences if sentence not in self._read]


def sentences_of(file: str, name: str) -> tuple[str, ...]:
    """Return what the page says of test ``name`` in ``file``; ``name`` holds its parameters."""
    function = name.partition("[")[0]
    rows = [row for row in read_faults() if file in row.files and {name, function} & set(row.tests)]
    return tuple(dict.fromkeys(sentence for row in rows for sentence in row.sentences))
