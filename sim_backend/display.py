"""A simulated display: it shows a frame in the world, and checks that the frame fits its panel."""

from types import TracebackType

from drivers.errors import DeviceProtocolError, DeviceTimeoutError
from drivers.protocols import DeviceInfo, Frame, ScreenInfo
from sim_backend.world import World


class SimulatedDisplay:
    """Shows frames in ``world``. Implements :class:`drivers.protocols.Display`."""

    def __init__(self, world: World, *, columns: int, rows: int, latency_s: float) -> None:
        self._world = world
        self._columns = columns
        self._rows = rows
        self._latency_s = latency_s

    def info(self) -> DeviceInfo:
        """Say that this display is simulated."""
        return DeviceInfo("simulated", "simulated display")

    def screen(self) -> ScreenInfo:
        """Size of the panel in device pixels."""
        return ScreenInfo(self._columns, self._rows)

    def show(self, frame: Frame, *, frame_id: int, timeout_s: float) -> None:
        """Show ``frame``; returns when it is on the glass, or believed to be where the scene's display is slower than it says.

        Raises ``DeviceProtocolError`` for a frame that does not fit.
        """
        self._check(frame)
        commanded_s = self._world.clock.now_s()
        self._world.clock.sleep_s(min(self._latency_s, timeout_s))
        if self._latency_s > timeout_s:
            raise DeviceTimeoutError(
                f"display: frame {frame_id} was not on the glass after {timeout_s:g} s; allow more time"
            )
        self._world.show(frame, frame_id=frame_id, commanded_s=commanded_s)

    def _check(self, frame: Frame) -> None:
        panel = f"the panel has {self._columns} × {self._rows} device pixels"
        if frame.image is not None:
            if frame.axis is not None or frame.levels is not None:
                raise DeviceProtocolError("display: a frame is an image or levels along an axis, this one is both")
            if frame.image.shape != (self._rows, self._columns):
                raise DeviceProtocolError(f"display: an image of shape {frame.image.shape} asked, {panel}")
        elif frame.axis is None or frame.levels is None:
            raise DeviceProtocolError("display: a frame needs an image, or levels and their axis; this one is empty")
        elif frame.levels.shape != ((self._columns if frame.axis == "x" else self._rows),):
            raise DeviceProtocolError(f"display: {frame.levels.size} levels along {frame.axis} asked, {panel}")
        for patch in frame.patches:
            rows, columns = patch.levels.shape
            inside = (0 <= patch.row <= self._rows - rows) and (0 <= patch.column <= self._columns - columns)
            if not inside:
                raise DeviceProtocolError(
                    f"display: a patch of {columns} × {rows} at column {patch.column}, row {patch.row} asked, {panel}"
                )

    def __enter__(self) -> "SimulatedDisplay":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._world.show_nothing()
