"""Origin of a result: the files behind it with their SHA-256, and the program's version and commit.

A document carries it as `provenance` (a model within its own `provenance`, as `origin`), a report page in its head and
as its last section; `legid verify` reads it back and looks at the files.
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from html import unescape
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from daq import InputError, input_errors, open_regular, read_bytes

META = "legid-provenance"
"""Name of the element in a page's head that holds it as JSON."""
GIT_TIMEOUT_S = 5.0
MOST_BYTES = 1 << 28
"""Of a document, which a page with its figures can be, too."""
LONGEST_NAME = 255


class Source(Struct, frozen=True, kw_only=True):
    """One file that was read."""

    file: str
    """Its name, without the folder."""
    sha256: str
    inside: str = ""
    """The run that holds it, where it is no file of its own: a rig.toml that was recorded."""


class Origin(Struct, frozen=True, kw_only=True):
    """Everything that a result was made from."""

    version: str
    commit: str
    """Of the checkout or of the installed package; `unknown` where neither tells."""
    runs: tuple[Source, ...] = ()
    rig: Source | None = None
    model: Source | None = None
    command: str = ""
    """What was typed, without folders; empty where a script asked."""
    seed: int | None = None
    """From which random numbers were drawn; None where none were."""
    models: tuple[Source, ...] = ()
    """Further models, of a comparison."""

    @property
    def sources(self) -> tuple[Source, ...]:
        """All files."""
        return (*self.runs, *(s for s in (self.rig, self.model) if s is not None), *self.models)


def origin_of(runs: Sequence[Path | str] = (), rig: Source | None = None, seed: int | None = None, command: str = ""
              ) -> Origin:
    """Hashes of the runs as they are now. Raises `InputError` for one that cannot be read."""
    return Origin(version=program_version(), commit=commit(), runs=tuple(map(source_of, runs)), rig=rig,
                  command=command, seed=seed)


def source_of(path: Path | str) -> Source:
    """One file with its hash. Raises `InputError`."""
    with input_errors(path, "give a file that can be read"), open_regular(path) as file:
        return Source(file=Path(path).name, sha256=hashlib.file_digest(file, "sha256").hexdigest())


def text_source(text: str, file: str, inside: str) -> Source:
    """A text that stands inside a run."""
    return Source(file=file, sha256=hashlib.sha256(text.encode()).hexdigest(), inside=inside)


def program_version() -> str:
    """The installed version, or `unknown` where the package is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("legid")
    except PackageNotFoundError:
        return "unknown"


@lru_cache(maxsize=1)
def commit() -> str:
    """Commit of the checkout of this file, with `-dirty` after changes; else what the installer noted."""
    root = Path(__file__).parent.parent
    if (root / ".git").exists():
        with suppress(OSError, subprocess.SubprocessError):
            asked = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
            done = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=GIT_TIMEOUT_S)
            return done.stdout.strip()
    from importlib.metadata import PackageNotFoundError, distribution

    with suppress(PackageNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        noted = json.loads(distribution("legid").read_text("direct_url.json") or "")
        return str(noted["vcs_info"]["commit_id"])
    return "unknown"


def read_origin(path: Path | str) -> Origin:
    """Origin of a document, a model or a report page. Raises `InputError` for a file that carries none."""
    where = str(path)
    try:
        with input_errors(path, "give a JSON, model or report of legid"):
            text = read_bytes(path, MOST_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(where, "is no text", "give a JSON, model or report of legid") from None
    found = re.search(rf'<meta name="{META}" content="([^"]*)"', text)
    try:
        document = {"provenance": json.loads(unescape(found[1]))} if found else json.loads(text)
        inner = document["provenance"]
        return msgspec.convert(inner.get("origin") or inner, Origin)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, msgspec.ValidationError):
        raise InputError(where, "says nothing of the files that it was made from",
                         "give a JSON, model or report of this version of legid") from None


@dataclass(frozen=True)
class Checked:
    """Result of the check of one file."""

    source: Source
    state: Literal["same", "CHANGED", "missing"]
    where: str = ""


def verify(origin: Origin, folders: Sequence[Path], where: str = "provenance") -> list[Checked]:
    """Every file of `origin` looked for by its name in `folders` and below them.

    A link that leads out of its folder is not followed. Raises `InputError` for a source of the file `where` that has
    no plain name.
    """
    for source in origin.sources:
        name = source.inside or source.file
        if not 0 < len(name) <= LONGEST_NAME or name != Path(name).name or not name.isprintable():
            raise InputError(where, f"names {name[:40]!r}, which is no name of a file",
                             "give a JSON, model or report of legid")
    return [_check(source, folders) for source in origin.sources]


def _check(source: Source, folders: Sequence[Path]) -> Checked:
    from daq.runs import read_run

    other, name = "", source.inside or source.file
    for folder in folders:
        for path in sorted(found for found in folder.rglob("*") if found.name == name):
            if not path.resolve().is_relative_to(folder.resolve()):
                continue
            with suppress(InputError, OSError):
                if source.inside:
                    text = read_run(path).files.get(source.file, "")
                    same = text_source(text, source.file, source.inside).sha256 == source.sha256
                else:
                    same = source_of(path).sha256 == source.sha256
                if same:
                    return Checked(source, "same", str(path))
                other = other or str(path)
    return Checked(source, "CHANGED", other) if other else Checked(source, "missing")
