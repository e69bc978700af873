"""Live quality: what is asked of a sweep, who decodes it meanwhile, and the page that shows it."""

import json
import os
import shutil
import signal
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from recon.sessions.session import open_session
from recon.sweeps.correspondence_store import load_stored
from recon.sweeps.sweep_quality import SweepQuality
from rig.capture_sections import Live
from rig.capturing.progress import CaptureProgress
from rig.capturing.session_manifest import manifest_of
from rig.errors import CaptureError
from rig.live.live_decoder import LiveDecoder
from rig.live.live_quality import LiveQuality, SweepVerdict, judge
from rig.live.live_status import LiveStatus
from rig.live.status_page import StatusPage

GOOD: dict[str, Any] = {
    "set": "pos0_air",
    "axis": "x",
    "photos": 100,
    "lit_pixels": 1000,
    "coverage": 0.95,
    "saturated_share": 0.0,
    "contrast": 0.9,
    "misfit": 2.0,
    "sd_px": 0.02,
    "dark_gap": 0,
}


@pytest.fixture
def session(captured: Path, tmp_path: Path) -> Path:
    """A captured session that may be written to."""
    return Path(shutil.copytree(captured, tmp_path / "session"))


@pytest.fixture
def manifest(config, scene):
    return manifest_of(config, devices={}, scene=scene)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"lit_pixels": 0, "coverage": float("nan"), "sd_px": float("nan")}, "no pixel saw the stripe"),
        ({"coverage": 0.4}, "matched"),
        ({"saturated_share": 0.2}, "clipped"),
        ({"contrast": 0.1}, "contrast"),
        ({"misfit": 300.0}, "did something move"),
        ({"dark_gap": 20}, "show no stripe"),
    ],
)
def test_each_limit_that_a_sweep_breaks_is_named(manifest, change: dict[str, Any], word: str) -> None:
    assert judge(SweepQuality(**GOOD), Live(), manifest).reasons == ()
    reasons = judge(SweepQuality(**GOOD | change), Live(), manifest).reasons
    assert len(reasons) == 1
    assert word in reasons[0]


def test_the_expected_error_is_a_limit_only_where_the_distance_is_known(manifest) -> None:
    strict = Live(largest_entry_sd_mm=1e-6, object_distance_mm=10.0)
    assert "entry points are expected" in judge(SweepQuality(**GOOD), strict, manifest).reasons[0]
    assert judge(SweepQuality(**GOOD), Live(largest_entry_sd_mm=1e-6), manifest).reasons == ()


def test_sweeps_are_decoded_in_another_process_and_kept_for_the_reconstruction(session: Path, manifest) -> None:
    news: list[str] = []
    seen: list[SweepVerdict] = []
    with LiveDecoder(session) as decoder:
        quality = LiveQuality(decoder, Live(), manifest, on_verdict=seen.append, on_news=news.append)
        for capture_set in manifest.sets:
            for axis in ("x", "y"):
                quality.sweep_taken(capture_set.name, axis)
        assert quality.pending()
        quality.wait(on_poll=lambda: None)
        quality.ask_for_entry_points()
        quality.wait(on_poll=lambda: None)
    opened = open_session(session)
    assert len(quality.verdicts) == 8
    assert all(verdict.quality.lit_pixels > 0 for verdict in quality.verdicts.values())
    assert quality.entry_points is not None
    assert quality.entry_points["matched"] > 0
    assert all(
        load_stored(opened, one, sweep.axis, method="full") is not None
        for one in opened.manifest.sets
        for sweep in one.sweeps
    )
    assert len(seen) == 8
    assert len(news) == 1


def test_a_sweep_that_cannot_be_decoded_is_told_in_one_sentence_and_the_next_has_its_turn(
    session: Path, manifest
) -> None:
    (session / "photos/pos0_air/x/0003.jpg").write_bytes(b"\xff\xd8 no photo")
    news: list[str] = []
    seen: list[SweepVerdict] = []
    with LiveDecoder(session) as decoder:
        quality = LiveQuality(decoder, Live(), manifest, on_verdict=seen.append, on_news=news.append)
        quality.sweep_taken("pos0_air", "x")
        quality.sweep_taken("pos0_air", "y")
        quality.wait(on_poll=lambda: None)
    assert "0003.jpg" in news[0]
    assert "\n" not in news[0]
    assert set(quality.verdicts) == {("pos0_air", "y")}


def test_the_capture_goes_on_when_the_decoding_process_is_killed(session: Path, manifest) -> None:
    news: list[str] = []
    seen: list[SweepVerdict] = []
    with LiveDecoder(session) as decoder:
        quality = LiveQuality(decoder, Live(), manifest, on_verdict=seen.append, on_news=news.append)
        quality.sweep_taken("pos0_air", "x")
        os.kill(decoder.process_id, signal.SIGKILL)
        quality.wait(on_poll=lambda: None)
        quality.sweep_taken("pos0_air", "y")
        quality.wait(on_poll=lambda: None)
    assert len(news) == 1
    assert "goes on without verdicts" in news[0]
    assert not quality.pending()


def test_waiting_for_a_verdict_can_be_interrupted_and_the_process_ends_with_us(session: Path, manifest) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    with LiveDecoder(session) as decoder:
        quality = LiveQuality(decoder, Live(), manifest, on_verdict=print, on_news=print)
        quality.sweep_taken("pos0_air", "x")
        with pytest.raises(KeyboardInterrupt):
            quality.wait(on_poll=interrupt)
    deadline = time.monotonic() + 5
    while Path(f"/proc/{decoder.process_id}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def fetch(address: str) -> tuple[str, bytes]:
    with urllib.request.urlopen(address, timeout=5) as answer:
        return answer.headers["Content-Type"], answer.read()


def test_the_page_is_one_file_and_its_numbers_are_json(config) -> None:
    status = LiveStatus(config, CaptureProgress(Console(quiet=True)))
    status.add("pos0_air x: good")
    status.photographing = ("pos0_air", "y")
    with StatusPage(status.as_json, port=0) as page:
        assert page.address.startswith("http://127.0.0.1:")
        kind, html = fetch(page.address)
        assert kind.startswith("text/html")
        assert b"http" not in html.replace(b"http-equiv", b"")  # nothing from elsewhere
        kind, body = fetch(page.address + "status.json")
        shown = json.loads(body)
        assert kind == "application/json"
        assert shown["news"] == ["pos0_air x: good"]
        assert [sweep["state"] for sweep in shown["sweeps"]] == ["waiting", "photographing"] + ["waiting"] * 6
        with pytest.raises(urllib.error.HTTPError):
            fetch(page.address + "../etc/passwd")


def test_a_port_that_is_taken_is_told_in_one_sentence() -> None:
    with StatusPage(dict, port=0) as page:
        port = int(page.address.rstrip("/").rsplit(":", 1)[1])
        with pytest.raises(CaptureError, match=rf"port {port} .* cannot be used"):
            StatusPage(dict, port=port)
