"""The command ``recon`` as its user meets it."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command_run import Done, one_sentence

from recon.cli import main


@pytest.fixture
def recon(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Run the command as the installed program does: the same ``main``, arguments from ``sys.argv``."""

    def run(*arguments: str | Path) -> Done:
        monkeypatch.setattr(sys, "argv", ["recon", *map(str, arguments)])
        capsys.readouterr()
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(bool(stop.code))
        captured = capsys.readouterr()
        return Done(code, captured.out, captured.err)

    return run


@pytest.fixture
def refusal(recon: Callable[..., Done]) -> Callable[..., str]:
    """Run the command, which must refuse in one sentence; return the sentence."""

    def run(*arguments: str | Path) -> str:
        return one_sentence(recon(*arguments))

    return run
