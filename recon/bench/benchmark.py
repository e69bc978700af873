"""The whole benchmark: write the photos, measure every contestant on them, and compare what was measured in this one run."""

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

from recon.bench.bench_result import Agreement, BenchResult, Measurement, Photos, Ratio
from recon.bench.bench_scene import ASPECT
from recon.bench.bench_session import BenchSession, kept_or_written
from recon.bench.contestants import DECODING, FULL, LOOP, PAPER, RUNNING, STACK
from recon.bench.machine import machine, memory_bytes
from recon.bench.measurement import measured, own_processes

PAPER_PIXELS = 3888 * 2592
# What an ordinary camera makes of 3888 × 2592 pixels; other sizes are scaled by their pixels.
PAPER_PHOTO_MB = (1.0, 1.7, 4.0)
LIBRARIES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless", "simplejpeg", "refractive-scan")
LARGEST_STACK_SHARE = 0.5
# So many photos tell by themselves what one more costs, and naive scripts, whose cost is the same for every photo, take too long.
LONG = 300
# A photo that is large enough for every loop to be called, so that it is compiled before anything is timed.
FIRST_COLUMNS, FIRST_PHOTOS = 384, 60

OURS = (PAPER, FULL)
NAIVE = (RUNNING, STACK)


def benchmark(
    folder: Path,
    *,
    columns: int,
    photos: int,
    photo_mb: tuple[float, ...] = PAPER_PHOTO_MB,
    seed: int,
    full: bool,
    command: str,
    say: Callable[[str], None],
) -> BenchResult:
    """Measure on ``photos`` photos of ``columns`` columns, which are written to ``folder``; ``say`` hears how far it is.

    ``photo_mb`` are the sizes of a photo of 3888 × 2592 pixels; everything is measured with the middle one. Without ``full`` the
    maximum-likelihood fit is left out. Raises ``ReconError`` where a measurement dies.
    """
    rows = round(columns * ASPECT)
    wanted = tuple(mb * 1e6 * rows * columns / PAPER_PIXELS for mb in photo_mb)
    middle = len(wanted) // 2
    before = machine()
    long = photos >= LONG
    say(
        f"writing {photos} photos of {columns} x {rows} px in {len(wanted)} sizes"
        + ("" if long else ", and half as many")
    )
    sessions = kept_or_written(folder / "long", columns=columns, photos=photos, photo_bytes=wanted, seed=seed)
    usual = sessions[middle]
    ours = OURS if full else (PAPER,)
    notes = []
    short: tuple[BenchSession, ...] = ()
    if long:
        notes.append(
            f"{PAPER} of half as many photos and the naive scripts were left out: fewer than {LONG} photos tell them"
        )
        tasks = [(session, one, 1) for session in sessions for one in (DECODING, PAPER)]
        tasks += [(usual, one, 1) for one in ours[1:]]
        tasks += [(usual, one, 2) for one in (DECODING, *ours)]
    else:
        short = kept_or_written(
            folder / "short", columns=columns, photos=photos // 2, photo_bytes=wanted[middle : middle + 1], seed=seed
        )
        tasks = [(session, one, 1) for session in sessions for one in (LOOP, DECODING, PAPER)]
        tasks += [(usual, one, 1) for one in ours[1:]]
        tasks += [(usual, one, 2) for one in (LOOP, DECODING, *ours)]
        tasks += [(usual, RUNNING, 1)]
        # A list of photos and the stack made of it are there at the same time.
        stack_bytes = 2 * photos * rows * columns
        if stack_bytes < LARGEST_STACK_SHARE * memory_bytes():
            tasks += [(usual, STACK, 1)]
        else:
            notes.append(f"{STACK} was left out: it needs {stack_bytes / 1e9:.3g} GB")
        tasks += [(short[0], one, 1) for one in ours]
    found = []
    (first,) = kept_or_written(
        folder / "first", columns=FIRST_COLUMNS, photos=FIRST_PHOTOS, photo_bytes=wanted[middle : middle + 1], seed=seed
    )
    with own_processes() as processes:
        say("a small sweep first, so that every loop is compiled before anything is timed")
        for contestant in ours:
            measured(processes, first, contestant, threads=1)
        for session, contestant, threads in tasks:
            say(f"{contestant}: {session.photos} photos of {session.file_mb:.3g} MB, threads {threads}")
            map_file = map_of(folder, contestant) if session is usual and threads == 1 and not long else None
            found.append(measured(processes, session, contestant, threads=threads, map_file=map_file))
    return BenchResult(
        command=command,
        machine=before.model_copy(update={"load_after": machine().load_before}),
        versions={name: version(name) for name in LIBRARIES},
        photos=tuple(
            Photos(
                wanted_mb=size / 1e6,
                file_mb=one.file_mb,
                quality=one.quality,
                photos=one.photos,
                columns=columns,
                rows=rows,
            )
            for one, size in zip((*sessions, *short), (*wanted, *(wanted[middle] for _ in short)), strict=True)
        ),
        measurements=tuple(found),
        ratios=(*ratios(found, photos=photos), *(ratio_of_one_more_photo(found, one, usual) for one in short)),
        agreement=tuple(agreement(folder, one) for one in NAIVE if map_of(folder, one).exists()),
        notes=tuple(notes),
    )


def ratios(found: list[Measurement], *, photos: int) -> list[Ratio]:
    """Return every sweep of the whole length over decoding alone, and every naive script over our sweep by the paper's method."""
    whole = {(one.contestant, one.file_mb, one.threads): one for one in found if one.photos == photos}
    over = {**dict.fromkeys((*OURS, LOOP), DECODING), **dict.fromkeys(NAIVE, PAPER)}
    made = []
    for (contestant, file_mb, threads), one in whole.items():
        if contestant in over:
            other = whole[over[contestant], file_mb, threads]
            made.append(
                Ratio(
                    contestant=contestant,
                    over=other.contestant,
                    file_mb=file_mb,
                    threads=threads,
                    wall=one.wall_s / other.wall_s,
                    processor=one.processor_s / other.processor_s,
                )
            )
    return made


def ratio_of_one_more_photo(found: list[Measurement], short: BenchSession, usual: BenchSession) -> Ratio:
    """Return what one more photo costs the sweep by the paper's method over decoding one.

    Both lengths place the same pixels, so that their difference is what grows with the photos. The full method's fit takes so
    long that nothing can be read from its difference.
    """
    one_thread = {(one.contestant, one.photos, one.file_mb): one for one in found if one.threads == 1}
    decoding = one_thread[DECODING, usual.photos, usual.file_mb]
    long_sweep = one_thread[PAPER, usual.photos, usual.file_mb]
    short_sweep = one_thread[PAPER, short.photos, short.file_mb]
    share = usual.photos / (usual.photos - short.photos)
    return Ratio(
        contestant=f"{PAPER}: one more photo",
        over=DECODING,
        file_mb=usual.file_mb,
        threads=1,
        wall=share * (long_sweep.wall_s - short_sweep.wall_s) / decoding.wall_s,
        processor=share * (long_sweep.processor_s - short_sweep.processor_s) / decoding.processor_s,
    )


def agreement(folder: Path, contestant: str) -> Agreement:
    """Compare the maps that a naive script and our sweep left in the folder."""
    ours, number = np.load(map_of(folder, PAPER)), np.load(map_of(folder, contestant))
    placed = np.isfinite(ours)
    # The vertex of a parabola lies within half a step of the brightest sample, and just between two that are equally bright.
    return Agreement(contestant=contestant, share=float((np.abs(ours - number)[placed] <= 0.5).mean()))


def map_of(folder: Path, contestant: str) -> Path:
    """Return where the map of a contestant is kept."""
    return folder / f"{contestant}.npy"
