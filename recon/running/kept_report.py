"""The report of an earlier run, kept where all that it shows is as it was, but for the times of the run."""

import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from recon.metrics import Metrics
from recon.report import page
from recon.running.kept_stages import keep_stage, kept_stage
from recon.sessions.manifest import Manifest

STAGE = "report"
TEMPLATES = Path(page.__file__).parent


def report_is_kept(out: Path, outcome_key: str, metrics: Metrics, manifest: Manifest) -> bool:
    """Tell whether the report in ``out`` shows these points, numbers and manifest; an evaluation in it counts as well."""
    return kept_stage(out, STAGE, _key(outcome_key, metrics, manifest)) is not None


def keep_report(out: Path, outcome_key: str, metrics: Metrics, manifest: Manifest, *, pages: Sequence[Path]) -> None:
    """Keep the pages of a report that were just written to ``out``; raises ``OSError``."""
    keep_stage(out, STAGE, _key(outcome_key, metrics, manifest), files=[path.name for path in pages], found={})


def _key(outcome_key: str, metrics: Metrics, manifest: Manifest) -> str:
    shown = metrics.model_dump_json(exclude={"stages"}) + manifest.model_dump_json()
    return hashlib.sha256(f"{outcome_key} {_look()} {shown}".encode()).hexdigest()


@cache
def _look() -> str:
    """Return the hash of all that pages are made with beside the program's text, which the outcome's key holds."""
    files = sorted(path for path in TEMPLATES.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc"))
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()
