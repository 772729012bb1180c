"""The documentation site: `make docs` builds it into site/. Nothing in it loads anything from elsewhere."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util.inspect import TypeAliasForwardRef

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from generated_pages import write_pages  # noqa: E402

project = "legid"
author = "the legid authors"
copyright = "the legid authors, MIT"
html_title = "legid"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["generated/streams.md", "generated/*_keys.md"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
language = "en"

html_theme = "furo"
html_math_renderer = "mathml"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it would fetch pages, which a browser refuses from file://
html_theme_options = {"footer_icons": [], "top_of_page_buttons": []}

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
autodoc_type_aliases = {name: name for name in ("FloatArray", "BoolArray", "Index", "Samples", "Progress")}
maximum_signature_line_length = 80
suppress_warnings = ["ref.python"]  # Model, Problem and others are names of several classes

SPACED = re.compile(r"<mi>(sin|cos)</mi>")
"""Functions stand off from what is before and behind them."""


def write_formula(writer: Any, node: nodes.math | nodes.math_block, display: str) -> None:
    """TeX as MathML, which browsers lay out themselves: no script, no font from elsewhere."""
    for part in re.split(r"\n\s*\n", node.astext().strip()):
        formula = SPACED.sub(r'<mspace width="0.15em"/>\g<0><mspace width="0.15em"/>', convert(part, display=display))
        writer.body.append(f'<div class="formula">{formula}</div>' if display == "block" else formula)


def inline_formula(writer: Any, node: nodes.math) -> None:
    """A formula within a line."""
    write_formula(writer, node, "inline")
    raise nodes.SkipNode


def display_formula(writer: Any, node: nodes.math_block) -> None:
    """A formula of its own line, with its number."""
    write_formula(writer, node, "block")
    raise nodes.SkipNode


def plain_docstring(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """The packages' docstrings are plain text: stars and bars mean themselves, indented parts are set as they stand."""
    out: list[str] = []
    inside = False
    for line in lines:
        indented = line.startswith("    ") and not line.lstrip().startswith(">>>")
        if indented and not inside and (not out or not out[-1]):
            out += ["::", ""]
            inside = True
        elif line and not line.startswith("    "):
            inside = False
        out.append(line if inside else escaped(line))
    lines[:] = out


def escaped(line: str) -> str:
    """Without markup but for `code`."""
    parts = re.split(r"`([^`]+)`", line)
    parts[::2] = [re.sub(r"([*|`])|(?<=\w)(_)(?!\w)", r"\\\1\2", part) for part in parts[::2]]
    parts[1::2] = [f"\\ ``{part}``\\ " for part in parts[1::2]]
    return "".join(parts)


def setup(app: Any) -> None:
    """What Sphinx calls first."""
    TypeAliasForwardRef.__repr__ = lambda alias: str(alias.name)  # dict[str, FloatArray], not its machinery
    write_pages(HERE / "generated")
    app.add_html_math_renderer("mathml", (inline_formula, None), (display_formula, None))
    app.connect("autodoc-process-docstring", plain_docstring)
