"""The index by the object's chords, on a ball whose light paths obey Snell's law by construction."""

import numpy as np
import pytest

from recon.media.chord_index import index_from_chords

N_LIQUID, N_AIR = 1.33, 1.0
RADIUS_MM = 40.0


def test_points_that_say_that_they_are_unsure_do_not_draw_the_index_by_an_error_that_they_share():
    y, x = np.mgrid[-66:66, -66:66] * 0.2
    normal = np.stack([x, y, np.sqrt(RADIUS_MM**2 - x**2 - y**2)], axis=2) / RADIUS_MM
    point, air = RADIUS_MM * normal, np.broadcast_to([0.3, -0.2, np.sqrt(1 - 0.13)], normal.shape)
    # n_liquid U = n_air V + k n, with k so that U is a unit vector.
    along = N_AIR * (normal * air).sum(axis=2)
    k = np.sqrt(along**2 + N_LIQUID**2 - N_AIR**2) - along
    liquid = (N_AIR * air + k[..., None] * normal) / N_LIQUID
    # On one side the points lie on a surface that leans, smooth and wrong, along their paths; noise is alike all over.
    rng = np.random.default_rng(3)
    off = rng.normal(0, 0.001, x.shape) + np.where(x > 6, 0.02 * (x - 6), 0.0)
    variance = np.where(x > 6, 0.1**2, 0.001**2)
    found = index_from_chords(point + off[..., None] * liquid, variance, liquid, air, n_air=N_AIR)
    trusting = index_from_chords(point + off[..., None] * liquid, 0 * variance, liquid, air, n_air=N_AIR)
    assert found is not None
    assert trusting is not None
    assert found.n == pytest.approx(N_LIQUID, abs=0.001)
    assert abs(trusting.n - N_LIQUID) > 3 * abs(found.n - N_LIQUID)
