"""The firmware core in C serving a port to the real driver."""

import time
from collections.abc import Iterator

import pytest

from drivers import LegController, Pong, State
from drivers.serial_link import SerialLink
from tests.support.c_firmware import Served
from tests.support.processes import REAL_CLOCK

pytestmark = REAL_CLOCK


@pytest.fixture
def served() -> Iterator[Served]:
    with Served() as served:
        yield served


def test_the_driver_works_with_it_over_a_port(served: Served) -> None:
    with LegController(SerialLink(served.path)) as controller:
        hello = controller.open()
        assert (hello.telemetry_hz, hello.gear_ratio, hello.torque_limit_nm) == (500, 50.0, 2.0)
        controller.arm(1000)
        until, sent_ns, pongs = time.monotonic() + 10.0, {}, list[tuple[Pong, int]]()
        while time.monotonic() < until and len(pongs) < 5:
            controller.command(0.5)
            ping_id, host_tx_ns = controller.ping()
            sent_ns[ping_id] = host_tx_ns
            time.sleep(0.01)
            pongs += [(message, host_ns) for message, host_ns, _ in controller.poll() if isinstance(message, Pong)]
        assert controller.armed and controller.telemetry.current_a == 0.5
        for pong, host_ns in pongs:
            inside = (pong.tx_tick_us - pong.rx_tick_us) % 2**32
            assert inside * 1000 <= host_ns - sent_ns[pong.ping_id] + 1000
        assert controller.stats.bad_crc == controller.stats.bad_length == controller.stats.lost == 0
    end = served.record_until(lambda change: change.state == State.DISARMED)[-1]
    assert (end.torque_unm, end.faults) == (0, 0)
