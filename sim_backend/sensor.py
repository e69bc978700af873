"""The sensor: shot noise, read noise, response and JPEG. A photo repeats to the byte for the same ``key``."""

import hashlib

import cv2
import numpy as np
import simplejpeg
from jaxtyping import Float32, UInt8
from scipy.special import ndtri

from drivers.protocols import Frame
from sim_backend.scene import SceneCamera

Values = Float32[np.ndarray, "rows columns"]


def _normal_table() -> Float32[np.ndarray, " words"]:
    """Return the mean of each of 65,536 equally likely slices of the normal distribution, scaled to variance 1."""
    edges = ndtri(np.arange(65537) / 65536)
    density = np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi)
    means = (density[:-1] - density[1:]) * 65536
    return (means / np.sqrt(np.mean(means**2))).astype(np.float32)


# Random 16-bit words look normal numbers up here: five times faster than drawing them, and finer by far than the
# quarter of a grey level that noise of a dark pixel amounts to. The largest is 4.3.
NORMAL_OF_WORD = _normal_table()


def normal_noise(shape: tuple[int, int], *, key: int) -> Values:
    """Return independent normal numbers of variance 1, the same ones for the same key."""
    count = shape[0] * shape[1]
    words = np.random.SFC64(key).random_raw((count + 3) // 4).view(np.uint16)[:count]
    noise = np.empty(count, np.float32)
    # "wrap" only spares numpy the check of bounds that 16 bits cannot break.
    np.take(NORMAL_OF_WORD, words, out=noise, mode="wrap")
    return noise.reshape(shape)


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
    exposed = normal_noise(value.shape, key=key)
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
