"""The comparison of a session's reference photos, kept from an earlier run where neither they nor the points have changed."""

import contextlib
import hashlib
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from recon.maps import Maps
from recon.running.kept_stages import file_hash, keep_stage, kept_stage
from recon.scene.scene_check import REFERENCE
from recon.scene.scene_stage import SceneStage, scene_stage
from recon.sessions.journal import JOURNAL_NAME
from recon.sessions.session import Session

STAGE = "scene"
ADAPTER = TypeAdapter(SceneStage)


def scene_key(session: Session, outcome_key: str) -> str | None:
    """Return the hash of what the comparison follows from, or None where the journal does not hold the photos' own."""
    if any(record.sha256 is None for (_, sweep, _), record in session.photos.items() if sweep == REFERENCE):
        return None
    return hashlib.sha256(f"{outcome_key} {file_hash(session.folder / JOURNAL_NAME)}".encode()).hexdigest()


def scene_of(
    session: Session, maps: Maps, *, out: Path, outcome_key: str, force: bool = False
) -> tuple[SceneStage, bool]:
    """Return the comparison, and whether it is that of an earlier run; one that is made is kept. Raises ``OSError``."""
    key = scene_key(session, outcome_key)
    kept = None if force or key is None else kept_stage(out, STAGE, key)
    if kept is not None:
        with contextlib.suppress(ValidationError):
            return ADAPTER.validate_python(kept.found), True
    scene = scene_stage(session, maps)
    if key is not None:
        keep_stage(out, STAGE, key, files=(), found=ADAPTER.dump_python(scene, mode="json"))
    return scene, False
