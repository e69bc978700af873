"""What the commands of ``rig calibrate`` say and ask."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from rig.capturing.operators import answered
from rig.options import Rig

console = Console(soft_wrap=True, highlight=False)
FolderArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder of the calibration; photos are kept in it.")
]


def say(text: str) -> None:
    """Tell the operator one thing, in one line."""
    console.print(text, markup=False)


def ready(rig: Rig, *steps: str) -> None:
    """Say what to prepare, and wait for the return key where somebody is there to press it."""
    for step in steps:
        say(f"· {step}")
    if rig.scene is None and sys.stdin is not None and sys.stdin.isatty():
        say("Press return when it is so.")
        sys.stdin.readline()


def yes(question: str) -> bool:
    """Ask a question whose answer is no unless somebody says yes."""
    return answered(f"{question} [y/N] ").lower() in ("y", "yes")
