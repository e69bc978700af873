"""The index that a manifest or a configuration states for its liquid, or that follows from water's temperature."""

from dataclasses import dataclass

from recon.media.water import PRIMARY_NM, water_index
from recon.sessions.manifest import Liquid, Manifest

# For what hardly depends on the index: points behind cover glass, quality during a capture.
PROVISIONAL_N = 1.333


@dataclass(frozen=True, slots=True)
class StatedIndex:
    """An index, and what says so."""

    n: float
    source: str


def index_of(liquid: Liquid, *, primary: str) -> StatedIndex | None:
    """Return the index stated, or that of water at the temperature stated, in the display's colour; None where neither is."""
    if liquid.n is not None:
        return StatedIndex(liquid.n, "as stated")
    if liquid.name.strip().lower() != "water" or liquid.temperature_c is None:
        return None
    wavelength_nm = PRIMARY_NM[primary]
    return StatedIndex(
        water_index(liquid.temperature_c, wavelength_nm=wavelength_nm),
        f"of water at {liquid.temperature_c:g} °C and {wavelength_nm:g} nm",
    )


def stated_index(manifest: Manifest) -> StatedIndex | None:
    """Return what a manifest states of its liquid's index."""
    return None if manifest.liquid is None else index_of(manifest.liquid, primary=manifest.display.primary)


def with_index(manifest: Manifest, n: float) -> Manifest:
    """Return the manifest with the liquid's index."""
    liquid = manifest.liquid
    return manifest if liquid is None else manifest.model_copy(update={"liquid": liquid.model_copy(update={"n": n})})


def provisional(manifest: Manifest) -> Manifest:
    """Return the manifest with the index stated, or else one that serves for what hardly depends on it."""
    stated = stated_index(manifest)
    return with_index(manifest, stated.n if stated is not None else PROVISIONAL_N)
