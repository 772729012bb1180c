"""`builders`: every mechanism that can be named; a new mechanism is a file in this folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from inspect import Parameter, isfunction, signature
from pathlib import Path
from pkgutil import iter_modules

from estimator.model.mechanism import Mechanism

Builder = Callable[..., Mechanism]


@cache
def builders() -> dict[str, Builder]:
    """Name -> the function of that name in a module of this folder that returns a `Mechanism`."""
    package = __name__.rpartition(".")[0]
    modules = [import_module(f"{package}.{info.name}") for info in iter_modules([str(Path(__file__).parent)])]
    return {name: function for module in modules for name, function in vars(module).items()
            if isfunction(function) and function.__module__ == module.__name__ and not name.startswith("_")
            and function.__annotations__.get("return") in (Mechanism, Mechanism.__name__)}


def settings_of(name: str) -> frozenset[str]:
    """Keywords of the function of the mechanism of this name. Raises KeyError where there is none."""
    return frozenset(signature(builders()[name]).parameters)


def joint_counts() -> dict[str, int]:
    """Name -> number of joints of every mechanism whose number is fixed; a chain's is its number of links."""
    return {name: build().n for name, build in builders().items()
            if all(p.default is not Parameter.empty for p in signature(build).parameters.values())}
