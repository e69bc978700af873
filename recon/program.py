"""Which program this is, down to its text: what was made by another one is not taken for this one's."""

import hashlib
import json
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# The libraries whose numbers end up in results; not all of them need be there.
LIBRARIES = ("numpy", "scipy", "opencv-contrib-python-headless", "simplejpeg", "rawpy", "pyamg", "trimesh")


@cache
def program_hash() -> str:
    """Return a hash of the text of all of recon and of the libraries that its numbers rest on."""
    digest = hashlib.sha256(json.dumps({name: _version(name) for name in LIBRARIES}).encode())
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
