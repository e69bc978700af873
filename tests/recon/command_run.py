"""How a command ended, and what the person who typed it saw."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Done:
    """How a command ended and what the person saw."""

    returncode: int
    stdout: str
    stderr: str


def one_sentence(done: Done) -> str:
    assert done.returncode != 0
    assert "Traceback" not in done.stderr + done.stdout
    message = done.stderr.strip()
    assert message.startswith("recon: ")
    assert "\n" not in message
    return message
