"""A simulated camera: it photographs what the world shows while its shutter is open."""

from collections.abc import Mapping
from fractions import Fraction
from types import TracebackType

from drivers.errors import DeviceBusyError, DeviceProtocolError, DeviceTimeoutError
from drivers.protocols import DeviceInfo, Photo
from sim_backend.exif import Exposure, with_exif
from sim_backend.exposure import TakesPhotos, WorldExposure
from sim_backend.world import World

# What can be set on this body, and stands in its photos. The scene's own brightness is that of these settings; others get more
# or less light. Where the scene's display changes with time, the shutter is open for as long as it is set to.
DEFAULT_SETTINGS = {"shutter": "1/4", "aperture": "8", "iso": "100", "white_balance": "daylight", "focus": "manual"}
# The shutter's times, by thirds of a stop, in the words of cameras.
SHORT_TIMES = "1/125 1/100 1/80 1/60 1/50 1/40 1/30 1/25 1/20 1/15 1/13 1/10 1/8 1/6 1/5 1/4"
LONG_TIMES = "0.3 0.4 0.5 0.6 0.8 1 1.3 1.6 2 2.5 3.2 4"


def light_of_settings(settings: Mapping[str, str]) -> Fraction:
    """Return how many times the light of ``DEFAULT_SETTINGS`` reaches the sensor: time, sensitivity, area of the aperture."""

    def ratio(name: str) -> Fraction:
        return Fraction(settings[name]) / Fraction(DEFAULT_SETTINGS[name])

    return ratio("shutter") * ratio("iso") / ratio("aperture") ** 2


def developed(photo: bytes, settings: Mapping[str, str]) -> bytes:
    """Return the file of a photo that was taken with ``settings``, which stand in its Exif."""
    exposure = Exposure(Fraction(settings["shutter"]), Fraction(settings["aperture"]), int(settings["iso"]))
    return with_exif(photo, exposure)


class SimulatedCamera:
    """Photographs ``world`` through ``optics``. Implements :class:`drivers.protocols.Camera`.

    ``dial_turned`` counts the photos to come for which somebody turns the dial to twice the time, and back again.
    """

    def __init__(self, world: World, optics: TakesPhotos, *, exposure_s: float, download_s: float) -> None:
        self._world = world
        self._exposure = WorldExposure(world, optics)
        self._exposure_s = exposure_s
        self._download_s = download_s
        self._settings = dict(DEFAULT_SETTINGS)
        self._exposed = False
        self._count = 0
        self.dial_turned = 0

    def info(self) -> DeviceInfo:
        """Say that this camera is simulated."""
        return DeviceInfo("simulated", "simulated camera")

    def settings(self) -> dict[str, str]:
        """The settings as they stand."""
        return dict(self._settings)

    def setting_choices(self, name: str) -> tuple[str, ...]:
        """The values that this body offers."""
        return tuple(f"{SHORT_TIMES} {LONG_TIMES}".split()) if name == "shutter" else ()

    def apply_settings(self, settings: dict[str, str]) -> None:
        """Take over these settings; raises ``DeviceProtocolError`` for one that this camera does not have."""
        unknown = sorted(set(settings) - set(self._settings))
        if unknown:
            raise DeviceProtocolError(
                f"camera: setting {unknown[0]!r} asked, this camera has {', '.join(sorted(self._settings))}"
            )
        wanted = self._settings | settings
        try:
            developed(b"", wanted)
        except (ValueError, ZeroDivisionError):
            raise DeviceProtocolError(
                f"camera: {settings} asked; shutter takes seconds such as 1/4, aperture and iso take numbers"
            ) from None
        self._settings = wanted

    def _settings_of_photo(self) -> dict[str, str]:
        if self.dial_turned == 0:
            return self._settings
        self.dial_turned -= 1
        return self._settings | {"shutter": str(2 * Fraction(self._settings["shutter"]))}

    def expose(self, *, timeout_s: float) -> None:
        """Take one photo; the display may change when this returns."""
        if self._exposed:
            raise DeviceBusyError("camera: a second photo asked before the first was collected; collect it first")
        open_s = self._exposure.lasts_s(float(Fraction(self._settings["shutter"])))
        self._exposure.open_shutter()
        self._wait(self._exposure_s if open_s is None else open_s, timeout_s=timeout_s, what="the exposure")
        self._exposure.close_shutter()
        self._exposed = True

    def collect(self, *, timeout_s: float) -> tuple[Photo, ...]:
        """Develop and hand over the photo of the last ``expose``."""
        if not self._exposed:
            raise DeviceProtocolError("camera: a photo was asked for, but none was taken; expose first")
        self._wait(self._download_s, timeout_s=timeout_s, what="the download")
        self._exposed = False
        settings = self._settings_of_photo()
        data = developed(self._exposure.develop(light=float(light_of_settings(settings))), settings)
        self._count += 1
        return (Photo(data, ".jpg", f"sim{self._count:05d}.jpg"),)

    def keep_awake(self) -> None:
        """A simulated camera does not fall asleep."""

    def _wait(self, duration_s: float, *, timeout_s: float, what: str) -> None:
        self._world.clock.sleep_s(min(duration_s, timeout_s))
        if duration_s > timeout_s:
            raise DeviceTimeoutError(f"camera: {what} was not over after {timeout_s:g} s; allow more time")

    def __enter__(self) -> "SimulatedCamera":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._exposed = False
