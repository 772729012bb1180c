"""Writes measured calibration into the text of a rig.toml; everything else in it, comments too, stays as it is."""

from __future__ import annotations

import re
from collections.abc import Mapping

import msgspec

from daq.errors import InputError
from daq.rig import Calibration, parse_rig

TABLE = "[calibration]"


def set_calibration(text: str, values: Mapping[str, object], where: str = "rig.toml") -> str:
    """`text` with these keys of `[calibration]` set. Raises `InputError` when the file is written in another way."""
    lines = text.splitlines()
    start = next((k for k, line in enumerate(lines) if line.split("#")[0].strip() == TABLE), None)
    if start is None:
        lines += ["", TABLE] if lines and lines[-1].strip() else [TABLE]
        start = len(lines) - 1
    end = next((k for k in range(start + 1, len(lines)) if re.match(r"\s*\[", lines[k])
                and not _inside_array(lines[start + 1: k])), len(lines))
    body = lines[start + 1: end]
    for key in values:
        body = _without(body, key)
    while body and not body[-1].strip():
        body.pop()
    body += [f"{key} = {_toml(value)}" for key, value in values.items()]
    new = "\n".join([*lines[: start + 1], *body, *([""] if end < len(lines) else []), *lines[end:]]) + "\n"
    _check(text, new, values, where)
    return new


def _check(old: str, new: str, values: Mapping[str, object], where: str) -> None:
    """The new text says what the old one said, but for the values."""
    try:
        before, after = parse_rig(old, where), parse_rig(new, where)
    except InputError as error:
        raise InputError(where, f"cannot be changed by program ({error})", f"set {', '.join(values)} by hand") from None
    wanted = msgspec.convert({**msgspec.to_builtins(before.calibration), **values}, Calibration)
    if after != msgspec.structs.replace(before, calibration=wanted):
        raise InputError(where, "its [calibration] is written in a way that cannot be changed by program",
                         f"set {', '.join(values)} by hand")


def _without(body: list[str], key: str) -> list[str]:
    """The table's lines without this key and its value, which may go over several lines."""
    out: list[str] = []
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
    return out


def _inside_array(lines: list[str]) -> bool:
    """An array is open at the end of these lines."""
    text = "".join(line.split("#")[0] for line in lines)
    return text.count("[") > text.count("]")


def _toml(value: object) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
