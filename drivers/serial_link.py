"""A serial port as a byte link: the controller's transport. pyserial below, nothing of the protocol in here."""

from __future__ import annotations

import errno
from pathlib import Path

import serial

from drivers.errors import DeviceAbsent, DeviceBusy, LinkLost

_OPEN_ERRORS: dict[int, tuple[type[DeviceAbsent] | type[DeviceBusy], str]] = {
    errno.ENOENT: (DeviceAbsent, "no such port; plug the controller in, or correct [devices.controller] port"),
    errno.ENODEV: (DeviceAbsent, "the port's device is gone; plug the controller in again"),
    errno.ENXIO: (DeviceAbsent, "the port's device is gone; plug the controller in again"),
    errno.EACCES: (DeviceAbsent, "permission denied; add the user to the port's group (often dialout)"),
    errno.EBUSY: (DeviceBusy, "another program holds the port; close it"),
    errno.EAGAIN: (DeviceBusy, "another program holds the port; close it"),
}


class SerialLink:
    """A serial port, opened exclusively and in low-latency mode where the driver has one.

    Raises `DeviceAbsent` or `DeviceBusy` when it cannot be opened, `LinkLost` when it goes away later.
    """

    def __init__(self, port: str, baud: int = 1_000_000) -> None:
        self.port = port
        try:
            self._serial = serial.Serial(port, baud, timeout=0.02, write_timeout=0.5, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            number = getattr(error, "errno", None) or 0
            kind, why = _OPEN_ERRORS.get(number, (DeviceAbsent, f"cannot be opened as a serial port ({error})"))
            raise kind(f"leg controller on {port}: {why}") from error
        self.low_latency = self._ask_low_latency()
        self._serial.reset_input_buffer()  # bytes from before this run carry no usable arrival time

    def _ask_low_latency(self) -> bool:
        """An FTDI's 16 ms timer becomes 1 ms. Ports without the setting (PTY, USB-ACM) refuse: no harm."""
        try:
            self._serial.set_low_latency_mode(True)
        except (ValueError, OSError, AttributeError):
            return False
        return True

    @property
    def latency_timer_ms(self) -> int | None:
        """The adapter's latency timer as the kernel has it [ms]; None where the port has none."""
        path = Path("/sys/class/tty") / Path(self.port).resolve().name / "device" / "latency_timer"
        try:
            return int(path.read_text())
        except (OSError, ValueError):
            return None

    @property
    def facts(self) -> dict[str, str | int | None]:
        """Facts about the connection, for a run file."""
        return {"kind": "serial", "port": self.port, "latency_timer_ms": self.latency_timer_ms}

    def read(self) -> bytes:
        """Whatever arrived; blocks up to the timeout and returns b"" then. Raises `LinkLost`."""
        try:
            return bytes(self._serial.read(max(1, self._serial.in_waiting)))
        except (serial.SerialException, OSError, TypeError) as error:  # TypeError: closed by another thread
            raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        """Hand over all of `data`. Raises `LinkLost`, also when the port stops taking bytes."""
        try:
            self._serial.write(data)
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> LinkLost:
        return LinkLost(f"leg controller on {self.port}: the connection is gone ({error}); "
                        "check cable and power, then start again")

    def close(self) -> None:
        """Close the port; may be called twice."""
        self._serial.close()
