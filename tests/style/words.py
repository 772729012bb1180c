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

from tests.style.vocabulary import IN_ESTIMATOR, WORDS, compiled, lix
from tests.support.paths import ROOT

FLOORS = ("drivers", "daq", "estimator", "experiments", "legid", "studies")
LONGEST = 30
"""Most words of a sentence in a message, and of a docstring's first sentence."""
SENTENCES = r"(?<=[.:;!?])\s+|\n\s*\n|\n\s*[-*|]"
"""Between the sentences of a message."""
MOST_LIX = 24.0
"""Of all messages together."""
CLAUSE = re.compile(r"(What|Who|Whoever|Whose|Which|Where|How|That|Of|By|With|From|As(?! many)|So|Nothing|Beyond)\b")
"""First word of a clause that does not say what comes back."""
ALLOWED = [
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


def text_of(node: ast.AST, value: str = "X") -> str | None:
    """Text of a string or f-string, with `value` for each of its values; None of any other node."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(v.value) if isinstance(v, ast.Constant) else value for v in node.values)
    return None


def docstrings(nodes: list[ast.AST]) -> Iterator[tuple[ast.AST, ast.Expr]]:
    """What is documented, with its docstring: modules, classes, functions, constants, fields."""
    for node in nodes:
        body = getattr(node, "body", None)
        if isinstance(body, list):
            for owner, one in zip([node, *body], body):
                if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and \
                        isinstance(one.value.value, str):
                    yield owner, one


def names(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    """Line and name of all classes, functions, arguments, variables and fields among the nodes of a module."""
    for node in nodes:
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.arg(
                    arg=name) | ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name


@cache
def said_in(path: Path) -> list[Said]:
    """Everything that a person reads in a file; each name once."""
    source = path.read_text()
    nodes = list(ast.walk(ast.parse(source)))
    found, used = [], set()
    for owner, one in docstrings(nodes):
        public = isinstance(owner, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and \
            not getattr(owner, "name", "").startswith("_")
        found.append(Said(one.lineno, "docstring", str(ast.literal_eval(one.value)), public))
        used.add(id(one.value))
    used |= {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in nodes:
        if isinstance(node, ast.expr) and id(node) not in used:
            text = text_of(node)
            if text is not None and " " in text.strip():
                found.append(Said(node.lineno, "message", text))
    found += [Said(token.start[0], "comment", token.string.lstrip("# "))
              for token in tokenize.generate_tokens(io.StringIO(source).readline) if token.type == tokenize.COMMENT]
    first = {name: line for line, name in sorted(names(nodes), reverse=True)}
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


def unused_phrases() -> Iterator[str]:
    """Phrases that ALLOWED has although no file has them, or although nothing refuses them."""
    for where, phrase, _ in ALLOWED:
        if not any(phrase in " ".join(one.text.split()) for path in FILES
                   if fnmatch(str(path.relative_to(ROOT)), where) for one in said_in(path)):
            yield f"{where} has no {phrase!r}: take it from ALLOWED"
        if not any(pattern.search(phrase) for pattern, _ in [*EVERYWHERE, *ESTIMATOR_ONLY]):
            yield f"nothing refuses {phrase!r}: take it from ALLOWED"


def problems() -> Iterator[str]:
    """Every line that `make lint` prints about words."""
    for path in FILES:
        yield from (line for one in said_in(path) for line in complaints(str(path.relative_to(ROOT)), one))
    hard = lix([sentence for path in FILES for one in said_in(path) if one.kind == "message"
                for sentence in re.split(SENTENCES, one.text)])
    if hard >= MOST_LIX:
        yield f"messages: LIX {hard:.1f}; at most {MOST_LIX:g} are allowed"
    for path in sorted((ROOT / "evidence").rglob("*.py")):  # messages are words of pages; models of MuJoCo are not
        yield from (line for one in said_in(path) if one.kind == "message" and not one.text.lstrip().startswith("<")
                    for line in complaints(str(path.relative_to(ROOT)), one))
    for floor in FLOORS:
        for path in sorted((ROOT / "tests" / floor).rglob("*.py")):
            yield from (line for one in said_in(path) if one.kind == "name"
                        for line in complaints(str(path.relative_to(ROOT / "tests")), one))
    yield from unused_phrases()
