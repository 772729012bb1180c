"""What can go wrong between a program and the example board, or with either: functions that make it so from now on."""

import signal
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from cobs import cobs
from fastcrc import crc16

from drivers.protocol import (
    DELIMITER,
    TYPES,
    Arm,
    ClearFaults,
    Decoder,
    Hello,
    HelloRequest,
    LimitsRequest,
    Message,
    Ping,
    Stop,
    Telemetry,
    TimedCommand,
    TorqueCommand,
    encode,
)
from tests.support.fault_bench import MOMENTS
from tests.support.port_bench import PortBench
from tests.support.port_line import Way, as_it_is, lost
from tests.support.qemu_board import HANG, RETURN, returns

Act = Callable[[PortBench], None]
Commands = TorqueCommand | TimedCommand
INT_MIN, INT_MAX, NAN_BITS = -2**31, 2**31 - 1, 0x7FC00000


class PortFault(NamedTuple):
    """What is done, and at which moments a recording may go on under it: then it must move nothing that was not
    asked for."""

    act: Act
    borne: tuple[str, ...] = ()
    stood_s: float = 0.0
    """The emulator stood still for so long, its watchdog too: that is not the board's."""
    busy: bool = False
    """The board runs a processor hot, ahead of everything: one at a time."""


def framed(payload: bytes) -> bytes:
    """As `encode`, of a payload that no message has."""
    return bytes(cobs.encode(payload + crc16.ibm_3740(payload).to_bytes(2, "little"))) + DELIMITER


def understood(frame: bytes) -> Message | None:
    """The message of one frame."""
    return next(iter(Decoder().feed(DELIMITER + frame)), None)


def on(names: str, act: Callable[[PortBench, Way], None]) -> Act:
    """Something done to one way of the line, or to both."""
    def strike(bench: PortBench) -> None:
        for name in names.split():
            act(bench, getattr(bench.line, name))
    return strike


# -- the line ----------------------------------------------------------------------------------------------------


def cut(names: str, for_s: float | None = None) -> Act:
    """Bytes vanish, for good or for a while."""
    def act(bench: PortBench, way: Way) -> None:
        way.change = lost
        if for_s is not None:
            bench.later(for_s, lambda: setattr(way, "change", as_it_is))
    return on(names, act)


def late(names: str, by_s: float) -> Act:
    return on(names, lambda bench, way: setattr(way, "late_s", by_s))


def collected(names: str, for_s: float) -> Act:
    """Held back, then all of it at once."""
    def act(bench: PortBench, way: Way) -> None:
        held = bytearray()
        way.change = lambda frame: bytes(held.extend(frame) or b"")

        def burst() -> None:
            way.change = as_it_is
            way.put(bytes(held))
        bench.later(for_s, burst)
    return on(names, act)


def changed(names: str, change: Callable[[bytes, Any], bytes]) -> Act:
    """Each frame by a function of it and of the bench's random numbers."""
    return on(names, lambda bench, way: setattr(way, "change", lambda frame: change(frame, bench.rng)))


def one_bit(frame: bytes, rng: Any) -> bytes:
    at = rng.integers(len(frame))
    return frame[:at] + bytes([frame[at] ^ 1 << rng.integers(8)]) + frame[at + 1:]


def bits_at(share: float) -> Callable[[bytes, Any], bytes]:
    """One bit wrong in so many bytes."""
    return lambda frame, rng: bytes(b ^ (1 << rng.integers(8)) * (rng.random() < share) for b in frame)


def dropped(share: float) -> Callable[[bytes, Any], bytes]:
    return lambda frame, rng: b"" if rng.random() < share else frame


def noise(count: int) -> Callable[[bytes, Any], bytes]:
    return lambda frame, rng: bytes(rng.bytes(count)) + DELIMITER + frame


def halved(frame: bytes, rng: Any) -> bytes:
    return frame[: len(frame) // 2]


def doubled(frame: bytes, rng: Any) -> bytes:
    return frame + frame


# -- what is said on it ------------------------------------------------------------------------------------------


def says(kind: type, how: Callable[[Any], Message | bytes | None]) -> Act:
    """Messages of a kind replaced, their check sums right."""
    def strike(bench: PortBench) -> None:
        def change(frame: bytes) -> bytes:
            message = understood(frame)
            if not isinstance(message, kind):
                return frame
            said = how(message)
            return b"" if said is None else said if isinstance(said, bytes) else encode(said)
        (bench.line.up if kind in (Telemetry, Hello) else bench.line.down).change = change
    return strike


def commands(how: Callable[[Commands], Message | bytes | None]) -> Act:
    return says(Commands, how)  # type: ignore[arg-type]


def frozen(kind: Any, *names: str) -> Act:
    """Fields that stay what they were, or the whole message."""
    def strike(bench: PortBench) -> None:
        kept: list[Any] = []

        def freeze(message: Any) -> Message:
            kept.append(message)
            held: Message = replace(message, **{name: getattr(kept[0], name) for name in names}) if names else kept[0]
            return held
        says(kind, freeze)(bench)
    return strike


def old(kind: Any, frames: int) -> Act:
    """Messages of before instead of those of now."""
    def strike(bench: PortBench) -> None:
        queue: deque[Any] = deque(maxlen=frames)

        def swap(message: Any) -> Message | None:
            queue.append(message)
            return queue[0] if len(queue) == frames else None
        says(kind, swap)(bench)
    return strike


def raw_torque(unm: int) -> Act:
    """The command's torque as a bare number of the field, whatever it means."""
    def how(command: Commands) -> bytes:
        seen = struct.pack("<H", command.seen_seq) if isinstance(command, TimedCommand) else b""
        return framed(struct.pack("<BHi", TYPES[type(command)], command.seq, unm) + seen)
    return commands(how)


def seen_off(frames: int) -> Act:
    def how(command: Commands) -> Message:
        return replace(command, seen_seq=(command.seen_seq + frames) % 65536) if isinstance(
            command, TimedCommand) else command
    return commands(how)


def seq_off(by: int) -> Act:
    return commands(lambda command: replace(command, seq=(command.seq + by) % 65536))


def stuck_sequence(bench: PortBench) -> None:
    """At that of a command which the board may have obeyed already."""
    seq = bench.command.seq if bench.command is not None else 0
    commands(lambda command: replace(command, seq=seq))(bench)


def hello(**fields: Any) -> Act:
    """Somebody says Hello, and from now on so does the board."""
    def strike(bench: PortBench) -> None:
        says(Hello, lambda message: replace(message, **fields))(bench)
        bench.line.down.put(encode(HelloRequest()))
    return strike


def second_host(*messages: Message, each_s: float = 0.01, times: int = 200) -> Act:
    """Somebody else on the same wires."""
    return lambda bench: bench.every(each_s, lambda: bench.say_down(*messages), times)


def second_driver(timed: bool, torque_nm: float = 0.4) -> Act:
    """Another program commands, a little ahead of this one's sequence; as rigs that share a line would."""
    def strike(bench: PortBench) -> None:
        def command() -> None:
            if bench.command is None or bench.telemetry is None:
                return
            seq = (bench.command.seq + 100) % 65536
            seen = bench.telemetry.seq
            bench.say_down(TimedCommand(seq, torque_nm, seen) if timed else TorqueCommand(seq, torque_nm))
        bench.every(0.005, command)
    return strike


# -- the board ---------------------------------------------------------------------------------------------------


def patched(function: str, code: bytes) -> Act:
    return lambda bench: bench.board.patch(function, code)


def stuck_tick(bench: PortBench) -> None:
    bench.board.patch("board_tick_us", returns(bench.board.trace().loop_us))


def stopped_clock(for_s: float) -> Act:
    def strike(bench: PortBench) -> None:
        bench.board.stop_clock(True)
        bench.later(for_s, lambda: bench.board.stop_clock(False))
    return strike


def stopped_processor(for_s: float) -> Act:
    def strike(bench: PortBench) -> None:
        def go_on() -> None:
            bench.board.signal(signal.SIGCONT)
            bench.watched = True
        bench.watched = False
        bench.board.signal(signal.SIGSTOP)
        bench.later(for_s, go_on)
    return strike


def button(bench: PortBench) -> None:
    bench.board.estop(True)


def button_and_arm(bench: PortBench) -> None:
    """Pressed and let go, and somebody arms and commands without Stop and ClearFaults."""
    bench.board.estop(True)
    bench.later(0.02, lambda: bench.board.estop(False))
    bench.later(0.03, lambda: second_host(Arm(1000), TorqueCommand(1, 0.4), TorqueCommand(2, 0.4))(bench))


def arm_after_watchdog(bench: PortBench) -> None:
    """The host's commands are lost; somebody arms again without ClearFaults."""
    commands(lambda command: None)(bench)
    second_host(Arm(50), each_s=0.02, times=10)(bench)


# -- the host ----------------------------------------------------------------------------------------------------


def signalled(number: int, then: int = signal.SIGCONT, after_s: float | None = None) -> Act:
    def strike(bench: PortBench) -> None:
        bench.signal_host(number)
        if after_s is not None:
            bench.later(after_s, lambda: bench.signal_host(then))
    return strike


def stops_lost(bench: PortBench) -> None:
    """Nothing that says Stop comes through, when it is asked to stop."""
    says(Stop, lambda message: None)(bench)
    bench.signal_host(signal.SIGTERM)


FAULTS: dict[str, PortFault] = {
    "line cut both ways": PortFault(cut("up down")),
    "nothing comes up": PortFault(cut("up")),
    "nothing goes down": PortFault(cut("down")),
    "cable pulled": PortFault(lambda bench: bench.line.pull()),
    "line cut for 50 ms": PortFault(cut("up down", 0.05), borne=MOMENTS),
    "line cut for 300 ms": PortFault(cut("up down", 0.3)),
    "frames from the board 200 ms late": PortFault(late("up", 0.2)),
    "frames from the board 300 ms late": PortFault(late("up", 0.3)),
    "frames to the board 200 ms late": PortFault(late("down", 0.2)),
    "frames to the board 300 ms late": PortFault(late("down", 0.3)),
    "both ways 200 ms late": PortFault(late("up down", 0.2)),
    "frames to the board collected for 200 ms, then sent at once": PortFault(collected("down", 0.2)),
    "every frame from the board damaged": PortFault(changed("up", one_bit)),
    "every frame to the board damaged": PortFault(changed("down", one_bit)),
    "one byte in 100 damaged, from the board": PortFault(changed("up", bits_at(0.01)), borne=MOMENTS),
    "one byte in 100 damaged, to the board": PortFault(changed("down", bits_at(0.01)), borne=MOMENTS),
    "a third of the frames lost, from the board": PortFault(changed("up", dropped(1 / 3)), borne=MOMENTS),
    "a third of the frames lost, to the board": PortFault(changed("down", dropped(1 / 3)), borne=MOMENTS),
    "noise between frames, from the board": PortFault(changed("up", noise(20)), borne=MOMENTS),
    "noise between frames, to the board": PortFault(changed("down", noise(20)), borne=MOMENTS),
    "frames cut in half, to the board": PortFault(changed("down", halved)),
    "every frame twice, to the board": PortFault(changed("down", doubled), borne=MOMENTS),
    "every frame twice, from the board": PortFault(changed("up", doubled), borne=MOMENTS),
    "telemetry repeats one frame": PortFault(frozen(Telemetry)),
    "telemetry's tick is frozen": PortFault(frozen(Telemetry, "tick_us")),
    "telemetry's sequence is frozen": PortFault(frozen(Telemetry, "seq")),
    "telemetry's echo is frozen": PortFault(frozen(Telemetry, "torque_cmd_nm")),
    "telemetry of 300 ms ago": PortFault(old(Telemetry, 75)),
    "command of 2.5 N m, limit 2": PortFault(raw_torque(2500000)),
    "command of the largest number": PortFault(raw_torque(INT_MAX)),
    "command of the invalid value": PortFault(raw_torque(INT_MIN)),
    "command of a float NaN's bits": PortFault(raw_torque(NAN_BITS)),
    "commands' sequence is frozen": PortFault(stuck_sequence),
    "commands' sequence jumps back": PortFault(seq_off(-1000), borne=("arming",)),
    "commands of 300 ms ago": PortFault(old(Commands, 30)),
    "commands name telemetry of 300 ms ago": PortFault(seen_off(-75)),
    "commands name telemetry of the future": PortFault(seen_off(100)),
    "commands lose their age": PortFault(commands(lambda c: TorqueCommand(c.seq, c.torque_nm)), borne=("arming",)),
    "commands of a wrong length": PortFault(commands(lambda c: framed(struct.pack("<BHi", 0x07, c.seq, 100000)))),
    "Hello of protocol version 2": PortFault(hello(version=2)),
    "Hello of another boot": PortFault(hello(boot_id=1)),
    "second host says Stop": PortFault(second_host(Stop())),
    "second host says Arm 65535 ms": PortFault(second_host(Arm(65535)), borne=MOMENTS),
    "second host says ClearFaults": PortFault(second_host(ClearFaults()), borne=MOMENTS),
    "second host asks and pings": PortFault(second_host(HelloRequest(), Ping(7), LimitsRequest()), borne=MOMENTS),
    "second host commands": PortFault(second_driver(True)),
    "second host commands without age": PortFault(second_driver(False), borne=MOMENTS),
    "board reset": PortFault(lambda bench: bench.board.reset()),
    "board's polling hangs": PortFault(patched("leg_poll", HANG), busy=True),
    "board's sampling hangs": PortFault(patched("leg_sample", HANG), busy=True),
    "board's current loop ends": PortFault(patched("current_loop", RETURN), busy=True),
    "board's UART interrupt ends": PortFault(patched("uart0_interrupt", RETURN), busy=True),
    "board's tick stands still": PortFault(stuck_tick, busy=True),
    "board does not hear": PortFault(patched("leg_receive", RETURN)),
    "board does not speak": PortFault(patched("board_send", RETURN)),
    "board's watchdog is not kicked": PortFault(patched("board_watchdog_kick", RETURN), busy=True),
    "board's clock stands for 50 ms": PortFault(stopped_clock(0.05), borne=MOMENTS),
    "board's clock stands for 300 ms": PortFault(stopped_clock(0.3)),
    "board's processor stands for 40 ms": PortFault(stopped_processor(0.04), stood_s=0.04),
    "board's processor stands for 300 ms": PortFault(stopped_processor(0.3), stood_s=0.3),
    "E-stop opened": PortFault(button),
    "E-stop opened and closed, armed without a clear": PortFault(button_and_arm),
    "watchdog's fault, armed without a clear": PortFault(arm_after_watchdog),
    "SIGKILL": PortFault(signalled(signal.SIGKILL)),
    "SIGSTOP, SIGKILL 1 s later": PortFault(signalled(signal.SIGSTOP, signal.SIGKILL, 1.0)),
    "SIGSTOP for 50 ms": PortFault(signalled(signal.SIGSTOP, after_s=0.05), borne=MOMENTS),
    "SIGSTOP for 300 ms": PortFault(signalled(signal.SIGSTOP, after_s=0.3)),
    "SIGTERM": PortFault(signalled(signal.SIGTERM)),
    "Ctrl-C": PortFault(signalled(signal.SIGINT)),
    "SIGTERM, every Stop lost": PortFault(stops_lost),
}
