"""A New Era pump on a pseudo terminal with its driver, which the tests of the pump share."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pump_bench import dry_world

from drivers.new_era_pump import NewEraPump
from sim_backend.clock import SimulatedClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.new_era_memory import Memory
from sim_backend.wire import PtyServer
from sim_backend.world import World

WATCH_EVERY_S = 0.5


@dataclass(frozen=True)
class Bench:
    world: World
    emulator: NewEraEmulator
    wire: PtyServer

    def driver(self, **settings) -> NewEraPump:
        defaults = {"rate_ml_per_min": 600.0, "diameter_mm": 26.59, "reply_timeout_s": 0.3, "kind": "emulated"}
        return NewEraPump(self.wire.address, **(defaults | settings))

    def watch(self, pump: NewEraPump, duration_s: float) -> None:
        for _ in range(round(duration_s / WATCH_EVERY_S)):
            self.world.clock.sleep_s(WATCH_EVERY_S)
            pump.status()


@contextmanager
def bench_with(memory: Memory | None = None) -> Iterator[Bench]:
    world = dry_world(SimulatedClock())
    emulator = NewEraEmulator(world, memory=memory)
    with PtyServer(emulator) as wire:
        yield Bench(world, emulator, wire)
