"""Measure the display's response with the configured devices: photos of levels, of changes, at shutter times, over minutes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version

import numpy as np

from drivers.errors import DeviceProtocolError
from recon.calibration.brightness_drift import drift_warnings, fit_drift
from recon.calibration.display_light import (
    clipped_share,
    lit_region,
    mean_value,
    places_of,
    row_values,
    upper_and_lower,
)
from recon.calibration.flicker import (
    FEWEST_SHUTTERS,
    Swing,
    bands_of,
    fit_flicker,
    flicker_warnings,
    safe_times,
    swing_of,
)
from recon.calibration.latency import fit_rolling_latency, latency_warnings
from recon.calibration.level_response import fit_levels, level_warnings
from recon.calibration.primary_planes import measure_planes, primary_warnings
from recon.calibration.response_record import (
    ResponseRecord,
    drift_record,
    flicker_record,
    latency_record,
    level_record,
    planes_record,
)
from recon.sessions.journal import now_text
from rig.calibrating.calibration_devices import CameraAndDisplay
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.calibration_photos import CalibrationCamera, Taken
from rig.capturing.exposure_check import TIME_NAMES, exposure_of_settings
from rig.config import RigConfig
from rig.errors import CaptureError

LEVELS = tuple(range(0, 256, 15))
LEVEL_ROUNDS = 3
# Long enough for any display to be at rest before it is changed again.
REST_S = 1.0
LATENCY_PHOTOS = 32
LATEST_S = 0.6
SHUTTER_DIVISORS = (1000, 800, 640, 500, 400, 320, 250, 200, 160, 125, 100, 80, 60)
PHOTOS_A_SHUTTER = 8
# Photos of flicker must not keep step with it: the wait between them grows by the golden ratio of 20 ms, over and over.
ISO, HIGHEST_ISO = "iso", 6400.0
JITTER_S, GOLDEN = 0.02, 0.618034
DRIFT_PHOTOS = 11
# What is left of the flicker below this share of the light moves no stripe.
LARGEST_SWING = 0.005
# Darker than this share of the range, a photo says nothing of flicker.
DARKEST_SHARE = 0.02
SMALLEST_REGION = 0.005


@dataclass(slots=True)
class ResponseCapture:
    """Takes the photos of a display's response; ``say`` tells the operator what is done and what was found."""

    devices: CameraAndDisplay
    config: RigConfig
    folder: CalibrationFolder
    say: Callable[[str], None]
    camera: CalibrationCamera = field(init=False)
    settings: dict[str, str] = field(init=False)
    region: np.ndarray = field(init=False)
    white: Taken = field(init=False)
    black: Taken = field(init=False)
    found: dict[str, object] = field(init=False, default_factory=dict)
    warnings: list[str] = field(init=False, default_factory=list)
    left_out: dict[str, str] = field(init=False, default_factory=dict)

    def run(self, *, minutes: float) -> ResponseRecord:
        """Measure everything; what cannot be measured is left out with its reason.

        Raises
        ------
        CaptureError
            Where the camera does not see the display lit.
        """
        self.camera = CalibrationCamera(self.devices, self.config, self.folder)
        self.camera.set(self.config.camera.settings if self.devices.camera.info().kind == "real" else {})
        self.settings = dict(self.camera.settings)
        self._look()
        self._measure("levels", self._levels)
        self._measure("latency", self._latency)
        self._measure("flicker", self._flicker)
        self._measure("drift", lambda: self._drift(minutes))
        self._measure("planes", self._planes)
        return ResponseRecord.model_validate(
            {
                "schema_version": 1,
                "name": self.config.name,
                "created": now_text(),
                "display": self.config.display,
                "settings": self.settings,
                "warnings": tuple(self.warnings),
                "left_out": self.left_out,
                "software": {"refractive-scan": version("refractive-scan")},
                "devices": self.devices.records(),
                "photos": tuple(self.folder.photos),
                **self.found,
            }
        )

    def _measure(self, name: str, step: Callable[[], object]) -> None:
        try:
            self.found[name] = step()
        except ValueError as why:
            self.left_out[name] = f"{str(why)[0].upper()}{str(why)[1:]}."
            self.say(f"{name}: not measured. {self.left_out[name]}")

    def _warn(self, warnings: tuple[str, ...]) -> None:
        for warning in warnings:
            self.warnings.append(warning)
            self.say(f"! {warning}")

    def _steady(self, level: int) -> Taken:
        self.camera.show_level(level)
        return self.camera.take(f"level {level}", after_s=REST_S)

    def _look(self) -> None:
        """Find the part of the photo that sees the display."""
        self.white, self.black = self._steady(255), self._steady(0)
        self.region = lit_region(self.white.grey, self.black.grey)
        share = float(self.region.mean())
        if share < SMALLEST_REGION:
            raise CaptureError(
                "the camera does not see the display light up: point it at the display, take off the lens cap, and check with "
                "`rig display show white` and `rig camera snap`"
            )
        self.say(
            f"the display is seen in {100 * share:.0f} % of the photo: black {mean_value(self.black.grey, self.region):.1f}, "
            f"white {mean_value(self.white.grey, self.region):.1f} of {self._full_scale():.0f}"
        )

    def _full_scale(self) -> float:
        return 255.0 if self.white.grey.dtype == np.uint8 else 65535.0

    def _levels(self) -> object:
        self.say(f"levels: {len(LEVELS) * LEVEL_ROUNDS} photos of {len(LEVELS)} levels")
        levels, values, clipped = [], [], []
        # Each round goes through the levels in another order, so that a drift is no part of the curve.
        order = np.random.default_rng(1)
        for _ in range(LEVEL_ROUNDS):
            for level in order.permutation(LEVELS):
                photo = self._steady(int(level)).grey
                levels.append(float(level))
                values.append(mean_value(photo, self.region))
                clipped.append(clipped_share(photo, self.region))
        found = fit_levels(np.array(levels), np.array(values), np.array(clipped), full_scale=self._full_scale())
        self.say(
            f"levels: gamma {found.gamma:.4f} ± {found.gamma_sd:.4f}, black {found.black:.1f}, white {found.white:.1f}, "
            f"{found.model_rms:.2f} counts from the curve"
        )
        self._warn(level_warnings(found))
        return level_record(found)

    def _latency(self) -> object:
        self.say(
            f"latency: {LATENCY_PHOTOS} photos up to {1000 * LATEST_S:.0f} ms after a change between black and white"
        )
        self._steady(0)
        after_s: list[float] = []
        shares: list[np.ndarray] = []
        exposure_s = None
        halves = upper_and_lower(self.region)
        dark = np.array([mean_value(self.black.grey, half) for half in halves])
        lit = np.array([mean_value(self.white.grey, half) for half in halves])
        self.camera.acknowledged_s.clear()
        for number in range(LATENCY_PHOTOS):
            rising = number % 2 == 0
            self.camera.wait(REST_S)
            self.camera.show_level(255 if rising else 0)
            wanted_s = LATEST_S * number / (LATENCY_PHOTOS - 1)
            photo = self.camera.take("black to white" if rising else "white to black", after_s=wanted_s)
            share = (np.array([mean_value(photo.grey, half) for half in halves]) - dark) / (lit - dark)
            after_s.append(photo.after_s)
            shares.append(share if rising else 1 - share)
            exposure_s = photo.exposure_s
        if exposure_s is None:
            raise ValueError("neither photo nor camera says how long the shutter was open")
        found = fit_rolling_latency(
            np.array(after_s), np.array(shares), exposure_s=exposure_s, at_share=places_of(halves)
        )
        acknowledged_s = float(np.median(self.camera.acknowledged_s))
        self.say(
            f"latency: {1000 * found.latency_s:.1f} ± {1000 * found.latency_sd_s:.1f} ms from the command to the light, and the "
            f"display says so after {1000 * acknowledged_s:.0f} ms; from first to last row the shutter takes "
            f"{1000 * found.readout_s:.1f} ± {1000 * found.readout_sd_s:.1f} ms"
        )
        self._warn(latency_warnings(found, waits_s=acknowledged_s + self.config.timing.settle_s))
        return latency_record(found, acknowledged_s=acknowledged_s)

    def _flicker(self) -> object:
        name = next((each for each in TIME_NAMES if each in self.camera.settings), None)
        if name is None:
            raise ValueError("the camera does not let its shutter time be set")
        before = {each: self.camera.settings[each] for each in (name, ISO) if each in self.camera.settings}
        self.say(f"flicker: {PHOTOS_A_SHUTTER} photos of white at each of {len(SHUTTER_DIVISORS)} shutter times")
        swings: list[Swing] = []
        bands = None
        try:
            for divisor in SHUTTER_DIVISORS:
                try:
                    self.camera.set({name: f"1/{divisor}", **self._sensitivity(1 / divisor)})
                except DeviceProtocolError:  # a camera has the times that it has
                    continue
                rows = self._rows(f"1/{divisor} s")
                if np.nanmean(rows) >= DARKEST_SHARE * self._full_scale():
                    swings.append(swing_of(rows, exposure_s=1 / divisor))
                    bands = bands or bands_of(rows)
        finally:
            self.camera.set(before)
        if len(swings) < FEWEST_SHUTTERS:
            raise ValueError(
                f"{len(swings)} of {len(SHUTTER_DIVISORS)} shutter times gave bright photos; open the aperture, or turn the "
                "display's brightness up"
            )
        found = fit_flicker(swings)
        capture_s = self.white.exposure_s
        safe = tuple(str(each) for each in safe_times(found, largest_swing=LARGEST_SWING))
        self.say(
            f"flicker: {found.frequency_hz:.1f} ± {found.frequency_sd_hz:.1f} Hz, {100 * found.depth:.0f} % deep"
            if found.found
            else "flicker: none found"
        )
        if capture_s is not None:
            self._warn(flicker_warnings(found, exposure_s=capture_s, largest_swing=LARGEST_SWING))
        return flicker_record(found, tuple(swings), bands=bands, safe=safe if found.found else ())

    def _sensitivity(self, exposure_s: float) -> dict[str, str]:
        """Return the sensitivity that makes up for a short exposure, as far as it goes; nothing where it cannot be set."""
        now = exposure_of_settings(self.settings)
        if not now.iso or not now.time_s or ISO not in self.settings:
            return {}
        wanted = min(now.iso * now.time_s / exposure_s, HIGHEST_ISO)
        choices = self.devices.camera.setting_choices(ISO)
        offered = sorted(float(each) for each in choices if each.isdecimal()) or [
            2.0**stop * now.iso for stop in range(10)
        ]
        return {ISO: f"{max((each for each in offered if each <= wanted), default=now.iso):.0f}"}

    def _rows(self, shows: str) -> np.ndarray:
        """Return the row means, less black, of photos that are taken out of step with any flicker."""
        black = mean_value(self._steady(0).grey, self.region)
        self.camera.show_level(255)
        self.camera.wait(REST_S)
        rows = []
        for number in range(PHOTOS_A_SHUTTER):
            self.camera.wait(JITTER_S * ((number * GOLDEN) % 1))
            rows.append(row_values(self.camera.take(f"white at {shows}").grey, self.region))
        return np.array(rows) - black

    def _drift(self, minutes: float) -> object:
        self.say(f"drift: {DRIFT_PHOTOS} photos of white over {minutes:g} min")
        self.camera.show_level(255)
        self.camera.wait(REST_S)
        first_s = self.devices.clock.now_s()
        times_s, values = [], []
        for number in range(DRIFT_PHOTOS):
            self._wait_until(first_s + 60 * minutes * number / (DRIFT_PHOTOS - 1))
            photo = self.camera.take("white")
            times_s.append(photo.opened_s)
            values.append(mean_value(photo.grey, self.region))
        found = fit_drift(np.array(times_s), np.array(values), black=mean_value(self.black.grey, self.region))
        self.say(f"drift: {100 * found.per_min:.3f} ± {100 * found.per_min_sd:.3f} % a minute")
        photos = max(self.config.pattern("x").count, self.config.pattern("y").count)
        self._warn(drift_warnings(found, sweep_s=photos * self.config.timing.photo_s))
        return drift_record(found)

    def _wait_until(self, moment_s: float) -> None:
        """Wait in small parts, so that no camera falls asleep."""
        clock = self.devices.clock
        while clock.now_s() < moment_s:
            clock.sleep_s(min(5.0, moment_s - clock.now_s()))
            self.devices.camera.keep_awake()

    def _planes(self) -> object:
        lit, dark = self.white.colours(), self.black.colours()
        if lit is None or dark is None:
            raise ValueError("the photos cannot be decoded in colour")
        found = measure_planes(lit, dark, self.region)
        self._warn(primary_warnings(found, self.config.display.primary))
        return planes_record(found)
