"""How often 95 % intervals hold, as tables: every noise by itself, and over all of them how many tenths miss the goal."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import ndtr

from recon.evaluation.coverage import Coverage, Share
from recon.method import Method
from recon.study.noise_rounds import MethodErrors
from recon.study.study_result import Cell, StudyTable

LEAST, MOST = 0.93, 0.97
SAMPLING_SDS = 2.0
Errors = Mapping[Method, MethodErrors]


def coverage_tables(varied: str, errors: Mapping[tuple[str, float], Errors]) -> tuple[StudyTable, StudyTable]:
    """Return the coverage of method ``full`` for each noise, and its summary over all noises."""
    found = {
        (label, sigma, quantity): coverage
        for (label, sigma), each in errors.items()
        for quantity, coverage in (("points", each["full"].point_coverage), ("normals", each["full"].normal_coverage))
        if coverage is not None
    }
    return _each(varied, found), _summary(varied, found)


def _each(varied: str, found: Mapping[tuple[str, float, str], Coverage]) -> StudyTable:
    rows = tuple(
        (
            *key,
            _percent(coverage.whole),
            *_outside(coverage.by_decile),
            " ".join(_percent(share) for share in coverage.by_decile),
        )
        for key, coverage in found.items()
    )
    return StudyTable(
        title="95 % intervals of method full that hold the truth (%)",
        headings=(varied, "σ", "of", "all", "tenths outside", "clearly", "tenths, the surest first"),
        rows=rows,
        note="Tenths of the pixels by their stated standard deviation, over all rounds together. After ±, the standard deviation "
        "of the figure's sampling, from how rounds differ. Outside: not within 93 … 97 %; clearly: by more than twice that.",
    )


def _summary(varied: str, found: Mapping[tuple[str, float, str], Coverage]) -> StudyTable:
    rows: list[tuple[Cell, ...]] = []
    for label, quantity in dict.fromkeys((label, quantity) for label, _, quantity in found):
        chosen = [each for (one, _, of), each in found.items() if (one, of) == (label, quantity)]
        tenths = [share for each in chosen for share in each.by_decile]
        outside, clearly = _outside(tenths)
        rows.append(
            (
                label,
                quantity,
                _range([each.whole for each in chosen]),
                _range(tenths),
                f"{len(tenths) - outside} of {len(tenths)}",
                outside_by_chance(chosen),
                clearly,
                100 * float(np.median([share.sd for share in tenths])),
            )
        )
    return StudyTable(
        title="95 % intervals over all σ",
        headings=(
            varied,
            "of",
            "all (%)",
            "a tenth (%)",
            "tenths within 93 … 97 %",
            "outside by chance",
            "clearly outside",
            "sampling sd (%)",
        ),
        rows=tuple(rows),
        note="Least … most. Outside by chance: so many tenths would miss the goal if every interval held exactly 95 %, by the "
        "sampling of these rounds alone; more rounds make it less. Clearly outside: by more than twice the tenth's own sampling "
        "sd, of which the median is given.",
    )


def _outside(tenths: Sequence[Share]) -> tuple[int, int | None]:
    """Return how many tenths miss the goal, and how many by more than sampling explains; None where one round tells nothing."""
    outside = sum(share.outside(LEAST, MOST) for share in tenths)
    if any(np.isnan(share.sd) for share in tenths):
        return outside, None
    return outside, sum(share.clearly_outside(LEAST, MOST, sampling_sds=SAMPLING_SDS) for share in tenths)


def outside_by_chance(coverages: Sequence[Coverage]) -> float | None:
    """Return how many tenths would miss the goal if all held exactly its middle; None where one round tells nothing.

    The sampling sd of a tenth is known to a third from five rounds, and rarely missed goals are those of tenths for which it is
    told too large. So it is pooled over all noises.
    """
    sds = np.array([[share.sd for share in each.by_decile] for each in coverages])
    if np.isnan(sds).any():
        return None
    pooled = np.maximum(np.sqrt((sds**2).mean(axis=0)), np.finfo(float).tiny)
    return round(len(sds) * float(2 * ndtr(-(MOST - LEAST) / 2 / pooled).sum()), 1)


def _percent(share: Share) -> str:
    return f"{100 * share.value:.1f}" + ("" if np.isnan(share.sd) else f"±{100 * share.sd:.1f}")


def _range(shares: Sequence[Share]) -> str:
    values = [100 * share.value for share in shares]
    return f"{min(values):.1f} … {max(values):.1f}"
