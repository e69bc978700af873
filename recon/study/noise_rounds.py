"""Rounds of one experiment with noise drawn anew, both methods on the same pixels."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from recon.evaluation.coverage import Coverage, coverage_of, directions_alike
from recon.evaluation.spread import angle_between_rad
from recon.maps import Maps
from recon.method import Limits, Method
from recon.reconstruct import cross_paths, maps_of
from recon.sessions.manifest import Manifest
from recon.study.noisy_sweeps import TrueSession, noisy_sweeps
from recon.surface.surface_stage import surface_of
from recon.surface.thin_stage import thin_object
from recon.sweeps.correspondence import SweepResult

METHODS: tuple[Method, Method] = ("paper", "full")
Sweeps = dict[tuple[str, str], SweepResult]


@dataclass(frozen=True, slots=True)
class MethodErrors:
    """Errors of one method over all rounds.

    ``kept`` is the share of judged pixels that pass the paper's tests and have a point. Coverage is that of the 95 % intervals of
    all points that the method itself has, where it states their standard deviations.
    """

    position_rms: float
    normal_rms_deg: float
    normal_mean_deg: float
    kept: float
    point_coverage: Coverage | None = None
    normal_coverage: Coverage | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Stated:
    """Errors of one round and the standard deviations that the method stated, single precision."""

    point: np.ndarray
    point_sd: np.ndarray
    point_directions: np.ndarray
    normal: np.ndarray
    normal_sd: np.ndarray

    @classmethod
    def of(cls, maps: Maps, session: TrueSession) -> "_Stated | None":
        if maps.normal_sd_rad is None or maps.across_sd_mm is None:
            return None
        truth = session.truth
        own = maps.valid() & truth.judged & np.isfinite(maps.normal).all(axis=2)
        parts = (
            np.linalg.norm(maps.point_mm[own] - truth.point_mm[own], axis=1),
            maps.sd_mm[own],
            directions_alike(maps.sd_mm[own].astype(np.float64), maps.across_sd_mm[own].astype(np.float64)),
            angle_between_rad(maps.normal[own], truth.normal[own]),
            maps.normal_sd_rad[own],
        )
        return cls(*(part.astype(np.float32) for part in parts))


@dataclass(slots=True)
class _Sums:
    pixels: int = 0
    judged: int = 0
    position: float = 0.0
    normal: float = 0.0
    normal_size: float = 0.0
    stated: list[_Stated] = field(default_factory=list)

    def add(self, maps: Maps, session: TrueSession, found: Bool[np.ndarray, "rows cols"]) -> None:
        truth = session.truth
        angle = angle_between_rad(maps.normal[found], truth.normal[found])
        self.pixels += int(found.sum())
        self.judged += int(truth.judged.sum())
        self.position += float(((maps.point_mm[found] - truth.point_mm[found]) ** 2).sum())
        self.normal += float((angle**2).sum())
        self.normal_size += float(angle.sum())
        stated = _Stated.of(maps, session)
        if stated is not None:
            self.stated.append(stated)

    def coverage(self, error: str, sd: str, directions: str | None = None) -> Coverage | None:
        """Return the coverage over all rounds together."""
        if not self.stated:
            return None

        def told(name: str) -> np.ndarray:
            return np.concatenate([getattr(one, name) for one in self.stated]).astype(np.float64)

        numbers = np.repeat(np.arange(len(self.stated)), [len(one.point) for one in self.stated])
        return coverage_of(told(error), told(sd), numbers, directions=None if directions is None else told(directions))

    def errors(self) -> MethodErrors:
        if not self.pixels:
            return MethodErrors(np.nan, np.nan, np.nan, 0.0)
        return MethodErrors(
            position_rms=float(np.sqrt(self.position / self.pixels)),
            normal_rms_deg=float(np.degrees(np.sqrt(self.normal / self.pixels))),
            normal_mean_deg=float(np.degrees(self.normal_size / self.pixels)),
            kept=self.pixels / self.judged if self.judged else 0.0,
            point_coverage=self.coverage("point", "point_sd", "point_directions"),
            normal_coverage=self.coverage("normal", "normal_sd"),
        )


def noise_rounds(
    session: TrueSession,
    *,
    sd_px: float,
    rounds: int,
    rng: np.random.Generator,
    on_round: Callable[[], None] = lambda: None,
) -> dict[Method, MethodErrors]:
    """Return each method's errors over ``rounds`` draws of the noise, on the pixels where both have a point and normal.

    The paper's method gives the pixels: those that pass its tests (angle and gap). What the other leaves out of them lowers
    its ``kept``.
    """
    sums: dict[Method, _Sums] = {method: _Sums() for method in METHODS}
    for _ in range(rounds):
        sweeps = noisy_sweeps(session, sd_px=sd_px, rng=rng)
        maps = {method: reconstructed(sweeps, session.manifest, method=method) for method in METHODS}
        passed = {
            method: each.valid() & session.truth.judged & np.isfinite(each.normal).all(axis=2)
            for method, each in maps.items()
        }
        both = passed["paper"] & passed["full"]
        for method in METHODS:
            sums[method].add(maps[method], session, both)
        on_round()
    return {method: each.errors() for method, each in sums.items()}


def reconstructed(sweeps: Sweeps, manifest: Manifest, *, method: Method) -> Maps:
    """Return the maps of a session's method, as ``recon run`` makes them of decoded sweeps."""
    if manifest.method == "thin":
        return thin_object(sweeps, manifest, method=method).maps
    status, crossing = cross_paths(sweeps, manifest, method=method, limits=Limits())
    shape = (manifest.camera.rows, manifest.camera.columns)
    maps = maps_of(status, crossing, shape=shape, method=method)
    return maps if method == "paper" else surface_of(maps, crossing, manifest, method=method).maps
