"""The controller on CAN: the same `LegController`, over python-can's own buses and an emulated slcan adapter."""

import itertools
import os
from collections.abc import Iterator
from contextlib import closing, suppress

import can
import numpy as np
import pytest

from drivers import DeviceAbsent, LegController, LinkLost, State, Telemetry
from drivers.can_codec import CanCodec
from drivers.can_frame import CanFrame
from drivers.can_link import CanLink
from drivers.mock import CanServer, MockRig
from drivers.protocol import Stop
from tests.support.leg_on_a_link import drive, is_stopped, ping
from tests.support.processes import REAL_CLOCK
from tests.support.slcan_adapter import SlcanAdapter
from tests.support.still_plant import StillPlant
from tests.support.virtual_rig import VirtualRig

pytestmark = REAL_CLOCK

channels = (f"legid-{os.getpid()}-{n}" for n in itertools.count())


def test_on_virtual_time_nothing_is_lost() -> None:
    rig = VirtualRig(can=True)
    controller = rig.controller
    assert controller.open().boot_id == rig.firmware.boot_id
    controller.arm(50)
    frames = [m for m, *_ in rig.poll_for(2.0, 0.25) if isinstance(m, Telemetry)]
    assert (np.diff([m.seq for m in frames]) == 1).all()
    assert len(frames) == pytest.approx(1000, abs=5)
    assert frames[-1].torque_cmd_nm == 0.25 and controller.armed
    assert controller.stats.lost == controller.stats.bad_crc == controller.stats.unknown == 0
    controller.close()
    rig.clock.sleep(0.01)
    rig.mock.advance_to(rig.clock.now_ns())
    rig.firmware.transmit(rig.clock.now_ns())
    assert rig.firmware.drive.state == State.DISARMED


def test_a_reboot_is_noticed_by_the_heartbeat_though_its_hello_was_lost() -> None:
    rig = VirtualRig(can=True)
    rig.controller.open()
    rig.firmware.reboot()
    rig.firmware._outbox.clear()  # what it said at boot did not get through
    rig.poll_for(0.15)
    assert rig.controller.hello.boot_id == rig.firmware.boot_id and rig.controller.stats.reboots == 1


@pytest.fixture(params=["virtual", "udp_multicast"])
def bus(request: pytest.FixtureRequest) -> dict:
    if request.param == "virtual":
        return {"interface": "virtual", "channel": next(channels)}
    return {"interface": "udp_multicast", "channel": "239.74.163.2", "port": 43000 + os.getpid() % 2000}


@pytest.fixture
def rig() -> MockRig:
    return MockRig(StillPlant(), codec=lambda: CanCodec(3))


@pytest.fixture
def server(rig: MockRig, bus: dict) -> Iterator[CanServer]:
    try:
        opened = can.Bus(**bus)
    except OSError as error:
        pytest.skip(f"no multicast here: {error}")
    with CanServer(rig.firmware, opened, rig.clock) as server:
        yield server


def test_handshake_telemetry_torque_and_ping(rig: MockRig, server: CanServer, bus: dict) -> None:
    with LegController(CanLink(3, **bus), codec=CanCodec(3)) as controller:
        drive(controller, rig)
        ping(controller, rig)
        assert controller.stats.bad_crc == controller.stats.bad_length == controller.stats.unknown == 0
    is_stopped(rig)


def test_another_node_does_not_answer(rig: MockRig) -> None:
    channel = next(channels)
    with (CanServer(rig.firmware, can.Bus(interface="virtual", channel=channel), rig.clock),
          pytest.raises(DeviceAbsent, match=r"no answer within 0.3 s \(0 frames came")):
        LegController(CanLink(4, interface="virtual", channel=channel), codec=CanCodec(4)).open(0.3)


@pytest.mark.parametrize("config", [
    {"interface": "socketcan", "channel": "nocan9"}, {"interface": "nonsense", "channel": "0"},
    {"interface": "slcan", "channel": "/dev/does-not-exist"}], ids=lambda c: c["interface"])
def test_a_bus_that_is_not_there_is_said_in_words(config: dict) -> None:
    with pytest.raises(DeviceAbsent, match=r"^leg controller on CAN .*devices\.controller\.can\]$") as caught:
        CanLink(**config)
    assert "\n" not in str(caught.value)


class ScriptedBus:
    """A bus that hands out what it was given: messages, None, or exceptions."""

    def __init__(self, *script) -> None:
        self.script = list(script)

    def recv(self, timeout=None):
        item = self.script.pop(0) if self.script else None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, message, timeout=None) -> None:
        self.recv()

    def shutdown(self) -> None:
        pass


def scripted(monkeypatch: pytest.MonkeyPatch, *script) -> CanLink:
    monkeypatch.setattr(can, "Bus", lambda **_: ScriptedBus(*script))
    monkeypatch.setattr("drivers.can_link.lock_name", lambda name: None)  # nobody closes these links
    return CanLink(interface="scripted", channel="can0")


def data_frame(can_id: int = 1, **kind) -> can.Message:
    return can.Message(arbitration_id=can_id, data=b"\1", is_extended_id=kind.pop("is_extended_id", False), **kind)


def test_only_plain_data_frames_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    link = scripted(monkeypatch, data_frame(), data_frame(is_extended_id=True), data_frame(is_fd=True),
                    can.Message(arbitration_id=4, is_error_frame=True, data=bytes(8)), data_frame(2))
    assert link.read() == (CanFrame(1, b"\1"), CanFrame(2, b"\1"))
    assert (link.other_frames, link.errors) == (2, 1)


def test_bus_off_is_named_after_what_came_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    link = scripted(monkeypatch, data_frame(), can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
    assert link.read() == (CanFrame(1, b"\1"),)
    for _ in range(2):  # said once by the bus, lasting here
        with pytest.raises(LinkLost, match=r"bus-off.*termination"):
            link.read()


@pytest.mark.parametrize("number, said", [(100, "ip link set can0 up"), (19, "is gone"), (6, "is gone"),
                                              (105, "takes no more frames"), (5, "fails")])
def test_errors_of_the_bus_are_said_in_words(monkeypatch: pytest.MonkeyPatch, number: int, said: str) -> None:
    error = can.CanOperationError("broken", error_code=number)
    for link_call in (lambda link: link.read(), lambda link: link.write(CanCodec().encode(Stop()))):
        with pytest.raises(LinkLost, match=said):
            link_call(scripted(monkeypatch, error))


class ServingAdapter(SlcanAdapter):
    """With a controller on its bus."""

    def __init__(self, rig: MockRig) -> None:
        self.rig, self.commands, self.rest = rig, list[str](), ""
        super().__init__()

    def turn(self) -> None:
        heard, self.heard = self.rest + self.heard, ""
        *lines, self.rest = heard.split("\r")
        for line in lines:
            if line.startswith("t"):
                frame = CanFrame(int(line[1:4], 16), bytes.fromhex(line[5: 5 + 2 * int(line[4])]))
                self.rig.firmware.receive((frame,), self.rig.clock.now_ns())
            elif line:
                self.commands.append(line)
        with suppress(BlockingIOError):
            self.say("".join(f"t{f.can_id:03X}{len(f.data)}{f.data.hex().upper()}\r"
                             for _, chunk in self.rig.firmware.transmit(self.rig.clock.now_ns()) for f in chunk))


def test_a_serial_can_adapter_carries_it_too(rig: MockRig) -> None:
    with closing(ServingAdapter(rig)) as adapter:
        link = CanLink(3, interface="slcan", channel=adapter.path, bitrate=1_000_000, sleep_after_open=0.0)
        with LegController(link, codec=CanCodec(3)) as controller:
            drive(controller, rig)
        assert {"S8", "O"} <= set(adapter.commands)  # 1 Mbit/s
        is_stopped(rig)
        assert rig.firmware.drive.torque_nm == 0.0
