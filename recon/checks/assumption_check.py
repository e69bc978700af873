"""What a session shows of the assumptions of the method, as sentences for the verdict."""

from collections.abc import Mapping

from recon.checks.leaning import Lean, lean
from recon.checks.shared_gaps import AREA_SHARE, SharedGaps
from recon.checks.wet_spots import WetSpot, wet_spots
from recon.maps import Maps
from recon.reconstruct import Crossing
from recon.status import StatusMap
from recon.sweeps.correspondence import SweepResult

# Sessions in which nothing was wrong lean by up to 5 sd and 0.05 (an ornament of unlike facets), mostly by less than 2 sd.
LEAN_SIGMA = 8.0
LEAN_SLOPE = 0.1
SPOTS_NAMED = 3


def assumption_doubts(
    sweeps: Mapping[tuple[str, str], SweepResult],
    crossing: Crossing,
    maps: Maps,
    crossed: StatusMap,
    shared: SharedGaps,
    *,
    corner: tuple[int, int] = (0, 0),
) -> tuple[str, ...]:
    """Return a sentence for each assumption that the session itself contradicts; ``crossed`` is the status before any surface.

    ``corner`` is the row and the column of the photo at which the maps begin.
    """
    doubts = []
    if shared.share > AREA_SHARE:
        doubts.append(_shared_sentence(shared.share))
    spots = wet_spots(sweeps, crossed, shared.stands_out, corner=corner)
    if spots:
        doubts.append(_spots_sentence(spots, corner))
    leaning = lean(crossing, maps)
    if leaning is not None and leaning.sigma > LEAN_SIGMA and leaning.slope > LEAN_SLOPE:
        doubts.append(_lean_sentence(leaning))
    return tuple(doubts)


def _shared_sentence(share: float) -> str:
    return (
        f"Over {share:.0%} of the object, the light paths of neighbours miss each other alike, as no slip of the display makes "
        "them: light may leave the object there and enter it again (a hollow, a slot), or there is something between object and "
        "display. Do not use the points there; the gap map shows where."
    )


def _spots_sentence(spots: tuple[WetSpot, ...], corner: tuple[int, int]) -> str:
    named = "; ".join(f"column {corner[1] + spot.col}, row {corner[0] + spot.row}" for spot in spots[:SPOTS_NAMED])
    more = f"; and {len(spots) - SPOTS_NAMED} more" if len(spots) > SPOTS_NAMED else ""
    what = "One spot is" if len(spots) == 1 else f"{len(spots)} spots are"
    return f"{what} sound in air and not in the liquid: look for bubbles on object and display (photo pixels at {named}{more})."


def _lean_sentence(found: Lean) -> str:
    return (
        f"Points and normals lean against each other across the object ({found.sigma:.0f} sd): the object moved when the tank "
        "was filled, or a pose is wrong. Points and normals are then wrong by more than their standard deviations."
    )
