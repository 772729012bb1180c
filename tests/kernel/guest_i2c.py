"""In the guest: the IMU's driver on real /dev/i2c-N nodes. Collected by tests/kernel/uml.py only."""

import errno
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from smbus2 import SMBus, i2c_msg

from drivers import DeviceAbsent, DriverError, ImuConfig, Lsm9ds1, claim, explain, open_bus
from drivers.errors import DeviceBusy
from tests.kernel.cuse_bus import CuseBus
from tests.kernel.wires_bus import DEVICE, WiresBus
from tests.support.counted_chip import CountedChip
from tests.support.leg_on_a_link import settle
from tests.support.spies import before

ADDRESS = 0x6B


def stub_path() -> str:
    names = Path("/sys/bus/i2c/devices").glob("i2c-*/name")
    return f"/dev/{next(n.parent.name for n in names if 'stub' in n.read_text().lower())}"


class Bench(CountedChip):
    """Behind a device node, the chip's clock the test's."""

    def __init__(self, adapter: type, rate_hz: float = 952.0) -> None:
        super().__init__()
        self.adapter = adapter(self)
        self.bus = open_bus(self.adapter.path)
        self.driver = Lsm9ds1(self.bus, ADDRESS, ImuConfig(rate_hz), self.clock.now_ns, sleep=self.clock.sleep)

    def raw_bus(self) -> SMBus:
        return SMBus(int(self.adapter.path.rpartition("-")[2]))

    def i2c_rdwr(self, *messages) -> None:
        """The chip's wires; a test may cut in by setting another function on the chip."""
        self.chip.i2c_rdwr(*messages)


@pytest.fixture(params=[CuseBus, WiresBus])
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    if request.param is WiresBus and not DEVICE.exists():
        pytest.skip("the adapter module was not built; `make test-kernel` does it")
    bench = Bench(request.param)
    yield bench
    bench.bus.close()
    bench.adapter.close()


def test_a_bus_without_combined_transfers_is_named() -> None:
    bus = open_bus(stub_path())
    with pytest.raises(DriverError, match=r"no combined transfers \(I2C_RDWR\)"):
        Lsm9ds1(bus, ADDRESS).open()
    bus.close()


def test_a_chip_bound_to_a_kernel_driver_is_reported_and_left_alone() -> None:
    path = stub_path()
    node = Path("/sys/bus/i2c/devices") / Path(path).name
    (node / "new_device").write_text("24c02 0x6b")
    try:
        bus = open_bus(path)
        with pytest.raises(DeviceBusy, match=r"LSM9DS1 at 0x6B: a kernel driver holds the chip.*\[errno 16\]"):
            Lsm9ds1(bus, ADDRESS).open()
        bus.close()
    finally:
        (node / "delete_device").write_text("0x6b")
    bus = open_bus(path)
    claim(bus, ADDRESS)  # free again
    bus.close()


def test_identity_configuration_and_samples_in_bursts_beyond_32_bytes(bench: Bench) -> None:
    bench.driver.open()
    numbers = []
    for pause_s in (0.001, 0.020, 0.026, 0.007, 0.015):
        bench.clock.sleep(pause_s)
        batch = bench.driver.drain()
        assert (batch.raw == batch.raw[:, :1]).all()
        numbers += batch.raw[:, 0].tolist()
    assert len(numbers) > 60 and set(np.diff(numbers)) == {1}


@pytest.mark.parametrize("number", [errno.EREMOTEIO, errno.EAGAIN, errno.ETIMEDOUT, errno.EIO])
def test_errnos_come_through_the_kernel_and_passing_ones_are_retried(bench: Bench, number: int) -> None:
    bench.driver.open()
    bench.chip.fail(number, times=2)
    bench.clock.sleep(0.01)
    assert len(bench.driver.drain().raw)
    bench.chip.fail(number, times=99)
    with pytest.raises(DeviceAbsent, match=rf"\[errno {number}\]"):
        for _ in range(20):
            bench.driver.drain()


def test_an_absent_chip_gives_no_acknowledge(bench: Bench) -> None:
    with pytest.raises(DeviceAbsent, match="0x6A: no acknowledge"):
        Lsm9ds1(bench.bus, 0x6A, sleep=bench.clock.sleep, now_ns=bench.clock.now_ns).open()


def test_a_burst_that_breaks_off_is_a_gap_and_no_sample_is_doubled(bench: Bench) -> None:
    bench.driver.open()
    bench.clock.sleep(0.01)
    last = bench.driver.drain().raw[-1, 0]
    bench.clock.sleep(0.02)
    transfer = bench.chip.i2c_rdwr

    def break_off(*messages) -> None:
        if len(messages[-1]) > 32:
            bench.chip.fail(errno.EIO, after_bytes=60)
            bench.chip.i2c_rdwr = transfer

    before(bench.chip, "i2c_rdwr", break_off)
    batches = [bench.driver.drain()]
    bench.clock.sleep(0.01)
    batches.append(bench.driver.drain())
    first = next(b for b in batches if len(b.raw))
    assert first.gap_before and first.raw[0, 0] > last + 1


def test_a_hung_slave_times_out_and_is_said_to_hang(bench: Bench) -> None:
    bench.driver.open()
    freed = threading.Event()
    kernel_times_out = isinstance(bench.adapter, WiresBus)

    def hang(*messages) -> None:
        if kernel_times_out:
            freed.wait(20)  # the kernel's adapter gives up after a second
        elif not freed.wait(0.05):
            raise OSError(errno.ETIMEDOUT, "clock held low")  # what an adapter answers after its timeout

    before(bench.chip, "i2c_rdwr", hang)
    with bench.raw_bus() as bus, pytest.raises(OSError) as caught:
        bus.i2c_rdwr(i2c_msg.write(ADDRESS, [0x0F]), i2c_msg.read(ADDRESS, 1))
    assert caught.value.errno == errno.ETIMEDOUT
    assert "held low" in str(explain(caught.value, "chip"))
    freed.set()
    bench.clock.sleep(0.01)
    assert len(bench.driver.drain().raw)


def test_an_adapter_pulled_out_is_gone(bench: Bench) -> None:
    bench.driver.open()
    bench.adapter.close()
    with pytest.raises(DeviceAbsent, match=r"adapter is gone|no device answers"):
        for _ in range(20):
            bench.driver.drain()
    bench.bus.close()
    settle(lambda: not os.path.exists(bench.adapter.path))
    with pytest.raises(DeviceAbsent, match="no such bus"):
        open_bus(bench.adapter.path)


def test_the_kernel_keeps_its_limits(bench: Bench) -> None:
    for messages in ([i2c_msg.read(ADDRESS, 9000)], [i2c_msg.read(ADDRESS, 1)] * 43):
        with bench.raw_bus() as bus, pytest.raises(OSError) as caught:
            bus.i2c_rdwr(*messages)
        assert caught.value.errno == errno.EINVAL


def test_this_is_the_guest() -> None:
    assert os.environ["LEGID_KERNEL_GUEST"] == "1"
