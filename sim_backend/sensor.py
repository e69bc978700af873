"""The sensor: shot noise, read noise, response and JPEG. A photo repeats to the byte for the same ``key``."""

import hashlib

import cv2
import numpy as np
import simplejpeg
from jaxtyping import Float32, UInt8

from drivers.protocols import Frame
from sim_backend.scene import SceneCamera

Values = Float32[np.ndarray, "rows columns"]


def frame_key(frame: Frame, *parts: object) -> int:
    """Return a number that is the same whenever the frame's content and the other parts are."""
    digest = hashlib.blake2b(repr(parts).encode(), digest_size=16)
    digest.update(repr(frame.axis).encode())
    arrays = [frame.levels, frame.image]
    for patch in frame.patches:
        digest.update(repr((patch.column, patch.row)).encode())
        arrays.append(patch.levels)
    for array in arrays:
        if array is None:
            digest.update(b"none")
        else:
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return int.from_bytes(digest.digest(), "big")


def blur(light: Values, radius_px: float) -> Values:
    """Blur by a Gaussian of this standard deviation; nothing for 0."""
    return cv2.GaussianBlur(light, (0, 0), radius_px) if radius_px > 0 else light


def grey_levels(value: Values, camera: SceneCamera) -> Values:
    """Turn shares of full scale into grey levels 0 to 255, not rounded."""
    grey = np.clip(value, 0, 1)
    if camera.response_gamma != 1:
        grey = grey ** np.float32(1 / camera.response_gamma)
    return grey * np.float32(255)


def noisy_grey(value: Values, camera: SceneCamera, *, key: int) -> UInt8[np.ndarray, "rows columns"]:
    """Expose once: add shot and read noise to shares of full scale, and quantise.

    A pixel that expects E electrons varies by √(E + read²). Gaussian noise stands for Poisson's; with the ambient
    light of a scene a dark pixel already holds tens of electrons or more.
    """
    full = np.float32(camera.full_well_electrons)
    rng = np.random.Generator(np.random.SFC64(key))
    exposed = rng.standard_normal(value.shape, dtype=np.float32)
    variance = value * np.float32(1 / full)
    variance += np.float32((camera.read_noise_electrons / camera.full_well_electrons) ** 2)
    np.sqrt(variance, out=variance)
    exposed *= variance
    exposed += value
    if camera.response_gamma != 1:
        return np.rint(grey_levels(exposed, camera)).astype(np.uint8)
    exposed *= np.float32(255)
    np.clip(exposed, 0, 255, out=exposed)
    # Adding a half and cutting rounds, and is several times faster than rint.
    exposed += np.float32(0.5)
    return exposed.astype(np.uint8)


def jpeg_bytes(grey: UInt8[np.ndarray, "rows columns"], *, quality: int) -> bytes:
    """Encode a grey photo as JPEG."""
    return simplejpeg.encode_jpeg(np.ascontiguousarray(grey)[:, :, None], quality=quality, colorspace="GRAY")
