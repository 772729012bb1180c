"""The line between a program and the example board, frame by frame: what passes can be seen, changed, held up, cut."""

import os
import select
import time
import tty
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from drivers import Message
from drivers.protocol import DELIMITER, Decoder

Change = Callable[[bytes], bytes]
TURN_S = 0.002


def as_it_is(frame: bytes) -> bytes:
    """What an undisturbed line does."""
    return frame


def lost(frame: bytes) -> bytes:
    """What a cut line does."""
    return b""


class Way:
    """One direction: whole frames come in, are seen, changed, held up and handed on."""

    def __init__(self, see: Callable[[Message, bytes], None], onto: Callable[[], int | None]) -> None:
        self.change: Change = as_it_is
        self.late_s = 0.0
        self._see, self._onto = see, onto
        self._decoder, self._rest = Decoder(), b""
        self._decoder.feed(DELIMITER)
        self._waiting: deque[tuple[float, bytes]] = deque()

    def take(self, chunk: bytes) -> None:
        """Bytes from the sender; what follows the last delimiter waits for its own."""
        *frames, self._rest = (self._rest + chunk).split(DELIMITER)
        for frame in frames:
            for message in self._decoder.feed(frame + DELIMITER):
                self._see(message, frame + DELIMITER)
            self.put(self.change(frame + DELIMITER))

    def put(self, data: bytes) -> None:
        """Bytes for the receiver, behind what is on the way already."""
        if data:
            self._waiting.append((time.monotonic() + self.late_s, data))
            self.hand_on()

    def hand_on(self) -> None:
        """What is due; a receiver that is gone or does not read loses it."""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, data = self._waiting.popleft()
            descriptor = self._onto()
            if descriptor is not None:
                with suppress(OSError):
                    os.write(descriptor, data)


class Line:
    """A port for the program (`path`), the board's own at the other end; `turn` keeps it alive, without a thread."""

    def __init__(self, board_path: str, see_up: Callable[[Message, bytes], None],
                 see_down: Callable[[Message, bytes], None]) -> None:
        self._board = os.open(board_path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._board)
        host, port = os.openpty()
        tty.setraw(port)
        os.set_blocking(host, False)
        self.path = os.ttyname(port)
        self._host: int | None = host
        self._port: int | None = port
        """Held open until the program has it: a port that nobody has open says that it hung up."""
        self.up = Way(see_up, lambda: self._host)
        self.down = Way(see_down, lambda: self._board)

    @property
    def descriptors(self) -> list[int]:
        """What a forked program must not have: its port could not hang up."""
        return [one for one in (self._board, self._host, self._port) if one is not None]

    def turn(self) -> None:
        """Pass on what has come, waiting for it a moment."""
        ready, _, _ = select.select([one for one in (self._board, self._host) if one is not None], [], [], TURN_S)
        for descriptor in ready:
            try:
                chunk = os.read(descriptor, 4096)
            except OSError:  # nobody has the other end open
                time.sleep(TURN_S)
                continue
            (self.up if descriptor == self._board else self.down).take(chunk)
        self.up.hand_on()
        self.down.hand_on()

    def pull(self) -> None:
        """The cable out of the program's computer: its port is gone."""
        for descriptor in (self._host, self._port):
            if descriptor is not None:
                os.close(descriptor)
        self._host = self._port = None

    def close(self) -> None:
        """Both ends."""
        self.pull()
        os.close(self._board)
