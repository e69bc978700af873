"""The two devices that a measurement of the display needs; stage and pump need not be plugged in, and stand still."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from drivers.protocols import Camera, Clock, Device, Display
from recon.sessions.manifest import DeviceRecord
from rig.config import RigConfig
from rig.devices import open_devices, real_camera, real_display
from rig.rehearsing.rehearsal import Simulation
from sim_backend.clock import RealClock


@dataclass(frozen=True, slots=True)
class CameraAndDisplay:
    """A camera, the display that it sees, and their time; :class:`rig.devices.Devices` has the same parts and more."""

    camera: Camera
    display: Display
    clock: Clock

    def records(self) -> dict[str, DeviceRecord]:
        """Return who answered, for the calibration's provenance."""
        named: dict[str, Device] = {"camera": self.camera, "display": self.display}
        infos = {name: device.info() for name, device in named.items()}
        return {
            name: DeviceRecord(kind=info.kind, model=info.model, address=info.address, version=info.version)
            for name, info in infos.items()
        }


@contextmanager
def open_camera_and_display(config: RigConfig, *, simulation: Simulation | None) -> Iterator[CameraAndDisplay]:
    """Open camera and display alone. Errors as for :func:`rig.devices.open_devices`."""
    if simulation is not None:
        with open_devices(config, simulation=simulation) as devices:
            yield CameraAndDisplay(devices.camera, devices.display, devices.clock)
        return
    display, camera = real_display(config), real_camera(config)
    with display:
        display.screen()  # waits until somebody has opened the page
        with camera:
            yield CameraAndDisplay(camera, display, RealClock())
