"""Whether this computer was too busy to listen: what then looks like silence of a device is none.

Linux counts for each thread how long it was ready to run and waited for a processor (`schedstat`, second number,
nanoseconds). A device that is unplugged makes nobody wait; other programs do. Short waits are usual and harmless; what
counts is one turn of the recorder's loop that took long because of them.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from pathlib import Path

OWN = Path("/proc/thread-self/schedstat")
WINDOW_S = 1.0
LOOK_S = 0.1
LONG_TURN_S = 0.02
BUSY_S = 0.05
"""Half of the usual limit of a device's age: a turn as long as this may itself explain a device's silence."""


class HostLoad:
    """Looked at by the thread that serves the devices; knows nothing where the system does not tell."""

    def __init__(self, now_ns: int, source: Path = OWN) -> None:
        self._source, self._turned_ns = source, now_ns
        self._waited_ns, self._read_ns = 0, now_ns
        self._stalls: deque[tuple[int, float]] = deque(maxlen=32)
        self._read(now_ns)

    def look(self, now_ns: int) -> None:
        """Note one turn of the loop; the system's count is read now and then, and after every long turn."""
        turn_s, self._turned_ns = (now_ns - self._turned_ns) * 1e-9, now_ns
        if turn_s > LONG_TURN_S:
            self._stalls.append((now_ns, min(turn_s, self._read(now_ns))))
        elif now_ns - self._read_ns > LOOK_S * 1e9:
            self._read(now_ns)

    def stalled_s(self, now_ns: int) -> float:
        """The longest turn of the last second that was spent waiting for a processor [s]."""
        self.look(now_ns)
        return max((s for when_ns, s in self._stalls if now_ns - when_ns <= WINDOW_S * 1e9), default=0.0)

    def _read(self, now_ns: int) -> float:
        """Seconds waited since the last reading."""
        with suppress(OSError, ValueError, IndexError):
            before, self._waited_ns = self._waited_ns, int(self._source.read_text().split()[1])
            self._read_ns = now_ns
            return (self._waited_ns - before) * 1e-9
        return 0.0


def busy_words(stalled_s: float) -> str:
    """Sentence on the computer's load; empty where it was not too busy."""
    if stalled_s < BUSY_S:
        return ""
    return (f"the computer was too busy: the recorder waited {stalled_s:.2f} s for a processor, so the device need not "
            "be at fault; close other programs, or allow real-time priority")
