"""Make the picture at the top of README.md from a simulated scan: `make picture`.

Three panels from one run: what the camera saw, the normals that were found, and the surface.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista
from matplotlib.figure import Figure

from recon.maps import load_maps
from recon.sessions.photos import read_grey
from recon.sessions.session import open_session

TARGET = Path(__file__).with_name("scan.png")
SCENE = ["hemisphere", "--size", "480", "--display-columns", "2048", "--width-px", "24", "--step-px", "4"]
BACKGROUND = "#10151c"
STRIPES_SHOWN = 9


def simulate_and_reconstruct(folder: Path) -> tuple[Path, Path]:
    """Run the two programs as anyone would, and return the session and the result."""
    programs = Path(sys.executable).parent
    session, result = folder / "session", folder / "result"
    subprocess.run([programs / "rig", "simulate", *SCENE, session], check=True)
    subprocess.run([programs / "recon", "run", session, "--out", result], check=True)
    return session, result


def photo_of_stripes(session_folder: Path) -> np.ndarray:
    """Return the brightest of a few photos of one sweep: so many stripes at once as no display has shown."""
    session = open_session(session_folder)
    camera = session.manifest.camera
    count = session.manifest.set_named("pos0_liquid").sweep("x").pattern.count
    chosen = np.linspace(0.2, 0.8, STRIPES_SHOWN) * count
    photos = [
        read_grey(session.photo_file("pos0_liquid", "x", int(index)), rows=camera.rows, cols=camera.columns)
        for index in chosen
    ]
    return np.max(photos, axis=0)


def normal_colours(normal: np.ndarray) -> np.ndarray:
    """Return the usual colours of a normal map, with the direction towards the viewer in blue."""
    colours = 0.5 + 0.5 * normal * np.array([1.0, -1.0, 1.0])
    colours[~np.isfinite(normal).all(axis=2)] = [int(BACKGROUND[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return colours


def surface(mesh_file: Path) -> np.ndarray:
    """Draw the mesh as it stands in the tank, its curved side towards the viewer."""
    mesh = pyvista.read(mesh_file)
    plotter = pyvista.Plotter(off_screen=True, window_size=(900, 900))
    plotter.set_background(BACKGROUND)
    plotter.add_mesh(mesh, color="#9fd3e6", smooth_shading=True, specular=0.7, specular_power=40, ambient=0.15)
    plotter.view_vector((0.75, -0.55, 0.65), viewup=(0, -1, 0))
    plotter.camera.zoom(1.25)
    return np.asarray(plotter.screenshot(return_img=True))


def compose(panels: list[tuple[str, np.ndarray]]) -> Figure:
    """Set the panels side by side."""
    figure, axes = plt.subplots(1, len(panels), figsize=(4.2 * len(panels), 4.6), facecolor=BACKGROUND)
    for axis, (title, picture) in zip(axes, panels, strict=True):
        axis.imshow(picture, cmap="gray" if picture.ndim == 2 else None, interpolation="lanczos")
        axis.set_title(title, color="white", fontsize=13, pad=10)
        axis.set_axis_off()
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.02, top=0.88, wspace=0.03)
    return figure


def crop(picture: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Cut a picture to a square about the pixels that have a point; lone ones far away do not widen it."""
    rows, cols = np.nonzero(valid)
    (top, bottom), (left, right) = np.percentile(rows, [0.2, 99.8]), np.percentile(cols, [0.2, 99.8])
    half = int(max(bottom - top, right - left) * 0.62)
    row, col = int(top + bottom) // 2, int(left + right) // 2
    return picture[max(row - half, 0) : row + half, max(col - half, 0) : col + half]


def main() -> None:
    """Simulate, reconstruct and write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        session, result = simulate_and_reconstruct(Path(folder))
        maps = load_maps(result / "maps.npz")
        panels = [
            ("photos: stripes seen through glass in water", photo_of_stripes(session)),
            ("normals, one a pixel", crop(normal_colours(maps.normal), maps.valid())),
            ("surface", surface(result / "mesh.ply")),
        ]
        compose(panels).savefig(TARGET, dpi=110, facecolor=BACKGROUND)


if __name__ == "__main__":
    main()
