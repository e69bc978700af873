"""A bad sweep is known and taken again before the tank is filled; whatever happens to the decoding, the capture goes on."""

import dataclasses
import json
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.protocols import Frame
from recon.sessions.session import open_session
from recon.sweeps.correspondence_store import load_stored
from rig.capture_sections import Live
from rig.capturing.capture import capture
from rig.errors import CaptureError
from rig.live import live_capture
from rig.live.live_decoder import LiveDecoder
from rig.planning.plan import all_photos, plan_capture
from rig.planning.steps import FillTank, JudgeSet, TakePhoto


@pytest.fixture
def live_config(config):
    # Photos of 32 × 32 hold few pixels, many of them at the sweep's ends: what is asked of a sweep is asked gently.
    return config.model_copy(update={"live": Live(least_coverage=0.3)})


def journal_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


class Flickering:
    """A display that stays dark for a sweep's frames, so many times over."""

    def __init__(self, display: Any, frames: frozenset[int], times: int) -> None:
        self._display = display
        self._left = dict.fromkeys(frames, times)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._display, name)

    def show(self, frame: Frame, *, frame_id: int, timeout_s: float) -> None:
        if self._left.get(frame_id, 0) > 0:
            self._left[frame_id] -= 1
            frame = Frame(axis=frame.axis, levels=np.zeros_like(frame.levels))
        self._display.show(frame, frame_id=frame_id, timeout_s=timeout_s)


def frames_of(config, set_name: str, sweep: str) -> frozenset[int]:
    return frozenset(photo.frame_id for photo in all_photos(config) if photo.key[:2] == (set_name, sweep))


def hashes(folder: Path) -> dict[tuple[str, str, int], str | None]:
    return {key: record.sha256 for key, record in open_session(folder).photos.items()}


def test_every_set_is_judged_before_what_follows_it(live_config) -> None:
    plan = plan_capture(live_config)
    judged = [index for index, step in enumerate(plan) if isinstance(step, JudgeSet)]
    assert [plan[index].set_name for index in judged] == ["pos0_air", "pos1_air", "pos1_liquid", "pos0_liquid"]
    filled = next(index for index, step in enumerate(plan) if isinstance(step, FillTank))
    assert judged[1] < filled
    done = {photo.key for photo in all_photos(live_config)}
    assert [step for step in plan_capture(live_config, done=done) if isinstance(step, JudgeSet | TakePhoto)] == [
        plan[index] for index in judged
    ]


def test_a_dark_sweep_is_taken_again_before_the_tank_is_filled(
    open_bench, live_config, scene, quiet, tmp_path, captured
) -> None:
    folder = tmp_path / "session"
    with open_bench(live_config, scene) as (devices, _):
        flickering = Flickering(devices.display, frames_of(live_config, "pos1_air", "y"), times=1)
        devices = dataclasses.replace(devices, display=flickering)
        capture(live_config, folder, devices=devices, scene=scene, resume=False, console=quiet)
    lines = journal_of(folder)
    events = [line["event"] for line in lines]
    (rejected,) = [line for line in lines if line["event"] == "sweep_rejected"]
    assert (rejected["set"], rejected["sweep"]) == ("pos1_air", "y")
    assert "no pixel saw the stripe" in rejected["reason"]
    assert events.index("sweep_rejected") < events.index("fill_started")
    assert events.count("sweep_judged") == 8
    assert events.count("homing_started") == events.count("fill_started") == 1
    assert hashes(folder) == hashes(captured)
    assert open_session(folder).photo_file("pos1_air", "y", 0).parent.name == "y-2"
    session = open_session(folder)
    assert all(
        load_stored(session, one, sweep.axis, method="full") is not None
        for one in session.manifest.sets
        for sweep in one.sweeps
    )


def test_a_sweep_that_stays_bad_ends_the_capture_in_one_sentence_and_is_taken_again_on_resuming(
    open_bench, live_config, scene, quiet, tmp_path, captured
) -> None:
    folder = tmp_path / "session"
    with open_bench(live_config, scene) as (devices, world):
        flickering = Flickering(devices.display, frames_of(live_config, "pos0_air", "x"), times=99)
        devices = dataclasses.replace(devices, display=flickering)
        with pytest.raises(CaptureError, match=r"sweep pos0_air x was photographed 2 times .* no pixel saw") as error:
            capture(live_config, folder, devices=devices, scene=scene, resume=False, console=quiet)
        assert world.state().tank_ml == 0
    assert "\n" not in str(error.value)
    assert not [key for key in open_session(folder).photos if key[:2] == ("pos0_air", "x")]
    with open_bench(live_config, scene) as (devices, _):
        capture(live_config, folder, devices=devices, scene=scene, resume=True, console=quiet)
    assert hashes(folder) == hashes(captured)
    assert open_session(folder).photo_file("pos0_air", "x", 0).parent.name == "x-3"


def test_sweeps_that_were_never_judged_are_judged_on_resuming_and_no_photo_is_taken_again(
    open_bench, live_config, scene, quiet, tmp_path, captured
) -> None:
    folder = Path(shutil.copytree(captured, tmp_path / "session"))
    with open_bench(live_config, scene) as (devices, _):
        result = capture(live_config, folder, devices=devices, scene=scene, resume=True, console=quiet)
    assert result.photos_taken == 0
    assert [line["event"] for line in journal_of(folder)].count("sweep_judged") == 8
    with open_bench(live_config, scene) as (devices, _):
        capture(live_config, folder, devices=devices, scene=scene, resume=True, console=quiet)
    assert [line["event"] for line in journal_of(folder)].count("sweep_judged") == 8


def test_a_capture_whose_decoding_process_dies_takes_every_photo(
    open_bench, live_config, scene, quiet, tmp_path, captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Doomed(LiveDecoder):
        def __enter__(self) -> "Doomed":
            os.kill(self.process_id, signal.SIGKILL)
            return self

    monkeypatch.setattr(live_capture, "LiveDecoder", Doomed)
    folder = tmp_path / "session"
    with open_bench(live_config, scene) as (devices, _):
        capture(live_config, folder, devices=devices, scene=scene, resume=False, console=quiet)
    assert hashes(folder) == hashes(captured)
    assert "sweep_judged" not in [line["event"] for line in journal_of(folder)]
