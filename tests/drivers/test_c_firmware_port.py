"""The firmware core in C serving a port to the real driver."""

import time
from collections.abc import Iterator

import pytest

from drivers import LegController, Pong, Received, State
from drivers.errors import DeviceFault
from drivers.protocol import Fault
from drivers.serial_link import SerialLink
from tests.support.c_firmware import (
    Served,
)
from tests.support.processes import REAL_CLOCK

pytestmark = REAL_CLOCK


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.close()


def test_the_driver_works_with_it_over_a_port(served: Served) -> None:
    with LegController(SerialLink(served.path)) as controller:
        hello = controller.open()
        assert (hello.telemetry_hz, hello.gear_ratio, hello.torque_limit_nm) == (500, 50.0, 2.0)
        controller.arm(1000)
        received: list[Received] = []
        until = time.monotonic() + 10.0
        sent_ns = {}
        while time.monotonic() < until and sum(isinstance(m, Pong) for m, *_ in received) < 5:
            controller.command(0.5)
            ping_id, host_tx_ns = controller.ping()
            sent_ns[ping_id] = host_tx_ns
            time.sleep(0.01)
            received += controller.poll()
        assert controller.armed
        assert controller.telemetry.current_a == 0.5
        for message, host_ns, _ in received:
            if isinstance(message, Pong):
                inside = (message.tx_tick_us - message.rx_tick_us) % 2**32
                assert inside * 1000 <= host_ns - sent_ns[message.ping_id] + 1000
        assert controller.stats.bad_crc == controller.stats.bad_length == controller.stats.lost == 0
    end = served.record_until(lambda change: change.state == State.DISARMED)[-1]
    assert (end.torque_unm, end.faults) == (0, 0)


def test_a_host_that_falls_silent_ends_in_the_watchdog(served: Served) -> None:
    controller = LegController(SerialLink(served.path))
    controller.open()
    controller.arm(200)
    controller.command(1.0)
    end = served.record_until(lambda change: change.state == State.FAULT)[-1]
    assert (end.torque_unm, end.faults) == (0, Fault.WATCHDOG)
    assert 200_000_000 <= end.value <= 200_500_000  # 1e-6 ms, by the firmware's own clock; it looks every 0.5 ms
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline and (controller.telemetry is None or not controller.telemetry.faults):
        controller.poll()
    with pytest.raises(DeviceFault, match="watchdog"):
        controller.arm(200)
    controller.close()
