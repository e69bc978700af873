"""A simulated capture in which something moves: it is found, named and answered, and the report says so later."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from recon.run import run_session
from recon.running.settings import Settings
from recon.scene.scene_check import NO_REFERENCES, REFERENCE, check_scene
from recon.sessions.session import open_session
from rig.capturing.capture import CaptureResult, capture
from rig.config import RigConfig
from rig.devices import simulated_devices
from rig.errors import SceneMovedError
from rig.rehearsing.rehearsal import Simulation, open_world
from sim_backend.disturbance import Disturbance
from sim_backend.photography import Photographer
from sim_backend.unrest import Ripples
from sim_backend.world import World
from tests.bench.quiet_captures import count_alarms, short_rig

QUIET = Console(quiet=True)
# How often the shortest capture of the suite is repeated without an alarm; make bench repeats it 300 times.
CAPTURES = 4


class Lab:
    """One scene with its rig; ``run`` captures it while ``happens`` is done to its world at the first photo that fits."""

    def __init__(self, name: str = "hemisphere") -> None:
        self.scene, self.config = short_rig(name, columns=160)
        self._photographer = Photographer(self.scene)
        self.object_px_mm = -self.scene.camera.position_mm[2] / self.scene.camera.focal_x_px

    def run(
        self,
        folder: Path,
        happens: Callable[[World], None] | None = None,
        *,
        during: tuple[str, str] = ("pos1_liquid", "x"),
        config: RigConfig | None = None,
        resume: bool = False,
    ) -> CaptureResult:
        config = config or self.config
        with open_world(config, Simulation(self.scene)) as world:
            devices = simulated_devices(config, world, self._photographer)
            waiting = [happens] if happens else []

            def collect(**timeout: float) -> Any:
                if waiting and self._photographing(folder) == during:
                    waiting.pop()(world)
                return devices.camera.collect(**timeout)

            camera = _Camera(devices.camera, collect)
            watched = dataclasses.replace(devices, camera=camera)
            return capture(config, folder, devices=watched, scene=self.scene, resume=resume, console=QUIET)

    def _photographing(self, folder: Path) -> tuple[str, str] | None:
        started = [event for event in journal_of(folder) if event["event"] == "sweep_started"]
        return (started[-1]["set"], started[-1]["axis"]) if started else None


class _Camera:
    def __init__(self, camera: Any, collect: Callable[..., Any]) -> None:
        self._camera = camera
        self.collect = collect

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)


def journal_of(folder: Path, event: str | None = None) -> list[dict[str, Any]]:
    entries = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    return [entry for entry in entries if event is None or entry["event"] == event]


def causes_of(folder: Path) -> list[str]:
    return [found["cause"] for entry in journal_of(folder, "scene_checked") for found in entry["findings"]]


@pytest.fixture(scope="module")
def lab() -> Lab:
    return Lab()


def disturbed(**what: Any) -> Callable[[World], None]:
    return lambda world: world.unrest.disturb(Disturbance(**what))


@pytest.mark.parametrize("during", [("pos0_air", "y"), ("pos1_liquid", "x")])
def test_an_object_that_moved_by_a_third_of_a_pixel_stops_the_capture(lab: Lab, tmp_path: Path, during) -> None:
    folder = tmp_path / "session"
    with pytest.raises(SceneMovedError, match=r"the object moved: its marks by 0\.3\d px .*entry points off") as told:
        lab.run(folder, disturbed(object_shift_mm=(0.3 * lab.object_px_mm, 0.0)), during=during)
    assert "fasten the object" in str(told.value)
    assert causes_of(folder) == ["object"]
    # Of the sweep that was under way, every photo is kept.
    kept = [key for key in open_session(folder).photos if key[:2] == during]
    assert len(kept) == lab.config.pattern(during[1]).count


@pytest.mark.parametrize("during", [("pos0_air", "x"), ("pos0_liquid", "y")])
def test_a_display_that_slipped_by_a_twentieth_of_a_millimetre_stops_the_capture(
    lab: Lab, tmp_path: Path, during
) -> None:
    folder = tmp_path / "session"
    with pytest.raises(SceneMovedError, match="the display slipped"):
        lab.run(folder, disturbed(display_shift_mm=(0.0, 0.05)), during=during)
    assert causes_of(folder) == ["display"]
    # Position 0 is 473 mm away, so that 0.05 mm are 0.05 · f / 473 px in air, and a little more through the liquid.
    by_hand_px = 0.05 * lab.scene.camera.focal_y_px / 473
    (checked,) = [entry for entry in journal_of(folder, "scene_checked") if entry["findings"]]
    assert checked["parts"]["display"]["shift_px"][1] == pytest.approx(by_hand_px, rel=0.15)


def test_a_display_that_slipped_in_water_behind_a_bottle_is_not_taken_for_ripples(tmp_path: Path) -> None:
    """What is seen through the bottle is so small that it moves by a quarter of what is seen beside it."""
    with pytest.raises(SceneMovedError, match="the display slipped"):
        Lab("bottle").run(tmp_path / "session", disturbed(display_shift_mm=(0.05, 0.0)))
    assert causes_of(tmp_path / "session") == ["display"]


def test_a_camera_that_moved_stops_the_capture(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    with pytest.raises(SceneMovedError, match="the camera moved"):
        lab.run(folder, disturbed(camera_shift_mm=(0.0, 0.3 * lab.object_px_mm, 0.0)))
    assert causes_of(folder) == ["camera"]


def test_light_that_sinks_by_five_per_cent_is_told_and_the_capture_goes_on(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    result = lab.run(folder, disturbed(light=0.95))
    assert result.photos_done == result.photos_needed
    assert set(causes_of(folder)) == {"light"}
    (first, *_) = [entry for entry in journal_of(folder, "scene_checked") if entry["findings"]]
    # Half-way between: (0.95 − 1) / 0.975 of what is seen, less the ambient light's 1 % of full scale.
    assert first["parts"]["display"]["light"] == pytest.approx(-0.0513, abs=0.003)
    stopping = lab.config.model_copy(
        update={"watch": lab.config.watch.model_copy(update={"when_light_changed": "stop"})}
    )
    with pytest.raises(SceneMovedError, match="the light changed by -5"):
        lab.run(tmp_path / "strict", disturbed(light=0.95), config=stopping)


def test_photos_wait_until_ripples_after_a_fill_have_died_down(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    ripples = Ripples(slope=0.05, lasts_s=40.0)
    lab.run(folder, lambda world: world.unrest.ripple_after_flows(ripples), during=("pos0_air", "x"))
    (waited,) = [entry for entry in journal_of(folder, "waited_until_still") if "liquid" in entry["reason"]]
    assert waited["still"]
    # Half the limit, 0.025 px, is reached when the slope has sunk to what turns a ray by that much: over 52 mm of water a
    # slope s moves the picture by 52 · s · (1 − 1/1.3355) mm, a photo pixel is 0.45 mm.
    still_slope = 0.025 * 473 / lab.scene.camera.focal_x_px / (52 * (1 - 1 / 1.3355))
    assert ripples.slope_after(lab.config.timing.still_after_fill_s + waited["waited_s"]) < 4 * still_slope
    assert waited["waited_s"] > 15
    assert causes_of(folder) == []


def test_a_sweep_over_ripples_is_taken_again(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"

    def knocked(world: World) -> None:
        """Somebody knocks against the tank in the middle of a sweep."""
        world.unrest.ripple_after_flows(Ripples(slope=0.05, lasts_s=40.0))
        world.unrest.liquid_moved(world.clock.now_s())

    result = lab.run(folder, knocked)
    assert result.photos_done == result.photos_needed
    assert causes_of(folder) == ["liquid"]
    (rejected,) = journal_of(folder, "sweep_rejected")
    assert (rejected["set"], rejected["sweep"]) == ("pos1_liquid", "x")
    assert "the liquid is not still" in rejected["reason"]
    session = open_session(folder)
    again = [record for key, record in session.photos.items() if key[:2] == ("pos1_liquid", "x")]
    assert len(again) == lab.config.pattern("x").count
    assert all(record.file.startswith("photos/pos1_liquid/x-2/") for record in again)


def test_a_liquid_that_never_comes_to_rest_ends_the_wait_with_a_sentence(lab: Lab, tmp_path: Path) -> None:
    watch = lab.config.watch.model_copy(update={"longest_wait_s": 60.0})
    config = lab.config.model_copy(update={"watch": watch})
    with pytest.raises(
        SceneMovedError, match=r"the liquid was moved, and after 6\d s the picture is still not the same"
    ):
        lab.run(
            tmp_path / "session",
            lambda world: world.unrest.ripple_after_flows(Ripples(slope=0.05, lasts_s=1e5)),
            during=("pos0_air", "x"),
            config=config,
        )


def test_what_moved_between_two_runs_is_found_on_resuming(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"

    def interrupted(world: World) -> None:  # noqa: ARG001
        raise KeyboardInterrupt

    with pytest.raises(Exception, match="stopped with"):
        lab.run(folder, interrupted, during=("pos0_air", "x"))
    references = len([key for key in open_session(folder).photos if key[1] == REFERENCE])
    assert references == 2
    moved = Disturbance(object_shift_mm=(0.3 * lab.object_px_mm, 0.0))
    with open_world(lab.config, Simulation(lab.scene)) as world:
        world.unrest.disturb(moved)
        devices = simulated_devices(lab.config, world, Photographer(lab.scene))
        with pytest.raises(SceneMovedError, match="the object moved"):
            capture(lab.config, folder, devices=devices, scene=lab.scene, resume=True, console=QUIET)
    # Before a single photo of the sweep was taken.
    assert len([key for key in open_session(folder).photos if key[1] == "x"]) == 0


@pytest.mark.slow
def test_nothing_is_told_of_quiet_captures() -> None:
    count = count_alarms(CAPTURES)
    assert count.captures == CAPTURES
    # 4 + 3 + 3 + 3 reference photos: all but the very first are compared.
    assert count.comparisons == 12 * CAPTURES
    assert count.alarms == []
    # They do differ: every photo has noise of its own.
    assert min(count.sigmas) > 0


def test_the_report_says_what_moved_and_what_could_not_be_checked(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    warning = lab.config.model_copy(update={"watch": lab.config.watch.model_copy(update={"when_moved": "warn"})})
    lab.run(folder, disturbed(object_shift_mm=(0.3 * lab.object_px_mm, 0.0)), config=warning)
    metrics = run_session(folder, tmp_path / "result", Settings(method="paper"))
    assert {finding.split(":")[0] for row in metrics.scene for finding in row.findings} >= {"the object moved"}
    assert any("the object moved" in reason for reason in metrics.verdict.reasons) or metrics.verdict.grade == "fail"
    assert any(text.startswith("The scene did not stay as it was") for text in metrics.warnings)
    page = (tmp_path / "result" / "report.html").read_text(encoding="utf-8")
    assert "Did the scene stay as it was?" in page
    assert "the object moved: its marks" in page
    # The next set still fits its own first photo, and no longer the session's.
    across = [row for row in metrics.scene if row.across_sets and row.set == "pos0_liquid"]
    assert across[0].findings


def test_a_session_without_reference_photos_says_that_it_could_not_be_checked(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    lab.run(folder, config=lab.config.model_copy(update={"watch": None}))
    assert check_scene(open_session(folder)).note == NO_REFERENCES
    metrics = run_session(folder, tmp_path / "result", Settings(method="paper"))
    assert (metrics.scene, metrics.scene_note) == ((), NO_REFERENCES)
    assert "could not be checked" in (tmp_path / "result" / "report.html").read_text(encoding="utf-8")


def test_the_report_finds_what_the_capture_found(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    lab.run(folder, disturbed(light=0.95))
    told = [(entry["set"], entry["index"], entry["findings"] != []) for entry in journal_of(folder, "scene_checked")]
    again = check_scene(open_session(folder))
    assert [(check.set_name, check.index, check.findings != ()) for check in again.checks] == told
    assert again.note == ""
