"""A display whose light is late, flickers and drifts, seen through a shutter of a known time."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
import simplejpeg

from drivers.protocols import Frame
from sim_backend.brightness import light_got, opening_times_s
from sim_backend.camera import SimulatedCamera
from sim_backend.clock import SimulatedClock
from sim_backend.display import SimulatedDisplay
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, SceneFlicker, load_scene
from sim_backend.world import TankSize, World, WorldState

COLUMNS = 64
FREQUENCY_HZ, DEPTH = 240.0, 0.3
STAGE_MM = 20.0


@dataclass(frozen=True)
class Bench:
    scene: Scene
    clock: SimulatedClock
    display: SimulatedDisplay
    camera: SimulatedCamera

    def show(self, level: int) -> None:
        levels = np.full(self.scene.display.columns, level, np.uint8)
        self.display.show(Frame(axis="x", levels=levels), frame_id=level, timeout_s=1.0)

    def photo(self, shutter: str) -> np.ndarray:
        # As bright as the scene has it at 1/4 s and ISO 100, whatever the time.
        sensitivity = 100 * Fraction("1/4") / Fraction(shutter)
        self.camera.apply_settings({"shutter": shutter, "iso": str(sensitivity)})
        self.camera.expose(timeout_s=60.0)
        (photo,) = self.camera.collect(timeout_s=60.0)
        return simplejpeg.decode_jpeg(photo.data, "GRAY")[:, :, 0].astype(np.float64)


def bench(*, camera: dict[str, object] | None = None, **display: object) -> Bench:
    """A camera that looks straight at a white display that fills its photo, without an object."""
    plain = load_scene("semi_ellipsoid").resized(camera_columns=COLUMNS, display_columns=COLUMNS)
    given = {
        "ambient": 0.0,
        "read_noise_electrons": 0.0,
        "full_well_electrons": 1e7,
        "signal": 0.5,
        "jpeg_quality": 100,
    }
    scene = Scene.model_validate(
        plain.model_dump()
        | {"display": plain.display.model_dump() | {"pitch_mm": 0.6} | display}
        | {"camera": plain.camera.model_dump() | given | (camera or {})}
    )
    clock = SimulatedClock()
    dark = Frame(axis="x", levels=np.zeros(scene.display.columns, np.uint8))
    world = World(
        clock=clock,
        tank=TankSize(2.0, 1.0),
        dark_frame=dark,
        state=WorldState(stage_mm=STAGE_MM, object_present=False),
        light_delay_s=scene.display.latency_s,
    )
    panel = scene.display
    return Bench(
        scene,
        clock,
        SimulatedDisplay(world, columns=panel.columns, rows=panel.rows, latency_s=0.03),
        SimulatedCamera(world, Photographer(scene), exposure_s=0.5, download_s=0.0),
    )


def middle(photo: np.ndarray) -> float:
    return float(photo[28:36, 28:36].mean())


@pytest.mark.parametrize(("after_s", "share"), [(0.04, 0.0), (0.095, 0.0), (0.11, 0.5), (0.115, 0.75), (0.13, 1.0)])
def test_a_photo_gets_the_late_light_for_as_long_as_it_was_there(after_s: float, share: float) -> None:
    """Light comes 120 ms after the command; a shutter opened at 110 ms for 20 ms gets half of it."""
    rig = bench(latency_s=0.12)
    rig.show(255)
    rig.clock.sleep_s(1.0)
    white = middle(rig.photo("1/50"))
    rig.show(0)
    rig.clock.sleep_s(1.0)
    rig.show(255)  # returns 30 ms after the command
    rig.clock.sleep_s(after_s - 0.03)
    assert middle(rig.photo("1/50")) == pytest.approx(share * white, abs=1.0)


def test_a_display_that_is_never_late_shows_its_frame_when_it_says_so() -> None:
    rig = bench()
    rig.show(255)
    assert middle(rig.photo("1/50")) > 100


@pytest.mark.parametrize("shutter_s", [1 / 1000, 1 / 400, 1 / 300, 1 / 100, 0.0173])
def test_a_sine_leaves_a_global_exposure_its_sinc(shutter_s: float) -> None:
    """The mean of 1 + d · sin(2πft) over T swings by d · |sin(πfT) / (πfT)| about 1."""
    scene = bench(flicker={"frequency_hz": FREQUENCY_HZ, "depth": DEPTH}).scene
    opened_s = np.linspace(3.0, 3.0 + 1 / FREQUENCY_HZ, 2001)
    got = light_got(scene.display, opened_s, shutter_s, first_s=-np.inf, last_s=np.inf)
    expected = DEPTH * abs(np.sinc(FREQUENCY_HZ * shutter_s))
    assert (got.max() - got.min()) / 2 == pytest.approx(expected, abs=1e-6)
    assert got.mean() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("wave", ["sine", "square"])
def test_a_shutter_open_for_whole_periods_sees_no_flicker(wave: str) -> None:
    scene = bench(flicker={"frequency_hz": FREQUENCY_HZ, "depth": DEPTH, "wave": wave}).scene
    opened_s = np.linspace(0.0, 1.0, 1001)
    got = light_got(scene.display, opened_s, 3 / FREQUENCY_HZ, first_s=-np.inf, last_s=np.inf)
    np.testing.assert_allclose(got, 1.0, atol=1e-12)


def test_an_exposure_equals_the_sum_of_its_moments() -> None:
    """The closed form of the square wave against a sum over a million moments."""
    panel = bench(flicker={"frequency_hz": FREQUENCY_HZ, "depth": DEPTH, "wave": "square"}).scene.display
    shutter_s = 0.0071
    got = light_got(panel, np.array([0.4321]), shutter_s, first_s=-np.inf, last_s=0.4375)[0]
    moments_s = 0.4321 + shutter_s * (np.arange(1_000_000) + 0.5) / 1_000_000
    bright = np.where((FREQUENCY_HZ * moments_s) % 1 < 0.5, 1 + DEPTH, 1 - DEPTH)
    assert got == pytest.approx(np.where(moments_s < 0.4375, bright, 0).mean(), abs=2e-6)


def test_a_rolling_shutter_draws_bands_and_a_global_one_none() -> None:
    """240 Hz and a readout of 12.5 ms: three bands in a photo."""
    flicker = {"frequency_hz": FREQUENCY_HZ, "depth": DEPTH}
    rolling = bench(flicker=flicker, camera={"shutter": "rolling", "readout_s": 3 / FREQUENCY_HZ})
    steady = bench()
    steady.show(255)
    reference = steady.photo("1/1000")[:, 28:36].mean(axis=1)
    assert reference.min() > 50  # the display is behind every row
    rolling.show(255)
    bands = rolling.photo("1/1000")[:, 28:36].mean(axis=1) / reference - 1
    spectrum = np.abs(np.fft.rfft(bands))
    assert np.argmax(spectrum[1:]) + 1 == 3
    assert 2 * spectrum[3] / len(bands) == pytest.approx(DEPTH * np.sinc(0.24), abs=0.01)
    whole = bench(flicker=flicker)
    whole.show(255)
    assert np.ptp(whole.photo("1/1000")[:, 28:36].mean(axis=1) / reference) < 0.03


def test_rows_of_a_rolling_shutter_open_one_after_the_other() -> None:
    camera = bench(camera={"shutter": "rolling", "readout_s": 0.064}).scene.camera
    opened_s = opening_times_s(camera, 2.0)
    np.testing.assert_allclose(np.diff(opened_s), 0.064 / camera.rows)
    assert opened_s[0] == 2.0


def test_a_drifting_display_is_brighter_by_its_share_a_minute_later() -> None:
    rig = bench(drift_per_min=0.1)
    rig.show(255)
    first = middle(rig.photo("1/50"))
    rig.clock.sleep_s(60.0)
    assert middle(rig.photo("1/50")) / first == pytest.approx(1.1, abs=0.01)


def test_photos_of_a_flickering_display_have_noise_of_their_own() -> None:
    rig = bench(flicker={"frequency_hz": FREQUENCY_HZ, "depth": DEPTH}, camera={"read_noise_electrons": 1e5})
    rig.show(255)
    assert not np.array_equal(rig.photo("1/240"), rig.photo("1/240"))


@pytest.mark.parametrize("camera", [{"shutter": "rolling"}, {"shutter": "global", "readout_s": 0.1}])
def test_a_readout_without_a_rolling_shutter_is_refused(camera: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="readout_s belongs to the shutter 'rolling'"):
        bench(camera=camera)


def test_a_flicker_deeper_than_all_light_is_refused() -> None:
    with pytest.raises(ValueError, match="less than or equal to 1"):
        SceneFlicker(frequency_hz=240, depth=1.5)
