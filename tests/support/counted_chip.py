"""An IMU chip on virtual time whose samples are numbered, so that every lost or doubled one shows."""

from collections.abc import Sequence

from drivers.mock import VirtualClock
from drivers.mock.lsm9ds1 import MockLsm9ds1


class CountedChip:
    """The k-th sample has k in its first word, and in all words where no `rest` is given."""

    def __init__(self, rest: Sequence[int] = (), bus_khz: float = 400.0) -> None:
        self.clock = VirtualClock()
        self.chip = MockLsm9ds1(self.clock, advance=self.advance, bus_khz=bus_khz)
        self.made, self.next_ns, self._rest = 0, 0.0, list(rest)

    def advance(self, t_ns: int) -> None:
        """Sample up to a time."""
        rate = self.chip.rate_hz
        if not rate:
            self.next_ns = 0.0
            return
        self.next_ns = self.next_ns or t_ns
        while self.next_ns <= t_ns:
            k = self.made % 30000
            self.chip.push([k, *self._rest] if self._rest else [k] * 6)
            self.made += 1
            self.next_ns += 1e9 / rate
