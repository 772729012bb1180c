"""Calls of a method, looked at or broken into as they are made."""

from collections.abc import Callable
from typing import Any


def before(owner: Any, name: str, act: Callable[..., object]) -> None:
    """From now on `act` is called first, with what the method is called with."""
    method = getattr(owner, name)

    def call(*given: Any) -> Any:
        act(*given)
        return method(*given)

    setattr(owner, name, call)


def recorded(owner: Any, name: str) -> list[tuple[Any, ...]]:
    """What the method is called with from now on, call by call."""
    calls: list[tuple[Any, ...]] = []
    before(owner, name, lambda *given: calls.append(given))
    return calls
