"""The part of a sweep that was really photographed, where a scan found that the rest of the display is not seen."""

from collections.abc import Mapping

from recon.errors import SessionError
from recon.sessions.journal import SweepRange
from recon.sessions.manifest import Manifest, Sweep
from recon.sessions.pattern import Pattern, StripePattern

FEWEST_STRIPES = 3  # what a pattern holds at least


def narrowed(manifest: Manifest, ranges: Mapping[tuple[str, str], SweepRange], *, source: str) -> Manifest:
    """Return the manifest with each sweep narrowed to its range; ``source`` names the journal in errors."""
    names = {one.name for one in manifest.sets}
    for name, _ in ranges:
        if name not in names:
            raise SessionError(f"{source}: sweep_range: the manifest has no set {name!r}; correct the line")

    def part(name: str, sweep: Sweep) -> Sweep:
        found = ranges.get((name, sweep.axis))
        if found is None:
            return sweep
        return sweep.model_copy(update={"pattern": _part_of(sweep.pattern, found, source=source)})

    sets = tuple(
        one.model_copy(update={"sweeps": tuple(part(one.name, sweep) for sweep in one.sweeps)}) for one in manifest.sets
    )
    return manifest.model_copy(update={"sets": sets})


def _part_of(pattern: Pattern, found: SweepRange, *, source: str) -> StripePattern:
    if not isinstance(pattern, StripePattern):
        raise SessionError(
            f"{source}: sweep_range of {found.set}/{found.axis} narrows a sweep of kind {pattern.kind!r}, which is always "
            "whole; remove the line"
        )
    count = found.last_index - found.first_index + 1
    if count < FEWEST_STRIPES or found.last_index >= pattern.count:
        raise SessionError(
            f"{source}: sweep_range of {found.set}/{found.axis} is {found.first_index} to {found.last_index}; "
            f"it must hold at least {FEWEST_STRIPES} of the {pattern.count} stripes of the manifest"
        )
    return pattern.model_copy(
        update={"first_px": pattern.first_px + pattern.step_px * found.first_index, "count": count}
    )
