"""Whole captures in which the pump is a real driver on a wire and everything else is simulated, in one world."""

import dataclasses
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.new_era_pump import NewEraPump
from drivers.protocols import Pump
from drivers.tank_board import TankBoard
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.errors import CaptureError
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import World

# So fast that a fill is watched a hundred times and not a thousand times.
RATE_ML_PER_MIN = 9000.0


@contextmanager
def new_era(world: World) -> Iterator[tuple[NewEraEmulator, Pump]]:
    emulator = NewEraEmulator(world, max_rate_ml_per_min=RATE_ML_PER_MIN)
    with (
        PtyServer(emulator) as wire,
        NewEraPump(wire.address, rate_ml_per_min=RATE_ML_PER_MIN, diameter_mm=26.59, kind="emulated") as pump,
    ):
        yield emulator, pump


@contextmanager
def tank_board(world: World) -> Iterator[tuple[TankBoardEmulator, Pump]]:
    rate_ml_per_s = RATE_ML_PER_MIN / 60
    emulator = TankBoardEmulator(world, fill_ml_per_s=rate_ml_per_s, drain_ml_per_s=rate_ml_per_s)
    rates = {"fill_ml_per_min": RATE_ML_PER_MIN, "drain_ml_per_min": RATE_ML_PER_MIN}
    with PtyServer(emulator) as wire, TankBoard(wire.address, **rates, kind="emulated") as pump:
        yield emulator, pump


@pytest.fixture
def fast_config(config: RigConfig) -> RigConfig:
    assert config.tank is not None
    tank = config.tank.model_copy(update={"pump_rate_ml_per_min": RATE_ML_PER_MIN})
    return config.model_copy(update={"tank": tank})


@pytest.mark.parametrize("opened", [new_era, tank_board])
def test_a_capture_fills_and_drains_through_the_driver(
    opened: Callable, open_bench, fast_config: RigConfig, scene, quiet, tmp_path: Path
) -> None:
    with open_bench(fast_config, scene) as (devices, world), opened(world) as (_, pump):
        devices = dataclasses.replace(devices, pump=pump)
        result = capture(fast_config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
        assert result.photos_taken == result.photos_needed
        assert world.disturbed_photos == 0
        assert world.state().overflow_ml == 0
        assert world.state().tank_ml == pytest.approx(0.0, abs=1.0)  # four digits of volume
    manifest = json.loads((tmp_path / "s/manifest.json").read_text(encoding="utf-8"))
    assert manifest["provenance"]["devices"]["pump"]["kind"] == "emulated"


def test_a_leak_during_the_photos_ends_the_capture_before_anything_else_is_done(
    open_bench, fast_config: RigConfig, scene, quiet, tmp_path: Path
) -> None:
    with open_bench(fast_config, scene) as (devices, world), tank_board(world) as (board, pump):
        expose = devices.camera.expose
        photos = iter(range(10**6))

        def wet_at_the_fifth_photo(*, timeout_s: float) -> None:
            expose(timeout_s=timeout_s)
            board.leak_open = next(photos) >= 4

        devices.camera.expose = wet_at_the_fifth_photo
        devices = dataclasses.replace(devices, pump=pump)
        with pytest.raises(CaptureError, match=r"leak contact is open.*it is not safe to"):
            capture(fast_config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
        assert next(photos) < 10


def test_a_power_cut_in_mid_fill_ends_the_capture_with_the_tank_unknown(
    open_bench, fast_config: RigConfig, scene, quiet, tmp_path: Path
) -> None:
    with open_bench(fast_config, scene) as (devices, world), new_era(world) as (emulator, pump):
        status = pump.status

        def power_fails_when_half_is_in():
            if world.flow_direction() == "fill" and world.state().tank_ml > 1000:
                emulator.power_cycle()
            return status()

        pump.status = power_fails_when_half_is_in
        devices = dataclasses.replace(devices, pump=pump)
        with pytest.raises(CaptureError, match=r"unknown; look at the tank.*--checked"):
            capture(fast_config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
        assert world.flow_direction() is None
        assert 1000 < world.state().tank_ml < fast_config.tank.fill_ml
    events = [json.loads(line)["event"] for line in (tmp_path / "s/journal.jsonl").read_text().splitlines()]
    # Intent without end: whoever resumes is asked what the tank holds.
    assert "fill_started" in events
    assert "fill_stopped" not in events
