"""What can go wrong between a program and the example board, or with either: functions that make it so from now on."""

import signal
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from cobs import cobs
from fastcrc import crc16

from drivers import Hello, Message, Telemetry
from drivers.protocol import (
    DELIMITER,
    TYPES,
    Arm,
    ClearFaults,
    Decoder,
    HelloRequest,
    LimitsRequest,
    Ping,
    Stop,
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
    borne: tuple[str, ...]
    stood_s: float
    """The emulator stood still for so long, its watchdog too: that is not the board's."""
    busy: bool
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
        way.change = lambda frame: bytes(held.extend(frame) or b"")  # type: ignore[func-returns-value]

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
    def strike(bench: PortBench) -> None:
        bench.board.patch(function, code)
    return strike


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


ACTS: dict[str, Act] = {
    "line cut both ways": cut("up down"),
    "nothing comes up": cut("up"),
    "nothing goes down": cut("down"),
    "cable pulled": lambda bench: bench.line.pull(),
    "line cut for 50 ms": cut("up down", 0.05),
    "line cut for 300 ms": cut("up down", 0.3),
    "frames from the board 200 ms late": late("up", 0.2),
    "frames from the board 300 ms late": late("up", 0.3),
    "frames to the board 200 ms late": late("down", 0.2),
    "frames to the board 300 ms late": late("down", 0.3),
    "both ways 200 ms late": late("up down", 0.2),
    "frames to the board collected for 200 ms, then sent at once": collected("down", 0.2),
    "every frame from the board damaged": changed("up", one_bit),
    "every frame to the board damaged": changed("down", one_bit),
    "one byte in 100 damaged, from the board": changed("up", bits_at(0.01)),
    "one byte in 100 damaged, to the board": changed("down", bits_at(0.01)),
    "a third of the frames lost, from the board": changed("up", dropped(1 / 3)),
    "a third of the frames lost, to the board": changed("down", dropped(1 / 3)),
    "noise between frames, from the board": changed("up", noise(20)),
    "noise between frames, to the board": changed("down", noise(20)),
    "frames cut in half, to the board": changed("down", halved),
    "every frame twice, to the board": changed("down", doubled),
    "every frame twice, from the board": changed("up", doubled),
    "telemetry repeats one frame": frozen(Telemetry),
    "telemetry's tick is frozen": frozen(Telemetry, "tick_us"),
    "telemetry's sequence is frozen": frozen(Telemetry, "seq"),
    "telemetry's echo is frozen": frozen(Telemetry, "torque_cmd_nm"),
    "telemetry of 300 ms ago": old(Telemetry, 75),
    "command of 2.5 N m, limit 2": raw_torque(2500000),
    "command of the largest number": raw_torque(INT_MAX),
    "command of the invalid value": raw_torque(INT_MIN),
    "command of a float NaN's bits": raw_torque(NAN_BITS),
    "commands' sequence is frozen": stuck_sequence,
    "commands' sequence jumps back": seq_off(-1000),
    "commands of 300 ms ago": old(Commands, 30),
    "commands name telemetry of 300 ms ago": seen_off(-75),
    "commands name telemetry of the future": seen_off(100),
    "commands lose their age": commands(lambda c: TorqueCommand(c.seq, c.torque_nm)),
    "commands of a wrong length": commands(lambda c: framed(struct.pack("<BHi", 0x07, c.seq, 100000))),
    "Hello of protocol version 2": hello(version=2),
    "Hello of another boot": hello(boot_id=1),
    "second host says Stop": second_host(Stop()),
    "second host says Arm 65535 ms": second_host(Arm(65535)),
    "second host says ClearFaults": second_host(ClearFaults()),
    "second host asks and pings": second_host(HelloRequest(), Ping(7), LimitsRequest()),
    "second host commands": second_driver(True),
    "second host commands without age": second_driver(False),
    "board reset": lambda bench: bench.board.reset(),
    "board's polling hangs": patched("leg_poll", HANG),
    "board's sampling hangs": patched("leg_sample", HANG),
    "board's current loop ends": patched("current_loop", RETURN),
    "board's UART interrupt ends": patched("uart0_interrupt", RETURN),
    "board's tick stands still": stuck_tick,
    "board does not hear": patched("leg_receive", RETURN),
    "board does not speak": patched("board_send", RETURN),
    "board's watchdog is not kicked": patched("board_watchdog_kick", RETURN),
    "board's clock stands for 50 ms": stopped_clock(0.05),
    "board's clock stands for 300 ms": stopped_clock(0.3),
    "board's processor stands for 40 ms": stopped_processor(0.04),
    "board's processor stands for 300 ms": stopped_processor(0.3),
    "E-stop opened": button,
    "E-stop opened and closed, armed without a clear": button_and_arm,
    "watchdog's fault, armed without a clear": arm_after_watchdog,
    "SIGKILL": signalled(signal.SIGKILL),
    "SIGSTOP, SIGKILL 1 s later": signalled(signal.SIGSTOP, signal.SIGKILL, 1.0),
    "SIGSTOP for 50 ms": signalled(signal.SIGSTOP, after_s=0.05),
    "SIGSTOP for 300 ms": signalled(signal.SIGSTOP, after_s=0.3),
    "SIGTERM": signalled(signal.SIGTERM),
    "Ctrl-C": signalled(signal.SIGINT),
    "SIGTERM, every Stop lost": stops_lost,
}
BORNE = (
    "line cut for 50 ms", "one byte in 100 damaged, from the board", "one byte in 100 damaged, to the board",
    "a third of the frames lost, from the board", "a third of the frames lost, to the board",
    "noise between frames, from the board", "noise between frames, to the board", "every frame twice, to the board",
    "every frame twice, from the board", "second host says Arm 65535 ms", "second host says ClearFaults",
    "second host asks and pings", "second host commands without age", "board's clock stands for 50 ms",
    "SIGSTOP for 50 ms")
"""Under these a recording may go on at any moment."""
BORNE_AS_ARM_GOES_OUT = ("commands' sequence jumps back", "commands lose their age")
STOOD_S = {"board's processor stands for 40 ms": 0.04, "board's processor stands for 300 ms": 0.3}
BUSY = (
    "board's polling hangs", "board's sampling hangs", "board's current loop ends", "board's UART interrupt ends",
    "board's tick stands still", "board's watchdog is not kicked")
assert {*BORNE, *BORNE_AS_ARM_GOES_OUT, *STOOD_S, *BUSY} <= set(ACTS)
FAULTS = {name: PortFault(act, MOMENTS if name in BORNE else ("arming",) if name in BORNE_AS_ARM_GOES_OUT else (),
                          STOOD_S.get(name, 0.0), name in BUSY) for name, act in ACTS.items()}
