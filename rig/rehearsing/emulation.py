"""A whole rig of emulated devices that share one world: what ``rig capture --sim-wire`` drives with the real drivers.

The camera speaks PTP/IP, the stage GRBL and the pump New Era's protocol, each on a port of this machine; the display's page
is shown by Chromium. The camera photographs what Chromium's screen shows when the shutter closes, not what the rig believes
to have sent there.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from drivers.errors import DeviceError
from rig.config import DeviceAddresses, RigConfig
from sim_backend.browser_tablet import BrowserTablet
from sim_backend.chromium import Chromium
from sim_backend.exposure import TakesPhotos
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.ptpip.process import EmulatedCamera, Model, emulate_camera
from sim_backend.ptpip.world_photos import WorldPhotos
from sim_backend.wire import PtyServer
from sim_backend.world import World

# A New Era pump chooses its units by the inside diameter of what is mounted; this one counts in millilitres.
PUMP_DIAMETER_MM = 26.59
DISPLAY_ADDRESS = "browser:127.0.0.1:0"


@dataclass(frozen=True, slots=True)
class EmulatedRig:
    """``config`` names the emulators' addresses; ``tablet`` opens the display's page; ``camera`` takes faults."""

    config: RigConfig
    tablet: BrowserTablet
    camera: EmulatedCamera


@contextmanager
def emulate_rig(
    config: RigConfig,
    world: World,
    optics: TakesPhotos,
    *,
    camera_model: Model = "generic",
    exposure_s: float = 0.0,
    download_s: float = 0.0,
) -> Iterator[EmulatedRig]:
    """Start an emulator of every device that ``config`` needs; they end with the context.

    Raises
    ------
    DeviceNotFoundError
        When Chromium is not installed, or an emulator does not start.
    DeviceError
        On leaving, when Chromium failed while the camera looked at it.
    """
    world.stop_flow()  # these devices are switched on only now
    world.stop_motion()
    with ExitStack() as stack:
        chromium = stack.enter_context(Chromium())
        tablet = BrowserTablet(chromium, columns=config.display.columns, rows=config.display.rows)
        eyes = TabletPhotos(world, optics, tablet)
        camera = stack.enter_context(
            emulate_camera(eyes, model=camera_model, exposure_s=exposure_s, download_s=download_s)
        )
        stage = stack.enter_context(PtyServer(GrblEmulator(world, travel_mm=config.stage.travel_mm)))
        pump_address = ""
        if config.tank is not None and config.tank.has_pump:
            emulator = NewEraEmulator(world, max_rate_ml_per_min=config.tank.pump_rate_ml_per_min)
            pump_address = f"new_era:{stack.enter_context(PtyServer(emulator)).address}"
        addresses = DeviceAddresses(
            camera=f"gphoto2:{camera.address}",
            display=DISPLAY_ADDRESS,
            stage=f"grbl:{stage.address}",
            pump=pump_address,
        )
        pump = config.pump.model_copy(update={"diameter_mm": PUMP_DIAMETER_MM})
        addressed = config.model_copy(update={"devices": addresses, "pump": pump})
        try:
            yield EmulatedRig(addressed, tablet, camera)
        finally:
            if eyes.failure is not None:
                raise eyes.failure


class TabletPhotos:
    """Photographs the world with the tablet's screen in it. ``failure`` is why there was no photo."""

    def __init__(self, world: World, optics: TakesPhotos, tablet: BrowserTablet) -> None:
        self._world = world
        self._tablet = tablet
        self._photos = WorldPhotos(world, optics)
        self.failure: DeviceError | None = None

    def open_shutter(self) -> None:
        """Begin to see."""
        self._look()
        self._photos.open_shutter()

    def close_shutter(self) -> None:
        """End to see."""
        self._look()
        self._photos.close_shutter()

    def develop(self) -> bytes:
        """Return the file of what was seen."""
        return self._photos.develop()

    def __call__(self) -> bytes:
        """Return the file of a photo that takes no time."""
        self._look()
        return self._photos()

    def _look(self) -> None:
        """Put into the world what the screen shows now."""
        try:
            self._world.show(self._tablet.frame(), frame_id=None)
        except DeviceError as error:
            self.failure = error
            raise ConnectionError(str(error)) from error  # to the camera, its owner is gone
