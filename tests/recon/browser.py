"""Headless Chromium for tests of pages: run a page from disk and hear what its console said."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

# The software renderer reads pixels back for the screenshot and remarks on it; that is no fault of the page.
HARMLESS = "GPU stall due to ReadPixels"
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--hide-scrollbars",
    "--enable-logging=stderr",
    "--virtual-time-budget=15000",
)
# Words in drawings that are smaller than 8 px on the screen, each drawing by the id of its panel.
SMALL_WORDS = """
  const found = {};
  for (const text of document.querySelectorAll('svg text')) {
    const scale = text.getScreenCTM();
    const size_px = scale ? parseFloat(getComputedStyle(text).fontSize) * scale.a : 0;
    if (size_px > 0 && size_px < 8) found[text.closest('[id]').id] = size_px;
  }
  answer(found);
"""
NO_WEBGL = ("--disable-3d-apis",)
SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader")


@dataclass(frozen=True, slots=True)
class Visit:
    """What a visit to a page left behind: its document after the scripts ran, and the lines of its console."""

    document: str
    console: tuple[str, ...]


def visit(page: Path, scratch: Path, *options: str, webgl: bool = True) -> Visit:
    """Open a page from disk, wait until it is quiet, and return its document and console."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Chromium to look at the page: apt-get install chromium")
    graphics = SOFTWARE_WEBGL if webgl else NO_WEBGL
    profile = f"--user-data-dir={scratch / 'profile'}"
    command = [program, *OPTIONS, *graphics, *options, profile, "--dump-dom", page.as_uri()]
    ended = subprocess.run(command, capture_output=True, timeout=90, check=True)
    said = re.findall(r"CONSOLE[^\]]*\] (.*)", ended.stderr.decode(errors="replace"))
    return Visit(ended.stdout.decode(), tuple(line for line in said if HARMLESS not in line))


def ask(page: Path, scratch: Path, script: str, *options: str) -> object:
    """Run ``script`` at the end of a copy of the page, without its security policy, and return the JSON it leaves.

    The script calls ``answer(value)`` once.
    """
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"<meta http-equiv=.Content-Security-Policy.[^>]*>", "", text)
    probe = (
        "<script>function answer(value) { const note = document.createElement('pre'); note.id = 'answer';"
        "note.textContent = btoa(JSON.stringify(value)); document.body.append(note); }"
        f"addEventListener('load', () => {{ {script} }});</script></body>"
    )
    copy = scratch / "asked.html"
    copy.write_text(text.replace("</body>", probe), encoding="utf-8")
    found = re.search(r'<pre id="answer">([^<]*)</pre>', visit(copy, scratch, *options).document)
    assert found, "the script left no answer"
    return json.loads(base64.b64decode(found[1]))
