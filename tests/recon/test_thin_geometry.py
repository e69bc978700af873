"""Thin objects against traced paths: the tracer here knows Snell's law as angles in a plane, nothing of the product."""

import numpy as np
import pytest

from recon.geometry.entry_point import entry_points
from recon.geometry.flat_face import inner_directions, points_on_face
from recon.geometry.light_paths import LightPaths, ScreenNoise
from recon.geometry.normals import normals_from_paths

N_GLASS = 1.7
TO_CAMERA = np.array([0.0, 0.0, -1.0])


def refract_back(ray: np.ndarray, normal: np.ndarray, n_from: float, n_to: float) -> np.ndarray:
    """Follow light from the camera one surface on: turn each ray in its plane of incidence by the law of sines."""
    cosine = np.abs((ray * normal).sum(1))
    facing = normal * -np.sign((ray * normal).sum(1))[:, None]
    sideways = ray + cosine[:, None] * facing
    length = np.linalg.norm(sideways, axis=1, keepdims=True)
    sideways = np.divide(sideways, length, out=np.zeros_like(sideways), where=length > 0)
    angle = np.arcsin(n_from / n_to * np.sin(np.arccos(np.clip(cosine, -1, 1))))
    return np.sin(angle)[:, None] * sideways - np.cos(angle)[:, None] * facing


def angle_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(2 * np.arcsin(np.linalg.norm(first - second, axis=1) / 2))


def tilted(alpha_rad: float) -> np.ndarray:
    """A display-side normal (towards +z, where the display stands) tilted by an angle about y."""
    return np.array([[np.sin(alpha_rad), 0.0, np.cos(alpha_rad)]])


def normal_found(inside: np.ndarray, outside_back: np.ndarray) -> np.ndarray:
    return normals_from_paths(inside, -outside_back, n_liquid=N_GLASS, n_air=1.0)


@pytest.mark.parametrize("alpha_deg", [0.5, 3.0, 12.0])
def test_wedge_seen_square_on_gives_its_normal_exactly(alpha_deg: float) -> None:
    # The ray enters the camera-side face at right angles, so one refraction is all there is.
    normal = tilted(np.radians(alpha_deg))
    back = refract_back(-TO_CAMERA[None], normal, N_GLASS, 1.0)
    assert angle_deg(normal_found(TO_CAMERA[None], back), normal)[0] < 1e-9


def test_small_wedge_deviates_by_n_minus_one_times_its_angle() -> None:
    alpha = 1e-3
    back = refract_back(-TO_CAMERA[None], tilted(alpha), N_GLASS, 1.0)
    deviation = np.arccos(np.clip(-(back @ TO_CAMERA)[0], -1, 1))
    assert deviation == pytest.approx((N_GLASS - 1) * alpha, rel=1e-4)
    # The other way about: the normal's tilt is the deviation over n − 1.
    tilt = np.arcsin(normal_found(TO_CAMERA[None], back)[0, 0])
    assert tilt == pytest.approx(alpha, rel=1e-9)


def test_plane_parallel_plate_leaves_every_ray_its_direction() -> None:
    ray = np.array([[0.3, -0.2, 0.9]])
    ray /= np.linalg.norm(ray)
    flat = tilted(0.0)
    through = refract_back(refract_back(ray, flat, 1.0, N_GLASS), flat, N_GLASS, 1.0)
    # Both rays of the pixel are parallel, so Eq. 3 returns their direction, whatever the plate's normal.
    assert angle_deg(normal_found(-ray, through), ray)[0] < 1e-6


def cone() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A cone of height 1 and radius 4 (slope 14°) on its back at z = 0, seen from 60 units.

    Returns the camera, the rays from it, the inner rays, the surface points and normals; the display side is +z.
    """
    camera = np.array([0.0, 0.0, -60.0])
    radius, azimuth = np.meshgrid(np.linspace(0.2, 3.8, 40), np.linspace(0.01, 2 * np.pi, 60))
    hit = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.zeros_like(radius)], axis=2).reshape(-1, 3)
    ray = (hit - camera) / np.linalg.norm(hit - camera, axis=1, keepdims=True)
    back = np.broadcast_to([0.0, 0.0, 1.0], ray.shape)
    inside = refract_back(ray, back, 1.0, N_GLASS)
    # Each ray stays in its plane through the axis: r + s d_r meets z = 1 − r/4 where s d_z = 1 − (r + s d_r)/4.
    r = np.linalg.norm(hit[:, :2], axis=1)
    radial = hit / r[:, None]
    step = (1 - r / 4) / (inside[:, 2] + (inside * radial).sum(1) / 4)
    normal = np.stack([radial[:, 0] / 4, radial[:, 1] / 4, np.ones_like(r)], axis=1)
    return camera, ray, inside, hit + step[:, None] * inside, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def test_cone_on_its_flat_back_is_degrees_off_with_one_refraction_and_exact_with_the_face_known() -> None:
    _, ray, inside, _, normal = cone()
    outside = refract_back(inside, normal, N_GLASS, 1.0)
    one = angle_deg(normal_found(-ray, outside), normal)
    face = inner_directions(-ray, face_normal=np.array([0.0, 0.0, 1.0]), n_object=N_GLASS, n_air=1.0)
    both = angle_deg(normal_found(face, outside), normal)
    # To first order the neglected bend (n − 1)/n · θ of the ray tilts the normal by n/(n − 1) times as much: by θ, the
    # angle of the ray itself, at most arctan(3.8 / 60) = 3.6°.
    theta = np.degrees(np.arccos(ray[:, 2]))
    assert np.median(one) == pytest.approx(np.median(theta), rel=0.15)
    assert both.max() < 1e-9


def test_inner_ray_crosses_the_path_outside_in_the_surface_point() -> None:
    camera, ray, inside, surface, normal = cone()
    outside = refract_back(inside, normal, N_GLASS, 1.0)
    flat = {"face_normal": np.array([0.0, 0.0, 2.0])}
    start = points_on_face(np.broadcast_to(camera, ray.shape).copy(), -ray, face_point_mm=np.zeros(3), **flat)
    direction = inner_directions(-ray, **flat, n_object=N_GLASS, n_air=1.0)

    def paths(far: np.ndarray, towards: np.ndarray) -> LightPaths:
        noise = ScreenNoise(np.ones((len(far), 2)), np.eye(3)[:, :2])
        return LightPaths(far + 10 * towards, towards, np.full(len(far), 10.0), noise, noise)

    crossed = entry_points(paths(start, direction), paths(surface + 20 * outside, -outside), weighted=False)
    assert np.abs(crossed.point_mm - surface).max() < 1e-9
    assert np.nanmax(np.abs(crossed.gap_mm)) < 1e-9


def test_inner_direction_does_not_depend_on_the_sign_of_the_face() -> None:
    ray = np.array([[0.3, -0.2, -0.9]])
    ray /= np.linalg.norm(ray)
    one, other = (
        inner_directions(ray, face_normal=sign * np.array([0.1, 0.0, 1.0]), n_object=1.5, n_air=1.0) for sign in (1, -2)
    )
    assert np.allclose(one, other)
    assert np.linalg.norm(one) == pytest.approx(1.0)
