"""What a page is made of: sections that hold panels."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Panel:
    """One thing to look at, with what good and bad look like; a panel without its data says why.

    ``template`` draws ``data``; it is left out where ``missing`` gives the reason that there is nothing to draw.
    """

    id: str
    title: str
    template: str
    data: Mapping[str, object] = field(default_factory=dict)
    what: str = ""
    good: str = ""
    bad: str = ""
    missing: str = ""
    wide: bool = True


@dataclass(frozen=True, slots=True)
class Section:
    """Panels that belong together, under one entry of the navigation."""

    id: str
    title: str
    panels: tuple[Panel, ...]
    intro: str = ""


@dataclass(frozen=True, slots=True)
class Banner:
    """A line across the top of the page that nobody can overlook."""

    title: str
    text: str
    loud: bool


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text under headings; ``numeric`` names the columns that align right."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[int, ...] = ()
    caption: str = ""
