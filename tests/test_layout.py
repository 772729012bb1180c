"""The house: imports go down its floors and rooms, past no face, in no circle, and no room is too long to read."""

import ast
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support.paths import ROOT

FLOORS = {"drivers": {"drivers"}, "daq": {"drivers", "daq"}, "estimator": {"estimator"},  # and OF_DAQ
          "experiments": {"drivers", "daq", "estimator", "experiments"},
          "legid": {"drivers", "daq", "estimator", "experiments", "legid"},
          "studies": {"drivers", "daq", "estimator", "experiments", "studies"}}
"""Floor to the floors that it may import."""
ROOMS = {
    "daq": [["errors", "files", "findings", "dataset", "imu_mount", "loop", "mechanisms", "rig", "rig_columns",
             "rig_devices", "rig_imu", "rig_limits", "rig_sampling", "rig_text", "rig_types", "servo", "si_units"],
            ["runs"], ["looks"], ["timing"], ["recording"], ["calibration"]],
    "estimator": [["errors", "methods", "parallel", "verdicts"], ["numerics"], ["model"], ["options", "result"],
                  ["signals"], ["effects"], ["likelihood"], ["score", "free_runs", "loops"], ["fitting"],
                  ["prediction"], ["diagnosis", "calibration", "change"]],
    "experiments": [["bounded_child", "console", "provenance"], ["models"], ["exchange", "simulators"],
                    ["rig", "excite", "emulation", "session"], ["judge"], ["documents"], ["reports"],
                    ["workflows", "doctor", "calibrate", "live"], ["cli"]],
    "legid": [["tables", "figures"],
              ["results", "listings", "run_lists", "changes", "diagnoses", "fits", "validations", "comparisons"],
              ["found_models", "given"],
              ["api", "tools"]],
    "studies": [["machine", "rk4_free_run"], ["walker"], ["biped3", "casebook"], ["casebook_page"],
                ["run_casebook", "run_monte_carlo"]],
}
"""The rooms of a floor from the ground up; those of one row may know each other as far as they make no circle."""
LEVELS = 10
"""Most storeys that the rooms of one floor may stand above each other."""
LINES, TOO_LONG = 400, 500
"""Beyond the first a file is due to be split by meaning, which the test warns of; beyond the second it is refused."""
CLI = "experiments.cli"
"""The commands stand above `legid`, whose verbs they call."""
OF_DAQ = {"Dataset", "FloatArray", "Loop"}
"""What the estimator knows of daq."""
FILES = sorted(p for floor in FLOORS for p in (ROOT / floor).rglob("*.py"))
BESIDE = sorted(p for folder in ("tests", "evidence") for p in (ROOT / folder).rglob("*.py"))


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in FILES}
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


@cache
def imports(module: str) -> frozenset[tuple[str, str]]:
    """(module, name) of everything imported from this house; a submodule by its own name, and no name."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names if alias.name.split(".")[0] in FLOORS}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            source = node.module or ""
            if source.split(".")[0] in FLOORS:
                found |= {(source, alias.name) for alias in node.names}
    return frozenset(found)


def package_of(module: str) -> str:
    return module if module in PACKAGES else module.rpartition(".")[0]


@cache
def face(package: str) -> dict[str, str]:
    """Name that a package exports -> where its face has it from."""
    stub = MODULES[package].with_suffix(".pyi")
    out = {}
    for node in ast.walk(ast.parse((stub if stub.is_file() else MODULES[package]).read_text())):
        if isinstance(node, ast.ImportFrom):
            source = node.module or ""
            source = ".".join(filter(None, [package, source])) if node.level else source
            for alias in node.names:
                own = f"{source}.{alias.name}"
                out[alias.asname or alias.name] = own if own in MODULES else source
    return out


def defined_in(source: str, name: str) -> str:
    """The module behind a name, looked up through faces."""
    behind = face(source).get(name) if source in PACKAGES else None
    if behind is not None:
        return defined_in(behind, name) if behind in PACKAGES else behind
    return f"{source}.{name}" if f"{source}.{name}" in MODULES else source


@cache
def needs(module: str) -> frozenset[str]:
    """The modules that this one takes names from; a face, that hands names on, is not among them."""
    if module in PACKAGES:
        return frozenset()
    return frozenset(defined_in(source, name) for source, name in imports(module)) - {module}


def room_of(module: str) -> str:
    """The part of a floor that a module belongs to: its room, or itself where it stands beside the rooms."""
    return ".".join(module.split(".")[:2])


def storeys(graph: dict[str, set[str]]) -> dict[str, int]:
    """How high each stands above what it needs. Raises AssertionError naming a circle."""
    height: dict[str, int] = {}

    def climb(name: str, path: tuple[str, ...]) -> int:
        assert name not in path, f"a circle: {' -> '.join([*path[path.index(name):], name])}"
        if name not in height:
            height[name] = 1 + max((climb(below, (*path, name)) for below in graph[name]), default=0)
        return height[name]

    for name in graph:
        climb(name, ())
    return height


def past_faces(module: str) -> Iterator[str]:
    own = package_of(module)
    for source, name in imports(module):
        if source in PACKAGES:
            exported = face(source)
            if name and own != source and not own.startswith(f"{source}.") and name not in exported:
                yield f"{source} does not offer {name}"
            continue
        behind = package_of(source)
        beside = behind in FLOORS and not face(behind)  # a floor without a face: what stands beside its rooms
        if own != behind and not own.startswith(f"{behind}.") and not beside:
            yield f"{source} is inside {behind}: take {name} from {behind}"


@pytest.mark.parametrize("module", sorted(MODULES))
def test_imports_go_down_the_floors_and_past_no_face(module: str) -> None:
    floor = module.split(".")[0]
    for source, name in imports(module):
        top = source.split(".")[0]
        allowed = top in FLOORS[floor] or (floor == "estimator" and source == "daq" and name in OF_DAQ)
        allowed |= top == "legid" and module.startswith(f"{CLI}.")
        assert not (floor == "legid" and source.startswith(CLI)), f"{module} imports {source}"
        assert allowed, f"{module} imports {source}.{name}"
    assert not list(past_faces(module)), module


@pytest.mark.parametrize("floor", sorted(ROOMS))
def test_rooms_stand_in_their_order(floor: str) -> None:
    height = {f"{floor}.{room}": i for i, row in enumerate(ROOMS[floor]) for room in row}
    inside = [m for m in MODULES if m.split(".")[0] == floor and m != floor]
    assert {room_of(m) for m in inside} == set(height), "ROOMS and the folder differ"
    for module in inside:
        for below in needs(module):
            if below.split(".")[0] == floor:
                assert height[room_of(below)] <= height[room_of(module)], f"{module} -> {below}"


@pytest.mark.parametrize("floor", sorted(ROOMS))
def test_rooms_make_no_circle_and_few_storeys(floor: str) -> None:
    rooms: dict[str, set[str]] = {}
    for module in MODULES:
        if module.split(".")[0] == floor and module != floor:
            own = room_of(module)
            rooms.setdefault(own, set()).update(
                room_of(m) for m in needs(module) if m.split(".")[0] == floor and room_of(m) != own)
    assert max(storeys(rooms).values()) <= LEVELS


def test_no_circle_of_modules() -> None:
    storeys({module: set(needs(module)) & MODULES.keys() for module in MODULES})


@pytest.mark.parametrize("path", [*FILES, *BESIDE], ids=lambda p: str(p.relative_to(ROOT)))
def test_no_file_is_too_long(path: Path) -> None:
    lines = len(path.read_text().splitlines())
    assert lines <= TOO_LONG
    if lines > LINES:
        warnings.warn(f"{path.relative_to(ROOT)} has {lines} lines: split it by meaning", stacklevel=1)


def test_every_floor_was_read() -> None:
    assert {p.relative_to(ROOT).parts[0] for p in FILES} == set(FLOORS)


def test_a_circle_and_a_look_past_a_face_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AssertionError, match="a circle: a -> b -> a"):
        storeys({"a": {"b"}, "b": {"a"}})
    monkeypatch.setitem(globals(), "imports", lambda module: {("estimator.fitting.mle", "fit_mle")})
    assert list(past_faces("legid.api")) == [
        "estimator.fitting.mle is inside estimator.fitting: take fit_mle from estimator.fitting"]
    assert not list(past_faces("estimator.fitting.fit"))


def test_tests_take_nothing_from_each_other_but_by_support() -> None:
    """And from what they test: the packages and the programs that measure, which take from tests only the support."""
    for path in BESIDE:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tests."):
                assert path.is_relative_to(ROOT / "tests") or (node.module or "").startswith("tests.support"), path
                names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
                assert not any(part.startswith("test_") for name in names for part in name.split(".")), path
