"""The house: imports go down its floors and rooms, past no face, in no circle, and no file is too long to read."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

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
    "estimator": [["errors", "fit_errors", "methods", "parallel", "use", "verdicts"], ["numerics"], ["model"],
                  ["options", "result"], ["signals"], ["effects"], ["likelihood"], ["score", "free_runs", "loops"],
                  ["fitting"], ["prediction"], ["diagnosis", "calibration", "change"]],
    "experiments": [["bounded_child", "console", "provenance"], ["models"], ["exchange", "simulators"],
                    ["rig", "excite", "emulation", "session"], ["judge"], ["documents"], ["reports"],
                    ["workflows", "doctor", "calibrate", "live"]],
    "legid": [["tables", "figures"],
              ["results", "listings", "run_lists", "changes", "diagnoses", "fits", "validations", "comparisons"],
              ["found_models", "given"],
              ["api", "tools"], ["cli"]],
    "studies": [["machine", "rk4_free_run"], ["walker"], ["biped3", "casebook"], ["casebook_page"],
                ["run_casebook", "run_monte_carlo"]],
}
"""The rooms of a floor from the ground up; those of one row may know each other as far as they make no circle."""
LEVELS = 10
"""Most storeys that the rooms of one floor may stand above each other."""
LINES, TOO_LONG = 400, 500
"""Beyond the first a file is due to be split by meaning, which `make lint` says; beyond the second it is refused."""
OF_DAQ = {"BoolArray", "Dataset", "FloatArray", "IndexArray", "Loop"}
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
            source = "." * node.level + (node.module or "")
            if node.level or source.split(".")[0] in FLOORS:
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


def storeys(graph: dict[str, set[str]]) -> dict[str, int] | str:
    """How high each stands above what it needs; where there is a circle, the circle."""
    height: dict[str, int] = {}

    def climb(name: str, path: tuple[str, ...]) -> None:
        if name in path:
            raise RecursionError(" -> ".join([*path[path.index(name):], name]))
        if name not in height:
            for below in graph[name]:
                climb(below, (*path, name))
            height[name] = 1 + max((height[below] for below in graph[name]), default=0)

    try:
        for name in graph:
            climb(name, ())
    except RecursionError as error:
        return str(error)
    return height


def past_faces(module: str) -> Iterator[str]:
    """Names that a module takes from inside another package, or that a face does not offer."""
    own = package_of(module)
    for source, name in imports(module):
        if source in PACKAGES:
            exported = face(source).keys() | {room for row in ROOMS.get(source, []) for room in row}
            if name and own != source and not own.startswith(f"{source}.") and name not in exported:
                yield f"{source} does not offer {name}"
            continue
        behind = package_of(source)
        beside = behind in FLOORS and not face(behind)  # a floor without a face: what stands next to its rooms
        if own != behind and not own.startswith(f"{behind}.") and not beside:
            yield f"{source} is inside {behind}: take {name} from {behind}"


def climbs(module: str) -> Iterator[str]:
    """Imports of a module from a floor above its own."""
    floor = module.split(".")[0]
    for source, name in imports(module):
        top = source.split(".")[0]
        allowed = top in FLOORS[floor] or (floor == "estimator" and source == "daq" and name in OF_DAQ)
        if not allowed:
            yield f"imports {source}.{name}"


def rooms_out_of_order(floor: str) -> Iterator[str]:
    """Rooms of a floor that ROOMS does not know, need one above them, or stand too high."""
    height = {f"{floor}.{room}": i for i, row in enumerate(ROOMS[floor]) for room in row}
    inside = [m for m in MODULES if m.split(".")[0] == floor and m != floor]
    different = {room_of(m) for m in inside} ^ set(height)
    if different:
        yield f"ROOMS and the folder differ: {', '.join(sorted(different))}"
        return
    rooms: dict[str, set[str]] = {}
    for module in inside:
        below = {room_of(m) for m in needs(module) if m.split(".")[0] == floor} - {floor, room_of(module)}
        rooms.setdefault(room_of(module), set()).update(below)
        for room in sorted(below):
            if height[room] > height[room_of(module)]:
                yield f"{module} -> {room}"
    high = storeys(rooms)
    if isinstance(high, str):
        yield f"a circle of rooms: {high}"
    elif max(high.values()) > LEVELS:
        yield f"{max(high.values())} storeys of rooms; {LEVELS} are allowed"


def borrowed(path: Path) -> Iterator[str]:
    """Names that a test takes from another test's module, or a study from more than tests/support."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tests."):
            names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
            if any(part.startswith("test_") for name in names for part in name.split(".")):
                yield f"takes {names[-1]} from another test; put it into tests/support"
            elif path.is_relative_to(ROOT / "evidence") and not (node.module or "").startswith("tests.support"):
                yield f"takes {names[-1]} from tests; a study takes only what is in tests/support"


def problems() -> Iterator[str]:
    """Every line that `make lint` prints about the layout; those that begin with `warning` refuse nothing."""
    for module in sorted(MODULES):
        yield from (f"{MODULES[module].relative_to(ROOT)}: {said}" for said in (*climbs(module), *past_faces(module)))
    for floor in ROOMS:
        yield from (f"{floor}: {said}" for said in rooms_out_of_order(floor))
    circle = storeys({module: set(needs(module)) & MODULES.keys() for module in MODULES})
    if isinstance(circle, str):
        yield f"a circle of modules: {circle}"
    for path in [*FILES, *BESIDE]:
        lines = len(path.read_text().splitlines())
        if lines > LINES:
            kind = "" if lines > TOO_LONG else "warning: "
            yield f"{kind}{path.relative_to(ROOT)}: {lines} lines; split it by meaning"
    for path in BESIDE:
        yield from (f"{path.relative_to(ROOT)}: {said}" for said in borrowed(path))
