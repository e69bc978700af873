"""The driver of the tank board against the compiled firmware itself."""

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.tank_board import TankBoard
from sim_backend.wire import PtyServer


class CompiledFirmware:
    """The firmware in a process of its own, on the real clock; contacts closed, no liquid."""

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._start_s = time.monotonic()
        self._lock = threading.Lock()
        self._line = b""
        self.filling = False
        self.filled_s = 0.0
        self._last_s = 0.0

    def step(self, command: str = "-") -> str:
        with self._lock:
            now_s = time.monotonic() - self._start_s
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            self._process.stdin.write(f"{int(now_s * 1000)} 0 0 0 {command or '(empty)'}\n")
            self._process.stdin.flush()
            fill, _, reply = self._process.stdout.readline().rstrip("\n").split(" ", 2)
            self.filled_s += (now_s - self._last_s) * self.filling
            self.filling, self._last_s = fill == "1", now_s
            return reply

    def receive(self, data: bytes) -> bytes:
        *lines, self._line = (self._line + data).split(b"\n")
        return b"".join(self.step(line.decode()).encode() + b"\n" for line in lines)

    def poll(self) -> bytes:
        self.step()
        return b""

    def end(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@contextmanager
def firmware_in(folder: Path, compiler: str) -> Iterator[CompiledFirmware]:
    program = folder / "tank_logic"
    header = Path(__file__).parents[2] / "docs/firmware/tank_board"
    source = Path(__file__).with_name("tank_logic_harness.cpp")
    subprocess.run([compiler, "-std=c++11", f"-I{header}", str(source), "-o", str(program)], check=True)
    firmware = CompiledFirmware(program)
    try:
        yield firmware
    finally:
        firmware.end()


def test_the_driver_runs_on_the_firmware_itself(tmp_path: Path, require_program: Callable[[str, str], str]) -> None:
    with (
        firmware_in(tmp_path, require_program("g++", "g++")) as firmware,
        PtyServer(firmware) as wire,
        TankBoard(wire.address, fill_ml_per_min=600.0, drain_ml_per_min=600.0, kind="emulated") as board,
    ):
        board.start("fill", volume_ml=15.0, max_run_s=60.0)
        while board.status().running:
            time.sleep(0.1)
        assert board.status().moved_ml == pytest.approx(15.0, abs=0.5)  # 10 ml/s and a loop that is not a board's
        assert firmware.filled_s == pytest.approx(1.5, abs=0.05)
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        time.sleep(1.3)  # nobody asks
        assert not firmware.filling
        assert "so it stopped the pump" in board.status().alarm
