"""The house rules that no other tool checks."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("recon", "rig", "drivers", "sim_backend")
FOLDERS = {*PACKAGES, "tests", "docs"}
# What builds and demonstrations leave beside the sources; git ignores all of them.
LEFT_BEHIND = {"build", "dist", "demo", "refractive_scan.egg-info", "__pycache__"}
LONGEST_MODULE = 400
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "tests/data").rglob("*.md")])
PAGES = [page for page in PAGES if "_build" not in page.parts]
TEXTS = [*MODULES, *PAGES, *ROOT.glob("tests/**/*.py"), *ROOT.glob("*.txt"), ROOT / "Makefile", ROOT / "pyproject.toml"]


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_top_level_holds_the_four_packages_the_tests_and_the_docs() -> None:
    found = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
    assert found - LEFT_BEHIND == FOLDERS


@pytest.mark.parametrize("module", MODULES, ids=name_of)
def test_a_module_is_one_noun_of_readable_length(module: Path) -> None:
    assert module.stem not in ("utils", "util", "helpers", "common", "misc")
    assert len(module.read_text(encoding="utf-8").splitlines()) <= LONGEST_MODULE


def test_recon_imports_on_a_machine_without_any_hardware_library() -> None:
    names = [
        name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for path in MODULES
        if path.is_relative_to(ROOT / "recon")
    ]
    script = (
        "import importlib, sys\n"
        "for name in ('serial', 'usb', 'gphoto2', 'aiohttp', 'segno', 'rig', 'drivers', 'sim_backend'):\n"
        "    sys.modules[name] = None\n"
        f"for name in {names!r}:\n"
        "    importlib.import_module(name)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize(
    ("arguments", "libraries", "option"),
    [
        (["recon", "run"], ["scipy", "matplotlib", "numba", "cv2", "pyamg", "trimesh"], "--smallest-angle-deg"),
        (["rig", "capture"], ["scipy.stats", "matplotlib", "numba", "pyamg", "trimesh"], "--pause-after"),
    ],
)
def test_help_waits_for_no_library_that_is_slow_to_load(
    arguments: list[str], libraries: list[str], option: str
) -> None:
    script = (
        "import sys\n"
        f"for name in {libraries}:\n"
        "    sys.modules[name] = None\n"
        f"sys.argv = {[*arguments, '--help']}\n"
        f"from {arguments[0]}.cli import main\n"
        "main()\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert option in ran.stdout


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_relative_link_of_a_page_leads_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]*)\)", re.sub(r"`[^`\n]*`", "", text)):
        if target and not target.startswith(("#", "https://", "mailto:")):
            assert (page.parent / target.split("#")[0]).exists(), f"{target} does not exist"


def test_every_dependency_is_pinned_and_no_pin_names_a_place() -> None:
    def plain(name: str) -> str:
        return re.sub(r"[-_.]+", "-", name).lower()

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [pin for line in lines if (pin := line.split("#")[0].strip())]
    assert [pin for pin in pins if not re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!]+(; [\w\s.<>='\"]+)?", pin)] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {name: project["optional-dependencies"][name] for name in ("rig", "cluster", "dev", "docs")}
    wanted = {plain(re.split(r"[<>=!~\[; ]", line)[0]) for line in sum(extras.values(), project["dependencies"])}
    assert wanted <= {plain(pin.split("==")[0]) for pin in pins}


@pytest.mark.parametrize("text", TEXTS, ids=name_of)
def test_no_file_names_a_package_registry_or_somebodys_machine(text: Path) -> None:
    # In two halves each, so that this file does not name them either.
    hosts = ["pypi" + ".org", "pythonhosted" + ".org", "deb.debian" + ".org", "/home" + "/", "/work" + "/"]
    content = text.read_text(encoding="utf-8")
    assert [host for host in hosts if host in content] == []
