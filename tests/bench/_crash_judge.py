"""What a capture that was ended by force must have kept, judged from outside.

The judge reads the journal with its own few lines, the photos from their files, and the shutter from a log that the simulated
world writes: one line a release, on its way before the program can die.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PhotoKey = tuple[str, str, int]


def journal_lines(folder: Path) -> list[dict[str, Any]]:
    """Return the whole lines of a session's journal; none where there is none yet."""
    path = folder / "journal.jsonl"
    data = path.read_bytes() if path.exists() else b""
    return [json.loads(line) for line in data.split(b"\n")[:-1] if b"\0" not in line]


def good_photos(folder: Path) -> dict[PhotoKey, bytes]:
    """Return the photos that a line on the disk names and whose file has the hash of that line."""
    named: dict[PhotoKey, dict[str, Any]] = {}
    for line in journal_lines(folder):
        if line["event"] == "photo":
            named[line["set"], line["sweep"], line["index"]] = line
        elif line["event"] == "sweep_rejected":
            named = {key: photo for key, photo in named.items() if key[:2] != (line["set"], line["sweep"])}
    good = {}
    for key, line in named.items():
        path = folder / line["file"]
        data = path.read_bytes() if path.is_file() else b""
        if hashlib.sha256(data).hexdigest() == line["sha256"]:
            good[key] = data
    return good


def torn_lines(folder: Path) -> list[str]:
    """Return the number of each line of the journal that is not whole, which may never stand before another."""
    *lines, rest = (folder / "journal.jsonl").read_bytes().split(b"\n")
    torn = ["the journal does not end with a line"] if rest else []
    for number, line in enumerate(lines, start=1):
        try:
            json.loads(line)
        except ValueError:
            torn.append(f"line {number} of the journal is torn")
    return torn


@dataclass(frozen=True, slots=True)
class ShutterLog:
    """The log of a simulated shutter: the number of the frame on the glass, and whether anything moved."""

    path: Path

    def add(self, frame_id: int | None, *, disturbed: bool) -> None:
        """Take down one release, in one write."""
        with self.path.open("ab", buffering=0) as file:
            file.write(f"{frame_id} {int(disturbed)}\n".encode())

    def releases(self) -> Counter[str]:
        """Return how often the shutter was released for each frame."""
        return Counter(line.split()[0] for line in self._lines())

    def disturbed(self) -> int:
        """Return how many photos were taken while the stage moved or the pump ran."""
        return sum(line.split()[1] == "1" for line in self._lines())

    def _lines(self) -> list[str]:
        return self.path.read_text(encoding="ascii").splitlines() if self.path.exists() else []


class Judge:
    """Holds a session against the one that nobody disturbed.

    ``frames`` numbers the planned photos; ``plain`` takes away what no two files of a camera share.
    """

    def __init__(
        self,
        expected: Mapping[PhotoKey, bytes],
        frames: Mapping[PhotoKey, int],
        *,
        plain: Callable[[bytes], bytes] = lambda data: data,
    ) -> None:
        self.expected = {key: plain(data) for key, data in expected.items()}
        self._frames = frames
        self._plain = plain

    def share_left(self, folder: Path) -> float:
        """Return the share of the planned photos that are still to be taken."""
        return 1 - len(good_photos(folder).keys() & self.expected.keys()) / len(self.expected)

    def releases_of_good(self, folder: Path, log: ShutterLog) -> dict[PhotoKey, int]:
        """Return for each good photo how often the shutter was released for it until now."""
        releases = log.releases()
        return {key: releases[str(self._frames[key])] for key in good_photos(folder) if key in self._frames}

    def faults(self, folder: Path, log: ShutterLog, before: Mapping[PhotoKey, int]) -> list[str]:
        """Say what is wrong with a session that was completed; ``before`` is what was good when it was ended by force."""
        good = good_photos(folder)
        releases = log.releases()
        found = [f"{key} is missing" for key in self.expected if key not in good]
        found += [
            f"{key} has other bytes"
            for key, data in self.expected.items()
            if key in good and self._plain(good[key]) != data
        ]
        for key, count in before.items():
            if releases[str(self._frames[key])] != count:
                found.append(f"{key} was good after {count} releases, and was shot again")
        found += torn_lines(folder)
        if log.disturbed():
            found.append(f"{log.disturbed()} photos were taken while something moved")
        found += [f"left behind: {path.name}" for path in folder.rglob("*.part")]
        return found

    def shot_in_vain(self, log: ShutterLog) -> int:
        """Return how many releases went into photos that were in doubt and taken again."""
        releases = log.releases()
        return sum(releases[str(frame)] - 1 for key, frame in self._frames.items() if key in self.expected)
