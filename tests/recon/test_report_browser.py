"""The report in a browser: no fault in the console, a view that draws, words where it cannot."""

import re
from pathlib import Path

import pytest
from browser import SMALL_WORDS, ask, visit
from report_example import example_manifest, example_maps, example_mesh, example_metrics

from recon.report.writer import write_report

# Share of the canvas that is drawn on, and how many colours there are among the pixels drawn.
LOOK = """
  const gl = document.querySelector('#viewer canvas').getContext('webgl2');
  const share = () => {
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const colours = new Set();
    let drawn = 0;
    for (let k = 0; k < pixels.length; k += 4) {
      if (!pixels[k + 3]) continue;
      drawn++;
      colours.add(pixels[k] >> 4 << 8 | pixels[k + 1] >> 4 << 4 | pixels[k + 2] >> 4);
    }
    return [drawn / (width * height), colours.size];
  };
  const found = {};
  const press = (what) => { document.querySelector(what).click(); };
  const steps = [
    ['points', () => press('[data-show=points]')], ['mesh', () => press('[data-show=mesh]')],
    ['normal', () => press('[data-colour=normal]')], ['sd', () => press('[data-colour=sd]')],
    ['plain', () => press('[data-colour=plain]')], ['side', () => press('[data-view=side]')],
  ];
  const next = () => {
    if (!steps.length) { answer(found); return; }
    const [name, act] = steps.shift();
    act();
    // Asked after the page's own request, so this runs when the page has drawn.
    requestAnimationFrame(() => { found[name] = share(); next(); });
  };
  next();
"""

# Elements whose words stand out less than 4.5 to 1 from the ground behind them, in either theme.
CONTRAST = """
  const linear = (part) => { const c = part / 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; };
  const light = (text) => {
    const [r, g, b] = text.match(/[\\d.]+/g).map(Number).map(linear);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = getComputedStyle(at).backgroundColor;
      if (!colour.endsWith(', 0)')) return colour;
    }
    return 'rgb(255, 255, 255)';
  };
  const poor = [];
  const words = 'h1,h2,h3,p,dt,dd,li,th,td,a,button,figcaption,.reason,.note,.banner:not(.loud)';
  for (const theme of ['light', 'dark']) {
    document.documentElement.dataset.theme = theme;
    for (const element of document.querySelectorAll(words)) {
      if (!element.textContent.trim() || !element.getClientRects().length || element.disabled) continue;
      if (element.closest('tr.none')) continue;  // reasons that no pixel has are pale on purpose
      const a = light(getComputedStyle(element).color), b = light(ground(element));
      const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (contrast < 4.5) poor.push([theme, element.tagName, element.className, contrast]);
    }
  }
  answer(poor);
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    maps = example_maps()
    folder = tmp_path_factory.mktemp("browser")
    return write_report(
        folder, maps=maps, metrics=example_metrics(maps), manifest=example_manifest(), mesh=example_mesh(maps)
    )


def test_loads_without_a_word_in_the_console_and_draws_the_view(page: Path, tmp_path: Path) -> None:
    seen = visit(page, tmp_path)
    assert seen.console == ()
    assert re.search(r'<div class="viewer live" id="viewer" data-drawn="points">', seen.document)


def test_a_fault_in_the_page_would_be_heard(page: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.html"
    broken.write_text(page.read_text(encoding="utf-8").replace("</body>", "<script>nonsense()</script></body>"))
    assert any("Content Security Policy" in line for line in visit(broken, tmp_path).console)


def test_draws_points_and_mesh_in_every_colour(page: Path, tmp_path: Path) -> None:
    found = ask(page, tmp_path, LOOK, "--window-size=1200,900")
    assert isinstance(found, dict)
    # The cap is round and just fits a window of 12 to 7: its disc, seen from the side by 32 degrees at first, covers from
    # a fifth to a half of it. Seen along the edge it is a thin segment.
    for name in ("points", "mesh", "normal", "sd", "plain"):
        assert 0.15 < found[name][0] < 0.5, name
    assert found["side"][0] < found["plain"][0]
    assert found["points"][1] > 20
    # Shades of one grey are a line through the colours, which meets at most three times sixteen of their cells; normals
    # spread over a half ball of colours.
    assert found["plain"][1] <= 48
    assert found["normal"][1] > 100


def test_keeps_the_still_picture_and_a_sentence_where_there_is_no_webgl(page: Path, tmp_path: Path) -> None:
    seen = visit(page, tmp_path, webgl=False)
    assert seen.console == ()
    assert '<div class="viewer" id="viewer">' in seen.document
    assert "offers no WebGL 2" in seen.document


def test_does_not_scroll_sideways_on_a_narrow_screen(page: Path, tmp_path: Path) -> None:
    measure = "const root = document.documentElement; answer([root.scrollWidth, root.clientWidth]);"
    found = ask(page, tmp_path, measure, "--window-size=500,900")
    assert isinstance(found, list)
    assert found[0] <= found[1]


def test_words_in_drawings_can_be_read_on_a_narrow_screen(page: Path, tmp_path: Path) -> None:
    assert ask(page, tmp_path, SMALL_WORDS, "--window-size=500,900") == {}


def test_words_stand_out_from_their_ground_in_both_themes(page: Path, tmp_path: Path) -> None:
    # WCAG 2.2, success criterion 1.4.3: a contrast of at least 4.5 to 1.
    assert ask(page, tmp_path, CONTRAST) == []
