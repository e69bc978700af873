"""``rig camera``: the camera by hand."""

import time
from pathlib import Path
from typing import Annotated, Protocol, runtime_checkable

import typer

from drivers.protocols import Camera
from rig import options
from rig.devices import open_camera
from rig.errors import ConfigError
from rig.options import Rig, choose_rig
from rig.rehearsing.scene_config import SceneOptions

app = typer.Typer(
    help="The camera by hand: snap, settings, preview. Settings of the configuration are set first.",
    no_args_is_help=True,
)
TIMEOUT_S = 60.0


@runtime_checkable
class HasLiveView(Protocol):
    """A camera that can show what it sees without taking a photo."""

    def live_view(self) -> bytes:
        """Return one frame, a JPEG."""
        ...


def _prepared(rig: Rig, camera: Camera) -> None:
    """Set what the configuration asks for, as a capture does."""
    if rig.config.camera.settings and rig.scene is None:
        camera.apply_settings(rig.config.camera.settings)


def _save(path: Path, data: bytes) -> None:
    try:
        with path.open("xb") as file:
            file.write(data)
    except FileExistsError:
        raise ConfigError(f"{path}: exists already, and photos are never overwritten; choose another name") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None


@app.command()
def snap(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to save the photo; its suffix is the camera's.")],
    times: Annotated[int, typer.Option("--times", min=1, help="Take so many, and say how long one takes.")] = 1,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Take a photo and save it; of several, the last one.

    The time of one photo belongs into [timing] photo_s of the configuration.
    """
    rig = choose_rig(sim, config, scene, SceneOptions())
    with open_camera(rig.config, simulation=rig.simulation(real_time=real_time, state_file=None)) as camera:
        _prepared(rig, camera)
        started_s = time.monotonic()
        for _ in range(times):
            camera.expose(timeout_s=TIMEOUT_S)
            photos = camera.collect(timeout_s=TIMEOUT_S)
        elapsed_s = time.monotonic() - started_s
    for photo in photos:
        path = file.with_suffix(photo.suffix)
        _save(path, photo.data)
        print(f"camera: {path}, {len(photo.data) / 1e6:.2f} MB")
    print(f"camera: {elapsed_s / times:.2f} s a photo")


@app.command()
def settings(
    changes: Annotated[
        list[str] | None, typer.Argument(metavar="NAME=VALUE", help="Set these first, under the camera's names.")
    ] = None,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
) -> None:
    """Read the settings back from the camera; names and values are the camera's own."""
    wanted = {}
    for change in changes or []:
        name, equals, value = change.partition("=")
        if not (name and equals):
            raise ConfigError(f"{change!r} asked; write NAME=VALUE, such as shutterspeed=1/4")
        wanted[name] = value
    rig = choose_rig(sim, config, scene, SceneOptions())
    with open_camera(rig.config, simulation=rig.simulation(real_time=False, state_file=None)) as camera:
        _prepared(rig, camera)
        if wanted:
            camera.apply_settings(wanted)
        info = camera.info()
        print(f"{info.model} ({info.kind}{f', {info.version}' if info.version else ''})")
        for name, value in camera.settings().items():
            print(f'{name} = "{value}"')


@app.command()
def preview(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to save the picture, a small JPEG.")],
    config: options.ConfigOption = None,
) -> None:
    """Save one frame of live view: for framing and focus, where the camera has it."""
    rig = choose_rig(False, config, None, SceneOptions())
    with open_camera(rig.config, simulation=None) as camera:
        if not isinstance(camera, HasLiveView):
            raise ConfigError("camera: this one has no live view; use `rig camera snap`")
        data = camera.live_view()
    _save(file, data)
    print(f"camera: {file}, {len(data) / 1e3:.0f} kB")
