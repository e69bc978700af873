"""The exposure time is chosen once, from what the body offers, so that white keeps clear of clipping."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simplejpeg
from rich.console import Console

from recon.sessions.session import open_session
from rig.capture_sections import AutoExposure
from rig.capturing.auto_exposure import Brightness, brightness_of, choose_time, usable_times
from rig.capturing.capture import capture
from rig.errors import CaptureError, CaptureStopped

WANTED = AutoExposure(setting="shutter")


def test_only_times_of_whole_refresh_periods_remain_and_two_at_least() -> None:
    # At 60 Hz: 1/60 s is one period, 1/50 is 1.2, 1/25 is 2.4, 1/8 is 7.5; 1/30, 1/20, 1/4, 0.3 and 1 s are 2, 3, 15, 18, 60.
    offered = ("bulb", "1", "0.3", "1/4", "1/8", "1/20", "1/25", "1/30", "1/50", "1/60")
    assert usable_times(offered, refresh_hz=60.0) == ["1/30", "1/20", "1/4", "0.3", "1"]
    # At 50 Hz: 1/25 s is two periods, 1/20 is 2.5, 1/8 is 6.25, 1/4 is 12.5, 0.3 is 15.
    assert usable_times(offered, refresh_hz=50.0) == ["1/25", "0.3", "1"]


def test_glints_do_not_count_and_the_region_does() -> None:
    counts = np.full((100, 100), 100, dtype=np.uint8)
    counts[0, :5] = 255  # 5 of 10,000 pixels
    counts[50:, 50:] = 50
    whole = brightness_of(counts, None)
    assert whole.brightest == pytest.approx(100 / 255)
    assert whole.clipped == pytest.approx(5e-4)
    assert brightness_of(counts, (60, 60, 90, 90)) == Brightness(50 / 255, 0.0)
    wide = brightness_of(counts.astype(np.uint16) * 257, None)
    assert wide.brightest == pytest.approx(100 / 255)


class Lamp:
    """White gets brighter in proportion to the time, up to the top of the range."""

    def __init__(self, share_a_second: float) -> None:
        self.share_a_second = share_a_second
        self.tried: list[str] = []

    def __call__(self, time: str) -> Brightness:
        self.tried.append(time)
        over, _, under = time.partition("/")
        share = self.share_a_second * float(over) / float(under or 1)
        return Brightness(min(share, 1.0), float(share > 1))


TIMES = ("1/30", "1/20", "1/15", "1/10", "1/6", "1/5", "1/4", "0.3", "0.4", "0.5", "0.6", "0.8", "1")


@pytest.mark.parametrize("share_a_second", [0.8, 1.0, 2.0, 3.1, 7.4, 20.0])
def test_the_longest_time_below_the_limit_is_found_in_few_photos(share_a_second: float) -> None:
    lamp = Lamp(share_a_second)
    chosen = choose_time(TIMES, wanted=WANTED, brightness_at=lamp)
    fine = [time for time in TIMES if Lamp(share_a_second)(time).brightest <= 0.75]
    assert chosen.value == fine[-1]
    assert chosen.brightness == Lamp(share_a_second)(fine[-1])
    assert chosen.warning == ""
    assert len(lamp.tried) <= 5


@pytest.mark.parametrize(
    ("share_a_second", "value", "word"), [(100.0, "1/30", "close the aperture"), (0.01, "1", "open the aperture")]
)
def test_a_display_beyond_every_time_is_told_in_one_sentence(share_a_second: float, value: str, word: str) -> None:
    chosen = choose_time(TIMES, wanted=WANTED, brightness_at=Lamp(share_a_second))
    assert chosen.value == value
    assert word in chosen.warning
    assert "\n" not in chosen.warning


@pytest.fixture
def auto_config(config):
    return config.model_copy(
        update={"capture": config.capture.model_copy(update={"auto_exposure": AutoExposure(setting="shutter")})}
    )


def journal_of(folder: Path, event: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    return [line for line in lines if line["event"] == event]


def brightest(folder: Path, set_name: str) -> float:
    white = open_session(folder).photo_file(set_name, "white").read_bytes()
    return float(np.quantile(simplejpeg.decode_jpeg(white, colorspace="GRAY"), 0.999)) / 255


def test_a_capture_is_exposed_alike_in_all_sets_and_the_next_longer_time_would_be_too_bright(
    open_bench, auto_config, scene, quiet, tmp_path
) -> None:
    with open_bench(auto_config, scene) as (devices, _):
        capture(auto_config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
        offered = usable_times(devices.camera.setting_choices("shutter"), refresh_hz=60.0)
    (chosen,) = journal_of(tmp_path / "s", "exposure_chosen")
    assert {line["settings"]["shutter"] for line in journal_of(tmp_path / "s", "camera_frozen")} == {chosen["value"]}
    assert brightest(tmp_path / "s", "pos0_air") == pytest.approx(chosen["brightest"], abs=0.02)
    assert chosen["brightest"] <= 0.75
    longer = offered[offered.index(chosen["value"]) + 1]
    over, _, under = longer.partition("/")
    own_over, _, own_under = chosen["value"].partition("/")
    ratio = (float(over) / float(under or 1)) / (float(own_over) / float(own_under or 1))
    assert ratio * chosen["brightest"] > 0.75  # the simulated sensor's response is linear
    assert len(journal_of(tmp_path / "s", "exposure_checked")) == 4


def interrupted_at(devices: Any, number: int) -> Any:
    calls = iter(range(10**9))
    collect = devices.camera.collect

    def call(**arguments: Any) -> Any:
        if next(calls) == number:
            raise KeyboardInterrupt
        return collect(**arguments)

    devices.camera.collect = call
    return devices


def test_a_resumed_capture_keeps_the_exposure_that_it_began_with(
    open_bench, auto_config, scene, quiet, tmp_path
) -> None:
    for folder in ("whole", "resumed"):
        with open_bench(auto_config, scene) as (devices, _):
            if folder == "whole":
                capture(auto_config, tmp_path / folder, devices=devices, scene=scene, resume=False, console=quiet)
                continue
            with pytest.raises(CaptureStopped):
                capture(
                    auto_config,
                    tmp_path / folder,
                    devices=interrupted_at(devices, 30),
                    scene=scene,
                    resume=False,
                    console=quiet,
                )
        with open_bench(auto_config, scene) as (devices, _):  # a camera that was switched off and on
            capture(auto_config, tmp_path / folder, devices=devices, scene=scene, resume=True, console=quiet)
    hashes = [
        {key: record.sha256 for key, record in open_session(tmp_path / folder).photos.items()}
        for folder in ("whole", "resumed")
    ]
    assert hashes[0] == hashes[1]
    assert len(journal_of(tmp_path / "resumed", "exposure_chosen")) == 1


def with_choices(devices: Any, choices: Sequence[str]) -> Any:
    camera = devices.camera
    camera.setting_choices = lambda name: tuple(choices)  # noqa: ARG005  (whatever is asked)
    return dataclasses.replace(devices, camera=camera)


def test_a_body_that_cannot_be_set_is_photographed_as_it_is_with_one_sentence_where_it_is_too_bright(
    open_bench, auto_config, scene, tmp_path
) -> None:
    bright = scene.model_copy(update={"camera": scene.camera.model_copy(update={"signal": 3.0})})
    console = Console(record=True, width=1000, file=open("/dev/null", "w"))  # noqa: SIM115  (closed below)
    with open_bench(auto_config, bright) as (devices, _):
        devices = with_choices(devices, ())
        capture(auto_config, tmp_path / "s", devices=devices, scene=bright, resume=False, console=console)
    console.file.close()
    said = [line for line in console.export_text().splitlines() if line.startswith("exposure: ")]
    assert "can only be set on its body" in said[0]
    assert len(said) == 5  # and once for each set's white photo
    assert journal_of(tmp_path / "s", "exposure_chosen")[0]["value"] == ""


def test_a_body_without_a_time_of_whole_periods_is_refused_before_any_photo(
    open_bench, auto_config, scene, quiet, tmp_path
) -> None:
    with open_bench(auto_config, scene) as (devices, _):
        devices = with_choices(devices, ("1/125", "1/60"))
        with pytest.raises(CaptureError, match=r"\(1/125 … 1/60\) holds whole refresh periods of 60 Hz"):
            capture(auto_config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
    assert not open_session(tmp_path / "s").photos
