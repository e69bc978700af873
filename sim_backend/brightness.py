"""How bright the display is from moment to moment: flicker and drift, and what a row of the sensor gets of them.

Brightness is a share of what the scene's levels say: 1 in the mean. A row that is open from a to b sees the mean of it,
(B(b) − B(a)) / (b − a), with the integral B in closed form: for a sine, 1 + d · sin(2πft) integrates to
t − d · cos(2πft) / (2πf); for a square wave, to t plus a triangle.
"""

import numpy as np
from jaxtyping import Float64

from sim_backend.scene_parts import SceneCamera, SceneDisplay, SceneFlicker

Times = Float64[np.ndarray, " rows"]


def opening_times_s(camera: SceneCamera, opened_s: float) -> Times:
    """Return when each row of the sensor opens, if the first does at ``opened_s``."""
    return opened_s + np.arange(camera.rows) / camera.rows * camera.readout_s


def light_got(display: SceneDisplay, opened_s: Times, exposure_s: float, *, first_s: float, last_s: float) -> Times:
    """Return how much each row gets of a frame that is lit from ``first_s`` to ``last_s``, as a share of a steady one.

    Each row is open for ``exposure_s``; shares of all frames add up to the display's mean brightness in that time.
    """
    drift = 1 + display.drift_per_min / 60 * (opened_s + exposure_s / 2)
    if exposure_s <= 0:
        lit = (opened_s >= first_s) & (opened_s < last_s)
        return np.where(lit, drift * _brightness(display.flicker, opened_s), 0.0)
    start_s = np.clip(opened_s, first_s, last_s)
    end_s = np.clip(opened_s + exposure_s, first_s, last_s)
    return drift * (end_s - start_s + _swing(display.flicker, end_s) - _swing(display.flicker, start_s)) / exposure_s


def _brightness(flicker: SceneFlicker | None, time_s: Times) -> Times:
    if flicker is None:
        return np.ones_like(time_s)
    turns = flicker.frequency_hz * time_s
    wave = np.sin(2 * np.pi * turns) if flicker.wave == "sine" else np.where(turns % 1 < 0.5, 1.0, -1.0)
    return 1 + flicker.depth * wave


def _swing(flicker: SceneFlicker | None, time_s: Times) -> Times:
    """Return the integral of the brightness less 1."""
    if flicker is None:
        return np.zeros_like(time_s)
    turns = (flicker.frequency_hz * time_s) % 1
    wave = -np.cos(2 * np.pi * turns) / (2 * np.pi) if flicker.wave == "sine" else np.minimum(turns, 1 - turns)
    return flicker.depth * wave / flicker.frequency_hz
