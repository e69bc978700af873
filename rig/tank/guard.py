"""Asks the interlocks before anything is done, and knows what is under way meanwhile."""

from collections.abc import Iterator
from contextlib import contextmanager

from drivers.protocols import Pump
from rig.capturing.causes import part_of_rig
from rig.config import Tank
from rig.tank.interlocks import Action, ActionKind, RigState, broken_by, told
from rig.tank.ledger_book import LedgerBook


class Guard:
    """Refuses what must not be done now. ``pump`` is None where there is none, or where it was not opened."""

    def __init__(self, *, pump: Pump | None, book: LedgerBook, tank: Tank | None) -> None:
        self._pump = pump
        self._book = book
        self._tank = tank
        self._stage_moves = False
        self._exposing = False

    def check(self, kind: ActionKind, *, volume_ml: float = 0.0) -> None:
        """Raise the error of the first interlock that forbids the action; its message is the sentence for the operator."""
        with part_of_rig("pump"):
            status = None if self._pump is None else self._pump.status()
        state = RigState(
            self._book.ledger, pump=status, stage_moves=self._stage_moves, exposing=self._exposing, tank=self._tank
        )
        action = Action(kind, volume_ml)
        row = broken_by(action, state)
        if row is not None:
            raise row.error(told(row, action, state))

    @contextmanager
    def moving(self) -> Iterator[None]:
        """Let the stage be under way inside the block."""
        self._stage_moves = True
        try:
            yield
        finally:
            self._stage_moves = False

    @contextmanager
    def exposing(self) -> Iterator[None]:
        """Let the shutter be open inside the block."""
        self._exposing = True
        try:
            yield
        finally:
            self._exposing = False
