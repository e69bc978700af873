"""Numbers, ticks and sentences of the report."""

import doctest
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup
from report_example import example_maps, example_metrics

from recon.report import charts, numbers, result_section, run_section
from recon.report.page import prose
from recon.report.writer import tiles
from recon.status import PixelStatus


@pytest.mark.parametrize("module", [charts, numbers, result_section, run_section])
def test_examples_in_the_docstrings_hold(module: object) -> None:
    result = doctest.testmod(module)  # type: ignore[arg-type]
    assert result.attempted > 0
    assert result.failed == 0


@given(st.floats(min_value=1e-12, max_value=1e12), st.sampled_from([-1, 1]))
def test_a_number_reads_back_within_half_of_its_third_digit(size: float, sign: int) -> None:
    text = numbers.number(sign * size)
    plain = text.replace(",", "").replace("−", "-")
    if "×" in plain:
        mantissa, _, power = plain.partition(" × 10")
        plain = f"{mantissa}e{power.translate(str.maketrans('⁻⁰¹²³⁴⁵⁶⁷⁸⁹', '-0123456789'))}"
    assert float(plain) == pytest.approx(sign * size, rel=0.00501)


@given(st.integers(1, 10**7), st.integers(1, 10**7))
def test_only_everything_is_a_hundred_per_cent(part: int, whole: int) -> None:
    if part < whole:
        assert numbers.share(part, whole) not in ("100 %", "0 %")
    assert numbers.share(whole, whole) == "100 %"


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(2, 8))
def test_ticks_are_few_and_inside_the_scale(low: float, span: float, wanted: int) -> None:
    scale = charts.Scale(low, low + span, 0.0, 100.0)
    places = [place for place, _ in scale.ticks(wanted)]
    assert len(places) <= wanted + 1
    assert all(-0.1 <= place <= 100.1 for place in places)


def test_a_path_lifts_its_pen_where_there_is_no_value() -> None:
    scale = charts.Scale(0, 1, 0, 10)
    assert charts.line_path(scale, scale, [(0, 0), (0.5, math.nan), (1, 1)]) == "M0 0M10 10"


def test_words_between_backticks_become_code_and_all_else_is_escaped() -> None:
    assert prose("run `a <b>` & go") == Markup("run <code>a &lt;b&gt;</code> &amp; go")


def test_a_lone_backtick_stays_as_it_is() -> None:
    assert prose("5` <i>") == "5` &lt;i&gt;"


def test_the_tiles_tell_of_the_points_that_were_measured_as_the_table_does() -> None:
    maps = example_maps()
    sd_mm, status = maps.sd_mm.copy(), maps.status.copy()
    points = np.flatnonzero(maps.valid())
    sd_mm.ravel()[points] = 0.02
    covered = points[: 2 * len(points) // 3]
    status.ravel()[covered], sd_mm.ravel()[covered] = PixelStatus.COVERED, 0.5
    shown = tiles(replace(maps, sd_mm=sd_mm, status=status), example_metrics(maps), numbers.LengthUnit.of("mm"))
    assert dict(tile[:2] for tile in shown)["Standard deviation"] == "0.0200"
