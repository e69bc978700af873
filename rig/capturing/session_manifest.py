"""What a session of this rig says of itself: the manifest, built from the configuration in one place."""

from importlib.metadata import version
from typing import Any

from pydantic import ValidationError

from recon.calibration.board import board_places
from recon.sessions.journal import now_text
from recon.sessions.manifest import CaptureSet, DeviceRecord, Manifest, Provenance, Sweep
from recon.sessions.session import Session
from rig.config import RigConfig, first_fault, parse_config
from rig.errors import CaptureError
from rig.planning.plan import set_order
from sim_backend.scene import Scene

SIMULATED_DEVICE = DeviceRecord(kind="simulated", model="simulated rig")


def manifest_of(config: RigConfig, *, devices: dict[str, DeviceRecord], scene: Scene | None) -> Manifest:
    """Return the manifest of a capture; ``scene`` is what the simulated devices pretend, None in a lab."""
    sweeps = (Sweep(axis="x", pattern=config.pattern("x")), Sweep(axis="y", pattern=config.pattern("y")))
    sets = tuple(
        CaptureSet(position=position, condition=condition, sweeps=sweeps) for position, condition in set_order(config)
    )
    board = config.capture.board
    configuration: dict[str, object] = {"rig": config.model_dump(mode="json")}
    if scene is not None:
        configuration["scene"] = scene.model_dump(mode="json")
    return Manifest(
        schema_version=1,
        name=config.name,
        created=now_text(),
        method=config.method,
        object=config.object,
        n_air=config.n_air,
        liquid=config.liquid,
        length_unit=config.length_unit,
        display=config.display,
        display_poses=config.display_poses,
        camera=config.camera,
        sets=sets,
        board=board_places(config.display, squares_along=board.squares_along) if board else None,
        provenance=Provenance(
            software={"refractive-scan": version("refractive-scan")},
            devices=devices,
            configuration=configuration,
        ),
    )


def config_of_session(session: Session) -> RigConfig:
    """Return the configuration that a session was captured with, so that it can go on with the same."""
    data = session.manifest.provenance.configuration.get("rig")
    if not isinstance(data, dict):
        raise CaptureError(f"{session.folder}: was not captured by `rig`, so it cannot be resumed; start a new session")
    return parse_config(data, source=f"{session.folder}: configuration in the manifest")


def scene_of_session(session: Session) -> Scene | None:
    """Return the scene of a simulated session, None for one from a lab."""
    data: Any = session.manifest.provenance.configuration.get("scene")
    if data is None:
        return None
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        source = f"{session.folder}: scene in the manifest"
        raise CaptureError(
            f"{first_fault(error, source=source)}; restore the manifest, or start a new session"
        ) from None
