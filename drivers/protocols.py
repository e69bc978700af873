"""What the rest of the rig may ask of a device, in our words and not the vendor's.

Each protocol is small, blocking and explicit about time: a call that waits takes ``timeout_s`` and
raises :class:`~drivers.errors.DeviceTimeoutError` when it runs out. Each device is a context manager; leaving
it, by any road, leaves the hardware still and the pump off.
"""

from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt

Axis = Literal["x", "y"]
FlowDirection = Literal["fill", "drain"]
DeviceKind = Literal["real", "simulated", "emulated"]


@runtime_checkable
class Clock(Protocol):
    """Time as the devices feel it. The real one is :func:`time.monotonic`; a test may run it fast."""

    def now_s(self) -> float:
        """Seconds since an arbitrary start; never runs backwards."""
        ...

    def sleep_s(self, duration_s: float) -> None:
        """Let ``duration_s`` seconds of this clock pass."""
        ...


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Who answered: recorded in every session, so that nobody mistakes a simulation for a lab."""

    kind: DeviceKind
    model: str
    address: str = ""
    version: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A small image drawn over a frame: ``levels`` [rows, cols] uint8, its top-left device pixel."""

    column: int
    row: int
    levels: npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What the display gets: drive levels, never the idea of a stripe.

    Either ``axis`` and ``levels`` (one uint8 a device pixel along that axis, constant across the other), or a whole
    ``image`` [rows, cols] uint8. ``patches`` are drawn on top of either.
    """

    axis: Axis | None = None
    levels: npt.NDArray[np.uint8] | None = None
    image: npt.NDArray[np.uint8] | None = None
    patches: tuple[Patch, ...] = ()


@dataclass(frozen=True, slots=True)
class ScreenInfo:
    """What the display says of itself, in device pixels."""

    columns: int
    rows: int
    pixel_ratio: float = 1.0
    visible: bool = True


@dataclass(frozen=True, slots=True)
class Photo:
    """One file as the camera gave it."""

    data: bytes = field(repr=False)
    suffix: str  # ".jpg", ".cr2", ...
    name: str = ""


@dataclass(frozen=True, slots=True)
class PumpStatus:
    """What the pump reports: whether it turns, what it has moved since ``start``, and its alarm if any."""

    running: bool
    direction: FlowDirection | None
    moved_ml: float
    alarm: str = ""


class Device(Protocol):
    """What every device can do."""

    def info(self) -> DeviceInfo:
        """Model, address and version of the device that answers."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class Camera(Device, Protocol):
    """A camera on a tripod. Exposure and download are apart, so that the next frame can be shown between."""

    def settings(self) -> dict[str, str]:
        """The exposure settings read back from the camera."""
        ...

    def setting_choices(self, name: str) -> tuple[str, ...]:
        """The values that the body offers for a setting; empty where it has no such list, or only the body can change it."""
        ...

    def apply_settings(self, settings: dict[str, str]) -> None:
        """Freeze these settings and read them back; raises ``DeviceProtocolError`` where one did not take."""
        ...

    def expose(self, *, timeout_s: float) -> None:
        """Take one photo; returns when the shutter has closed and the display may change."""
        ...

    def collect(self, *, timeout_s: float) -> tuple[Photo, ...]:
        """Download the photo of the last ``expose`` (two files for RAW+JPEG), verified as complete."""
        ...

    def keep_awake(self) -> None:
        """Called now and then while nothing is photographed, so that the body does not fall asleep."""
        ...


class Display(Device, Protocol):
    """The screen in the tank."""

    def screen(self) -> ScreenInfo:
        """Size of the panel in device pixels."""
        ...

    def show(self, frame: Frame, *, frame_id: int, timeout_s: float) -> None:
        """Show ``frame``; returns when it is on the glass."""
        ...


class Stage(Device, Protocol):
    """A linear stage that carries the display."""

    def home(self, *, timeout_s: float) -> None:
        """Find the reference switch; afterwards the position is known."""
        ...

    def is_homed(self) -> bool:
        """Whether the position can be trusted."""
        ...

    def travel_mm(self) -> tuple[float, float]:
        """Smallest and largest position."""
        ...

    def move_to_mm(self, position_mm: float, *, timeout_s: float) -> None:
        """Move and block until settled. Raises ``OutOfTravelError`` before any motion."""
        ...

    def position_mm(self) -> float:
        """Ask the hardware, never a cache."""
        ...

    def stop(self) -> None:
        """Stop now: any time, twice, from ``finally``."""
        ...


class Pump(Device, Protocol):
    """The tank's pump. Every start carries a volume and a longest run time; both end the flow."""

    def start(self, direction: FlowDirection, *, volume_ml: float, max_run_s: float) -> None:
        """Begin to move ``volume_ml``. Raises ``OutOfVolumeError`` for a volume that is not positive."""
        ...

    def status(self) -> PumpStatus:
        """Ask the hardware."""
        ...

    def stop(self) -> None:
        """Stop now: any time, twice, from ``finally``."""
        ...


class LevelSensor(Device, Protocol):
    """Knows how much liquid stands in the tank. Few rigs have one; without it the operator is asked."""

    def volume_ml(self) -> float:
        """What the tank holds now, asked from the hardware."""
        ...
