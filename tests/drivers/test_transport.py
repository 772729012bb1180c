"""Which transport a port's name asks for."""

import sys
from types import ModuleType, SimpleNamespace

import pytest

from drivers import DeviceAbsent, transport
from drivers.serial_link import SerialLink
from drivers.transport import open_port


def test_a_path_is_a_serial_port(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "SerialLink", lambda port, baud: (SerialLink, port, baud))
    assert open_port("/dev/ttyACM0", 1_000_000) == (SerialLink, "/dev/ttyACM0", 1_000_000)


def test_a_name_before_the_slashes_is_a_file_of_this_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("drivers.radio_link")
    module.open_link = lambda address: f"to {address}"  # type: ignore[attr-defined]
    module.__spec__ = SimpleNamespace(name=module.__name__)  # type: ignore[assignment]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    assert open_port("radio://channel 4", 9600) == "to channel 4"


@pytest.mark.parametrize("port", ["radio://channel 4", "can://can0", "i2c://x"])
def test_what_no_file_opens_is_said_in_one_line(port: str) -> None:
    """can_link.py is there, and has no `open_link`: CAN has a table of its own."""
    with pytest.raises(DeviceAbsent) as caught:
        open_port(port, 9600)
    said = str(caught.value)
    assert said.startswith(f"{port}: no driver knows") and "serial port" in said and "\n" not in said
