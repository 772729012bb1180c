"""What can go wrong while a leg is driven: each a function that makes it so from now on."""

import os
import signal
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from daq.runs import mcap_run
from drivers import State, Telemetry
from tests.support.device_faults import WireFaults
from tests.support.fault_bench import FaultBench

Fault = Callable[[FaultBench], None]


def says(**fields: Any) -> Fault:
    """Telemetry with fields replaced: by a value, by a function of the truth, or by what they were (None)."""
    def strike(bench: FaultBench) -> None:
        then: dict[str, Any] = {}

        def lie(truth: Telemetry) -> Telemetry:
            if not then:
                then.update({name: getattr(truth, name) for name in fields})
            return replace(truth, **{name: then[name] if how is None else how(getattr(truth, name)) if callable(how)
                                     else how for name, how in fields.items()})
        bench.firmware.says = lie
    return strike


def repeated(bench: FaultBench) -> None:
    kept: list[Telemetry] = []

    def lie(truth: Telemetry) -> Telemetry:
        kept.append(truth)
        return kept[0]
    bench.firmware.says = lie


def late(frames: int) -> Fault:
    def strike(bench: FaultBench) -> None:
        queue: deque[Telemetry] = deque()

        def lie(truth: Telemetry) -> Telemetry | None:
            queue.append(truth)
            return queue.popleft() if len(queue) > frames else None
        bench.firmware.says = lie
    return strike


def old_echo(bench: FaultBench) -> None:
    queue: deque[float] = deque(maxlen=150)

    def lie(truth: Telemetry) -> Telemetry:
        queue.append(truth.torque_cmd_nm)
        return replace(truth, torque_cmd_nm=queue[0] if len(queue) == 150 else 0.7)
    bench.firmware.says = lie


def knee_turns(times: float) -> Fault:
    """From where it is now the knee's angle changes by so many times what is true."""
    def strike(bench: FaultBench) -> None:
        then: list[float] = []

        def lie(truth: Telemetry) -> Telemetry:
            then.append(truth.knee_rad)
            return replace(truth, knee_rad=then[0] + times * (truth.knee_rad - then[0]))
        bench.firmware.says = lie
    return strike


def imu_reads(change: Callable[[list[int]], list[int]]) -> Fault:
    def strike(bench: FaultBench) -> None:
        push = bench.chip.push
        bench.chip.push = lambda raw: push(change(list(raw)))  # type: ignore[method-assign]
    return strike


def held(first: int, last: int) -> Fault:
    """These words of a sample stay what they were."""
    def strike(bench: FaultBench) -> None:
        kept: list[list[int]] = []

        def change(raw: list[int]) -> list[int]:
            kept.append(raw)
            return [*raw[:first], *kept[0][first:last], *raw[last:]]
        imu_reads(change)(bench)
    return strike


def set_on(path: str, value: Any) -> Fault:
    def strike(bench: FaultBench) -> None:
        *owners, name = path.split(".")
        owner: Any = bench
        for part in owners:
            owner = getattr(owner, part)
        setattr(owner, name, value)
    return strike


def hears_nothing(bench: FaultBench) -> None:
    def read() -> bytes:
        bench.clock.sleep(0.001)
        return b""
    bench.link.read = read  # type: ignore[method-assign]


def crash(*_: Any, **__: Any) -> None:
    raise ZeroDivisionError("crashed on purpose")


def dead_drive(bench: FaultBench) -> None:
    """Asked for torque, and echoing it, the motor gives none: a phase has come off."""
    step = bench.firmware.motor.step

    def without(t_ns: int, dt_s: float, command_nm: float) -> float:
        step(t_ns, dt_s, command_nm)
        bench.firmware.motor.impulse_nms -= bench.firmware.motor.last_mean_nm * dt_s
        bench.firmware.motor.last_mean_nm = 0.0
        return 0.0
    bench.firmware.motor.step = without  # type: ignore[method-assign]


def on_file(act: Callable[[FaultBench], None]) -> Fault:
    def strike(bench: FaultBench) -> None:
        mcap_run.WATCH_EVERY_S = 0.0
        act(bench)
    return strike


def signalled(number: int) -> Fault:
    return lambda bench: signal.raise_signal(number)


NAN = float("nan")
FAULTS: dict[str, Fault] = {
    "telemetry repeats one frame": repeated,
    "telemetry's tick is frozen": says(tick_us=None),
    "telemetry's sequence is frozen": says(seq=None),
    "ticks advance by half the period": says(tick_us=lambda tick: tick // 2),
    "telemetry ends, the rest goes on": set_on("firmware.says", lambda truth: None),
    "telemetry is 200 ms old": late(100),
    "telemetry is 300 ms old": late(150),
    "knee encoder stuck": says(knee_rad=None),
    "knee encoder invalid": says(knee_rad=NAN),
    "knee encoder mirrored": knee_turns(-1.0),
    "knee encoder counts double": knee_turns(2.0),
    "knee encoder jumps by 3 rad": says(knee_rad=lambda q: q + 3.0),
    "knee Hall angle stuck": says(knee_hall_rad=None),
    "pivot Hall angle stuck": says(pivot_hall_rad=None),
    "pivot Hall angle invalid": says(pivot_hall_rad=NAN),
    "pivot Hall angle jumps by 2 rad": says(pivot_hall_rad=lambda q: q + 2.0),
    "shunt reads zero": says(current_a=0.0),
    "shunt reversed": says(current_a=lambda i: -i),
    "shunt invalid": says(current_a=NAN),
    "shunt reads three times": says(current_a=lambda i: 3 * i),
    "shunt off by 1.5 A": says(current_a=lambda i: i + 1.5),
    "shunt stuck": says(current_a=None),
    "echo off by 1.5 N m": says(torque_cmd_nm=lambda tau: tau + 1.5),
    "echo zero": says(torque_cmd_nm=0.0),
    "echo stuck": says(torque_cmd_nm=None),
    "echo 300 ms old": old_echo,
    "motor temperature invalid": says(motor_degc=NAN),
    "motor at 80 degC": says(motor_degc=80.0),
    "supply voltage invalid": says(bus_v=NAN),
    "drive says DISARMED": says(state=int(State.DISARMED)),
    "drive says a fault": says(faults=2),
    "motor gives no torque": dead_drive,
    "gate driver fault": set_on("firmware.gate_driver_ok", False),
    "knee encoder fault of the firmware": set_on("firmware.knee_encoder_ok", False),
    "controller restarts": lambda bench: bench.firmware.reboot(),
    "cable pulled": lambda bench: bench.link.unplug(),
    "nothing comes up": hears_nothing,
    "nothing goes down": set_on("link.write", lambda data: None),
    "link stands still for 300 ms": lambda bench: bench.link.stall(0.3),
    "every frame up is damaged": set_on("link.wire._faults", WireFaults(flip=1.0)),
    "IMU constant": held(0, 6),
    "IMU all 0x00": imu_reads(lambda raw: [0] * 6),
    "IMU all 0xFF": imu_reads(lambda raw: [-1] * 6),
    "IMU at its rail": imu_reads(lambda raw: [32767] * 6),
    "gyro constant": held(0, 3),
    "accelerometer constant": held(3, 6),
    "gyro reversed": imu_reads(lambda raw: [-v for v in raw[:3]] + raw[3:]),
    "I2C reads 0x00": set_on("bus.reads", 0),
    "I2C reads 0xFF": set_on("bus.reads", 255),
    "IMU silent": set_on("chip.push", lambda raw: None),
    "I2C without acknowledge": lambda bench: bench.chip.fail(121, times=10_000),
    "I2C hangs": lambda bench: bench.chip.fail(110, times=10_000),
    "host stands still for 150 ms": lambda bench: bench.clock.sleep(0.15),
    "reading the controller crashes": set_on("controller.poll", crash),
    "reading the IMU crashes": set_on("imu.drain", crash),
    "Ctrl-C": signalled(signal.SIGINT),
    "SIGTERM": signalled(signal.SIGTERM),
    "disk full": set_on("disk._room", 0),
    "run file removed": on_file(lambda bench: bench.path.unlink()),
    "run file cut short": on_file(lambda bench: os.truncate(bench.path, 100)),
    "run file replaced": on_file(lambda bench: os.replace(_other(bench), bench.path)),
}


def _other(bench: FaultBench) -> str:
    other = bench.path.with_suffix(".other")
    other.write_text("not a run")
    return str(other)
