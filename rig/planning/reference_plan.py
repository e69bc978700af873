"""Where the reference photos go in a plan: before and after every sweep."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

from recon.scene.scene_check import REFERENCE
from rig.planning.steps import PhotoKey, StartSweep, Step, TakePhoto

AXES = ("x", "y")


def with_references(steps: Sequence[Step], *, done: Collection[PhotoKey], photo: TakePhoto) -> list[Step]:
    """Return the plan with a reference photo before and after every sweep; one between two sweeps is both.

    Those of a set are numbered on from what is ``done``, so that one more is taken whenever a capture is resumed. Two are
    taken in a row where there is none yet: their difference is the photos' noise. All show the frame of ``photo``.
    """
    return list(_with_references(steps, done=done, photo=photo))


def _with_references(steps: Sequence[Step], *, done: Collection[PhotoKey], photo: TakePhoto) -> Iterator[Step]:
    taken = [key for key in done if key[1] == REFERENCE]
    following_index: dict[str, int] = {}
    for name, _, index in taken:
        following_index[name] = max(following_index.get(name, 0), index + 1)

    def reference(name: str) -> TakePhoto:
        index = following_index.get(name, 0)
        following_index[name] = index + 1
        return replace(photo, set_name=name, index=index)

    none_yet = not taken
    last: str | None = None  # the set whose reference photo was the last step
    for step, following in zip_longest(steps, steps[1:]):
        if isinstance(step, StartSweep) and last != step.set_name:
            if none_yet:
                yield reference(step.set_name)
            none_yet = False
            yield reference(step.set_name)
        yield step
        last = None
        if isinstance(step, TakePhoto) and step.sweep in AXES and not _same_sweep(step, following):
            yield reference(step.set_name)
            last = step.set_name


def _same_sweep(photo: TakePhoto, following: Step | None) -> bool:
    return isinstance(following, TakePhoto) and (following.set_name, following.sweep) == (photo.set_name, photo.sweep)
