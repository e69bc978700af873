"""Which index a reconstruction uses for the liquid: the one stated, that of water, or the one the session itself shows."""

from dataclasses import dataclass, replace

import numpy as np

from recon.errors import ReconError
from recon.media.chord_index import index_from_chords
from recon.media.index_estimate import IndexEstimate
from recon.media.level_index import index_from_level
from recon.media.stated_index import StatedIndex
from recon.metrics import LiquidIndexRecord
from recon.reconstruct import Crossing
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus

# A measured index contradicts a stated one where it differs this surely, and by more than ordinary errors of the poses explain.
CONTRADICTION_SIGMA = 4.0
CONTRADICTION_N = 0.001
# Known worse than this, an index turns normals by more than 0.3° at 30° of incidence: it is not used.
LARGEST_SD = 0.003
# Paths so nearly parallel that their crossing is 3 % uncertain are also biased along themselves.
CHORD_ANGLE_SIGMA = 30.0


@dataclass(frozen=True, slots=True)
class MeasuredIndex:
    """What the session shows: by the liquid's level beside the object, and by the object's own points and normals.

    The level is believed first: its plane is a plane, while an object may hide a second path.
    """

    level: IndexEstimate | None
    chords: IndexEstimate | None

    @property
    def best(self) -> IndexEstimate | None:
        """The estimate to use, if there is one that is good enough."""
        return next((one for one in (self.level, self.chords) if one is not None and one.sd <= LARGEST_SD), None)


def measured_index(crossing: Crossing, manifest: Manifest) -> MeasuredIndex:
    """Measure the index from crossed paths, which do not depend on it."""
    camera = manifest.camera
    beside = crossing.status == PixelStatus.BESIDE_OBJECT
    level = None
    if beside.any():
        row, column = np.divmod(crossing.pixels[beside], camera.columns)
        upright = np.median(crossing.normal[beside], axis=0)
        level = index_from_level(
            crossing.liquid.some(beside),
            crossing.air.some(beside),
            upright=upright / np.linalg.norm(upright),
            place=np.column_stack([row / camera.rows, column / camera.columns]),
            n_air=manifest.n_air,
        )
    points = crossing.points
    with np.errstate(invalid="ignore"):
        sound = points.angle_rad > CHORD_ANGLE_SIGMA * points.angle_sd_rad
    sound &= crossing.status == PixelStatus.OK

    def on_grid(values: np.ndarray) -> np.ndarray:
        grid = np.full((camera.rows * camera.columns, *values.shape[1:]), np.nan)
        grid[crossing.pixels[sound]] = values[sound]
        return grid.reshape(camera.rows, camera.columns, *values.shape[1:])

    chords = index_from_chords(
        on_grid(points.point_mm),
        on_grid(np.trace(points.covariance, axis1=1, axis2=2)),
        on_grid(crossing.liquid.direction),
        on_grid(crossing.air.direction),
        n_air=manifest.n_air,
    )
    return MeasuredIndex(level, chords)


def with_index_uncertainty(crossing: Crossing, manifest: Manifest, *, sd: float) -> Crossing:
    """Return the crossings with the uncertainty of the index in the variance that all normals share.

    n ∝ n_liquid U − n_air V, so that a change of n_liquid turns it by the part of U across it over the length of the difference.
    """
    u = crossing.liquid.direction
    length = np.linalg.norm(manifest.n_liquid() * u - manifest.n_air * crossing.air.direction, axis=1)
    across = 1 - (u * crossing.normal).sum(axis=1) ** 2
    return replace(crossing, carried_rad2=crossing.carried_rad2 + sd**2 * across / length**2)


def chosen_index(stated: StatedIndex | None, measured: MeasuredIndex) -> LiquidIndexRecord:
    """Return the index to use and where it comes from.

    Raises
    ------
    ReconError
        Where it is neither stated nor measured well enough.
    """
    best = measured.best
    if stated is None and best is None:
        raise ReconError(
            "the liquid's index is not stated, and this session does not show it: no flat liquid is seen beside the object, and "
            "too little of the object; give liquid.n, or for water liquid.temperature_c, in the manifest"
        )
    contradiction = 0.0
    if stated is not None and best is not None and abs(stated.n - best.n) > CONTRADICTION_N:
        contradiction = abs(stated.n - best.n) / best.sd
    return LiquidIndexRecord(
        n=stated.n if stated is not None else best.n,  # type: ignore[union-attr]  # one of them is there
        sd=None if stated is not None else best.sd,  # type: ignore[union-attr]  # one of them is there
        source=stated.source if stated is not None else "measured by the session",
        level_n=measured.level.n if measured.level else None,
        level_sd=measured.level.sd if measured.level else None,
        chords_n=measured.chords.n if measured.chords else None,
        chords_sd=measured.chords.sd if measured.chords else None,
        contradicted=contradiction > CONTRADICTION_SIGMA,
    )


def index_sentences(record: LiquidIndexRecord) -> tuple[str, ...]:
    """Say where a measured index comes from, and where the session contradicts a stated one."""
    by_level = record.level_sd is not None and record.level_sd <= LARGEST_SD
    n, sd = (record.level_n, record.level_sd) if by_level else (record.chords_n, record.chords_sd)
    way = "by the liquid's flat surface beside the object" if by_level else "by the object's own points and normals"
    if record.sd is not None:
        return (f"The liquid's index was not stated; the session shows {n:.4f} ± {sd:.4f}, {way}.",)
    if record.contradicted:
        return (
            f"The liquid's index {record.source} is {record.n:.4f}, but the session shows {n:.4f} ± {sd:.4f}, {way}: "
            "check liquid, temperature, the display's colour, and how far apart its positions are.",
        )
    return ()
