"""`Section`s to one HTML page that needs nothing but itself: no font, no picture, no script from elsewhere.

Its own script, uPlot (MIT, https://github.com/leeoniya/uPlot) with `figures.js`, makes curves over time into figures
that zoom. It goes into pages that have any, and the page's policy lets that one run by its hash and no other. Without
it, and on paper, the same figures stand there as pictures.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import msgspec
from markupsafe import Markup, escape

from experiments.console import text_table, write_text
from experiments.judge import Headline
from experiments.provenance import META, Origin, program_version
from experiments.reports.chart import Chart

SCRIPT, STYLE = "uPlot.iife.js", "uPlot.min.css"
"""uPlot's, of the package `uplot-python` (extra `zoom`); without it the pages keep their still figures alone."""

PRINTED = {"^2": "²", "^3": "³", "m/s2": "m/s²", "+-": "±", " %": "\u00a0%", "`": ""}
"""What a terminal may lack -> how a page has it."""

WHOLE = re.compile(r"(?<![\w-])--[a-z][\w-]*|(?<=\blegid )[a-z]+(?:-[a-z]+)+|[\d.]+e-\d+")
"""What a browser would part at a hyphen, and a person reads or types as one."""


@dataclass(frozen=True)
class Table:
    """Cells as text; columns in `right` hold numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: Collection[int] = ()
    caption: str = ""

    @property
    def text(self) -> str:
        """Lines for a terminal; empty without rows."""
        return text_table(self.header, self.rows, self.right) if self.rows else ""


@dataclass(frozen=True)
class Picture:
    """An SVG element and what it shows."""

    svg: str
    caption: str
    chart: Chart | None = None
    """The same curves for a browser, to zoom in."""
    leads: bool = False
    """Stands at the head of the page, in place of its section; of several the first."""
    still: str = ""
    """Sentence on the SVG alone, where `chart` shows more."""

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
    notes: Sequence[str] = ()
    """A list of short sentences, after the figures."""
    command: str = ""
    """A command line to be copied, after the paragraphs."""
    folded: bool = False
    """Shows its heading until a reader opens it; paper shows all of it."""


def fold(*sections: Section | None) -> list[Section]:
    """The same sections, folded; without those that have nothing to show."""
    return [replace(s, folded=True) for s in sections if s and (s.paragraphs or s.tables or s.pictures or s.notes)]


def uplot_folder() -> Path | None:
    """Folder of uPlot's bundle; None where it is not installed."""
    found = find_spec("uplot")
    folder = Path(found.origin).parent / "static" if found is not None and found.origin else None
    return folder if folder is not None and (folder / SCRIPT).exists() and (folder / STYLE).exists() else None


@lru_cache(maxsize=1)
def page_script() -> str:
    """The one script that a page may hold; empty without uPlot."""
    folder, own = uplot_folder(), files(__package__) / "templates" / "figures.js"
    if folder is None:
        return ""
    return (folder / SCRIPT).read_text(encoding="utf-8") + "\n" + own.read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def script_hash() -> str:
    """Source expression of a content security policy that allows `page_script` and nothing else."""
    return "sha256-" + base64.b64encode(hashlib.sha256(page_script().encode()).digest()).decode()


def typeset(text: str) -> str:
    """Text for a terminal as a page has it: powers and signs as such, and no line ends between a number and its per
    cent sign."""
    for plain, printed in PRINTED.items():
        text = text.replace(plain, printed)
    return text


def whole_options(escaped: str) -> str:
    """Escaped text in whose lines no option, command of two words or number is parted at a hyphen."""
    return WHOLE.sub(r'<span class="whole">\g<0></span>', escaped)


def _prose(text: str) -> Markup:
    """Text as a page has it, in a paragraph or a cell."""
    return Markup(whole_options(str(escape(typeset(text)))))


def _cell(text: str) -> Markup:
    """The same as one element: on a phone a cell lays out its children in a row."""
    words = _prose(text)
    return Markup("<span>") + words + Markup("</span>") if "<span" in words else words


def render_page(title: str, summary: str, sections: Sequence[Section], origin: Origin | None = None,
                verdict: Headline | None = None) -> str:
    """The page as HTML text; all text is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(loader=PackageLoader(__package__), autoescape=select_autoescape(["html"]),
                              undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"typeset": typeset, "prose": _prose, "cell": _cell}
    folder = uplot_folder()
    sections, lead = _lead(sections)
    live = folder is not None and any(
        picture.chart for picture in (*([lead] if lead else []), *(p for s in sections for p in s.pictures)))
    sheets = [(folder / STYLE).read_text(encoding="utf-8")] if live and folder is not None else []
    css = Markup("\n".join([*sheets, environment.get_template("report.css").render()]))
    stamp = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return environment.get_template("report.html").render(
        title=title, summary=summary, sections=sections, lead=lead, css=css, stamp=stamp, version=program_version(),
        meta=META, origin=None if origin is None else msgspec.json.encode(origin).decode(), verdict=verdict,
        anchors=[f"s{k}-{re.sub('[^a-z0-9]+', '-', s.title.lower()).strip('-')}" for k, s in enumerate(sections, 1)],
        script=Markup(page_script()) if live else "", script_hash=script_hash())


def _lead(sections: Sequence[Section]) -> tuple[list[Section], Picture | None]:
    """The sections without the picture that leads the page, and that picture. A section without any other is left out
    if it has no table and no note."""
    lead = next((picture for s in sections for picture in s.pictures if picture.leads), None)
    rest = [replace(s, pictures=[p for p in s.pictures if p is not lead]) for s in sections]
    return [new for new, old in zip(rest, sections)
            if new.tables or new.pictures or new.notes or not old.pictures], lead


def write_page(path: Path | str, title: str, summary: str, sections: Sequence[Section],
               origin: Origin | None = None, verdict: Headline | None = None) -> None:
    """Render and write; `origin` goes into its head. Raises `InputError` where that place cannot be written."""
    write_text(path, render_page(title, summary, sections, origin, verdict))
