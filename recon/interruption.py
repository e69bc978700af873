"""Ctrl-C during a command, which the library of the command line would turn into an exit code without a word."""

from typing import Any

from typer.core import TyperGroup


class Interrupted(Exception):
    """A person stopped the command."""


class InterruptibleCommands(TyperGroup):
    """Commands that raise ``Interrupted`` where a person stops them."""

    def invoke(self, *arguments: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(*arguments)
        except KeyboardInterrupt as stop:
            raise Interrupted from stop
