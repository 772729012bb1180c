"""What a driver and an emulated leg do over any link, on the machine's own clock."""

import time
from collections.abc import Callable

from drivers import Drive, LegController, Pong, Received, State
from drivers.mock import MockRig

PATIENCE_S = 20.0


def settle(wanted: Callable[[], object]) -> None:
    """Wait until it is so."""
    deadline = time.monotonic() + PATIENCE_S
    while not wanted():
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.002)


def poll_until(controller: Drive, wanted: Callable[[list[Received]], object]) -> list[Received]:
    """Received messages up to the first that is wanted."""
    received: list[Received] = []
    deadline = time.monotonic() + PATIENCE_S
    while not wanted(received):
        assert time.monotonic() < deadline, "it did not come"
        received += controller.poll()
    return received


def drive(controller: LegController, rig: MockRig) -> None:
    """Handshake, then a torque that the telemetry shows."""
    assert controller.open(PATIENCE_S).boot_id == rig.firmware.boot_id
    controller.arm(1000)
    controller.command(0.5)
    poll_until(controller, lambda _: controller.armed and controller.telemetry and controller.telemetry.current_a > 0.3)


def ping(controller: LegController, rig: MockRig) -> None:
    """The answer brackets the firmware's tick."""
    ping_id, tx_ns = controller.ping()
    received = poll_until(controller, lambda r: any(isinstance(m, Pong) for m, *_ in r))
    pong, rx_ns = next((m, host_ns) for m, host_ns, _ in received if isinstance(m, Pong))
    assert pong.ping_id == ping_id
    middle = rig.firmware.tick_us((tx_ns + rx_ns) / 2)
    assert abs((pong.rx_tick_us + pong.tx_tick_us) / 2 - middle) <= (rx_ns - tx_ns) / 2000 + 60


def is_stopped(rig: MockRig) -> None:
    """The drive disarms."""
    settle(lambda: rig.firmware.drive.state == State.DISARMED)
