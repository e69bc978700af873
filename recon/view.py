"""Look at a result in a window, or write a picture of it without one (``recon view``).

VTK, which draws here, ends the whole program by a segmentation fault where no OpenGL library is installed. Whether it
can draw is therefore asked first, in another process.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from jaxtyping import Float64

from recon.errors import MissingProgramError, ReconError
from recon.maps import MAPS_NAME, Maps, load_maps
from recon.metrics import METRICS_NAME, load_metrics

What = Literal["cloud", "mesh", "normals"]

PROBE = (
    "import pyvista, sys\n"
    "plotter = pyvista.Plotter(off_screen=True, window_size=(32, 32))\n"
    "plotter.set_background('black')\n"
    "plotter.add_mesh(pyvista.Sphere(), color='white', lighting=False)\n"
    "sys.exit(0 if plotter.screenshot(return_img=True).max() > 200 else 3)\n"
)
# A first import of VTK from a slow disk takes tens of seconds.
PROBE_LIMIT_S = 120.0
WINDOW_PX = (1280, 960)
ARROWS_SHOWN = 500
# Above this a window answers the mouse slowly; every n-th point is shown.
POINTS_SHOWN = 2_000_000


def check_renderer(command: Sequence[str] = (sys.executable, "-c", PROBE), *, limit_s: float = PROBE_LIMIT_S) -> None:
    """Draw one small picture in another process.

    Raises
    ------
    MissingProgramError
        When that process crashes, hangs or draws nothing; the sentence names what to install.
    """
    advice = "install OpenGL for programs without a window: `apt-get install libegl1 libosmesa6` on Debian and Ubuntu"
    try:
        ended = subprocess.run(command, capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        raise MissingProgramError(f"view: drawing a test picture took more than {limit_s:.0f} s; {advice}") from None
    if ended.returncode == 0:
        return
    lines = ended.stderr.decode(errors="replace").strip().splitlines()
    reason = lines[-1] if lines and ended.returncode > 0 else f"the renderer ended with code {ended.returncode}"
    raise MissingProgramError(f"view: a test picture could not be drawn ({reason}); {advice}")


def view(out_dir: Path, *, what: What = "mesh", screenshot: Path | None = None) -> None:
    """Show a reconstruction.

    Parameters
    ----------
    out_dir
        Folder that ``recon run`` wrote.
    what
        ``cloud``: points coloured by standard deviation; ``mesh``: the surface, shaded; ``normals``: points with arrows along
        some of the normals.
    screenshot
        Where to write a PNG in place of opening a window.

    Raises
    ------
    ReconError
        When the folder has no result of this kind, no screen is there for a window, or the picture cannot be written.
    MissingProgramError
        When no OpenGL library is installed.
    """
    points = None if what == "mesh" else _points(out_dir)
    if what == "mesh" and not (out_dir / "mesh.ply").is_file():
        raise ReconError(f"{out_dir}: no mesh.ply here; run `recon run` first, or look at the points with --what cloud")
    if screenshot is None and not _has_screen():
        raise ReconError("view: no screen to open a window on; write a picture with --screenshot FILE.png")
    if screenshot is not None and screenshot.suffix.lower() != ".png":
        raise ReconError(f"{screenshot}: pictures are written as PNG; give a name that ends in .png")
    check_renderer()
    import pyvista  # takes half a second, which only this command should pay
    from vtkmodules.vtkCommonCore import vtkLogger

    # Without a screen VTK warns of that before it takes the road that needs none.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR if _has_screen() else vtkLogger.VERBOSITY_OFF)
    plotter = pyvista.Plotter(off_screen=screenshot is not None, window_size=WINDOW_PX)
    plotter.set_background("white")
    middle = (
        _add_mesh(plotter, out_dir / "mesh.ply")
        if points is None
        else _add_points(plotter, points, what, unit=_unit(out_dir))
    )
    _stand(plotter, middle)
    if screenshot is None:
        plotter.add_axes()
        plotter.show(title=f"{out_dir} · {what}")
        return
    try:
        plotter.screenshot(str(screenshot))
    except OSError as error:
        raise ReconError(f"{screenshot}: the picture cannot be written ({error.strerror})") from error
    finally:
        plotter.close()


def _points(out_dir: Path) -> Maps:
    """Read the maps and make sure that they hold a point."""
    maps = load_maps(out_dir / MAPS_NAME)
    if not maps.valid().any():
        raise ReconError(f"{out_dir}: this reconstruction has no point; its report says why")
    return maps


def _unit(out_dir: Path) -> str:
    """Return what a stored millimetre is called in this result."""
    return load_metrics(out_dir / METRICS_NAME).length_unit if (out_dir / METRICS_NAME).is_file() else "mm"


def _has_screen() -> bool:
    """Return whether a window can be opened: always on a desktop system, by its variable on X and Wayland."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _add_points(plotter: Any, maps: Maps, what: What, *, unit: str) -> Float64[np.ndarray, " 3"]:
    """Add the points, coloured by standard deviation, and arrows where asked; return the mean of the normals."""
    import pyvista

    valid = maps.valid()
    step = -(-int(valid.sum()) // POINTS_SHOWN)
    cloud = pyvista.PolyData(maps.point_mm[valid][::step])
    normal = maps.normal[valid][::step]
    sd_mm = maps.sd_mm[valid][::step]
    known = np.isfinite(sd_mm).any()
    if known:
        cloud["sd"] = sd_mm
    # Noise has no bound: colours span all but the last hundredth.
    limits = [float(value) for value in np.nanpercentile(sd_mm, (1, 99))] if known else None
    plotter.add_mesh(
        cloud,
        style="points",
        point_size=3,
        scalars="sd" if known else None,
        clim=limits,
        cmap="viridis" if known else None,
        color=None if known else "#4a7a8c",
        scalar_bar_args={"title": f"standard deviation ({unit})\n", "color": "black", "n_labels": 3} if known else None,
    )
    if what == "normals":
        some = np.random.default_rng(0).permutation(len(normal))[:ARROWS_SHOWN]
        plotter.add_arrows(cloud.points[some], np.nan_to_num(normal[some]), mag=0.05 * cloud.length, color="#b3142b")
    return np.nanmean(normal, axis=0)


def _add_mesh(plotter: Any, file: Path) -> Float64[np.ndarray, " 3"]:
    """Add the mesh and return the mean of its normals."""
    import pyvista

    mesh = pyvista.read(file)
    if mesh.n_points == 0:
        raise ReconError(f"{file}: this mesh is empty; the report says why")
    plotter.add_mesh(mesh, color="#a9c4cf", smooth_shading=True, specular=0.3)
    return np.asarray(mesh.point_normals, dtype=np.float64).mean(axis=0)


def _stand(plotter: Any, mean_normal: Float64[np.ndarray, " 3"]) -> None:
    """Place the eye in front of the surface, on the side to which its normals point, a little aside."""
    forward = mean_normal / (float(np.linalg.norm(mean_normal)) or 1.0)
    # Displays have y downwards, so the world's -y is up unless the surface looks that way.
    up = np.array([0.0, -1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    aside = np.cross(up, forward)
    eye = forward + 0.45 * aside / np.linalg.norm(aside) + 0.35 * up
    plotter.view_vector(tuple(eye), viewup=tuple(up))


def register(app: typer.Typer) -> None:
    """Add ``recon view`` to the command line."""

    @app.command("view")
    def view_(
        out_dir: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder that `recon run` wrote.")],
        what: Annotated[What, typer.Option(help="What to show.")] = "mesh",
        screenshot: Annotated[Path | None, typer.Option(help="Write this PNG in place of opening a window.")] = None,
    ) -> None:
        """Look at a reconstruction in a window, or write a picture of it."""
        view(out_dir, what=what, screenshot=screenshot)
        if screenshot is not None:
            typer.echo(screenshot)
