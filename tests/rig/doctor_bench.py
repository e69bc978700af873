"""A rig whose every device is an emulator on a real port, with the configuration that finds them."""

import asyncio
import json
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import aiohttp
import numpy as np

from drivers.protocols import Frame
from drivers.stripe_player.address import keep_token
from sim_backend.clock import RealClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.ptpip.process import EmulatedCamera, emulate_camera
from sim_backend.ptpip.sources import DRAWN_COLUMNS, DRAWN_ROWS, drawn_photos
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import TankSize, World, WorldState

TRAVEL_MM = (0.0, 100.0)
COLUMNS, ROWS = 2048, 1536
REPORT = {"columns": COLUMNS, "rows": ROWS, "ratio": 2, "zoom": 1, "visible": True, "fullscreen": True}
REPORT |= {"secure": True, "wake_lock": True, "refresh_hz": 60, "browser": "an emulated tablet"}


@dataclass(frozen=True)
class DoctorBench:
    file: Path
    world: World
    camera: EmulatedCamera
    stage: GrblEmulator
    new_era: NewEraEmulator
    board: TankBoardEmulator
    board_address: str

    def configure(self, **values: str) -> None:
        """Give values of the configuration another content, each written as in TOML."""
        lines = self.file.read_text(encoding="utf-8").splitlines()
        for name, value in values.items():
            at = next(n for n, line in enumerate(lines) if line.split("=")[0].strip(" #") == name)
            lines[at] = f"{name} = {value}"
        self.file.write_text("\n".join(lines) + "\n", encoding="utf-8")


@contextmanager
def emulated_rig(folder: Path) -> Iterator[DoctorBench]:
    """Start the emulators and write ``rig.toml`` into ``folder``; the display's page plays itself as in a tablet."""
    dark = Frame(axis="x", levels=np.zeros(COLUMNS, np.uint8))
    state = WorldState(reservoir_ml=5000.0, stage_mm=37.0)
    world = World(clock=RealClock(), tank=TankSize(6000.0, 4500.0), dark_frame=dark, state=state)
    stage, pump = GrblEmulator(world, travel_mm=TRAVEL_MM), NewEraEmulator(world)
    board = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=10.0)
    token = keep_token(Path(os.environ["XDG_STATE_HOME"]) / "refractive-scan" / "display")
    page = f"127.0.0.1:{_free_port()}"
    with (
        PtyServer(stage) as stage_wire,
        PtyServer(pump) as pump_wire,
        PtyServer(board) as board_wire,
        emulate_camera(drawn_photos(), model="canon-eos-40d") as camera,
        _tablet(page, token),
    ):
        file = folder / "rig.toml"
        file.write_text(resources.files("rig").joinpath("template.toml").read_text("utf-8"), encoding="utf-8")
        bench = DoctorBench(file, world, camera, stage, pump, board, board_wire.address)
        text = file.read_text("utf-8").replace("columns = 3888 ", f"columns = {DRAWN_COLUMNS} ")
        text = text.replace("rows = 2592", f"rows = {DRAWN_ROWS}")
        file.write_text(text, encoding="utf-8")
        bench.configure(
            camera=f'"gphoto2:{camera.address}"',
            display=f'"browser:{page}"',
            stage=f'"grbl:{stage_wire.address}"',
            pump=f'"new_era:{pump_wire.address}"',
            diameter_mm="26.59",
            shutterspeed='"1/4"',
        )
        yield bench


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def _tablet(netloc: str, token: str) -> Iterator[None]:
    """A tablet on which the page is open: it comes back whenever the server does, and acknowledges every frame."""
    over = threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(_play(netloc, token, over)), name="tablet")
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


async def _play(netloc: str, token: str, over: threading.Event) -> None:
    headers = {"Origin": f"http://{netloc}"}
    async with aiohttp.ClientSession(headers=headers) as session:
        while not over.is_set():
            with suppress(aiohttp.ClientError, TimeoutError, TypeError):
                async with session.ws_connect(f"http://{netloc}/socket?token={token}") as page:
                    await page.send_str(json.dumps({"type": "hello", "page_id": "tablet", "report": REPORT}))
                    await _acknowledge(page, over)
            await asyncio.sleep(0.1)


async def _acknowledge(page: aiohttp.ClientWebSocketResponse, over: threading.Event) -> None:
    while not over.is_set():
        with suppress(TimeoutError):
            message = await page.receive(timeout=0.2)
            if message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.ERROR):
                return
            if message.type == aiohttp.WSMsgType.BINARY:
                header = json.loads(message.data[4 : 4 + int.from_bytes(message.data[:4], "little")])
                said = {"type": "ack", "report": REPORT, "run": header["run"], "seq": header["seq"]}
                await page.send_str(json.dumps(said))
