"""The part of the photo that holds every pixel with places in all sets: what is made of them needs no more memory than that."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from recon.maps import NAMES, OPTIONAL_NAMES, Maps
from recon.photo_window import PhotoWindow
from recon.sessions.manifest import CameraBody, Manifest
from recon.status import PixelStatus, StatusMap, is_one_of
from recon.sweeps.correspondence import KNOWN, SweepResult
from recon.sweeps.set_places import combined_status

# So far from the last such pixel nothing that neighbours tell is asked for.
MARGIN_PX = 64
# What maps hold where there is nothing; elsewhere NaN.
NOTHING = {"support": 0, "path_count": 0}


@dataclass(frozen=True, slots=True, eq=False)
class ObjectPart:
    """Sweeps, manifest and mask of a part of the photo, and the status that all pixels of the photo have before any surface."""

    window: PhotoWindow
    sweeps: dict[tuple[str, str], SweepResult]
    manifest: Manifest
    mask: Bool[np.ndarray, "rows cols"] | None
    status: StatusMap

    @classmethod
    def of(
        cls,
        sweeps: Mapping[tuple[str, str], SweepResult],
        manifest: Manifest,
        *,
        inside_mask: Bool[np.ndarray, "photo_rows photo_cols"] | None,
    ) -> "ObjectPart":
        """Cut out the object; where nothing has places in all sets, the part is the whole photo."""
        camera = manifest.camera
        status = combined_status(sweeps, manifest.sets).reshape(camera.rows, camera.columns)
        if inside_mask is not None:
            status[~inside_mask & (status != PixelStatus.UNLIT)] = PixelStatus.MASKED_OUT
        placed = np.flatnonzero(is_one_of(status, KNOWN))
        if len(placed):
            window = PhotoWindow.about(placed, (camera.rows, camera.columns), margin_px=MARGIN_PX)
        else:
            window = PhotoWindow(slice(0, camera.rows), slice(0, camera.columns), camera.columns)
        return cls(
            window,
            {name: _cut(one, window) for name, one in sweeps.items()},
            manifest.model_copy(update={"camera": _cut_camera(camera, window)}),
            None if inside_mask is None else inside_mask[window.part],
            status,
        )

    @property
    def corner(self) -> tuple[int, int]:
        """Row and column of the photo at which the part begins."""
        return self.window.rows.start, self.window.cols.start

    def let_places_go(self) -> None:
        """Forget where the stripes were seen in the liquid, and how surely everywhere: after the crossings nobody asks."""
        nothing = np.broadcast_to(np.float32(np.nan), self.window.shape)
        for (name, axis), one in self.sweeps.items():
            place_px = one.place_px if name.endswith("_air") else nothing
            self.sweeps[name, axis] = replace(one, place_px=place_px, sd_px=nothing)

    def on_photo(self, maps: Maps, *, threads: int = 1) -> Maps:
        """Lay the maps of the part out on the photo, so many at a time."""
        if self.window.shape == self.status.shape:
            return maps
        values = {name: getattr(maps, name) for name in (*NAMES, *OPTIONAL_NAMES)}
        status = self.status.copy()
        status[self.window.part] = values.pop("status")
        rows = len(status)
        there = {name: one for name, one in values.items() if one is not None}

        def lay_out(name: str) -> np.ndarray:
            return self.window.on_photo(there[name], rows, nothing=NOTHING.get(name, np.nan))

        with ThreadPoolExecutor(threads) as pool:
            laid_out = dict(zip(there, pool.map(lay_out, there), strict=True))
        return Maps(status=status, **laid_out)


def _cut(sweep: SweepResult, window: PhotoWindow) -> SweepResult:
    """Return the places of a sweep in a window."""
    status = sweep.status[window.part]
    second_px, second_sd_px = sweep.second_px, sweep.second_sd_px
    if second_px is not None and second_sd_px is not None:
        two = np.flatnonzero(sweep.status == PixelStatus.TWO_PATHS)
        row, col = np.divmod(two, window.columns)
        inside = (row >= window.rows.start) & (row < window.rows.stop)
        inside &= (col >= window.cols.start) & (col < window.cols.stop)
        second_px, second_sd_px = second_px[inside], second_sd_px[inside]
    # Copies: a view would hold all of the photo.
    return replace(
        sweep,
        place_px=sweep.place_px[window.part].copy(),
        sd_px=sweep.sd_px[window.part].copy(),
        status=status.copy(),
        second_px=second_px,
        second_sd_px=second_sd_px,
    )


def _cut_camera(camera: CameraBody, window: PhotoWindow) -> CameraBody:
    """Return the camera as if it took the window alone."""
    rows, columns = window.shape
    lens = camera.intrinsics
    if lens is not None:
        lens = lens.model_copy(
            update={
                "centre_x_px": lens.centre_x_px - window.cols.start,
                "centre_y_px": lens.centre_y_px - window.rows.start,
            }
        )
    return camera.model_copy(update={"rows": rows, "columns": columns, "intrinsics": lens})
