"""The whole calibration, step by step: what is done is kept and said, what is missing is asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from recon.calibration.calibration_file import CALIBRATION_NAME
from recon.calibration.response_record import RESPONSE_NAME
from rig.calibrating.calibration_steps import (
    lens_of_kept,
    photograph_lens,
    photograph_poses,
    photos_at_positions,
    refuse_other_rig,
)
from rig.calibrating.kept_photos import DRY, WET
from rig.calibrating.pose_capture import PREPARATIONS
from rig.calibrating.response_step import DRIFT_MIN, RESPONSE_PREPARATIONS, measure_response
from rig.calibrating.session_calibration import with_calibration_of
from rig.capturing.session_manifest import manifest_of
from rig.config import RigConfig
from rig.rehearsing.rehearsal import Simulation
from sim_backend.scene import Scene

Say = Callable[[str], None]
STEPS = 5


@dataclass(slots=True)
class Guide:
    """Leads through a calibration in ``folder``.

    ``ready`` tells what to prepare and waits until it is so; ``ask`` asks whether something is wanted. ``response``, ``wet`` and
    ``fill`` answer such questions beforehand: whether to measure the display's response, to photograph under liquid, and to let
    the pump fill the tank for that.
    """

    folder: Path
    config: RigConfig
    scene: Scene | None
    simulation: Simulation | None
    say: Say
    ready: Callable[..., None]
    ask: Callable[[str], bool]
    response: bool | None = None
    wet: bool | None = None
    fill: bool | None = None

    def run(self) -> None:
        """Do what is missing, compute, and check."""
        refuse_other_rig(self.folder, self.config)
        self._response()
        self._lens()
        self._poses()
        # Loads what compiles loops, which would slow every other command.
        from rig.calibrating.computation import compute_calibration

        self._heading(4, "compute")
        compute_calibration(self.folder, self.say)
        self._heading(5, "check")
        self._check()

    def _heading(self, number: int, text: str) -> None:
        self.say(f"Step {number} of {STEPS}: {text}")

    def _wants(self, answer: bool | None, question: str) -> bool:
        return self.ask(question) if answer is None else answer

    def _response(self) -> None:
        self._heading(1, "the display's response")
        if (self.folder / RESPONSE_NAME).is_file():
            self.say(f"done: {self.folder / RESPONSE_NAME}")
        elif self._wants(
            self.response,
            "Measure levels, latency and flicker of the display now? That is 220 photos and five minutes.",
        ):
            self.ready(*RESPONSE_PREPARATIONS)
            measure_response(self.folder, self.config, minutes=DRIFT_MIN, simulation=self.simulation, say=self.say)
        else:
            self.say(f"left out; `rig calibrate response {self.folder}` measures it")

    def _lens(self) -> None:
        self._heading(2, "the camera's lens")
        so_far = lens_of_kept(self.folder, self.config)
        if not so_far.advice():
            self.say(f"done: {so_far.text()}")
            return
        where = "the printed board" if self.config.calibrate.board == "printed" else "the display, off its stage"
        self.ready(
            "Aperture, focus and zoom are as they will be in the capture, and stay so from now on.",
            f"Hold {where} where the object will be, or a little nearer or farther; sharp, evenly lit, without glare.",
            "After each photo one line says what it showed and what is missing.",
        )
        photograph_lens(self.folder, self.config, simulation=self.simulation, say=self.say)

    def _poses(self) -> None:
        self._heading(3, "the display's poses")
        photos = self.config.calibrate.photos
        dry = photos_at_positions(self.folder, DRY)
        if min(dry.values()) >= photos:
            self.say(f"dry, done: {photos} photos at each position")
        else:
            self.ready(*PREPARATIONS, "The tank is empty.")
            self._photograph(wet=False, fill=False)
        wet = photos_at_positions(self.folder, WET)
        if self.config.method != "liquid":
            return
        if min(wet.values()) >= photos:
            self.say(f"wet, done: {photos} photos at each position")
        elif self._wants(
            self.wet, "Photograph the board under liquid too? It shows whether filling the tank moves the display."
        ):
            tank = self.config.tank
            fill = tank is not None and tank.has_pump
            if fill and tank is not None:
                fill = self._wants(
                    self.fill, f"May the pump fill the tank to {tank.fill_ml:.0f} ml now? Stay beside it."
                )
            self._photograph(wet=True, fill=fill)
        else:
            self.say(f"wet: left out; `rig calibrate poses {self.folder} --wet` takes them")

    def _photograph(self, *, wet: bool, fill: bool) -> None:
        photograph_poses(self.folder, self.config, wet=wet, fill=fill, simulation=self.simulation, say=self.say)

    def _check(self) -> None:
        file = self.folder / CALIBRATION_NAME
        _, doubts = with_calibration_of(manifest_of(self.config, devices={}, scene=self.scene), str(file))
        for doubt in doubts:
            self.say(f"! {doubt}")
        if self.simulation is not None:
            self.say(f"{file}: fits this rig; give it to `rig capture --sim` with --calibration {file}")
        else:
            self.say(f'{file}: fits this rig; write calibration = "{file.resolve()}" into its configuration')
