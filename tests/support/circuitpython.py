"""CircuitPython's I2C bus over an emulated one, for drivers of other people that speak to it."""

from typing import Any

from smbus2 import i2c_msg


class Busio:
    """`busio.I2C` as those drivers use it."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus

    def try_lock(self) -> bool:
        return True

    def unlock(self) -> None:
        return None

    def writeto(self, address: int, buffer: Any, start: int = 0, end: int | None = None, stop: bool = True) -> None:
        self._bus.i2c_rdwr(i2c_msg.write(address, bytes(buffer)[start:end]))

    def readfrom_into(self, address: int, buffer: Any, start: int = 0, end: int | None = None) -> None:
        self._read(address, memoryview(buffer)[start:end])

    def writeto_then_readfrom(self, address: int, out: Any, into: Any, out_start: int = 0, out_end: int | None = None,
                              in_start: int = 0, in_end: int | None = None, stop: bool = False) -> None:
        self._read(address, memoryview(into)[in_start:in_end], i2c_msg.write(address, bytes(out)[out_start:out_end]))

    def _read(self, address: int, into: memoryview, *before: Any) -> None:
        reply = i2c_msg.read(address, len(into))
        self._bus.i2c_rdwr(*before, reply)
        into[:] = bytes(reply)
