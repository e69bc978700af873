"""The person at the terminal, while a capture stands still: asked whether to go on, or whether they have looked.

Unlike the :class:`~rig.capturing.operators.Operator`, whose part a simulation may play, this one is real or not there at all.
"""

import select
import sys
from collections.abc import Callable
from typing import Literal, Protocol

from rich.console import Console

Choice = Literal["go_on", "photo", "sweep", "set", "stop"]
CHOICES: dict[str, Choice] = {"": "go_on", "p": "photo", "w": "sweep", "e": "set", "q": "stop"}
MENU = (
    "return: go on · p: pause after the next photo · w: pause after this sweep · e: pause after this set · "
    "q: stop here and resume later"
)
LOOKED = "checked"
# How often a person who thinks is left for a moment, to keep the camera awake.
IDLE_S = 1.0


class Person(Protocol):
    """Somebody who can be asked while nothing moves. ``idle`` is called about once a second until they answer."""

    def after_pause(self, text: str, *, idle: Callable[[], None]) -> Choice:
        """Say why the capture pauses, and return how it goes on."""
        ...

    def has_looked(self, text: str, *, idle: Callable[[], None]) -> bool:
        """Say what is in doubt, and return whether they have looked and mended it."""
        ...


class PersonAtTerminal:
    """Asks on ``console`` and reads the answers from standard input."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def after_pause(self, text: str, *, idle: Callable[[], None]) -> Choice:
        """Ask until the answer is one of the menu's letters; the end of the input means stop."""
        self._say(text)
        while True:
            answer = self._answer(MENU, idle)
            if answer is None:
                return "stop"
            if answer.lower() in CHOICES:
                return CHOICES[answer.lower()]
            self._say(f"{answer!r} is none of these letters.")

    def has_looked(self, text: str, *, idle: Callable[[], None]) -> bool:
        """Ask for a whole word: nobody types it by leaning on the keyboard."""
        self._say(text)
        question = f"Look at tank, pump and stage. Type {LOOKED} to go on, anything else to stop here."
        return self._answer(question, idle) == LOOKED

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False)

    def _answer(self, question: str, idle: Callable[[], None]) -> str | None:
        """Return one line, or None at the end of the input."""
        self._say(question)
        while not select.select([sys.stdin], [], [], IDLE_S)[0]:
            idle()
        line = sys.stdin.readline()
        return line.strip() if line else None


def person_at_terminal(console: Console) -> Person | None:
    """Return who can be asked: None where standard input is no terminal."""
    return PersonAtTerminal(console) if sys.stdin is not None and sys.stdin.isatty() else None
