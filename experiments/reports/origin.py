"""Sources of a document, a model and a page: the files that they were generated from."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import msgspec
from msgspec import UnsetType

from daq import Dataset
from experiments.judge import Files, Headline, with_names
from experiments.models import Model
from experiments.provenance import Origin, origin_of
from experiments.reports.html import Section, Table, write_page
from experiments.session import damaged_runs


def model_with_origin(model: Model, origin: Origin, runs: Sequence[Dataset] = ()) -> Model:
    """`model` with `origin` and what is damaged in its provenance; of files, those of the rig and of its own runs."""
    named = tuple(source for source in origin.runs if source.file in model.provenance.runs)
    told = msgspec.structs.replace(
        model.provenance, origin=msgspec.structs.replace(origin, runs=named, model=None),
        damaged=tuple(f"{d['run']}: {d['what']}" for d in damaged_runs(runs)))
    return msgspec.structs.replace(model, provenance=told)


class Result(Protocol):
    """A document that a verb gives."""

    @property
    def headline(self) -> Headline:
        """The first lines."""

    @property
    def provenance(self) -> Origin | UnsetType:
        """Its files."""


def write_result(path: Path | str, result: Result, title: str, summary: str, sections: Sequence[Section],
                 files: Files | None = None) -> None:
    """Write the page of a document: what it says first in a box, `sections`, its files. The next step names `files`.

    Raises `InputError` where that place cannot be written.
    """
    origin, head = result.provenance or origin_of(), result.headline
    write_page(path, title, summary, [*sections, origin_section(origin, getattr(result, "damaged", ()))], origin,
               replace(head, action=with_names(head.action, files)))


def origin_section(origin: Origin, damaged: Sequence[Mapping[str, str]] = ()) -> Section:
    """The last section of a page; damaged runs are told as a document has them."""
    rows = [[source.file + (f" in {source.inside}" if source.inside else ""), source.sha256]
            for source in origin.sources]
    how = ["Command:"] if origin.command else []
    seed = [] if origin.seed is None else [f"Random numbers are drawn from seed {origin.seed}."]
    model = _model_of(origin)
    quoted, rig = shlex.quote(model), f" --rig {shlex.quote(origin.rig.file)}" if origin.rig is not None else ""
    use = [f"This model in MuJoCo: legid export {quoted} --to mujoco --out leg; its errors there: "
           f"legid validate {quoted} RUN...{rig} --simulator mujoco"] if model else []
    return Section("Where this comes from",
                   [f"legid {origin.version}, commit {origin.commit}. legid verify checks these files against this "
                    "page.", *seed, *how], [Table(["file", "SHA-256"], rows)], command=origin.command,
                   notes=[*(f"{d['run']} is damaged: {d['what']}" for d in damaged), *use],
                   folded=True)


def _model_of(origin: Origin) -> str:
    """Name of the model file that the command read or wrote; empty without one."""
    if origin.model is not None:
        return origin.model.file
    words = shlex.split(origin.command)
    return words[words.index("--model-out") + 1] if "--model-out" in words[:-1] else ""
