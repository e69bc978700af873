"""The person beside the tank, as the sequencer sees them: somebody to ask, who answers when it is done."""

import sys
from typing import Protocol

from rig.errors import CaptureError
from rig.planning.steps import Request


class Operator(Protocol):
    """Does by hand what no device does, and says how much is in the tank."""

    def do(self, request: Request, text: str) -> None:
        """Ask for it; returns when it is done."""
        ...

    def tank_ml(self, *, fill_ml: float) -> float:
        """Ask what the tank holds now."""
        ...


class ConsoleOperator:
    """A person at this terminal."""

    def do(self, request: Request, text: str) -> None:  # noqa: ARG002  (the text says it all)
        """Show the text and wait for the return key."""
        answered(f"{text}\nPress return when it is done. ")

    def tank_ml(self, *, fill_ml: float) -> float:
        """Ask until the answer is a volume."""
        question = f"How much liquid is in the tank, in ml? (0 = empty, {fill_ml:g} = filled) "
        while True:
            answer = answered(question)
            try:
                volume_ml = float(answer)
            except ValueError:
                volume_ml = -1.0
            if 0 <= volume_ml < float("inf"):
                return volume_ml
            question = f"{answer!r} is not a volume; a number from 0 upwards, please: "


def answered(question: str) -> str:
    """Ask a person and return one line; an error where nobody is at the terminal."""
    if not sys.stdin.isatty():
        raise CaptureError(
            f"a person has to answer ({question.strip().splitlines()[0]!r}), but nobody is at this terminal; "
            "run the command in an interactive terminal"
        )
    try:
        return input(question).strip()
    except EOFError:
        raise CaptureError("the question was not answered; run the command again") from None
