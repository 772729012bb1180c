"""A chip and a CAN node belong to one program at a time, and are free again when that has gone."""

import fcntl
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers import ImuConfig, Lsm9ds1, i2c_bus, open_bus
from drivers.can_link import CanLink
from drivers.errors import DeviceBusy
from drivers.mock import I2cServer, MockRig
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK
from tests.support.still_plant import StillPlant

pytestmark = REAL_CLOCK

HOLDER = """
import sys
from drivers.can_link import CanLink
from drivers.i2c_bus import claim, open_bus
bus = open_bus(sys.argv[1])
claim(bus, 0x6B)
link = CanLink(5, interface="virtual", channel=sys.argv[2])
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_program_is_refused_chip_and_node_until_the_first_is_killed(tmp_path: Path) -> None:
    channel = tmp_path.name
    with I2cServer(MockRig(StillPlant()).imu, tmp_path / "i2c") as server:
        child = subprocess.Popen([sys.executable, "-c", HOLDER, server.path, channel], stdin=subprocess.PIPE,
                                 stdout=subprocess.PIPE, text=True, cwd=ROOT)
        assert child.stdout.readline() == "held\n"
        imu = Lsm9ds1(open_bus(server.path), config=ImuConfig(238.0))
        with pytest.raises(DeviceBusy, match="another program reads the chip"):
            imu.open()
        with pytest.raises(DeviceBusy, match="another program drives node 5"):
            CanLink(5, interface="virtual", channel=channel)
        CanLink(6, interface="virtual", channel=channel).close()
        child.kill()
        child.wait()
        imu.open()
        imu.close()
        for _ in range(2):
            CanLink(5, interface="virtual", channel=channel).close()


def test_on_a_device_node_each_address_is_locked_for_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, "ioctl", lambda *_: 0)
    first, second = (cast(Any, SimpleNamespace(fd=os.open(tmp_path / "i2c-1", os.O_RDWR | os.O_CREAT)))
                     for _ in range(2))
    i2c_bus.claim(first, 0x6B)
    i2c_bus.claim(first, 0x6B)  # its own
    i2c_bus.claim(second, 0x6A)
    with pytest.raises(OSError) as caught:
        i2c_bus.claim(second, 0x6B)
    assert isinstance(i2c_bus.explain(caught.value, "LSM9DS1"), DeviceBusy)
    os.close(first.fd)
    i2c_bus.claim(second, 0x6B)
    os.close(second.fd)
