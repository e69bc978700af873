"""Make ``docs/images/calibration.png``: the page of a simulated calibration with one shaken photo and a display that slipped.

``python -m docs.images.make_calibration_picture`` needs Chromium.
"""

import base64
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.calibration.assembly import assemble
from recon.calibration.board import Board, board_for_display
from recon.calibration.calibration_file import CalibrationProvenance
from recon.calibration.constraints import lens_known, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, Travel, display_poses
from recon.calibration.fep_error import dome_geometry
from recon.calibration.intrinsics import calibrate_lens
from recon.calibration.wet_pose import wet_poses
from recon.report.calibration_page import write_calibration_page
from recon.sessions.manifest import CameraBody, DeviceRecord
from tests.bench._calibration_rig import Procedure, Rig
from tests.chromium_page import open_browser
from tests.recon.calibration.seen_corners import hand_held_views, slipped_scene
from tests.recon.calibration.seen_object import PANEL

PICTURE = Path(__file__).with_name("calibration.png")
WIDTH_PX, HEIGHT_PX = 1280, 1664
SLIP_MM = 0.3
SHAKEN, SHAKEN_PX = 4, 0.4


def named(views: list[BoardView], folder: str) -> list[BoardView]:
    """Return the views with the names of photos in a folder."""
    return [replace(view, name=f"{folder}/{number:04}.jpg") for number, view in enumerate(views)]


def write_page(path: Path) -> None:
    """Calibrate once in the simulator and write the page."""
    rng = np.random.default_rng(6)
    rig, procedure = Rig(), Procedure(60, Board(17, 12, 11.5), photos=16)
    held = named(
        hand_held_views(rig.scene, procedure.board, count=procedure.views, rng=rng, sd_px=procedure.corner_sd_px),
        "camera",
    )
    shaken = held[SHAKEN]
    moved = shaken.place_px + rng.normal(0, SHAKEN_PX, shaken.place_px.shape)
    held[SHAKEN] = replace(shaken, place_px=moved)
    camera = rig.scene.camera
    lens = calibrate_lens(held, columns=camera.columns, rows=camera.rows)
    slipped = slipped_scene(rig.scene, rig.stage_mm[1], np.array([0, 0, 0, SLIP_MM, 0, 0]))
    dry_views, wet_views = (
        {position: named(views, f"pos{position}_{condition}") for position, views in found.items()}
        for condition, found in (
            ("air", rig.views(rig.dry_px, rig.corner_mm, procedure, rng)),
            ("liquid", rig.views(rig.wet_px((rig.scene, slipped)), rig.wet_mm, procedure, rng)),
        )
    )
    dry = display_poses(dry_views, lens=lens.lens, lens_covariance=lens.covariance, travel=Travel(40.0, 0.02))
    known = [lens_known(lens.lens, lens.covariance), travel_known(*AIR_PANELS, travel_mm=40.0, sd_mm=0.02)]
    poses = wet_poses(dry, dry_views, wet_views, n_liquid=rig.n_liquid, known=known)
    panels = poses.state.panels
    geometry = dome_geometry(panels, radius_mm=27.99, n_object=1.5195, n_liquid=rig.n_liquid, gap_mm=25.0)
    made = assemble(
        lens,
        poses,
        geometry,
        board=board_for_display(PANEL).board,
        layout="new",
        camera=CameraBody(columns=camera.columns, rows=camera.rows, model="Canon EOS 40D"),
        display=PANEL,
        provenance=CalibrationProvenance(devices={"camera": DeviceRecord(kind="simulated", model="Canon EOS 40D")}),
    )
    write_calibration_page(path, made)


def main() -> None:
    """Write the page, look at it, and keep the upper part as a picture."""
    with tempfile.TemporaryDirectory() as folder, open_browser() as browser:
        path = Path(folder) / "calibration.html"
        write_page(path)
        with browser.page(path.as_uri(), columns=WIDTH_PX, rows=HEIGHT_PX) as page:
            page.wait_until("document.readyState == 'complete'")
            data = base64.b64decode(page.call("Page.captureScreenshot", format="png")["data"])
    PICTURE.write_bytes(data)


if __name__ == "__main__":
    main()
