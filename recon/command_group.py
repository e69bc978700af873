"""What the library of the command line keeps to itself or says in its own terms, told to a person.

It would turn Ctrl-C into an exit code without a word, and words a value that it refuses as its checks do.
"""

from typing import Any

import typer
from pydantic import ValidationError
from typer.core import TyperGroup

from recon.bad_value import reason_of


class Interrupted(Exception):
    """A person stopped the command."""


class CommandGroup(TyperGroup):
    """Commands that raise ``Interrupted`` where a person stops them, and say plainly what is wrong with an option's value."""

    def invoke(self, *arguments: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(*arguments)
        except KeyboardInterrupt as stop:
            raise Interrupted from stop
        except typer.BadParameter as bad:
            if isinstance(bad.__cause__, ValidationError):
                bad.message = f"{reason_of(bad.__cause__.errors()[0]).rstrip('.')}."
            raise
