"""Camera and display, or the camera alone: what else a rig has need not be plugged in, and stands still."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from drivers.protocols import Camera, Clock, Device, Display
from recon.sessions.manifest import DeviceRecord
from rig.capturing.operators import Operator
from rig.config import RigConfig
from rig.devices import open_devices, real_camera, real_display
from rig.rehearsing.rehearsal import Simulation
from sim_backend.clock import RealClock


@dataclass(frozen=True, slots=True)
class CameraAndDisplay:
    """A camera, the display that it sees if any, and their time; :class:`rig.devices.Devices` has the same parts and more."""

    camera: Camera
    display: Display | None
    clock: Clock
    operator: Operator | None = None

    def records(self) -> dict[str, DeviceRecord]:
        """Return who answered, for the calibration's provenance."""
        named: dict[str, Device | None] = {"camera": self.camera, "display": self.display}
        infos = {name: device.info() for name, device in named.items() if device is not None}
        return {
            name: DeviceRecord(kind=info.kind, model=info.model, address=info.address, version=info.version)
            for name, info in infos.items()
        }


@contextmanager
def open_camera_and_display(config: RigConfig, *, simulation: Simulation | None) -> Iterator[CameraAndDisplay]:
    """Open camera and display alone. Errors as for :func:`rig.devices.open_devices`."""
    if simulation is not None:
        with open_devices(config, simulation=simulation) as devices:
            yield CameraAndDisplay(devices.camera, devices.display, devices.clock, devices.operator)
        return
    display, camera = real_display(config), real_camera(config)
    with display:
        display.screen()  # waits until somebody has opened the page
        with camera:
            yield CameraAndDisplay(camera, display, RealClock())


@contextmanager
def open_camera_alone(config: RigConfig, *, simulation: Simulation | None) -> Iterator[CameraAndDisplay]:
    """Open the camera without a display, for what is printed. Errors as for :func:`rig.devices.open_devices`."""
    if simulation is not None:
        with open_camera_and_display(config, simulation=simulation) as devices:
            yield devices
        return
    with real_camera(config) as camera:
        yield CameraAndDisplay(camera, None, RealClock())
