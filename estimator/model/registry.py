"""`builders`: every mechanism that can be named; one of one's own is a file beside this one, and no list to mend."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from inspect import signature
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from estimator.model.mechanism import Mechanism, biped3, chain, joint1, leg2

Builder = Callable[..., Mechanism]
BUILDERS: dict[str, Builder] = {"leg2": leg2, "biped3": biped3, "joint1": joint1, "chain": chain}


@cache
def builders() -> dict[str, Builder]:
    """Name to the function that makes the mechanism: ours, and those of further modules here that have a function of
    the module's own name that returns a `Mechanism`. All but `chain` can be called without arguments."""
    package, found = __name__.rpartition(".")[0], dict(BUILDERS)
    for info in iter_modules([str(Path(__file__).parent)]):
        build: Any = getattr(import_module(f"{package}.{info.name}"), info.name, None)
        if getattr(build, "__annotations__", {}).get("return") in (Mechanism, Mechanism.__name__):
            found[info.name] = build
    return found


def settings_of(name: str) -> frozenset[str]:
    """What the mechanism of this name can be told: keywords of its function. Raises KeyError where there is none."""
    return frozenset(signature(builders()[name]).parameters)


def joint_counts() -> dict[str, int]:
    """Name to number of joints of the mechanisms that are not ours: what a rig file may name beside those."""
    return {name: build().n for name, build in builders().items() if name not in BUILDERS}
