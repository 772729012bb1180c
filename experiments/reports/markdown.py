"""`Section`s to a Markdown page; its pictures become SVG files in the same folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments.console import make_directory, write_text
from experiments.reports.figures import standalone
from experiments.reports.html import Section, Table

MARK = "<!-- written by legid -->"
"""By which `daq.files` knows the page again."""


def write_markdown(path: Path | str, title: str, summary: str, sections: Sequence[Section]) -> None:
    """Page at `path`, pictures at `<its stem>-1.svg` and so on. Raises `InputError` where that cannot be written."""
    page = Path(path)
    make_directory(page.parent)
    blocks, pictures = [f"# {title}", MARK, summary], 0
    for section in sections:
        blocks += [f"## {section.title}", *section.paragraphs, *_command(section), *map(markdown_table, section.tables)]
        for picture in section.pictures:
            pictures += 1
            name = f"{page.stem}-{pictures}.svg"
            write_text(page.parent / name, standalone(picture.svg))
            blocks.append(f"![{picture.caption}]({name})\n\n{picture.caption}")
        if section.notes:
            blocks.append("\n".join(f"- {note}" for note in section.notes))
    write_text(page, "\n\n".join(blocks) + "\n")


def _command(section: Section) -> list[str]:
    return [f"```sh\n{section.command}\n```"] if section.command else []


def markdown_table(table: Table) -> str:
    """A table with its caption above it."""
    rule = ["---:" if k in table.right else "---" for k in range(len(table.header))]
    rows = [list(table.header), rule, *table.rows]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(([f"**{table.caption}**", ""] if table.caption else []) + lines)
