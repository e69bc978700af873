"""Codes with fewer photos, from the rig's plan to the surface: photographed, decoded while it goes on, reconstructed."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from recon.run import decode_session
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.journal import read_journal
from recon.sessions.session import open_session
from recon.sweeps.doubtful_ranges import doubtful_ranges
from rig.cli import app

# 512 × 384 device pixels have 64 and 48 half periods of 8: six bits each, shown twice.
PITCH_MM = 0.3848
PHOTOS = {"gray_line": 4 * (2 * (16 + 2 * 6) + 2), "phase_shift": 4 * (2 * 24 + 2)}


@pytest.mark.parametrize("code", ["gray_line", "phase_shift"])
def test_a_session_of_few_photos_becomes_the_surface_to_a_quarter_of_a_display_pixel(code: str, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    size = ["--size", "64", "--display-columns", "512"]
    done = CliRunner().invoke(app, ["simulate", "hemisphere", str(folder), "--code", code, *size])
    assert done.exit_code == 0, done.output
    assert f"{PHOTOS[code]} photos" in done.output
    session = open_session(folder)
    sweeps = decode_session(session, Settings())
    maps = reconstruct(session, sweeps, Settings()).maps
    with np.load(folder / "truth.npz") as truth:
        true_mm = truth["point_mm"]
    judged = maps.valid() & np.isfinite(true_mm).all(axis=2)
    assert judged.sum() > 0.7 * np.isfinite(true_mm).all(axis=2).sum()
    error_mm = np.linalg.norm(maps.point_mm[judged] - true_mm[judged], axis=1)
    assert np.median(error_mm) < PITCH_MM / 4
    # At the rim a photo pixel sees more of the display than a period.
    x, pattern = sweeps["pos1_air", "x"], session.manifest.set_named("pos1_air").sweep("x").pattern
    assert doubtful_ranges(x, pattern, set_name="pos1_air", axis="x", device_px=512)


def test_a_capture_with_a_code_is_judged_while_it_goes_on(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    arguments = ["--scene", "hemisphere", "--size", "48", "--display-columns", "256", "--code", "gray_line", "--live"]
    done = CliRunner().invoke(app, ["capture", "--session", str(folder), "--sim", *arguments])
    assert done.exit_code == 0, done.output
    judged = [event for event in read_journal(folder / "journal.jsonl") if event["event"] == "sweep_judged"]
    assert len(judged) == 8
    assert all(one["photos"] == 26 and one["sd_px"] < 0.2 for one in judged)
