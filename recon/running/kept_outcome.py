"""Points, normals and surface of an earlier run, taken from its files where nothing that they follow from has changed."""

import hashlib
import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from recon.calibration.session_calibration import calibration_path
from recon.errors import ReconError
from recon.maps import MAPS_NAME, load_maps
from recon.program import program_hash
from recon.registration.gap_fit import MotionCovariance
from recon.running.kept_stages import file_hash, forget_stage, keep_stage, kept_stage
from recon.running.outcome import Outcome
from recon.running.settings import Settings
from recon.sessions.session import Session
from recon.surface.files import CLOUD_NAME, GLB_NAME, MESH_NAME, read_mesh_ply
from recon.sweeps.correspondence import SweepResult

STAGE = "surface"
ARRAYS = ("place_px", "sd_px", "status", "second_px", "second_sd_px")
# All but the arrays, which have files of their own.
ADAPTERS = {name: TypeAdapter(kind) for name, kind in get_type_hints(Outcome).items() if name not in ("maps", "mesh")}


def outcome_key(
    session: Session,
    sweeps: Mapping[tuple[str, str], SweepResult],
    settings: Settings,
    *,
    known: MotionCovariance | None = None,
    threads: int = 1,
) -> str:
    """Return the hash of all that the outcome follows from: places, manifest, mask, calibration, settings and program.

    ``known`` is what the session's photos of a board leave unknown of the slips, as :func:`~recon.running.outcome.reconstruct`
    takes it. So many ``threads`` share the sweeps.
    """
    with ThreadPoolExecutor(threads) as pool:
        hashes = list(pool.map(_hash_of, sweeps.values()))
    calibration = calibration_path(session, settings.calibration)
    mask = session.manifest.mask
    parts = {
        "program": program_hash(),
        "settings": settings.result_parts(),
        "manifest": session.manifest.model_dump(mode="json"),
        "mask": file_hash(session.folder / mask) if mask is not None else None,
        "calibration": file_hash(calibration) if calibration is not None else None,
        "known": None if known is None else np.asarray(known).tolist(),
        "sweeps": {f"{name}/{axis}": value for (name, axis), value in zip(sweeps, hashes, strict=True)},
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _hash_of(sweep: SweepResult) -> str:
    """Return the hash of a sweep's arrays; which pixels have a number is told in bits, since most of a photo may be dark."""
    digest = hashlib.blake2b(repr((sweep.noise, sweep.misfit)).encode())
    for array in (getattr(sweep, name) for name in ARRAYS):
        if array is not None and array.dtype.kind == "f":
            there = ~np.isnan(array)
            digest.update(np.packbits(there).data)
            digest.update(array[there].data)
        elif array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def kept_outcome(out: Path, key: str) -> Outcome | None:
    """Return the outcome that an earlier run left in ``out``, or None; the mesh has the single precision of its file."""
    kept = kept_stage(out, STAGE, key)
    if kept is None:
        return None
    try:
        rest = {name: adapter.validate_python(kept.found[name]) for name, adapter in ADAPTERS.items()}
        mesh = read_mesh_ply(out / MESH_NAME) if MESH_NAME in kept.files else None
        return Outcome(maps=load_maps(out / MAPS_NAME), mesh=mesh, **rest)
    except (ReconError, ValidationError, KeyError):
        return None


def keep_outcome(out: Path, key: str, outcome: Outcome, *, threads: int = 1) -> None:
    """Keep an outcome whose files were just written to ``out``; so many ``threads`` read them again. Raises ``OSError``."""
    files = (MAPS_NAME, CLOUD_NAME, *((MESH_NAME, GLB_NAME) if outcome.mesh is not None else ()))
    found = {name: adapter.dump_python(getattr(outcome, name), mode="json") for name, adapter in ADAPTERS.items()}
    keep_stage(out, STAGE, key, files=files, found=found, threads=threads)


def forget_outcome(out: Path) -> None:
    """Keep no outcome while its files are written: a run that is killed in between leaves no mixture; raises ``OSError``."""
    forget_stage(out, STAGE)
