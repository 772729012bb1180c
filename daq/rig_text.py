"""Writes measured values into the text of a rig.toml; everything else in it, comments too, stays as it is."""

from __future__ import annotations

import re
from collections.abc import Mapping

import msgspec

from daq.errors import InputError
from daq.rig import Rig, parse_rig

ASSUMED = "ASSUMED, please measure"
"""What `legid init` writes behind a value that nobody gave; it goes when the value is set."""
MOST_WORDS = 200
"""Characters of somebody else's name that are written."""


def comment(text: str) -> str:
    """`text` as the words of a TOML comment: on one line, whatever name of a file or a link is in it."""
    short = text if len(text) <= MOST_WORDS else f"{text[:MOST_WORDS]} ..."
    return "".join(c if c.isprintable() else " " for c in short)


def quoted(text: str) -> str:
    """`text` as a TOML string."""
    return f'"{"".join(map(_escaped, text))}"'


def _escaped(char: str) -> str:
    if char.isprintable():
        return f"\\{char}" if char in '"\\' else char
    return "?" if "\ud800" <= char < "\ue000" else f"\\U{ord(char):08x}"  # half of a character is none


def set_values(text: str, tables: Mapping[str, Mapping[str, object]], where: str = "rig.toml") -> str:
    """`text` with these keys of these tables set; `a.b` is the key b of the table a within them.

    Raises `InputError` when the file is written in another way.
    """
    new = text
    for table, values in tables.items():
        if values:
            new = _set_table(new, table, values)
    _check(text, new, tables, where)
    return new


def _set_table(text: str, table: str, values: Mapping[str, object]) -> str:
    lines = text.splitlines()
    start = next((k for k, line in enumerate(lines) if line.split("#")[0].strip() == f"[{table}]"), None)
    if start is None:
        lines += ["", f"[{table}]"] if lines and lines[-1].strip() else [f"[{table}]"]
        start = len(lines) - 1
    end = next((k for k in range(start + 1, len(lines)) if re.match(r"\s*\[", lines[k])
                and not _inside_array(lines[start + 1: k])), len(lines))
    body = lines[start + 1: end]
    while body and not body[-1].strip():
        body.pop()
    for key, value in values.items():
        body = _with(body, key, f"{key} = {_toml(value)}")
    return "\n".join([*lines[: start + 1], *body, *([""] if end < len(lines) else []), *lines[end:]]) + "\n"


def _check(old: str, new: str, tables: Mapping[str, Mapping[str, object]], where: str) -> None:
    """The new text says what the old one said, but for the values."""
    keys = ", ".join(key for values in tables.values() for key in values)
    try:
        before, after = parse_rig(old, where), parse_rig(new, where)
    except InputError as error:
        raise InputError(where, f"cannot be changed by program ({error})", f"set {keys} by hand") from None
    wanted = msgspec.to_builtins(before)
    for table, values in tables.items():
        wanted[table] = dict(wanted[table] or {})
        for key, value in values.items():
            outer, _, inner = key.partition(".")
            wanted[table][outer] = {**wanted[table].get(outer, {}), inner: value} if inner else value
    if after != msgspec.convert(wanted, Rig):
        raise InputError(where, f"its [{', '.join(tables)}] is written in a way that cannot be changed by program",
                         f"set {keys} by hand")


def _with(body: list[str], key: str, entry: str) -> list[str]:
    """The table's lines with this key's entry in place of an old one, which may go over several lines, or at the end.

    The comment behind an old value of one line stays, the mark of an assumed value does not.
    """
    out: list[str] = []
    placed = False
    rest = iter(body)
    for line in rest:
        if not re.match(rf"\s*{re.escape(key)}\s*=", line):
            out.append(line)
            continue
        seen = [line]
        while _inside_array(seen):
            more = next(rest, None)
            if more is None:
                break
            seen.append(more)
        comment = line.partition("#")[2].replace(ASSUMED, "").strip() if len(seen) == 1 else ""
        out.append(f"{entry:33} # {comment}" if comment else entry)
        placed = True
    return out if placed else [*out, entry]


def _inside_array(lines: list[str]) -> bool:
    """An array is open at the end of these lines."""
    text = "".join(line.split("#")[0] for line in lines)
    return text.count("[") > text.count("]")


def _toml(value: object) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return quoted(value) if isinstance(value, str) else repr(value)
