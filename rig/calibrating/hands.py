"""Whoever holds the calibration board before the camera: a person at this terminal, or in a simulation its hand."""

from typing import Literal, Protocol

from rig.capturing.operators import answered

Answer = Literal["photo", "back", "done"]
ANSWERS: dict[str, Answer] = {"": "photo", "b": "back", "d": "done"}
MENU = "Return: take the photo · b: leave out the last one · d: done "


class Hands(Protocol):
    """Holds the board in another pose whenever asked."""

    def pose(self, number: int, advice: tuple[str, ...]) -> Answer:
        """Hold the board for photo ``number`` of this run; returns when it is still, or what to do instead."""
        ...

    def away(self) -> None:
        """Put the board away."""
        ...


class ConsoleHands:
    """A person at this terminal."""

    def pose(self, number: int, advice: tuple[str, ...]) -> Answer:  # noqa: ARG002  (the advice is on the screen already)
        """Ask until the answer is one of the menu's letters."""
        answer = answered(MENU).lower()
        while answer not in ANSWERS:
            answer = answered(f"{answer!r} is none of these letters. {MENU}").lower()
        return ANSWERS[answer]

    def away(self) -> None:
        """Nothing to do: a person puts it away unasked."""
