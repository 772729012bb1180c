"""An emulated chip's bus on a unix socket, in real time: `SocketBus` opens it from another process."""

from __future__ import annotations

import errno
import socket
import threading
from contextlib import suppress
from pathlib import Path

from smbus2 import i2c_msg

from drivers.closing import Closing
from drivers.i2c_bus import I2CBus
from drivers.i2c_socket import PACKET_BYTES, REPLY, unpack


class I2cServer(Closing):
    """Serves a bus at `path`, each client from a thread of its own, until `close`, which is how one unplugs it."""

    def __init__(self, bus: I2CBus, path: Path | str) -> None:
        self.path = str(path)
        self._bus = bus
        self._clients: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._closed = False
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(self.path)
        self._listener.listen()
        threading.Thread(target=self._accept, name="i2c-server", daemon=True).start()

    def close(self) -> None:
        """Unplug: every transfer under way or to come fails. May be called twice."""
        with self._lock:
            self._closed = True
            open_ones = [self._listener, *self._clients]
            self._clients.clear()
        for one in open_ones:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        Path(self.path).unlink(missing_ok=True)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with self._lock:
                if self._closed:
                    client.close()
                    return
                self._clients.add(client)
            threading.Thread(target=self._serve, args=(client,), name="i2c-client", daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with suppress(OSError):  # the client has left, or we were unplugged
            while request := client.recv(PACKET_BYTES):
                client.send(self._answer(request))
        with self._lock:
            self._clients.discard(client)
        client.close()

    def _answer(self, request: bytes) -> bytes:
        try:
            messages = [i2c_msg.read(address, length) if read else i2c_msg.write(address, data)
                        for address, read, length, data in unpack(request)]
            self._bus.i2c_rdwr(*messages)
        except ValueError:
            return REPLY.pack(errno.EINVAL)
        except OSError as error:
            return REPLY.pack(error.errno or errno.EIO)
        return REPLY.pack(0) + b"".join(bytes(message) for message in messages if message.flags & 1)
