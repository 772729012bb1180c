"""Commands and verbs are one: a command that answers with a document calls a verb of `legid` and writes its result."""

import ast
from pathlib import Path
from typing import Any

import pytest

import legid
from legid.cli.command import Command, OneOf
from tests.support.paths import FIXTURES, ROOT
from tests.support.shell import document, read_json, typed

FOLDER = ROOT / "legid/cli/commands"
HEALTHY, RIG = FIXTURES / "healthy.mcap", FIXTURES / "rig.toml"
STUDIES = {"casebook", "monte_carlo"}
"""Their work is in the source tree, not in the package."""
WRITERS = {"write_json", "to_json", "save_model", "origin_of"}
"""Who calls them writes a document of its own."""


def module(name: str) -> ast.Module:
    return ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))


def verbs(tree: ast.AST) -> set[str]:
    """Names of `legid` that are called."""
    called = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
    return {f.attr for f in called if isinstance(f, ast.Attribute) and isinstance(f.value, ast.Name)
            and f.value.id == "legid"}


def names(tree: ast.AST) -> set[str]:
    return {node.attr if isinstance(node, ast.Attribute) else node.id for node in ast.walk(tree)
            if isinstance(node, ast.Attribute | ast.Name)}


def documents() -> list[str]:
    """Modules of commands with `--json`."""
    from importlib import import_module

    found = []
    for path in sorted(FOLDER.glob("[!_]*.py")):
        command: Command = import_module(f"legid.cli.commands.{path.stem}").COMMAND
        arguments = [one for part in command.arguments
                     for one in (part.arguments if isinstance(part, OneOf) else (part,))]
        if any("--json" in one.flags for one in arguments):
            found.append(path.stem)
    return found


@pytest.mark.parametrize("name", [name for name in documents() if name not in STUDIES])
def test_a_command_with_a_document_calls_its_verb_and_hands_the_result_over(name: str) -> None:
    tree = module(name)
    called = verbs(tree) - {"load", "load_model", "load_rig"}
    assert called and called <= set(vars(legid)["__all__"])
    assert not WRITERS & names(tree), "answer() writes"
    given = [call.args[1].id for call in ast.walk(tree) if isinstance(call, ast.Call)
             and isinstance(call.func, ast.Name) and call.func.id == "answer" and isinstance(call.args[1], ast.Name)]
    assert set(given) == {"found"}


def test_every_verb_with_a_document_has_its_command() -> None:
    called = set().union(*(verbs(module(name)) for name in documents()))
    assert called >= {"fit", "fit_each", "validate", "compare", "compare_sessions", "diagnose", "tune", "effects",
                      "list_runs"}


def answer(path: Path) -> Any:
    """A document without the command line and the time that it took."""
    found = read_json(path)
    return {k: v for k, v in found.items() if k != "wall_s"} | {"provenance": found["provenance"] | {"command": ""}}


def test_the_document_of_a_command_is_that_of_the_verb_with_all_that_it_was_made_from(here: Path) -> None:
    model, shell, python = here / "model.json", here / "shell.json", here / "python.json"

    def same(found: Any, *words: object) -> Any:
        typed(*words, "--json shell.json --force")
        python.unlink(missing_ok=True)
        found.to_json(python)
        assert answer(shell) == answer(python)
        return read_json(shell)["provenance"]

    run = legid.load(HEALTHY, RIG)
    origin = same(legid.fit(run, method="wls"), "fit", HEALTHY, "--rig", RIG, "--method wls --model-out", model)
    assert origin["rig"]["file"] == "rig.toml" and origin["command"].startswith("legid fit healthy.mcap")
    assert same(legid.validate(model, run), "validate", model, HEALTHY, "--rig", RIG)["model"]["file"] == "model.json"
    both = same(legid.compare(model, model, run, names=(str(model), str(model))), "compare", model, model, HEALTHY,
                "--rig", RIG)
    assert [one["file"] for one in both["models"]] == ["model.json", "model.json"]
    each = legid.fit_each([HEALTHY], RIG, method="wls")
    assert each.status == 0
    (one,) = document("fit --each", HEALTHY, "--rig", RIG, "--method wls --workers 1")["fits"]
    assert each.fits[0]["parameters"] == one["parameters"] and one["provenance"]["rig"]["file"] == "rig.toml"
    assert list(each.to_frame().index) == [str(HEALTHY.resolve())]
    same(legid.effects(), "effects")
    listed = legid.list_runs(FIXTURES)
    same(listed, "runs", FIXTURES)
    assert "healthy.mcap" in listed.to_frame().index and len(listed) == listed.of > 3
