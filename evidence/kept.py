"""`kept`: a study that was stopped goes on where it stopped.

Each piece's result is a file below build/evidence/, named by the piece's function, its arguments and the program's
source: after a change of the program every piece is measured anew. `make clean` removes them.
"""

import hashlib
import os
import pickle
from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from tests.support.paths import ROOT

FOLDER = ROOT / "build/evidence"
SOURCES = ("drivers", "daq", "estimator", "experiments", "legid", "studies", "evidence", "tests/support")
P = ParamSpec("P")
R = TypeVar("R")
found_again: list[str] = []
"""Files of an earlier call from which this process took results."""


@cache
def source_hash() -> bytes:
    """Of all code that a measurement may run, and of the versions of its packages."""
    digest = hashlib.sha256((ROOT / "requirements.lock").read_bytes())
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.digest()


def kept(piece: Callable[P, R]) -> Callable[P, R]:
    """`piece` of a study, whose result is kept on disk; what it raises is not. Arguments and result must pickle."""

    @wraps(piece)
    def again(*args: P.args, **kwargs: P.kwargs) -> R:
        name = f"{piece.__module__}.{piece.__qualname__}"
        key = hashlib.sha256(source_hash() + name.encode() + pickle.dumps((args, kwargs))).hexdigest()[:32]
        path = FOLDER / name / f"{key}.pickle"
        if path.exists():
            found: R = pickle.loads(path.read_bytes())
            found_again.append(key)
            return found
        found = piece(*args, **kwargs)
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = path.with_name(f"{key}.{os.getpid()}.part")
        whole.write_bytes(pickle.dumps(found))
        whole.replace(path)
        return found

    return again
