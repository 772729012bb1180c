"""`make drives`: the drives that labs own, emulated: faults, broken frames, a full bus, rates, parameters."""

import math
import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.random import default_rng

from daq import parse_rig
from drivers import attach
from drivers.can_frame import CanFrame, padded
from drivers.fdcanusb_link import FdcanusbCodec
from drivers.mock import EmulatorLink
from estimator import FitOptions, fit
from estimator.model import leg2
from estimator.numerics import student_quantile
from evidence.drive_faults import FAULTS, strike
from evidence.drive_rates import at_rate
from evidence.frame import Lines, new_folder, program, table
from evidence.fuzz_codecs import fuzz_dynamixel
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.emulation import LegBody, record_emulated, rig_with_drive
from experiments.exchange import load_any_run
from experiments.excite import random_multisine
from experiments.judge import estimates_of
from tests.support.drive_bench import DriveBench, telemetry
from tests.support.fault_bench import MOMENTS
from tests.support.paths import DEMO_RIG

KINDS = ["moteus", "odrive", "dynamixel"]
ON_CAN = KINDS[:2]
TARGET_MS = 110.0
SECONDS, PEAK_NM = 10.0, 0.6
DRAWN = ("m1", "c1", "i1", "m2", "c2", "i2", "viscous", "coulomb")
"""What differs from leg to leg."""
REPEATS = 50
WITHIN = 0.01


@kept
def struck(kind: str, name: str, moment: str) -> tuple[float, str]:
    """Time to zero torque [ms] and what was said."""
    return strike(kind, name, moment)


@kept
def watchdog(kind: str, way: str) -> list[float]:
    """Times [ms] from the last command to zero torque by the drive's own watchdog of 100 ms."""
    times = []
    for seed in range(REPEATS):
        bench = DriveBench(kind, seed=seed)
        bench.armed()
        bench.run(0.05 + 0.0137 * (seed % 7), 1.0)
        bench.drive.command(1.0)
        since = bench.clock.now_ns()
        if way == "the cable is pulled":
            bench.link.unplug()
            bench.clock.sleep(0.3)
            bench.far.transmit(bench.clock.now_ns())
        else:
            bench.run(0.3)
        times.append(1e3 * bench.zero_after(since))
    return times


@kept
def fuzz(frames: int) -> dict[str, tuple[float, int, int, float]]:
    """Broken frames through each codec: seconds, how many, of these counted, wrong. A crash ends the program."""
    rng = default_rng(1)
    out: dict[str, tuple[float, int, int, float]] = {}
    for kind in ON_CAN:
        bench = DriveBench(kind)
        bench.drive.open()
        good = _answers(bench)
        hear: Any = bench.drive
        began = time.monotonic()
        for _ in range(frames):
            hear._ask = lambda: None
            frame = good[rng.integers(len(good))]
            data = bytearray(frame.data)
            how = rng.integers(4)
            if how == 0 and data:
                data[rng.integers(len(data))] ^= 1 << rng.integers(8)
            elif how == 1:
                data = data[:rng.integers(len(data) + 1)]
            elif how == 2:
                data = bytearray(rng.bytes(int(rng.integers(65))))
            else:
                data += rng.bytes(int(rng.integers(16)))
            hear._found = {}
            hear._hear((frame._replace(data=bytes(data[:64])),))
        counted = bench.drive.stats.bad_crc + bench.drive.stats.unknown
        out[kind] = time.monotonic() - began, frames, counted, 0
    codec, began = FdcanusbCodec(), time.monotonic()
    line = b"rcv 100 " + padded(bytes(40), 0x50).hex().encode() + b" E B F\r\n"
    for _ in range(frames):
        broken = bytearray(line)
        for at in rng.integers(0, len(broken), rng.integers(1, 4)):
            broken[int(at)] = rng.integers(256)
        codec.feed(bytes(broken))
    out["fdcanusb line"] = time.monotonic() - began, frames, codec.bad, 0
    packets = fuzz_dynamixel(2 * frames, 1)
    out["dynamixel"] = packets.seconds, packets.broken, packets.counted, packets.wrong
    return out


def _answers(bench: DriveBench) -> list[CanFrame]:
    heard: list[CanFrame] = []
    true = bench.link.read

    def listening() -> Any:
        data = true()
        heard.extend(data)
        return data

    bench.link.read = listening  # type: ignore[method-assign]
    bench.run(0.2)
    bench.link.read = true  # type: ignore[method-assign]
    return heard


@kept
def loaded(kind: str) -> tuple[float, int, float, float]:
    """Beside traffic of 90 % of the bus: samples/s, lost, median and worst wait in ms.

    A frame waits until the bus is free: exponentially, with the mean of an M/D/1 queue of frames of 135 bits at
    1 Mbit/s, 0.6 ms each way; nine foreign frames come with each of the drive's own.
    """
    bench = DriveBench(kind)
    bench.link = EmulatorLink(bench.rig.drive, bench.clock, delay_s=0.0003, jitter_s=0.0006, seed=3, nothing=())
    bench.drive = attach(kind, bench.link, bench.wiring, bench.clock.now_ns, bench.clock.sleep)
    true, rng = bench.link.read, default_rng(2)

    def crowded() -> Any:
        data = true()
        foreign = tuple(CanFrame(int(n), rng.bytes(8)) for n in rng.integers(0x200, 0x7FF, 9 * len(data)))
        return foreign + data

    bench.link.read = crowded  # type: ignore[method-assign]
    bench.drive.open()
    bench.run(0.1)
    lost = bench.drive.stats.lost
    heard = bench.run(10.0)
    waits = [1e-6 * (one.host_ns - one.asked_ns) for one in heard if one.asked_ns is not None]
    return len(telemetry(heard)) / 10.0, bench.drive.stats.lost - lost, float(np.median(waits)), max(waits)


@kept
def leg(kind: str, seed: int) -> tuple[float, float]:
    """Of an emulated leg of its own body: the worst relative error of beta1 to beta5, and the share of all nine
    intervals that hold."""
    named = rig_with_drive(DEMO_RIG.read_text(), kind)
    rng, rig = default_rng(seed), parse_rig(named)
    usual, drawn = vars(LegBody()), dict[str, Any]()
    for name in DRAWN:
        value, by = usual[name], rng.uniform(0.85, 1.15, 2).tolist()
        drawn[name] = (value[0] * by[0], value[1] * by[1]) if isinstance(value, tuple) else value * by[0]
    body = LegBody(**drawn)
    with new_folder() as folder:
        path = folder / f"leg{seed}.mcap"
        record_emulated(path, rig, named, random_multisine(50 + seed, SECONDS, PEAK_NM), seed, body)
        data = load_any_run(path, rig)
    found = fit([data], leg2(lever_arm=0.2, gravity_mps2=9.81), FitOptions(sensors="imu"))
    truth, std = np.array(body.beta()), np.array([e.std for e in estimates_of(found).values()])
    error = np.array(found.beta) - truth
    return float(np.abs(error / truth)[:5].max()), float(np.mean(np.abs(error / std) <= 1.96))


rates = kept(at_rate)


def page(legs: int = 20, frames: int = 1_000_000, rate_s: float = 600.0, moments: Sequence[str] = MOMENTS) -> Lines:
    yield from ["# Drives, measured",
                "moteus, ODrive and Dynamixel, emulated with the leg behind them. No drive was at hand.",
                "## Faults while the leg is driven"]
    cells = {(kind, name, moment): struck(kind, name, moment) for kind in KINDS for name in FAULTS
             for moment in moments}
    for kind in KINDS:
        zero = [ms for (of, _, _), (ms, _) in cells.items() if of == kind]
        yield (f"- {kind}: zero torque after {np.median(zero):.0f} ms in the median, {max(zero):.0f} ms at most; "
               f"{sum(ms <= TARGET_MS for ms in zero)} of {len(zero)} cells within {TARGET_MS:g} ms.")
    yield ("Virtual time, a watchdog of 100 ms, default `[limits]`. Time in ms from the fault, or from the "
           "first torque if that is later, to the last torque of the motor. `ramp`: 60 ms into the plan. "
           "`driving`: 0.85 s into it. `stopping`: 20 ms after a SIGTERM. The message is that of `driving`.")
    yield table(f"drive | fault | {' | '.join(moments)} | message", (
        (kind, name, *(f"{cells[kind, name, m][0]:.0f}" for m in moments),
         cells.get((kind, name, "driving"), (0.0, ""))[1])
        for kind in KINDS for name in FAULTS))
    yield from ["[Recording and safety](../safety.md#bought-drives) lists faults that only the hard-wired stop ends.",
                "## The drive's own watchdog",
                f"A watchdog of 100 ms, {REPEATS} times each; time from the last command to zero torque."]
    yield table("drive | what happens | median [ms] | worst [ms]", (
        f"{kind} | {way} | {np.median(watchdog(kind, way)):.0f} | {max(watchdog(kind, way)):.0f}" for kind in KINDS
        for way in ("the host sends no more torque", "the cable is pulled")))
    yield from ["## Broken frames", "Frames have a bit flipped, are cut, are noise, or have noise behind them. "
                "A Dynamixel's stream is noise, broken and whole packets, a third each. Its packets have a CRC of 16 "
                "bits. CAN checks its own frames. None crashed a codec."]
    yield table("codec | broken frames | counted as bad | wrong | seconds", (
        f"{kind} | {broken:,} | {counted:,} | {wrong} | {took_s:.0f}"
        for kind, (took_s, broken, counted, wrong) in fuzz(frames).items()))
    yield from ["## A bus at 90 % load", "Frames wait as in an M/D/1 queue, 0.6 ms on average, with nine frames of "
                "other devices for each of the drive's. Ten virtual seconds."]
    yield table("drive | samples/s | lost | median wait [ms] | worst wait [ms]", (
        "{} | {:.0f} | {} | {:.2f} | {:.2f}".format(kind, *loaded(kind)) for kind in ON_CAN))
    found = rates(rate_s)
    yield from ["## Rates", "Emulator and polling program are real-time processes, two "
                "rows at a time, with a command every 10 ms. The load average was "
                f"{found['load']:.1f} before and {found['load_after']:.1f} at the end, on {os.cpu_count()} "
                "cores. An answer after more than 20 ms counts as lost."]
    yield table("drive | over | minutes | samples/s | lost | share of a core | median wait [ms] | armed at "
                "the end", (
        f"{v['kind']} | {v['over']} | {v['seconds'] / 60:.0f} | {v['rate']:.1f} | {v['lost']} | "
        f"{100 * v['share']:.0f} % | {v['wait_ms']:.2f} | {'yes' if v['armed'] else 'no'}" for v in found["rows"]))
    yield from ["## Parameters", f"A run of {SECONDS:g} s on each of {legs} emulated legs a drive, through all "
                f"bytes. Bodies vary by 15 %, seeds 0 to {legs - 1}. Errors are relative, of beta1 to beta5. The last "
                "column counts the 95 % intervals of all nine parameters."]
    yield table("drive | legs within 1 % | worst error | intervals that hold", (
        _leg_row(kind, np.array([leg(kind, seed) for seed in range(legs)])) for kind in KINDS))


def _leg_row(kind: str, found: np.ndarray) -> str:
    worst, holds = found.T
    half = student_quantile(holds.size - 1) * float(np.std(holds, ddof=1)) / math.sqrt(holds.size)
    return (f"{kind} | {int((worst <= WITHIN).sum())} of {worst.size} | {100 * worst.max():.2f} % | "
            f"{100 * holds.mean():.1f} % +- {100 * half:.1f} %")


EVIDENCE = Evidence(
    "Bought drives, emulated: faults, watchdogs, broken frames, rates, parameters", "make drives",
    "drives.md", 60, "zero torque within 110 ms, no crash, 500 and 250 samples/s without a loss "
    "below 25 % of a core, parameters within 1 %",
    tuple(rf"- ({kind}: zero torque after \d+ ms in the median, \d+ ms at most)" for kind in KINDS))
main = program(page)
