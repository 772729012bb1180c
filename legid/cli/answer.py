"""Runs and rig that a command was given, and its answer: on the terminal first, then in files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import legid
from daq import InputError
from experiments.console import note

if TYPE_CHECKING:
    from experiments.judge import Files
    from experiments.rig import ChosenRig


def chosen_rig(args: argparse.Namespace, runs: Sequence[str]) -> ChosenRig:
    """The rig that the command goes by, told of where nobody gave it."""
    from experiments.rig import choose_rig

    chosen = choose_rig(args.rig, runs)
    if getattr(args, "as_read", False):
        from msgspec import structs  # --help loads none

        sampling = structs.replace(chosen.rig.sampling, as_read=True)
        chosen = replace(chosen, rig=structs.replace(chosen.rig, sampling=sampling))
    if chosen.note:
        note(chosen.note)
    return chosen


def given_runs(args: argparse.Namespace, paths: Sequence[str]) -> tuple[tuple[legid.Dataset, ...], ChosenRig]:
    """The runs `paths` that a command is asked about, and the rig that it goes by."""
    chosen = chosen_rig(args, paths)
    return legid.load(list(paths), chosen, args.damaged), chosen


def given_reference(places: Sequence[str]) -> tuple[str | None, list[str]]:
    """A model to hold runs against, or else earlier runs. Raises `InputError` for both."""
    from experiments.workflows import runs_in

    models = [path for path in places if path.lower().endswith(".json")]
    if models and len(places) > 1:
        raise InputError(models[0], "is a model, and is not the only reference", "give one model, or runs alone")
    return (models[0], []) if models else (None, runs_in(places))


def refuse(args: argparse.Namespace, options: Sequence[str], why: str, remedy: str = "leave it out") -> None:
    """Raises `InputError` where one of `options`, which do not belong to what was asked, is given."""
    for option in options:
        if getattr(args, option.removeprefix("--").replace("-", "_")):
            raise InputError(option, why, remedy)


def answer(args: argparse.Namespace, found: Any, text: str, files: Files | None = None) -> int:
    """Exit status 0, once `text` is printed and the files that were asked for are written.

    Text comes before any file: a full disk must not take minutes of work with it. Raises `WorkError` for a result that
    is no use; its JSON and its page are there all the same, a model is not.
    """
    wanted = vars(args)
    if text:
        print(text, flush=True)
    if wanted.get("json"):
        found.to_json(args.json)
    if wanted.get("html"):
        found.page(args.html, *([] if files is None else [files]))
    found.check()
    if wanted.get("model_out"):
        legid.save_model(legid.model(found), args.model_out)
    return 0
