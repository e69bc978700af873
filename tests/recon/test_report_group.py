"""The page of a batch: table, strips, outliers and links."""

import doctest
from pathlib import Path, PurePosixPath

import pytest
from browser import SMALL_WORDS, ask, visit
from report_example import example_maps, example_metrics
from test_report import HOSTILE, Page

from recon.errors import ReconError
from recon.metrics import Funnel, Metrics
from recon.report import group
from recon.report.group import GroupRow, Measure, outliers, strip_panel, write_group_report


def metrics_with(normals: int, grade: str = "pass") -> Metrics:
    maps = example_maps(rows=30, cols=40, radius_px=12)
    funnel = Funnel(pixels=2_000_000, lit=1_200_000, matched=1_100_000, entry_points=normals, normals=normals)
    return example_metrics(maps, grade=grade, funnel=funnel)


@pytest.fixture(scope="module")
def rows() -> tuple[GroupRow, ...]:
    fine = [
        GroupRow(f"ball {k}", metrics_with(1_000_000 + 3_000 * k), PurePosixPath(f"ball {k}/recon-full/report.html"))
        for k in range(9)
    ]
    odd = GroupRow("odd one", metrics_with(40_000, "fail"), PurePosixPath("odd one/report.html"))
    return (*fine, odd, GroupRow("lost", None, fault="lost: no journal; is this the folder of a session?"))


def test_the_worst_session_comes_first_and_a_lost_one_says_why(rows: tuple[GroupRow, ...], tmp_path: Path) -> None:
    page = Page(write_group_report(tmp_path / "batch.html", rows).read_text(encoding="utf-8"))
    places = [page.text.index(word) for word in ("lost: no journal", "odd one", "ball 0")]
    assert places == sorted(places)
    assert "Pass 9 of 11 sessions" in page.text
    assert "No result 1 of 11 sessions" in page.text


def test_names_the_outlier_below_its_strip_with_a_link_to_its_report(
    rows: tuple[GroupRow, ...], tmp_path: Path
) -> None:
    text = write_group_report(tmp_path / "batch.html", rows).read_text(encoding="utf-8")
    assert 'Outliers: <a href="./odd%20one/report.html">odd one</a> (40,000)' in text
    assert "Outliers: ball" not in Page(text).text


def test_a_hostile_session_name_stays_text_and_its_link_stays_a_path(tmp_path: Path) -> None:
    row = GroupRow(HOSTILE, metrics_with(5), PurePosixPath('javascript:alert(1)/"><b>/report.html'))
    page = Page(write_group_report(tmp_path / "batch.html", [row]).read_text(encoding="utf-8"))
    assert [tag for tag, _ in page.elements].count("script") == 1
    assert "b" not in [tag for tag, _ in page.elements]
    links = [str(attributes.get("href", "#")) for tag, attributes in page.elements if tag == "a"]
    assert all(link.startswith(("#", "./")) for link in links)


def test_a_few_sessions_have_no_outliers_and_equal_ones_neither() -> None:
    assert outliers([1.0, 1.0, 1.0, 50.0]) == []
    assert outliers([2.0] * 20) == []
    assert doctest.testmod(group).failed == 0


def test_an_empty_batch_still_makes_a_page(tmp_path: Path) -> None:
    page = Page(write_group_report(tmp_path / "batch.html", []).read_text(encoding="utf-8"))
    assert "The batch had no session." in page.text


def test_loads_without_a_word_in_the_console(rows: tuple[GroupRow, ...], tmp_path: Path) -> None:
    assert visit(write_group_report(tmp_path / "batch.html", rows), tmp_path).console == ()


def test_numbers_below_strips_can_be_read_on_a_narrow_screen(rows: tuple[GroupRow, ...], tmp_path: Path) -> None:
    page = write_group_report(tmp_path / "batch.html", rows)
    assert ask(page, tmp_path, SMALL_WORDS, "--window-size=500,900") == {}


def test_names_the_file_when_it_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match=r"absent/batch\.html: the batch's page cannot be written"):
        write_group_report(tmp_path / "absent" / "batch.html", [])


def test_a_number_that_is_the_same_everywhere_stands_alone_on_its_axis() -> None:
    rows = [GroupRow(f"ball {k}", metrics_with(5)) for k in range(6)]
    zero = strip_panel(rows, Measure("saturated", "Saturated share", (0.0,) * 6, "%"))
    assert [label for _, label in zero.data["ticks"]] == ["0"]
    assert {dot["x"] for dot in zero.data["dots"]} == {zero.data["ticks"][0][0]}
