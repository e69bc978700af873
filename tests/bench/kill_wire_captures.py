"""Kill captures that drive real drivers, and resume them: ``python -m tests.bench.kill_wire_captures`` prints JSON.

Stage and pump are emulated on pseudo terminals and the camera on PTP/IP, all in another process than the capture, which is ended
by SIGKILL at a random instant: they go on as devices on a bench do, the pump until its dead-man timer ends it. Every third time
the whole bench loses its power with the capture: pump, stage and camera begin anew, as after a reboot of everything. Only
the display and the person at the tank are simulated, over a socket. Time passes ``SPEED`` times as fast as in a lab.
"""

import argparse
import json
import os
import random
import signal
import sys
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Client, Connection, Listener, Pipe
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

from rich.console import Console

from drivers.errors import DeviceError
from drivers.protocols import Clock, Frame
from recon.errors import ReconError
from rig.capturing.capture import capture
from rig.config import DeviceAddresses, RigConfig
from rig.devices import DISPLAY_LATENCY_S, real_devices
from rig.errors import RigError
from rig.planning.plan import all_photos
from rig.planning.steps import Request
from rig.rehearsing.emulation import PUMP_DIAMETER_MM
from rig.rehearsing.rehearsal import SimulatedOperator, fresh_state, new_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.tank.ledger_book import book_of
from sim_backend.clock import FastClock
from sim_backend.display import SimulatedDisplay
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.photography import Photographer
from sim_backend.ptpip.process import emulate_camera
from sim_backend.ptpip.world_photos import COMMENT, WorldPhotos
from sim_backend.scene import Scene
from sim_backend.wire import PtyServer
from sim_backend.world import World
from tests.bench._crash_judge import Judge, ShutterLog, good_photos, journal_lines

OPTIONS = SceneOptions(camera_columns=32, display_columns=32, step_px=4.0)
SPEED = 10.0
PUMP_RATE_ML_PER_MIN = 9000.0
DEAD_MAN_S = 1
LONGEST_GONE_S = 3.0
POWER_CUT_SHARE = 1 / 3
# An exposure that the killed capture had begun ends without it.
LAST_EXPOSURE_S = 0.3


def quick_rig() -> tuple[RigConfig, Scene]:
    """Return a rig that is small and does not wait; real drivers take their time all the same."""
    scene = open_scene("semi_ellipsoid", OPTIONS)
    config = config_of_scene(scene, OPTIONS)
    assert config.tank is not None
    timing = {"photo_s": 0.1, "settle_s": 0.0, "still_after_move_s": 0.0, "still_after_fill_s": 0.0}
    changes = {
        "timing": config.timing.model_copy(update=timing),
        "tank": config.tank.model_copy(update={"pump_rate_ml_per_min": PUMP_RATE_ML_PER_MIN}),
        "pump": config.pump.model_copy(update={"diameter_mm": PUMP_DIAMETER_MM, "dead_man_s": DEAD_MAN_S}),
    }
    return config.model_copy(update=changes), scene


class Surroundings:
    """The display and the person beside the tank, as a capture reaches them over a socket."""

    def __init__(self, address: str, clock: Clock) -> None:
        self.clock = clock
        self._line = Client(address)

    def show(self, frame: Frame, *, frame_id: int | None, **_: object) -> None:
        """Put a frame on the glass."""
        self._ask("show", frame, frame_id)

    def show_nothing(self) -> None:
        """Let the glass go dark."""
        self._ask("show_nothing")

    def do(self, request: Request, text: str) -> None:
        """Do something by hand."""
        self._ask("do", request, text)

    def tank_ml(self, *, fill_ml: float) -> float:
        """Look at the tank."""
        return self._ask("tank_ml", fill_ml)

    def _ask(self, *question: Any) -> Any:
        self._line.send(question)
        return self._line.recv()


def serve_surroundings(listener: Listener, world: World) -> None:
    """Answer one capture after another until the listener is closed."""
    operator = SimulatedOperator(world)
    while True:
        try:
            line = listener.accept()
        except OSError:
            return
        threading.Thread(target=_answer_capture, args=(line, world, operator), daemon=True).start()


def _answer_capture(line: Connection, world: World, operator: SimulatedOperator) -> None:
    while True:
        try:
            question, *values = line.recv()
        except (EOFError, OSError):  # the capture has ended, or was killed
            return
        answer = None
        match question:
            case "show":
                world.show(values[0], frame_id=values[1])
            case "show_nothing":
                world.show_nothing()
            case "do":
                operator.do(values[0], values[1])
            case "tank_ml":
                answer = operator.tank_ml(fill_ml=values[0])
        line.send(answer)


@dataclass(frozen=True, slots=True)
class Order:
    """What a capture is told."""

    config: RigConfig
    scene: Scene
    folder: Path
    surroundings: str


def be_the_capture(order: Order) -> int:
    """Begin or resume the capture with real drivers; return its exit code."""
    clock = FastClock(SPEED)
    around: Any = Surroundings(order.surroundings, clock)
    panel = order.config.display
    display = SimulatedDisplay(around, columns=panel.columns, rows=panel.rows, latency_s=DISPLAY_LATENCY_S)
    session = order.folder / "session"
    begun = (session / "manifest.json").exists()
    book = book_of(order.config, order.folder / "liquid.jsonl")
    devices = real_devices(order.config, display=display, operator=around, clock=clock, book=book, kind="emulated")
    try:
        with ExitStack() as stack:
            for device in (devices.display, devices.camera, devices.stage, devices.pump):
                if device is not None:
                    stack.enter_context(device)
            console = Console(file=sys.stdout)
            capture(order.config, session, devices=devices, scene=order.scene, resume=begun, console=console)
    except (RigError, ReconError, DeviceError) as error:
        print(f"rig: {error}")
        return 1
    return 0


def serve_captures(orders: Connection) -> NoReturn:
    """Run captures, each in a process of its own, for a process that has threads and cannot fork."""
    while True:
        try:
            order = orders.recv()
        except EOFError:
            os._exit(0)
        process = os.fork()
        if process == 0:
            out = os.open(order.folder / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(out, 1)
            os.dup2(out, 2)
            code = 99
            try:
                code = be_the_capture(order)
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            os._exit(code)
        orders.send(process)
        orders.send(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]))


@dataclass(slots=True)
class Rehearsal:
    """One rig with its session: what stands on the bench while captures come and go."""

    order: Order
    world: World
    log: ShutterLog
    captures: Connection
    lose_power: Callable[[], None]
    power_cuts: int = 0

    @property
    def session(self) -> Path:
        """The session's folder."""
        return self.order.folder / "session"

    def run(self, *, killed_after_s: float | None = None) -> int:
        """Run the capture, perhaps to its violent end; return its exit code, negative for a signal."""
        self.captures.send(self.order)
        process = self.captures.recv()
        if killed_after_s is not None and not self.captures.poll(killed_after_s):
            os.kill(process, signal.SIGKILL)
        return self.captures.recv()


@contextmanager
def rehearsal(folder: Path, photographer: Photographer, captures: Connection) -> Iterator[Rehearsal]:
    """Put a new rig on the bench: the liquid in the reservoir, the devices switched on."""
    folder.mkdir()
    config, scene = quick_rig()
    assert config.tank is not None
    clock = FastClock(SPEED)
    world = new_world(config, clock, fresh_state(config))
    log = ShutterLog(folder / "shutter.log")
    look = world.look

    def logged(**seen: Any) -> Any:
        sight = look(**seen)
        log.add(sight.frame_id, disturbed=sight.disturbed)
        return sight

    watched: Any = world
    watched.look = logged
    with ExitStack() as stack:
        camera = stack.enter_context(emulate_camera(WorldPhotos(world, photographer)))
        stage_emulator = GrblEmulator(world, travel_mm=config.stage.travel_mm)
        pump_emulator = NewEraEmulator(world, max_rate_ml_per_min=PUMP_RATE_ML_PER_MIN, world_s_per_host_s=SPEED)
        stage, pump = (stack.enter_context(PtyServer(one)) for one in (stage_emulator, pump_emulator))
        listener = stack.enter_context(Listener(family="AF_UNIX"))
        threading.Thread(target=serve_surroundings, args=(listener, world), daemon=True).start()
        addresses = DeviceAddresses(
            camera=f"gphoto2:{camera.address}", stage=f"grbl:{stage.address}", pump=f"new_era:{pump.address}"
        )
        order = Order(config.model_copy(update={"devices": addresses}), scene, folder, str(listener.address))

        def lose_power() -> None:
            pump_emulator.power_cycle()
            stage_emulator.power_cycle()
            camera.pull_cable()
            camera.replace()

        yield Rehearsal(order, world, log, captures, lose_power)


def without_number(data: bytes) -> bytes:
    """Return a photo's file without the comment that tells it from another photo of the same."""
    start = data.find(COMMENT)
    return data if start < 0 else data[:start] + data[start + 2 + int.from_bytes(data[start + 2 : start + 4], "big") :]


def run_session(
    rig: Rehearsal, judge: Judge, rng: random.Random, whole_s: float, died_in: Counter[str]
) -> list[str] | None:
    """Kill and resume one session; return its faults, or None where no kill hit it."""
    good: dict[Any, int] = {}
    kills = 0
    for _ in range(rng.choice([1, 1, 2, 3])):
        left = judge.share_left(rig.session)
        if rig.run(killed_after_s=rng.uniform(0, whole_s * left)) != -signal.SIGKILL:
            continue
        kills += 1
        if rng.random() < POWER_CUT_SHARE:
            rig.lose_power()
            rig.power_cuts += 1
        time.sleep(LAST_EXPOSURE_S)
        lines = journal_lines(rig.session)
        died_in[lines[-1]["event"] if lines else "nothing written"] += 1
        good = judge.releases_of_good(rig.session, rig.log) | good
        time.sleep(rng.choice([0.0, rng.uniform(0, LONGEST_GONE_S)]))
    if not kills:
        return None
    code = rig.run()
    said = (rig.order.folder / "said.txt").read_text(encoding="utf-8")
    faults = judge.faults(rig.session, rig.log, good)
    state = rig.world.state()
    if code != 0 or "Traceback" in said:
        faults.append(f"ended with {code}: {said[-600:]}")
    if state.overflow_ml or state.flow is not None:
        faults.append(f"the tank ran over by {state.overflow_ml} ml, or the pump still runs")
    return faults


def main() -> None:
    """Kill, resume, judge; end with 1 if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    captures, theirs = Pipe()
    server = os.fork()  # before any thread is started
    if server == 0:
        captures.close()
        serve_captures(theirs)
    theirs.close()
    rng = random.Random(given.seed)
    died_in: Counter[str] = Counter()
    faults: dict[int, list[str]] = {}
    sessions = in_vain = power_cuts = 0
    config, scene = quick_rig()
    photographer = Photographer(scene)
    with TemporaryDirectory(prefix="killed-wire-") as folder:
        with rehearsal(Path(folder) / "undisturbed", photographer, captures) as rig:
            begun_s = time.monotonic()
            if rig.run() != 0:
                raise SystemExit((rig.order.folder / "said.txt").read_text(encoding="utf-8"))
            whole_s = time.monotonic() - begun_s
            frames = {photo.key: photo.frame_id for photo in all_photos(config)}
            photos = good_photos(rig.session)
        judge = Judge({key: photos[key] for key in frames}, frames, plain=without_number)
        number = 0
        while sessions < given.sessions:
            number += 1
            with rehearsal(Path(folder) / f"{number:04d}", photographer, captures) as rig:
                found = run_session(rig, judge, rng, whole_s, died_in)
                if found is not None:
                    sessions += 1
                    in_vain += judge.shot_in_vain(rig.log)
                    power_cuts += rig.power_cuts
                if found:
                    faults[number] = found
    captures.close()
    os.waitpid(server, 0)
    result = {
        "sessions": sessions,
        "kills": died_in.total(),
        "kills_with_a_power_cut_of_the_bench": power_cuts,
        "seconds_of_an_undisturbed_capture": round(whole_s, 1),
        "photos_a_session": len(judge.expected),
        "photos_in_doubt_shot_again": in_vain,
        "last_event_before_the_kill": dict(died_in.most_common()),
        "sessions_with_faults": faults,
    }
    sys.stdout.write(json.dumps(result, indent=2) + "\n")
    raise SystemExit(bool(faults))


if __name__ == "__main__":
    main()
