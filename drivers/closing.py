"""`Closing` and `LinkHolder`: what closes at the end of a `with`, and the part of every drive that holds its link."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any, Self

from drivers.errors import LinkLost
from drivers.protocol import State, Telemetry


class Closing(ABC):
    """Closes at the end of a `with`."""

    @abstractmethod
    def close(self) -> None:
        """Let go of everything; may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class LinkHolder(Closing):
    """A drive at the end of a link."""

    _link: Any
    _closed = False
    telemetry: Telemetry | None

    @abstractmethod
    def stop(self) -> None:
        """Torque zero and disarm, in every state."""

    def close(self) -> None:
        """Stop the motor, then let go of the link; may be called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            with suppress(LinkLost):  # nothing hears a stop any more: the drive's watchdog has the motor
                self.stop()
        finally:
            self._link.close()

    @property
    def armed(self) -> bool:
        """The newest telemetry says ARMED."""
        return self.telemetry is not None and self.telemetry.state == State.ARMED

    @property
    def link_facts(self) -> dict[str, str | int | None]:
        """Facts about the link: its kind, port, latency timer; empty for an emulated one."""
        return dict(getattr(self._link, "facts", {}))
