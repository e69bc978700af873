"""The file that keeps a simulated rig between programs: a tank does not empty itself because a program was killed.

It is written anew, whole, whenever somebody does something to the world; the time alone, which moves thousands of times in
a capture, is written over in its place. What is under way when a program dies can so be computed for any later moment.
"""

import json
import os
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from drivers.errors import DeviceProtocolError
from sim_backend.world import Flow, Motion, WorldState

TIME_KEY = b'{"at_s": '
TIME_CHARACTERS = 26  # room for any float


class WorldFile:
    """Keeps the state of a simulated rig in the file ``path``; no call flushes it, as only power cuts ask for that."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: int | None = None

    def keep(self, state: WorldState) -> None:
        """Write the state, whole or not at all."""
        rest = {key: value for key, value in asdict(state).items() if key != "at_s"}
        text = TIME_KEY + _time_text(state.at_s) + b",\n" + json.dumps(rest, indent=2)[2:].encode() + b"\n"
        temporary = self._path.with_name(self._path.name + ".part")
        file = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
        os.write(file, text)
        temporary.replace(self._path)
        self.close()
        self._file = file

    def keep_time(self, now_s: float) -> None:
        """Write that it is ``now_s``, and that nothing else has changed."""
        if self._file is not None:
            os.pwrite(self._file, _time_text(now_s), len(TIME_KEY))

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def save_state(state: WorldState, path: Path) -> None:
    """Write the lasting state of a simulated rig as JSON, whole or not at all."""
    file = WorldFile(path)
    file.keep(state)
    file.close()


def load_state(path: Path) -> WorldState:
    """Read what :class:`WorldFile` wrote; raises ``DeviceProtocolError`` for a file that is something else."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        data = None
    if not isinstance(data, dict) or set(data) != {field.name for field in fields(WorldState)}:
        raise DeviceProtocolError(
            f"{path}: not the state of a simulated rig; name another file, or remove this one to start with an empty tank"
        )
    under_way: dict[str, Any] = {
        "flow": Flow(**data["flow"]) if data["flow"] else None,
        "motion": Motion(**data["motion"]) if data["motion"] else None,
    }
    return WorldState(**(data | under_way))


def after_restart(state: WorldState, now_s: float) -> WorldState:
    """Return a state whose clock began anew, at ``now_s``: what was under way has long ended."""
    flow, motion = state.flow, state.motion
    return replace(
        state,
        flow=replace(flow, started_s=now_s - flow.runs_s) if flow else None,
        stage_mm=motion.to_mm if motion else state.stage_mm,
        motion=None,
        at_s=now_s,
    )


def _time_text(now_s: float) -> bytes:
    return repr(float(now_s)).rjust(TIME_CHARACTERS).encode()
