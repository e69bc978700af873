"""The report as a file: what is on the page, what it loads, how it treats hostile or missing parts."""

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from report_example import example_manifest, example_maps, example_mesh, example_metrics

from recon.errors import ReconError
from recon.maps import Maps
from recon.metrics import Verdict
from recon.report.numbers import LengthUnit
from recon.report.page import render_page
from recon.report.result_section import result_section
from recon.report.run_section import device_banners, run_section
from recon.report.writer import write_report
from recon.status import REASONS, PixelStatus

PANELS = (
    "view",
    "funnel",
    "statistics",
    "evaluation",
    "depth",
    "normal",
    "angle",
    "gap",
    "sd",
    "distributions",
    "status",
    "curves",
    "photos",
    "drawing",
    "calibration",
    "poses",
    "parts",
    "patterns",
    "devices",
    "stages",
    "parameters",
    "versions",
    "hashes",
    "methods",
)
HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>"


class Page(HTMLParser):
    """Elements of a page with their attributes, and the text inside each element that has an id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def ids(self) -> list[str]:
        return [str(attributes["id"]) for _, attributes in self.elements if "id" in attributes]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def report_text(folder: Path, **changes: object) -> str:
    maps = changes.pop("maps", None) or example_maps()
    assert isinstance(maps, Maps)
    parts: dict[str, object] = {
        "metrics": changes.get("metrics") or example_metrics(maps),
        "manifest": example_manifest(),
        "mesh": example_mesh(maps) if maps.valid().any() else None,
    }
    return write_report(folder, maps=maps, **(parts | changes)).read_text(encoding="utf-8")  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    return report_text(tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_shows_every_panel(page: Page) -> None:
    assert [name for name in PANELS if f"panel-{name}" not in page.ids] == []


def test_every_entry_of_the_navigation_leads_somewhere_and_ids_are_unique(page: Page) -> None:
    targets = [
        str(attributes["href"])[1:]
        for tag, attributes in page.elements
        if tag == "a" and str(attributes.get("href", "")).startswith("#")
    ]
    assert len(targets) >= 8
    assert set(targets) <= set(page.ids)
    assert len(set(page.ids)) == len(page.ids)


def test_names_nothing_outside_itself(text: str) -> None:
    without_data = re.sub(r"data:[^\"')]*", "", text)
    assert "http:" not in without_data.replace("http://www.w3.org/2000/svg", "")
    assert "https:" not in without_data
    assert not re.search(r"@import|url\((?!\s*[\"']?data:)", without_data)


def test_loads_nothing_from_outside_itself(page: Page) -> None:
    for tag, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "poster", "action"):
            value = attributes.get(name)
            if value is not None and not (tag == "a" and value.startswith("#")):
                assert value.startswith("data:"), (tag, name, value[:80])


def test_its_policy_forbids_loading_and_foreign_scripts(page: Page) -> None:
    policy = next(str(a["content"]) for tag, a in page.elements if tag == "meta" and "http-equiv" in a)
    assert "default-src 'none'" in policy
    scripts = re.search(r"script-src ([^;]*)", policy)
    assert scripts
    assert "unsafe" not in scripts[1]
    assert scripts[1].count("sha256-") == 2


def test_every_picture_has_words_for_those_who_cannot_see_it(page: Page) -> None:
    pictures = [attributes for tag, attributes in page.elements if tag == "img"]
    assert len(pictures) > 10
    assert all(len(str(attributes.get("alt") or "")) > 20 for attributes in pictures)
    drawings = [attributes for tag, attributes in page.elements if tag == "svg"]
    assert all(attributes.get("aria-label") or attributes.get("aria-hidden") for attributes in drawings)


def test_is_small_enough_to_send_even_when_every_map_is_pure_noise(tmp_path: Path) -> None:
    # Noise is what PNG compresses worst, and larger maps are thinned to this size: no session makes a larger page.
    rng = np.random.default_rng(3)
    shape = (800, 900)
    normal = rng.normal(size=(*shape, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    values = rng.uniform(0.01, 1, (3, *shape)).astype(np.float32)
    maps = Maps(
        point_mm=rng.normal((0, 0, -40), 10, (*shape, 3)),
        normal=normal,
        sd_mm=values[0],
        gap_mm=values[1],
        pbc_angle_rad=values[2],
        status=np.zeros(shape, dtype=np.uint8),
    )
    path = write_report(
        tmp_path,
        maps=maps,
        metrics=example_metrics(example_maps()),
        manifest=example_manifest(),
        mesh=None,
    )
    assert path.stat().st_size < 10_000_000


def test_a_hostile_name_stays_text(page: Page, tmp_path: Path) -> None:
    maps = example_maps()
    metrics = example_metrics(
        maps,
        session=HOSTILE,
        warnings=(HOSTILE, f"`{HOSTILE}`"),
        parameters={HOSTILE: HOSTILE},
        versions={HOSTILE: HOSTILE},
        hashes={HOSTILE: HOSTILE},
    )
    text = report_text(tmp_path, maps=maps, metrics=metrics, manifest=example_manifest(name=HOSTILE))
    hostile = Page(text)
    assert [tag for tag, _ in hostile.elements].count("script") == [tag for tag, _ in page.elements].count("script")
    assert not [attributes for _, attributes in hostile.elements if "onerror" in attributes]
    assert hostile.text.count("<script>alert(1)</script>") >= 9


def test_the_verdict_comes_before_everything_else_with_reason_and_next_action(page: Page) -> None:
    sections = [str(attributes["id"]) for tag, attributes in page.elements if tag == "section"]
    assert sections[0] == "verdict"
    assert "4.1 % of the lit pixels have a curve that is not that of one stripe" in page.text
    assert "Next: Look at the status map" in page.text


@pytest.mark.parametrize("grade", ["pass", "check", "fail"])
def test_says_the_grade_in_words_and_not_by_colour_alone(grade: str) -> None:
    verdict = Verdict(grade=grade, reasons=("as measured",), next_action="none")  # type: ignore[arg-type]
    page = Page(render_page("a session", sections=(), kind="report", verdict=verdict))
    assert f"{grade.capitalize()} as measured Next: none" in page.text


def test_shows_each_reason_with_its_count(page: Page) -> None:
    status = example_maps().status
    for reason in PixelStatus:
        assert f"{REASONS[reason]} {int((status == reason).sum()):,}" in page.text


def test_the_funnel_says_what_each_step_lost(page: Page) -> None:
    funnel = example_metrics(example_maps()).funnel
    assert f"{funnel.lit:,}" in page.text
    assert f"−{funnel.matched - funnel.entry_points:,}" in page.text


def test_shouts_when_devices_were_simulated(page: Page) -> None:
    assert "Simulated session. No device was real" in page.text


def test_tells_a_partly_simulated_session_from_a_simulated_one() -> None:
    manifest = example_manifest(kind="real").model_dump()
    manifest["provenance"]["devices"]["pump"]["kind"] = "emulated"
    changed = type(example_manifest()).model_validate(manifest)
    page = Page(render_page("a session", sections=(), kind="report", banners=device_banners(changed)))
    assert "Partly simulated session. Not every device was real (emulated: pump)" in page.text


def test_has_no_banner_when_every_device_was_real() -> None:
    assert device_banners(example_manifest(kind="real")) == ()


def test_says_so_when_nobody_recorded_which_devices_were_real() -> None:
    (banner,) = device_banners(example_manifest(kind="unknown"))
    assert banner.title == "Origin not recorded."
    assert not banner.loud


def test_calls_lengths_scene_units_when_the_session_has_no_millimetres(tmp_path: Path) -> None:
    page = Page(report_text(tmp_path, manifest=example_manifest(length_unit="scene unit")))
    assert "one scene unit is stored as 1 mm" in page.text
    told = page.text.replace("one scene unit is stored as 1 mm in every file (fields named _mm)", "")
    # What remains speaks of millimetres only in the words of the paper's own hemisphere, which is absent here.
    assert not re.search(r"\d mm\b|\(mm\)", told)


def test_says_why_each_panel_is_empty_when_no_pixel_has_a_point(tmp_path: Path) -> None:
    maps = example_maps(rows=30, cols=40, radius_px=12)
    nothing = Maps(
        point_mm=np.full_like(maps.point_mm, np.nan),
        normal=np.full_like(maps.normal, np.nan),
        sd_mm=np.full_like(maps.sd_mm, np.nan),
        gap_mm=np.full_like(maps.gap_mm, np.nan),
        pbc_angle_rad=np.full_like(maps.pbc_angle_rad, np.nan),
        status=np.full_like(maps.status, PixelStatus.UNLIT),
    )
    metrics = example_metrics(maps, statistics=(), curves=(), photos=(), stages=(), hashes={})
    page = Page(report_text(tmp_path, maps=nothing, metrics=metrics))
    assert [name for name in PANELS if f"panel-{name}" not in page.ids] == []
    assert page.text.count("Not shown.") >= 11
    assert "No pixel has a point." in page.text


def test_says_that_the_baseline_gives_no_standard_deviation(tmp_path: Path) -> None:
    maps = example_maps(rows=60, cols=80, radius_px=26)
    without = Maps(
        maps.point_mm, maps.normal, np.full_like(maps.sd_mm, np.nan), maps.gap_mm, maps.pbc_angle_rad, maps.status
    )
    page = Page(report_text(tmp_path, maps=without))
    assert "The reconstruction gave no standard deviations; the method paper estimates none." in page.text


def test_shows_the_rows_of_an_evaluation_with_units_in_their_headings() -> None:
    rows = [{"primitive": "sphere", "radius_mm": 27.987, "normal_median_deg": 0.2136, "inliers": 16773}]
    section = result_section(example_metrics(example_maps()), unit=LengthUnit.of("mm"), thin=False, evaluation=rows)
    page = Page(render_page("a session", sections=(section,), kind="report"))
    assert "primitive radius (mm) normal median (°) inliers sphere 28.0 0.214 16,773" in page.text


def test_settings_that_come_once_a_sweep_become_one_table() -> None:
    noise = {"gain": 0.0086622, "misfit": None}
    maps = example_maps(rows=30, cols=40, radius_px=12)
    metrics = example_metrics(maps, parameters={"noise_x": noise, "noise_y": noise, "gap": {"sigma": 5.0}})
    page = Page(render_page("a session", sections=(run_section(metrics, example_manifest()),), kind="report"))
    assert "Parameter Value method full gap.sigma 5" in page.text
    assert "gain misfit noise_x 0.0086622 none noise_y 0.0086622 none" in page.text


def test_names_the_folder_when_the_report_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match="absent: no such folder"):
        report_text(tmp_path / "absent")
