"""A bus behind a socket whose far end is late: an old answer never passes for a new one's."""

import errno
import socket
import threading
from pathlib import Path

import pytest
from smbus2 import i2c_msg

from drivers import i2c_socket
from drivers.i2c_socket import REPLY, SocketBus
from tests.support.processes import REAL_CLOCK

pytestmark = REAL_CLOCK

LATE, TRUE = 0x11, 0x22


def serve(listener: socket.socket, given_up: threading.Event, sent: threading.Event) -> None:
    """Answers the first client's first request when it has been given up, and every other with the truth."""
    first, _ = listener.accept()
    first.recv(65536)
    given_up.wait()
    first.send(REPLY.pack(0) + bytes([LATE]))
    sent.set()
    second, _ = listener.accept()
    second.recv(65536)
    second.send(REPLY.pack(0) + bytes([TRUE]))
    second.recv(65536)
    second.send(REPLY.pack(0))  # a byte short


def test_an_answer_that_was_given_up_is_not_the_next_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(i2c_socket, "TIMEOUT_S", 0.2)
    given_up, sent = threading.Event(), threading.Event()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(tmp_path / "i2c"))
        listener.listen()
        far = threading.Thread(target=serve, args=(listener, given_up, sent), daemon=True)
        far.start()
        bus, message = SocketBus(str(tmp_path / "i2c")), i2c_msg.read(0x6B, 1)
        with pytest.raises(OSError) as late:
            bus.i2c_rdwr(message)
        assert late.value.errno == errno.ETIMEDOUT
        given_up.set()
        sent.wait()
        monkeypatch.setattr(i2c_socket, "TIMEOUT_S", 10.0)
        bus.i2c_rdwr(message)
        assert bytes(message) == bytes([TRUE])
        with pytest.raises(OSError) as short:
            bus.i2c_rdwr(message)
        assert short.value.errno == errno.EIO
        bus.close()
        far.join(10.0)
