"""The liquid's index: water by the published tables, and measured by sessions traced through the simulator's optics."""

from pathlib import Path

import numpy as np
import pytest
from traced_session import Mishap, TracedSession, traced_session

from recon.errors import ReconError
from recon.geometry.light_paths import LightPaths, ScreenNoise
from recon.media.level_index import index_from_level
from recon.media.liquid_index import chosen_index, index_sentences, measured_index, with_index_uncertainty
from recon.media.stated_index import StatedIndex, index_of, provisional, stated_index, with_index
from recon.media.water import refractive_index, water_density_kg_per_m3, water_index
from recon.method import Limits
from recon.reconstruct import Crossing, cross_paths
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.manifest import Liquid, Manifest
from recon.sessions.session import Session
from sim_backend.scene import load_scene

# What a measured index is used for: normals to 0.1° at 30° of incidence.
WANTED_N = 0.001


@pytest.mark.parametrize(
    ("wavelength_nm", "n"),
    [(226.50, 1.394527), (589.00, 1.334344), (1013.98, 1.326135)],
)
def test_water_at_0_degrees_has_the_indices_of_the_release(wavelength_nm: float, n: float) -> None:
    """IAPWS R9-97, Table 3, 0 °C and 0.1 MPa, six decimals."""
    assert water_index(0.0, wavelength_nm=wavelength_nm) == pytest.approx(n, abs=1.0e-6)


@pytest.mark.parametrize(
    ("density", "temperature_k", "wavelength_nm", "n"),
    [(997.047435, 298.15, 226.5, 1.39277824), (30.4758534, 773.15, 589.3, 1.00949307)],
)
def test_liquid_and_steam_agree_with_an_independent_program(
    density: float, temperature_k: float, wavelength_nm: float, n: float
) -> None:
    """The check values that the package iapws gives in its documentation."""
    found = refractive_index(density_kg_per_m3=density, temperature_k=temperature_k, wavelength_nm=wavelength_nm)
    assert found == pytest.approx(n, abs=1e-8)


@pytest.mark.parametrize(("temperature_c", "density"), [(4.0, 999.9749), (20.0, 998.2067), (25.0, 997.0470)])
def test_water_has_the_density_of_the_published_table(temperature_c: float, density: float) -> None:
    """Tanaka et al. 2001, Table 5."""
    assert water_density_kg_per_m3(temperature_c) == pytest.approx(density, abs=1e-4)


def test_water_outside_its_table_is_refused_in_one_sentence() -> None:
    with pytest.raises(ReconError, match="0 to 40 °C"):
        water_index(60.0, wavelength_nm=530.0)


def test_only_water_of_known_temperature_has_an_index_without_being_told() -> None:
    found = index_of(Liquid(name="Water", temperature_c=20.0), primary="blue")
    assert found is not None
    assert found.n == pytest.approx(1.3387, abs=5e-5)
    assert index_of(Liquid(name="water"), primary="blue") is None
    assert index_of(Liquid(name="glycerol", temperature_c=20.0), primary="blue") is None


def untold(session: TracedSession) -> Manifest:
    """Return the manifest as one who does not know the liquid writes it."""
    assert session.manifest.liquid is not None
    liquid = session.manifest.liquid.model_copy(update={"n": None, "name": "unknown"})
    return session.manifest.model_copy(update={"liquid": liquid})


def crossed(session: TracedSession, manifest: Manifest) -> Crossing:
    return cross_paths(session.sweeps, provisional(manifest), method="full", limits=Limits())[1]


@pytest.fixture(scope="module")
def hemisphere() -> TracedSession:
    return traced_session(load_scene("hemisphere").resized(camera_columns=192), noise_px=0.1)


def test_level_beside_the_object_shows_the_index_without_being_told(hemisphere: TracedSession) -> None:
    manifest = untold(hemisphere)
    assert stated_index(manifest) is None
    level = measured_index(crossed(hemisphere, manifest), provisional(manifest)).level
    assert level is not None
    assert level.n == pytest.approx(1.3355, abs=WANTED_N)
    assert abs(level.n - 1.3355) < 4 * level.sd


def test_object_alone_shows_the_index_to_within_its_own_uncertainty() -> None:
    """A finer display, for which the points are less noisy; the cap fills the photo."""
    scene = load_scene("semi_ellipsoid").resized(camera_columns=192, display_columns=1024)
    session = traced_session(scene, noise_px=0.1)
    chords = measured_index(crossed(session, untold(session)), provisional(untold(session))).chords
    assert chords is not None
    assert chords.sd < 1.5 * WANTED_N
    assert abs(chords.n - 1.3) < 4 * chords.sd


def directed(direction: np.ndarray, sd_rad: np.ndarray) -> LightPaths:
    """Return paths with these unit directions, known to ``sd_rad`` along x and y."""
    nowhere, baseline = np.zeros_like(direction), np.full(len(direction), 10.0)
    noise = ScreenNoise(sd_rad * 10.0 / np.sqrt(2.0), np.eye(3)[:, :2])
    return LightPaths(nowhere, direction, baseline, noise, noise)


def at_level(n_liquid: float, place: np.ndarray, lean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions in liquid and in air of light that a plane refracts, seen over ±0.15 rad."""
    air = np.column_stack([0.3 * (place[:, 1] - 0.5), 0.3 * (place[:, 0] - 0.5), -np.ones(len(place))])
    air /= np.linalg.norm(air, axis=1, keepdims=True)
    # Snell's law in vector form: the part across the upright shrinks by the ratio of the indices.
    across = (air - (air @ lean)[:, None] * lean) / n_liquid
    return across + np.sqrt(1 - (across**2).sum(axis=1, keepdims=True)) * lean, air


@pytest.mark.parametrize("n_liquid", [1.2, 1.36, 1.5])
def test_exact_paths_at_a_level_give_the_index_whatever_the_tilt(n_liquid: float) -> None:
    place = np.random.default_rng(1).uniform(0, 1, (2000, 2))
    lean = np.array([0.03, -0.02, -1.0]) / np.linalg.norm([0.03, -0.02, -1.0])
    liquid, air = at_level(n_liquid, place, lean)
    exact = np.zeros((2000, 2))
    found = index_from_level(
        directed(liquid, exact), directed(air, exact), upright=np.array([0.0, 0.0, 1.0]), place=place, n_air=1.0
    )
    assert found is not None
    # The lean of 2° is taken to first order about a provisional index.
    assert found.n == pytest.approx(n_liquid, abs=2e-4)


UPRIGHT = np.array([0.0, 0.0, -1.0])
# 120 × 120 pixels, of which an object hides the middle.
GRID = (np.indices((120, 120)).reshape(2, -1).T + 0.5) / 120
BESIDE = GRID[(np.abs(GRID - 0.5) > 0.3).any(axis=1)]


def test_places_that_are_known_badly_do_not_count_as_those_that_are_known_well() -> None:
    """Two thirds of the pixels are ten times worse: the others alone have a deviation √3 times that of all good ones."""
    rng = np.random.default_rng(2)
    liquid, air = at_level(1.3355, BESIDE, UPRIGHT)
    errors = {}
    for bad_sd in (1e-5, 1e-4):
        sd = np.where(rng.uniform(size=(len(BESIDE), 1)) < 2 / 3, bad_sd, 1e-5) * np.ones(2)
        errors[bad_sd] = []
        for _ in range(12):
            noisy = [one + np.pad(rng.normal(0, sd), ((0, 0), (0, 1))) for one in (liquid, air)]
            found = index_from_level(*(directed(one, sd) for one in noisy), upright=UPRIGHT, place=BESIDE, n_air=1.0)
            assert found is not None
            errors[bad_sd].append(found.n - 1.3355)
    good, mixed = (float(np.sqrt(np.mean(np.square(errors[sd])))) for sd in (1e-5, 1e-4))
    # 12 draws know a deviation to a fifth, a ratio to 0.28. If all counted alike it would be √(2/3 · 100 + 1/3) = 8.2.
    assert mixed < np.sqrt(3) * (1 + 2 * 0.28) * good


def test_errors_alike_on_all_four_sides_of_the_photo_are_in_the_standard_deviation() -> None:
    """Where camera and display are mirror-symmetric, what a ring of the photo errs is the same on its four sides."""
    rng = np.random.default_rng(3)
    liquid, air = at_level(1.3355, BESIDE, UPRIGHT)
    sd = np.full((len(BESIDE), 2), 1e-5)
    normalised = []
    for _ in range(24):
        ring = rng.normal(0, 1e-4, 60)
        side = 2 * BESIDE - 1
        shared = np.sign(side) * ring[np.minimum((np.abs(side) * 60).astype(int), 59)]
        noisy = (
            liquid
            + np.column_stack([shared[:, 1], shared[:, 0], np.zeros(len(BESIDE))])
            + rng.normal(0, 1e-5, liquid.shape)
        )
        found = index_from_level(directed(noisy, sd), directed(air, sd), upright=UPRIGHT, place=BESIDE, n_air=1.0)
        assert found is not None
        normalised.append((found.n - 1.3355) / found.sd)
    # 24 draws: one sd of the rms is 0.15 where the sd is right.
    assert 0.6 < float(np.sqrt(np.mean(np.square(normalised)))) < 1.45


def test_reconstruction_without_an_index_uses_the_one_that_the_session_shows(hemisphere: TracedSession) -> None:
    session = Session(Path("unused"), untold(hemisphere), {})
    outcome = reconstruct(session, hemisphere.sweeps, Settings())
    assert outcome.liquid_index is not None
    assert outcome.liquid_index.n == pytest.approx(1.3355, abs=WANTED_N)
    assert any("was not stated; the session shows 1.33" in sentence for sentence in outcome.warnings)


def test_a_wrong_index_is_used_as_stated_and_contradicted(hemisphere: TracedSession) -> None:
    measured = measured_index(crossed(hemisphere, hemisphere.manifest), hemisphere.manifest)
    wrong = chosen_index(StatedIndex(1.345, "as stated"), measured)
    assert wrong.n == 1.345
    assert wrong.contradicted
    assert "but the session shows 1.33" in index_sentences(wrong)[0]
    right = chosen_index(StatedIndex(1.3355, "as stated"), measured)
    assert not right.contradicted
    assert index_sentences(right) == ()


def test_normals_carry_the_uncertainty_of_a_measured_index(hemisphere: TracedSession) -> None:
    manifest = hemisphere.manifest
    here, there = (crossed(hemisphere, with_index(manifest, n)) for n in (1.3355, 1.3365))
    carried = np.sqrt(with_index_uncertainty(here, manifest, sd=0.001).carried_rad2)
    turned = np.linalg.norm(there.normal - here.normal, axis=1)
    fine = np.isfinite(turned)
    np.testing.assert_allclose(carried[fine], turned[fine], rtol=0.02, atol=1e-7)


def test_a_session_that_shows_nothing_is_refused_in_one_sentence() -> None:
    scene = load_scene("semi_ellipsoid").resized(camera_columns=24)
    session = traced_session(scene, noise_px=0.1, mishap=Mishap())
    with pytest.raises(ReconError, match=r"give liquid\.n"):
        chosen_index(None, measured_index(crossed(session, untold(session)), provisional(untold(session))))
