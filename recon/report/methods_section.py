"""A paragraph for a paper's methods section, made from the session, and the work to cite."""

from recon.metrics import Metrics
from recon.report.numbers import LengthUnit, number
from recon.report.panel import Panel, Section
from recon.sessions.manifest import Manifest
from recon.sessions.pattern import GrayLinePattern, Pattern, StripePattern

CITATION = (
    "K. Han, K.-Y. K. Wong, M. Liu: Dense Reconstruction of Transparent Objects by Altering Incident Light Paths "
    "Through Refraction. International Journal of Computer Vision, 2018. arXiv:2105.09993"
)
BIBTEX = """@article{han2018dense,
  author  = {Han, Kai and Wong, Kwan-Yee K. and Liu, Miaomiao},
  title   = {Dense Reconstruction of Transparent Objects by Altering Incident Light Paths Through Refraction},
  journal = {International Journal of Computer Vision},
  year    = {2018},
  eprint  = {2105.09993},
  archivePrefix = {arXiv}
}"""


def _shown(pattern: Pattern) -> str:
    """Return what the display showed in a sweep, in the words of a methods section."""
    if isinstance(pattern, StripePattern):
        return f"a bright stripe with a {pattern.profile.replace('_', '-')} profile that swept it"
    if isinstance(pattern, GrayLinePattern):
        return (
            f"lines with a {pattern.profile.replace('_', '-')} profile, {number(float(pattern.period_px))} pixels apart and "
            f"shifted in {pattern.steps} steps, and a Gray code of {pattern.bits} bits with its inverse"
        )
    periods = ", ".join(number(float(period), 4) for period in pattern.periods_px)
    return f"cosine fringes with periods of {periods} pixels in {pattern.steps} phases"


def methods_text(manifest: Manifest, metrics: Metrics, unit: LengthUnit) -> str:
    """Return what was done, in sentences that state only what the session and the run say."""
    display = manifest.display
    photos = sum(sweep.pattern.count for each in manifest.sets for sweep in each.sweeps)
    shown = " and ".join(sorted({_shown(sweep.pattern) for each in manifest.sets for sweep in each.sweeps}))
    first, second = manifest.display_poses
    apart = sum((a - b) ** 2 for a, b in zip(first.centre_mm, second.centre_mm, strict=True)) ** 0.5
    kinds = {device.kind for device in manifest.provenance.devices.values()}
    verb = "was photographed" if kinds == {"real"} else "was rendered" if kinds == {"simulated"} else "was captured"
    sentences = [
        f"The object ({manifest.object.name}) {verb} in front of a display of {display.columns} × {display.rows} "
        f"pixels ({number(display.pitch_mm, 4)} {unit.label} pitch) at two positions {number(apart)} {unit.label} apart.",
        f"In each of four sets the display showed {shown} along x and along y, "
        f"{number(photos)} photos of {manifest.camera.columns} × {manifest.camera.rows} pixels in all.",
    ]
    if manifest.method == "liquid" and manifest.liquid:
        sentences.append(
            f"The sets were taken at both positions in air (n = {number(manifest.n_air, 7)}) and with the display side "
            f"of the object in {manifest.liquid.name} (n = {number(manifest.liquid.n, 5)}). For each camera pixel the places "
            "of the stripe at the two positions give its light path before the object in each medium; the surface point is "
            "the middle of the shortest segment between the two paths, and the normal follows from Snell's law in vector "
            "form, n ∝ λ₁U − λ₂V (Han et al., 2018)."
        )
    elif manifest.visual_rays_from_camera:
        sentences.append(
            "The sets were taken at both positions with the object in place. The calibrated camera gives the visual ray of a "
            "pixel, the two places of the stripe its refracted path; the normal follows from Snell's law for one refraction "
            f"with the object's index n = {number(manifest.object.n, 5)} (Han et al., 2018)."
        )
    else:
        sentences.append(
            "The sets were taken at both positions with and without the object. Without it the two places of a pixel give its "
            "visual ray, with it the refracted path; the normal follows from Snell's law for one refraction with the "
            f"object's index n = {number(manifest.object.n, 5)} (Han et al., 2018)."
        )
    how = (
        "The published method was followed as a baseline."
        if metrics.method == "paper"
        else "The published method was extended; the settings of the run are listed under Parameters."
    )
    sentences.append(
        f"{how} Of {number(metrics.funnel.lit)} lit pixels {number(metrics.funnel.normals)} gave a point and a normal."
    )
    return " ".join(sentences)


def methods_section(manifest: Manifest, metrics: Metrics, *, unit: LengthUnit) -> Section:
    """Return the methods paragraph and the citation."""
    data = {"text": methods_text(manifest, metrics, unit), "citation": CITATION, "bibtex": BIBTEX}
    panel = Panel("methods", "For a methods section", "methods.html.j2", data)
    return Section("methods", "Methods and citation", (panel,))
