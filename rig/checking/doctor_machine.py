"""The doctor's checks of what needs no device: the configuration, the installed packages, the disk, the tank's arithmetic."""

import platform
import re
import shutil
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from drivers.open_camera import library_version
from rig.checking.doctor import INSTALL, Finding, finding_of_sentence
from rig.config import RigConfig, load_config, longest_run_s
from rig.errors import ConfigError
from rig.planning.plan import plan_capture, summarise

DISTRIBUTION = "refractive-scan"
# Earlier ones lose photos of several makers' cameras or wait for them without end.
LIBGPHOTO2 = (2, 5, 34)
# Photos differ in size; a disk that is full to the brim ends a capture in its last set.
DISK_MARGIN = 1.2


def read_config(path: Path) -> tuple[RigConfig | None, Finding]:
    """Read the configuration, and say what is wrong with it, with the line where that can be found."""
    name = "configuration"
    if not path.exists():
        return None, Finding(
            name, "fail", f"{path}: no such file", f"`rig init {path}`, then change its values to those of your rig"
        )
    try:
        config = load_config(path)
    except ConfigError as error:
        return None, finding_of_sentence(name, "fail", str(error), mend=f"correct this value in {path}")
    return config, Finding(name, "pass", f"{path}: {config.name}, method {config.method!r}")


def check_packages() -> Iterator[Finding]:
    """Look for every package of the extra ``rig``, and for a libgphoto2 that is new enough."""
    yield Finding("python", "pass", f"{platform.python_version()} on {platform.system()}")
    for package, least in rig_packages():
        name = f"package {package}"
        try:
            version = metadata.version(package)
        except metadata.PackageNotFoundError:
            yield Finding(name, "fail", "not installed", INSTALL)
            continue
        if _numbers(version) < _numbers(least):
            yield Finding(name, "fail", f"{version} found, {least} is the least", f"`pip install --upgrade {package}`")
        else:
            yield Finding(name, "pass", version)
    yield check_libgphoto2()


def rig_packages() -> tuple[tuple[str, str], ...]:
    """Return the packages of the extra ``rig``, each with its least version or ``""``, from our own metadata."""
    found = []
    for requirement in metadata.requires(DISTRIBUTION) or []:
        match = re.match(r"([A-Za-z0-9_.-]+)(?:>=([0-9.]+))?", requirement)
        if match and re.search(r"extra\s*==\s*['\"]rig['\"]", requirement):
            found.append((match[1], match[2] or ""))
    return tuple(found)


def check_libgphoto2() -> Finding:
    """Compare the library's own version with the least that is known to work."""
    name, least = "libgphoto2", ".".join(map(str, LIBGPHOTO2))
    try:
        version = library_version()
    except ImportError as error:
        return Finding(name, "fail", f"cannot be loaded ({error})", INSTALL)
    if _numbers(version) < LIBGPHOTO2:
        return Finding(name, "fail", f"{version} found, {least} is the least", "`pip install --upgrade gphoto2`")
    return Finding(name, "pass", version)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


def check_disk(config: RigConfig, folder: Path) -> Iterator[Finding]:
    """Compare the free space at ``folder``, which need not exist yet, with what the plan will write."""
    needed_gb = summarise(plan_capture(config), config).gigabytes
    present = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    free_gb = shutil.disk_usage(present).free / 1e9
    text = f"{free_gb:.3g} GB free at {folder}, the plan writes about {needed_gb:.2g} GB"
    if free_gb < needed_gb:
        yield Finding(
            "disk", "fail", text, f"free {needed_gb - free_gb:.2g} GB, or capture to another disk (--session)"
        )
    elif free_gb < DISK_MARGIN * needed_gb:
        yield Finding("disk", "warn", text, "make more room: photos may be larger than timing.photo_mb says")
    else:
        yield Finding("disk", "pass", text)


def check_tank(config: RigConfig) -> Iterator[Finding]:
    """Say the arithmetic that keeps the floor dry. A configuration in which it fails was refused before."""
    tank = config.tank
    if tank is None:
        yield Finding("tank", "skipped", "method 'thin' needs no liquid")
        return
    yield Finding(
        "tank",
        "pass",
        f"reservoir {tank.reservoir_ml:g} ml, tank's free volume {tank.free_volume_ml:g} ml: it cannot overflow, whatever "
        f"the pump does; a fill takes {tank.fill_ml:g} ml",
    )
    if tank.has_pump:
        yield Finding(
            "tank",
            "pass",
            f"a fill lasts {tank.fill_ml / tank.pump_rate_ml_per_min:.1f} min and is ended after "
            f"{longest_run_s(tank.fill_ml, tank) / 60:.1f} min in any case",
        )
