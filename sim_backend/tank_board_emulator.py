"""An emulated tank board: lines in, lines out, and the liquid of the world in between."""

import threading

from drivers.protocols import FlowDirection
from sim_backend.tank_board_logic import HEARTBEAT_MS, Inputs, TankBoardLogic
from sim_backend.world import World

LONGEST_LINE = 31
HIGHEST_COUNT = 1023
DIRECTION: dict[str, FlowDirection] = {"FILLING": "fill", "DRAINING": "drain"}


class TankBoardEmulator:
    """A board whose pump moves the liquid of ``world``.

    Parameters
    ----------
    fill_ml_per_s, drain_ml_per_s
        What the pump really moves.
    full_at_ml
        The tank's content at which the over-fill float opens its contact.
    counts_per_ml
        Slope of the level sensor; an empty tank reads 0.
    world_s_per_host_s
        How many of the world's seconds pass in one of the host's. The host's silence is measured in the host's own
        time: a world that runs faster does not make the host any quicker.

    Attributes
    ----------
    leak_open, full_open
        Set to pull a contact open by hand; liquid that ran over the tank's rim opens the leak contact too.
    stuck_level
        Counts that the level sensor reads whatever is in the tank; None while it is well.
    deaf_to, mute_after
        Verbs (``FILL``, ``HB``, ...) of which the next one is lost on its way in, or carried out without a reply.
    """

    def __init__(
        self,
        world: World,
        *,
        fill_ml_per_s: float,
        drain_ml_per_s: float,
        full_at_ml: float | None = None,
        counts_per_ml: float = 0.1,
        world_s_per_host_s: float = 1.0,
    ) -> None:
        self.leak_open = False
        self.full_open = False
        self.stuck_level: int | None = None
        self.deaf_to: list[str] = []
        self.mute_after: list[str] = []
        self.lines: list[str] = []
        self._world = world
        self._ml_per_s: dict[FlowDirection, float] = {"fill": fill_ml_per_s, "drain": drain_ml_per_s}
        self._full_at_ml = world.tank.free_volume_ml if full_at_ml is None else full_at_ml
        self._counts_per_ml = counts_per_ml
        self._heartbeat_ms = round(HEARTBEAT_MS * world_s_per_host_s)
        self._lock = threading.RLock()
        self._buffer = bytearray()
        self._greeting = b""
        self._wake_up()

    # The wire

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the replies."""
        with self._lock:
            self._advance()
            self._buffer += data.replace(b"\r", b"")
            *lines, rest = bytes(self._buffer).split(b"\n")
            self._buffer = bytearray(rest)
            return b"".join(self._answer(line) for line in lines)

    def poll(self) -> bytes:
        """Return the greeting of a board that woke up."""
        with self._lock:
            self._advance()
            greeting, self._greeting = self._greeting, b""
            return greeting

    def _answer(self, line: bytes) -> bytes:
        text = line.decode("latin-1") if len(line) <= LONGEST_LINE else ""
        verb = text.partition(" ")[0]
        if verb in self.deaf_to:
            self.deaf_to.remove(verb)
            return b""
        self.lines.append(text)
        reply = self._logic.command(text, self._now_ms())
        self._follow()
        if verb in self.mute_after:
            self.mute_after.remove(verb)
            return b""
        return reply.encode("latin-1") + b"\n"

    # What can happen to a board

    def power_cycle(self) -> None:
        """Take the power away and bring it back, as opening the port of an Arduino does too."""
        with self._lock:
            self._advance()
            self._world.stop_flow()
            self._wake_up()

    def _wake_up(self) -> None:
        self._woke_s = self._world.clock.now_s()
        self._logic = TankBoardLogic(heartbeat_ms=self._heartbeat_ms)
        self._logic.tick(0, self._inputs())
        self._greeting = self._logic.reply("BOOT").encode() + b"\n"
        self._buffer.clear()

    # The pump

    def _now_ms(self) -> int:
        return round((self._world.clock.now_s() - self._woke_s) * 1000)

    def _inputs(self) -> Inputs:
        state = self._world.state()
        level = min(round(state.tank_ml * self._counts_per_ml), HIGHEST_COUNT)
        level = level if self.stuck_level is None else self.stuck_level
        return Inputs(
            self.leak_open or state.overflow_ml > 0, self.full_open or state.tank_ml >= self._full_at_ml, level
        )

    def _advance(self) -> None:
        now_ms = self._now_ms()
        event_ms = self._logic.next_event_ms()
        # A simulated clock may leap past the moment at which the board stopped by itself.
        if event_ms is not None and event_ms < now_ms:
            self._logic.tick(event_ms, self._inputs())
        self._logic.tick(now_ms, self._inputs())
        if self._logic.state == "IDLE":
            self._world.stop_flow()

    def _follow(self) -> None:
        """Let the world's pump do what the board's pins say, and no longer than the board would let it."""
        if self._logic.state == "IDLE":
            self._world.stop_flow()
            return
        direction = DIRECTION[self._logic.state]
        event_ms = self._logic.next_event_ms()
        assert event_ms is not None  # a board that pumps has an end in sight
        # The moment as the world's clock says it: whole milliseconds would lose liquid at each heartbeat.
        ends_s = self._woke_s + event_ms / 1000
        self._world.start_flow(
            direction,
            rate_ml_per_s=self._ml_per_s[direction],
            volume_ml=float("inf"),
            max_run_s=max(0.0, ends_s - self._world.clock.now_s()),
        )
