"""Words: the five packages speak and name things in the textbook's terms, in short sentences."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.paths import ROOT
from tests.support.words import IN_ESTIMATOR, WORDS, compiled, lix

FLOORS = ("drivers", "daq", "estimator", "experiments", "legid", "studies")
LONGEST = 30
"""Most words of a sentence in a message, and of a docstring's first sentence."""
SENTENCES = r"(?<=[.:;!?])\s+|\n\s*\n|\n\s*[-*|]"
"""Between the sentences of a message."""
MOST_LIX = 24.0
"""Of all messages together."""
CLAUSE = re.compile(r"(What|Who|Whoever|Whose|Which|Where|How|That|Of|By|With|From|As(?! many)|So|Nothing|Beyond)\b")
"""First word of a clause that does not say what comes back."""
ALLOWED: list[tuple[str, str, str]] = [
    ("legid/tools.py", "doubt", "the flag --doubt of legid excite, an argument of the same name"),
    ("estimator/result.py", "`doubt`", "a role of a finding, as documents have it"),
]
"""(path, phrase, reason): a JSON key, a contract, another library's name, or the plain meaning of the word."""


EVERYWHERE, ESTIMATOR_ONLY = compiled(WORDS), compiled(IN_ESTIMATOR)
FILES = sorted(p for floor in FLOORS for p in (ROOT / floor).rglob("*.py"))


class Said(NamedTuple):
    """One docstring, comment, message or name of a file."""

    line: int
    kind: str
    text: str
    sentence: bool = False
    """A public docstring, which must begin with a sentence."""


def text_of(node: ast.expr) -> str | None:
    """Text of a string or f-string, each value of which counts as one word; None of any other node."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(v.value) if isinstance(v, ast.Constant) else "X" for v in node.values)
    return None


def docstrings(tree: ast.Module) -> Iterator[tuple[ast.AST, ast.Expr]]:
    """What is documented, with its docstring: modules, classes, functions, constants, fields."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            for owner, one in zip([node, *body], body):
                if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and \
                        isinstance(one.value.value, str):
                    yield owner, one


def names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of all classes, functions, arguments, variables and fields that a module defines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


@cache
def said_in(path: Path) -> list[Said]:
    """Everything that a person reads in a file; each name once."""
    source = path.read_text()
    tree = ast.parse(source)
    found, used = [], set()
    for owner, one in docstrings(tree):
        public = isinstance(owner, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and \
            not getattr(owner, "name", "").startswith("_")
        found.append(Said(one.lineno, "docstring", str(ast.literal_eval(one.value)), public))
        used.add(id(one.value))
    used |= {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.expr) and id(node) not in used:
            text = text_of(node)
            if text is not None and " " in text.strip():
                found.append(Said(node.lineno, "message", text))
    found += [Said(token.start[0], "comment", token.string.lstrip("# "))
              for token in tokenize.generate_tokens(io.StringIO(source).readline) if token.type == tokenize.COMMENT]
    first = {name: line for line, name in sorted(names(tree), reverse=True)}
    return sorted([*found, Said(1, "name", path.stem), *(Said(line, "name", name) for name, line in first.items())])


def length(sentence: str) -> int:
    """Number of words."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def complaints(path: str, one: Said) -> Iterator[str]:
    """What is wrong with one text of a file, and what to say instead."""
    here = f"{path}:{one.line}: {one.kind}"
    text = " ".join(one.text.split())
    if one.kind == "name":
        text = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", text)
    for where, phrase, _ in ALLOWED:
        if fnmatch(path, where):
            text = text.replace(phrase, "")
    for pattern, say in [*EVERYWHERE, *(ESTIMATOR_ONLY if path.startswith("estimator/") else [])]:
        for match in pattern.finditer(text):
            yield f"{here} {match.group()!r} (say: {say}) in {text[max(0, match.start() - 60):match.end() + 60]!r}"
    if one.kind == "message":
        for sentence in re.split(SENTENCES, one.text):
            if length(sentence) > LONGEST:
                yield f"{here} has a sentence of {length(sentence)} words: {sentence[:150]!r}"
    if one.kind == "docstring":
        first = re.split(r"(?<=[.:])(?:\s|$)", one.text.strip().split("\n\n")[0])[0]
        if one.sentence and not first.endswith((".", ":")):
            yield f"{here} has no first sentence: {first[:150]!r}"
        if one.sentence and CLAUSE.match(first):
            yield f"{here} does not begin with what comes back: {first[:150]!r}"
        if length(first) > LONGEST:
            yield f"{here} has a first sentence of {length(first)} words: {first[:150]!r}"


def problems_of(path: Path) -> list[str]:
    name = str(path.relative_to(ROOT))
    return [line for one in said_in(path) for line in complaints(name, one)]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_speaks_plainly(path: Path) -> None:
    found = problems_of(path)
    assert not found, "\n".join(found)


def test_messages_read_easily() -> None:
    assert lix([sentence for path in FILES for one in said_in(path) if one.kind == "message"
                for sentence in re.split(SENTENCES, one.text)]) < MOST_LIX


def test_programs_that_write_the_evidence_speak_plainly() -> None:
    """Their messages, which are the words of pages; models of MuJoCo are not."""
    programs = sorted((ROOT / "evidence").rglob("*.py"))
    found = [line for path in programs for one in said_in(path)
             if one.kind == "message" and not one.text.lstrip().startswith("<")
             for line in complaints(str(path.relative_to(ROOT)), one)]
    assert programs and not found, "\n".join(found)


def test_names_in_the_tests_of_the_packages_are_plain() -> None:
    found = [line for floor in FLOORS for path in sorted((ROOT / "tests" / floor).rglob("*.py"))
             for one in said_in(path) if one.kind == "name"
             for line in complaints(str(path.relative_to(ROOT / "tests")), one)]
    assert not found, "\n".join(found)


def test_every_allowed_phrase_is_still_there() -> None:
    """And each of them would be refused if it were not allowed."""
    for where, phrase, reason in ALLOWED:
        assert reason and any(phrase in " ".join(one.text.split()) for path in FILES
                              if fnmatch(str(path.relative_to(ROOT)), where) for one in said_in(path)), (where, phrase)
        assert any(pattern.search(phrase) for pattern, _ in [*EVERYWHERE, *ESTIMATOR_ONLY]), phrase


def test_faults_would_be_seen(tmp_path: Path) -> None:
    path = tmp_path / "kept_back.py"
    many = "word " * 31
    path.write_text(f'"""Of no end"""\nLOUD = f"what is {{1}} left over {{2}}"  # it strays\n'
                    f'def settle(doubts: int) -> str:\n    """Returns {many}."""\n    return "{many}"\n')
    found = [re.split(r" \(say|: ", line.split(": ", 1)[1])[0]
             for one in said_in(path) for line in complaints("estimator/x.py", one)]
    assert found == ["docstring has no first sentence", "docstring does not begin with what comes back",
                     "name 'kept_back'", "comment 'strays'", "message 'left over'",
                     "name 'LOUD'", "name 'doubts'", "name 'settle'", "docstring has a first sentence of 32 words",
                     "message has a sentence of 31 words"]
