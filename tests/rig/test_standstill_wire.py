"""Suspended through the real drivers: a tablet that was turned or closed, and a camera that vanished and came back."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import rig.capturing.photo_taker
import rig.devices
from recon.sessions.journal import read_journal
from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import open_devices
from rig.planning.plan import all_photos
from rig.rehearsing.emulation import EmulatedRig, emulate_rig
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.browser_tablet import BrowserTablet
from sim_backend.world import World

OPTIONS = SceneOptions(camera_columns=32, display_columns=48, width_px=16.0, step_px=20.0)
# A page may be away for as long as one call to show waits, and nobody notices.
SHOW_TIMEOUT_S = 4.0
AWAY_S = 7.0
pytestmark = pytest.mark.slow


@pytest.fixture
def interrupted(
    monkeypatch: pytest.MonkeyPatch, require_program: Callable[[str, str], str], tmp_path: Path
) -> Callable[..., tuple[list[dict[str, Any]], str]]:
    """Return ``interrupted(spoil, mend)``: a whole capture, spoiled at its seventh photo and mended seven seconds later."""
    require_program("chromium", "chromium")

    def run(
        spoil: Callable[[EmulatedRig], None], mend: Callable[[EmulatedRig], None]
    ) -> tuple[list[dict[str, Any]], str]:
        emulated: list[EmulatedRig] = []
        look, count = World.look, iter(range(10**9))
        timers: list[threading.Timer] = []

        @contextmanager
        def watched(*about: Any, **times_s: float) -> Iterator[EmulatedRig]:
            with emulate_rig(*about, **times_s) as found:
                emulated.append(found)
                yield found

        def looking(world: World, **opened_on: Any) -> Any:
            seen = look(world, **opened_on)
            if next(count) == 6:
                spoil(emulated[0])
                timers.append(threading.Timer(AWAY_S, mend, emulated))
                timers[0].start()
            return seen

        monkeypatch.setattr(rig.devices, "emulate_rig", watched)
        monkeypatch.setattr(World, "look", looking)
        monkeypatch.setattr(rig.capturing.photo_taker, "SHOW_TIMEOUT_S", SHOW_TIMEOUT_S)
        scene = open_scene("thin_cone", OPTIONS)
        config: RigConfig = config_of_scene(scene, OPTIONS)
        said = StringIO()
        with open_devices(config, simulation=Simulation(scene, wire=True)) as devices:
            capture(
                patient(config),
                tmp_path / "s",
                devices=devices,
                scene=scene,
                resume=False,
                console=Console(file=said, width=1000),
            )
        timers[0].join()
        assert set(open_session(tmp_path / "s").photos) == {photo.key for photo in all_photos(config)}
        return list(read_journal(tmp_path / "s/journal.jsonl")), said.getvalue()

    return run


def patient(config: RigConfig) -> RigConfig:
    """Waiting passes at once on the simulated clock, while the tablet is mended in the room's time."""
    return config.model_copy(update={"timing": config.timing.model_copy(update={"longest_suspension_s": 1e9})})


def turn(tablet: BrowserTablet, *, columns: int, rows: int) -> None:
    tablet._call("Emulation.setDeviceMetricsOverride", width=columns, height=rows, deviceScaleFactor=1, mobile=False)


def test_a_window_that_was_made_smaller_suspends_the_capture_until_it_is_large_again(interrupted) -> None:
    """The display of this scene is a square, so that turning it would not be seen in its size."""

    def rows(emulated: EmulatedRig) -> int:
        return emulated.config.display.rows

    journal, said = interrupted(
        lambda emulated: turn(emulated.tablet, columns=48, rows=rows(emulated) - 10),
        lambda emulated: turn(emulated.tablet, columns=48, rows=rows(emulated)),
    )
    causes = [entry["cause"] for entry in journal if entry["event"] == "suspended"]
    assert set(causes) == {"display away"}
    assert (
        "suspended: display: the page has 48 × 38 device pixels, it had 48 × 48; undo the change of window, zoom or"
        in said
    )
    assert "full screen; it goes on when the display shows frames again" in said
    assert "going on" in said


def test_a_page_that_was_closed_suspends_the_capture_until_it_is_opened_again(interrupted) -> None:
    addresses: list[str] = []

    def close(emulated: EmulatedRig) -> None:
        history: Any = emulated.tablet._call("Page.getNavigationHistory")
        addresses.append(history["entries"][history["currentIndex"]]["url"])
        emulated.tablet._call("Page.navigate", url="about:blank")

    journal, said = interrupted(close, lambda emulated: emulated.tablet.open(addresses[0]))
    assert {entry["cause"] for entry in journal if entry["event"] == "suspended"} == {"display away"}
    assert "suspended: display: no page is connected, so frame" in said
    assert "going on" in said
