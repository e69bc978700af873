"""``rig display``: the display by hand, simulated and as a page in Chromium."""

import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from chromium_page import open_browser

from rig.cli import main
from rig.config import load_config
from rig.devices import real_display
from rig.errors import ConfigError

# 255 · ½(1 + cos 2πd/12) at d = -6 … 6: the cosines are 0, ½, √3/2 and 1.
COSINE_12 = [0, 17, 64, 128, 191, 238, 255, 238, 191, 128, 64, 17, 0]
TEMPLATE = (resources.files("rig") / "template.toml").read_text("utf-8")


def rig_file(folder: Path, display: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(TEMPLATE.replace('display = "" ', f'display = "{display}" '), encoding="utf-8")
    return path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["rig", *arguments])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_a_simulated_display_shows_and_reports(monkeypatch, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "display", "show", "stripe", "3", "--axis", "y", "--sim") == 0
    assert run(monkeypatch, "display", "screen", "--sim") == 0
    out = capfd.readouterr().out
    assert "display: stripe 3 along y is on the glass" in out
    assert "as configured" in out
    assert "simulated: simulated display" in out


def test_a_stripe_beyond_the_sweep_is_refused(monkeypatch, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "display", "show", "stripe", "99999", "--sim") == 1
    assert "stripe 99999 asked, the sweep along x has stripes 0 to " in capfd.readouterr().err


@pytest.mark.parametrize(
    ("display", "sentence"),
    [
        ("", 'no display configured.*display = "browser:"'),
        ("hologram:9", "no driver answers to 'hologram:9'; write browser: or browser:HOST:PORT"),
    ],
)
def test_a_display_that_no_driver_answers_to_is_refused(tmp_path: Path, display: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        real_display(load_config(rig_file(tmp_path, display)))


def test_a_page_shows_the_stripe_of_the_configuration_until_return_is_pressed(tmp_path: Path) -> None:
    path = rig_file(tmp_path, "browser:127.0.0.1:0")
    arguments = ["display", "show", "stripe", "2", "--config", str(path)]
    with (
        open_browser() as browser,
        subprocess.Popen(
            [sys.executable, "-u", "-c", "from rig.cli import main; main()", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_STATE_HOME": str(tmp_path)},
        ) as rig,
    ):
        assert rig.stdin is not None
        assert rig.stdout is not None
        assert rig.stderr is not None
        try:
            url = next(line.strip() for line in rig.stderr if line.startswith("http://"))
            with browser.page(url, columns=2048, rows=1536) as page:
                assert rig.stdout.readline() == "display: stripe 2 along x is on the glass\n"
                picture = page.picture()
                # A raised cosine 12 pixels wide about column 400 + 2 · 4, in green: half as bright 3 pixels beside its centre.
                np.testing.assert_array_equal(picture[700, 402:415, 1], COSINE_12)
                np.testing.assert_array_equal(np.flatnonzero(picture[..., 1].any(axis=0)), np.arange(403, 414))
                assert not picture[..., [0, 2]].any()
                rig.stdin.write("\n")
                rig.stdin.flush()
                assert rig.wait(30) == 0
                assert not page.picture().any()
        finally:
            rig.kill()
