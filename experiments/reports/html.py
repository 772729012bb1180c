"""`Section`s to one HTML page that needs nothing but itself: no script, no font, no picture from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import msgspec
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from experiments.console import write_text
from experiments.provenance import META, Origin, program_version


@dataclass(frozen=True)
class Table:
    """Cells as text; columns in `right` hold numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    right: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Picture:
    """An SVG element and what it shows."""

    svg: str
    caption: str

    @property
    def markup(self) -> Markup:
        """The SVG as it goes into the page; it comes from `experiments.reports.figures`, never from a file."""
        return Markup(self.svg)


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it, in this order."""

    title: str
    paragraphs: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    notes: Sequence[str] = field(default_factory=tuple)
    """A list of short sentences, after the figures."""


def render_page(title: str, summary: str, sections: Sequence[Section], date: datetime | None = None,
                origin: Origin | None = None) -> str:
    """The page as HTML text; all text is escaped."""
    environment = Environment(loader=PackageLoader(__package__), autoescape=select_autoescape(["html"]),
                              undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    css = Markup(environment.get_template("report.css").render())
    stamp = (date or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    return environment.get_template("report.html").render(
        title=title, summary=summary, sections=sections, css=css, stamp=stamp, version=program_version(),
        meta=META, origin=None if origin is None else msgspec.json.encode(origin).decode())


def write_page(path: Path | str, title: str, summary: str, sections: Sequence[Section],
               origin: Origin | None = None) -> None:
    """Render and write; `origin` goes into its head. Raises `InputError` where that place cannot be written."""
    write_text(path, render_page(title, summary, sections, origin=origin))
