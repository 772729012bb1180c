"""Pages of the site that come from the code: commands, effects, streams of a run file, modules."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FLOORS = {
    "drivers": "Floor 1: bytes to physical units, for one device each.",
    "daq": "Floor 2: one time line. Clocks, recorder, safety, run files, alignment; hands over a Dataset.",
    "estimator": "Floor 3: mathematics on arrays. No input or output, no clock, no printing.",
    "experiments": "Floor 4: what a person runs. For scripts, :doc:`legid </reference>` is the interface.",
}
ROOT = Path(__file__).parent.parent


def write_pages(folder: Path) -> None:
    """All generated pages into `folder`; unchanged ones are left alone, so that a rebuild is quick."""
    folder.mkdir(exist_ok=True)
    pages = {"commands.md": commands_page(), "effects.md": effects_page(), "streams.md": streams_part()}
    pages |= {f"{name}_keys.md": text for name, text in key_tables().items()}
    pages |= {f"{floor}.rst": modules_page(floor, words) for floor, words in FLOORS.items()}
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def commands_page() -> str:
    """`--help` of every command."""
    from legid.cli.main import build_parser

    parser = build_parser()
    (subparsers,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    parts = ["# Commands", "What `legid COMMAND --help` says. Exit status: 0 done; 1 the work could not be done on "
             "this data or device; 2 bad arguments or bad input. Every failure is one line on stderr."]
    for name, command in subparsers.choices.items():
        command.formatter_class = lambda prog: argparse.HelpFormatter(prog, max_help_position=26, width=88)
        parts += [f"## legid {name}", f"```text\n{command.format_help()}```"]
    return "\n\n".join(parts) + "\n"


def effects_page() -> str:
    """The library of effects."""
    from experiments.models.effect_library import effects_document

    document = effects_document()
    parts = ["# Effects that a diagnosis can name", "What `legid effects` lists. Sizes are estimated with intervals; "
             "shapes are tried at the values given before they are fitted."]
    for row in document["effects"]:
        sizes = ", ".join(f"{s['name']} [{s['unit']}]" for s in row["sizes"])
        shapes = ", ".join(f"{s['name']} [{s['unit']}] (tried: {', '.join(f'{x:g}' for x in s['tried'])})"
                           for s in row["shapes"])
        lines = [f"- {_where(row)}", f"- sizes: {sizes}"]
        lines += [f"- shapes: {shapes}"] if shapes else []
        lines += [f"- after: {row['reference']}", f"- best shown by: {row['experiment']}"]
        parts += [f"## {row['effect']}", f"{row['meaning'][0].upper()}{row['meaning'][1:]}.", "\n".join(lines)]
    parts += ["## Not testable", "\n".join(f"- `{row['effect']}`: {row['why']}" for row in document["not_testable"])]
    return "\n\n".join(parts).replace("*", r"\*") + "\n"


def streams_part() -> str:
    """Topics, schemas and fields of a run file, for the page of formats."""
    from daq.runs.streams import NOTE_SCHEMA, NOTE_TOPICS, STREAMS

    parts = []
    for stream in STREAMS.values():
        rows = "\n".join(f"| `{f.name}` | {f.ros} | {f.note} |" for f in stream.fields)
        parts.append(f"### {stream.topic}\n\nSchema `{stream.schema}`.\n\n| field | type | meaning |\n"
                     f"| --- | --- | --- |\n{rows}")
    parts.append(f"### {' and '.join(NOTE_TOPICS)}\n\nSchema `{NOTE_SCHEMA}`: `int64 host_ns`, `string kind`, "
                 "`string text`.")
    return "\n\n".join(parts) + "\n"


def key_tables() -> dict[str, str]:
    """The table of keys of each JSON document that is a struct, for the page of formats."""
    from tests.support.documented import DOCUMENTED, keys_table

    return {name: keys_table(kind) for name, kind in DOCUMENTED.items()}


def modules_page(floor: str, words: str) -> str:
    """All modules of a package with what their docstrings say."""
    files = sorted(p for p in (ROOT / floor).rglob("*.py") if "commands" not in p.parts)
    names = sorted(".".join(p.relative_to(ROOT).with_suffix("").parts) for p in files if not p.name.startswith("__"))
    parts = [f"{floor}\n{'=' * len(floor)}", words]
    for name in names:
        parts += [f"{name}\n{'-' * len(name)}", f".. automodule:: {name}"]
    return "\n\n".join(parts) + "\n"


def _where(row: Mapping[str, Any]) -> str:
    """Where an effect is tested."""
    if row["by_joint"]:
        return "tested at every joint"
    return "tested at every motor where there are several" if row["by_motor"] else "of the whole rig"
