"""Render sections to one HTML file that loads nothing: style, scripts and pictures are inside."""

import base64
import hashlib
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from recon.metrics import Verdict
from recon.report import numbers
from recon.report.panel import Banner, Section

PACKAGE = "recon.report"


@cache
def environment() -> Environment:
    """Return the template environment: everything is escaped, and an unknown name is an error."""
    made = Environment(
        loader=PackageLoader(PACKAGE, "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(
        number=numbers.number, duration=numbers.duration, memory=numbers.memory, data_uri=data_uri, prose=prose
    )
    made.globals["share"] = numbers.share
    return made


def prose(text: str) -> Markup:
    """Return a sentence for the page, escaped, with `commands` between backticks set as code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return escape(text)
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if place % 2 else escape(part) for place, part in enumerate(parts)
    )


def data_uri(picture_png: bytes) -> str:
    """Return a PNG as an address that needs no file."""
    return "data:image/png;base64," + base64.b64encode(picture_png).decode("ascii")


def asset(name: str) -> Markup:
    """Return a style sheet or script of this package, to be put into the page as it is."""
    return Markup(resources.files(f"{PACKAGE}.templates").joinpath(name).read_text(encoding="utf-8"))


def script_policy(scripts: tuple[Markup, ...]) -> str:
    """Return the content security policy that lets exactly these scripts run and nothing be loaded."""
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" for script in scripts
    )
    return f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {hashes}"


def render_page(
    title: str,
    *,
    sections: tuple[Section, ...],
    kind: str,
    subtitle: str = "",
    banners: tuple[Banner, ...] = (),
    verdict: Verdict | None = None,
    tiles: tuple[tuple[str, str, str], ...] = (),
    scripts: tuple[str, ...] = ("page.js",),
) -> str:
    """Return a whole page.

    Parameters
    ----------
    title, subtitle, kind:
        The name of what is reported, a line below it, and what sort of page this is ("Reconstruction report").
    sections:
        The body, in order; also the navigation.
    banners, verdict, tiles:
        What comes first. A tile is a label, a value and a note.
    scripts:
        Names of this package's scripts that the page needs.
    """
    sources = tuple(asset(name) for name in scripts)
    return (
        environment()
        .get_template("page.html.j2")
        .render(
            title=title,
            subtitle=subtitle,
            kind=kind,
            sections=sections,
            banners=banners,
            verdict=verdict,
            tiles=tiles,
            style=asset("style.css"),
            scripts=sources,
            policy=script_policy(sources),
        )
    )
