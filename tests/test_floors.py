"""Imports go down the floors of the house, never up."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FLOORS = ["drivers", "daq", "estimator", "experiments"]
ALLOWED = {
    "drivers": {"drivers"},
    "daq": {"drivers", "daq"},
    "estimator": {"estimator"},  # and daq.dataset
    "experiments": set(FLOORS),
}
FILES = sorted(p for floor in FLOORS for p in (ROOT / floor).rglob("*.py"))


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down(path: Path) -> None:
    floor = path.relative_to(ROOT).parts[0]
    for module in imports(path):
        top = module.split(".")[0]
        if top in FLOORS and top not in ALLOWED[floor]:
            assert floor == "estimator" and module == "daq.dataset", f"{path} imports {module}"


def test_every_floor_was_read() -> None:
    assert {p.relative_to(ROOT).parts[0] for p in FILES} == set(FLOORS)
