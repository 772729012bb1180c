"""The drives that labs own, emulated: faults, broken frames, a full bus, rates, parameters.

    python -m evidence drives --out docs/evidence/drives.md       # what `make drives` does
    python -m evidence drives --parts faults,fuzz --keep d.json   # some parts; what is kept is not measured again
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from daq import parse_rig
from drivers import DriverError, attach
from drivers.can_frame import CanFrame, padded
from drivers.fdcanusb_link import FdcanusbCodec
from drivers.mock import EmulatorLink
from drivers.mock.moteus_drive import MockMoteus
from drivers.moteus_drive import QUERY
from estimator import FitOptions, fit
from estimator.model import leg2
from estimator.score import student_quantile
from evidence.drive_faults import FAULTS, strike
from evidence.drive_rates import at_rate
from evidence.fuzz_codecs import fuzz_dynamixel
from evidence.registry import Evidence
from experiments.cli import main as legid
from experiments.emulation import LegBody, record_emulated, rig_with_drive
from experiments.exchange import load_any_run
from experiments.excite import random_multisine
from tests.support.drive_bench import DriveBench, telemetry
from tests.support.fault_bench import MOMENTS

KINDS = ["moteus", "odrive", "dynamixel"]
ON_CAN = KINDS[:2]
TARGET_MS = 110.0
FRAMES = 1_000_000
LEGS, SECONDS, PEAK_NM = 20, 10.0, 0.6
DRAWN = ("m1", "c1", "i1", "m2", "c2", "i2", "viscous", "coulomb")
"""What differs from leg to leg."""
REPEATS = 50
WITHIN = 0.01
Results = dict[str, Any]


def faults(moments: Sequence[str]) -> Results:
    """Time to zero torque [ms] and what was said, by drive, fault and moment."""
    out: Results = {}
    for kind in KINDS:
        for name in FAULTS:
            for moment in moments:
                out[f"{kind}|{name}|{moment}"] = strike(kind, name, moment)
                print(kind, name, moment, out[f"{kind}|{name}|{moment}"], flush=True)
    return out


def watchdogs() -> Results:
    """Time [ms] from the last command to zero torque by the drive's own watchdog of 100 ms."""
    out: Results = {}
    for kind in KINDS:
        for way in ("the host sends no more torque", "the cable is pulled"):
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
            out[f"{kind}|{way}"] = [float(np.median(times)), max(times)]
    return out


def fuzz(frames: int) -> Results:
    """Broken frames through each codec: [seconds, readings made of them, counted]. A crash ends the program."""
    rng, out = np.random.default_rng(1), {}
    for kind in ON_CAN:
        bench = DriveBench(kind)
        bench.drive.open()
        good = _answers(bench)
        hear: Any = bench.drive
        began, made = time.monotonic(), 0
        for _ in range(frames):
            hear._ask = lambda: None
            frame = good[int(rng.integers(len(good)))]
            data = bytearray(frame.data)
            how = int(rng.integers(4))
            if how == 0 and data:
                data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            elif how == 1:
                data = data[:int(rng.integers(len(data) + 1))]
            elif how == 2:
                data = bytearray(rng.bytes(int(rng.integers(65))))
            else:
                data += rng.bytes(int(rng.integers(16)))
            hear._found = {}
            made += hear._hear((frame._replace(data=bytes(data[:64])),)) is not None
        counted = bench.drive.stats.bad_crc + bench.drive.stats.unknown
        out[kind] = [time.monotonic() - began, made, counted]
    codec, began = FdcanusbCodec(), time.monotonic()
    line = b"rcv 100 " + padded(bytes(40), 0x50).hex().encode() + b" E B F\r\n"
    passed = 0
    for _ in range(frames):
        broken = bytearray(line)
        for at in rng.integers(0, len(broken), int(rng.integers(1, 4))):
            broken[int(at)] = int(rng.integers(256))
        passed += len(codec.feed(bytes(broken)))
    out["fdcanusb line"] = [time.monotonic() - began, passed, codec.bad]
    packets = fuzz_dynamixel(2 * frames, 1)
    out["dynamixel"] = [packets.seconds, packets.wrong, packets.counted, packets.broken, packets.expected_wrong]
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


def loaded() -> Results:
    """Beside traffic of 90 % of the bus: [samples/s, lost, median and worst wait in ms].

    A frame waits until the bus is free: exponentially, with the mean of an M/D/1 queue of frames of 135 bits at
    1 Mbit/s, 0.6 ms each way; nine foreign frames come with each of the drive's own.
    """
    out: Results = {}
    for kind in ON_CAN:
        bench = DriveBench(kind)
        bench.link = EmulatorLink(bench.rig.drive, bench.clock, delay_s=0.0003, jitter_s=0.0006, seed=3, nothing=())
        bench.drive = attach(kind, bench.link, bench.wiring, bench.clock.now_ns, bench.clock.sleep)
        true, rng = bench.link.read, np.random.default_rng(2)

        def crowded(true: Callable[[], Any] = true, rng: np.random.Generator = rng) -> Any:
            data = true()
            foreign = tuple(CanFrame(int(n), rng.bytes(8)) for n in rng.integers(0x200, 0x7FF, 9 * len(data)))
            return foreign + data

        bench.link.read = crowded  # type: ignore[method-assign]
        bench.drive.open()
        bench.run(0.1)
        lost = bench.drive.stats.lost
        heard = bench.run(10.0)
        waits = [1e-6 * (one.host_ns - one.asked_ns) for one in heard if one.asked_ns is not None]
        out[kind] = [len(telemetry(heard)) / 10.0, bench.drive.stats.lost - lost, float(np.median(waits)), max(waits)]
    return out


def lines() -> Results:
    """What is said where something is not as it should be."""
    def said(kind: str, node: int | None = None, **far: Any) -> str:
        bench = DriveBench(kind)
        for name, value in far.items():
            setattr(bench.far, name, value)
        wiring = bench.wiring if node is None else replace(bench.wiring, node=node)
        drive = attach(kind, bench.link, wiring, bench.clock.now_ns, bench.clock.sleep)
        try:
            drive.open(0.5)
            for _ in range(30):
                drive.poll()
            drive.arm(100)
            for _ in range(800):
                drive.poll()
                drive.command(0.0)
        except DriverError as error:
            return str(error)
        return "nothing"

    return {
        "moteus: wrong node": said("moteus", 9), "odrive: wrong node": said("odrive", 9),
        "dynamixel: wrong ID": said("dynamixel", 9),
        "moteus: register map 4": said("moteus", map_version=4),
        "odrive: firmware 0.5.6": said("odrive", version=(2, 3, 6, 56, 0, 5, 6, 0)),
        "moteus: in a fault": said("moteus", mode=1, fault=34),
        "odrive: in an error": said("odrive", active=1 << 9, reason=1 << 9),
        "odrive: no watchdog": said("odrive", watchdog_on=False),
        "two moteus on one bus": _two(),
    }


def _two() -> str:
    bench = DriveBench("moteus")
    other = MockMoteus(bench.far.settings, replace(bench.wiring, node=2), 2, bench.clock.now_ns())
    true = bench.far.transmit

    def both(until_ns: int) -> list[tuple[int, Any]]:
        other.receive((CanFrame(0x8002, QUERY, True, True),), until_ns)
        return sorted(true(until_ns) + other.transmit(until_ns))

    bench.far.transmit = both
    bench.armed()
    seen = telemetry(bench.run(1.0, 0.5))
    right = all(t.torque_cmd_nm == 0.0 or abs(t.torque_cmd_nm - 0.5) < 1e-3 for t in seen)
    return f"{len(seen)} samples in a second, {'all' if right else 'NOT all'} of the right one; the other's torque " \
           f"{other.torque_nm:g} N m"


def legs(count: int) -> Results:
    """Fits of emulated legs, each of its own body. By drive and leg: relative errors of beta1 to beta5, and the errors
    of all nine over their standard deviations."""
    out: Results = {}
    text = (files("experiments.workflows") / "demo_rig.toml").read_text(encoding="utf-8")
    for kind in KINDS:
        named = rig_with_drive(text, kind)
        rig, found_by_leg = parse_rig(named), []
        for seed in range(count):
            rng = np.random.default_rng(seed)
            usual, drawn = vars(LegBody()), dict[str, Any]()
            for name in DRAWN:
                value, by = usual[name], rng.uniform(0.85, 1.15, 2).tolist()
                drawn[name] = (value[0] * by[0], value[1] * by[1]) if isinstance(value, tuple) else value * by[0]
            body = LegBody(**drawn)
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"leg{seed}.mcap"
                record_emulated(path, rig, named, random_multisine(50 + seed, SECONDS, PEAK_NM), seed, body)
                data = load_any_run(path, rig)
            found = fit([data], leg2(lever_arm=0.2, gravity_mps2=9.81), FitOptions(sensors="imu"))
            truth, std = np.array(body.beta()), np.array([e.std for e in _estimates(found)])
            error = np.array(found.beta) - truth
            found_by_leg.append([(error / truth)[:5].tolist(), (error / std).tolist()])
            print(kind, seed, (100 * error / truth)[:5].round(2), (error / std).round(2), flush=True)
        out[kind] = found_by_leg
    return out


def _estimates(found: Any) -> Any:
    from experiments.judge import estimates_of

    return estimates_of(found).values()


def springs() -> Results:
    """What the demo's diagnosis says of the hidden spring, by drive."""
    out: Results = {}
    for kind in KINDS:
        with tempfile.TemporaryDirectory() as folder:
            legid(["demo", "--drive", kind, "--seconds", "8", "--out", folder])
            found = json.loads((Path(folder) / "diagnosis.json").read_text(encoding="utf-8"))
        sizes = "; ".join(
            f"{cause['effect']} at joint {cause['joint']}" + "".join(
                f", {size['name']} {size['value']:.3g} {size['unit']} [{size['ci95'][0]:.3g}, {size['ci95'][1]:.3g}]"
                for size in cause["size"]) for cause in found["causes"])
        out[kind] = f"{found['verdict']}: {sizes}"
        print(kind, out[kind], flush=True)
    return out


def page(r: Results) -> str:
    """Everything measured, dated."""
    out = [f"# Drives, measured, {datetime.now(UTC):%Y-%m-%d}", "",
           "By `make drives`: moteus, ODrive and Dynamixel, emulated with the leg behind them. No drive was at hand.",
           ""]
    if "faults" in r:
        out += _fault_lines(r["faults"])
    if "watchdogs" in r:
        out += ["## The drive's own watchdog", "",
                f"A watchdog of 100 ms, {REPEATS} times each; time from the last command to zero torque.", "",
                "| drive | what happens | median [ms] | worst [ms] |", "| --- | --- | ---: | ---: |"]
        out += [f"| {key.split('|')[0]} | {key.split('|')[1]} | {v[0]:.0f} | {v[1]:.0f} |"
                for key, v in r["watchdogs"].items()] + [""]
    if "fuzz" in r:
        out += ["## Broken frames", "", "Frames have a bit flipped, are cut, are noise, or have noise behind them. "
                "A Dynamixel's stream is noise, broken and whole packets, a third each.", "",
                "| codec | broken frames | crashes | counted as bad | seconds |", "| --- | ---: | ---: | ---: | ---: |"]
        out += [f"| {kind} | {v[3] if len(v) > 3 else FRAMES:,} | 0 | {v[2]:,} | {v[0]:.0f} |"
                for kind, v in r["fuzz"].items()] + [""]
        wrong, expected = r["fuzz"]["dynamixel"][1], r["fuzz"]["dynamixel"][4]
        out += [f"A Dynamixel's packets have a CRC of 16 bits: {wrong} wrong packets were accepted, "
                f"{expected:.0f} expected by chance. CAN checks its own frames.",
                ""]
    if "loaded" in r:
        out += ["## A bus at 90 % load", "", "Frames wait as in an M/D/1 queue, 0.6 ms on average, with nine frames of "
                "other devices for each of the drive's. Ten virtual seconds.", "",
                "| drive | samples/s | lost | median wait [ms] | worst wait [ms] |",
                "| --- | ---: | ---: | ---: | ---: |"]
        out += [f"| {kind} | {v[0]:.0f} | {v[1]} | {v[2]:.2f} | {v[3]:.2f} |" for kind, v in r["loaded"].items()]
        out += [""]
    if "rates" in r:
        out += ["## Rates", "", "Emulator and polling program are real-time processes, two "
                "rows at a time, with a command every 10 ms. The load average was "
                f"{r['rates']['load']:.1f} before and {r['rates']['load_after']:.1f} at the end, on {os.cpu_count()} "
                "cores. An answer after more than 20 ms counts as lost.", "",
                "| drive | over | minutes | samples/s | lost | share of a core | median wait [ms] | armed at the "
                "end |", "| --- | --- | ---: | ---: | ---: | ---: | ---: | --- |"]
        out += [f"| {v['kind']} | {v['over']} | {v['seconds'] / 60:.0f} | {v['rate']:.1f} | {v['lost']} | "
                f"{100 * v['share']:.0f} % | {v['wait_ms']:.2f} | {'yes' if v['armed'] else 'no'} |"
                for v in r["rates"]["rows"]] + ["", r["rates"].get("note", ""), ""]
    if "legs" in r:
        out += ["## Parameters", "", f"A run of {SECONDS:g} s on each of {LEGS} emulated legs a drive, through all "
                "bytes. Bodies vary by 15 %, seeds 0 to 19. Errors are relative, of beta1 to beta5. The last "
                "column counts the 95 % intervals of all nine parameters.", "",
                "| drive | legs within 1 % | worst error | intervals that hold |", "| --- | ---: | ---: | ---: |"]
        out += [_leg_row(kind, v) for kind, v in r["legs"].items()] + [""]
    if "springs" in r:
        out += ["## The hidden spring", "", "`legid demo --drive KIND --seconds 8`, a spring at the knee that the rig "
                "file does not know.", "", "| drive | diagnosis |", "| --- | --- |"]
        out += [f"| {kind} | {text} |" for kind, text in r["springs"].items()] + [""]
    if "lines" in r:
        out += ["## What is said", "", "| what is wrong | line |", "| --- | --- |"]
        out += [f"| {what} | {text} |" for what, text in r["lines"].items()] + [""]
    return "\n".join(out).rstrip() + "\n"


def _leg_row(kind: str, by_leg: list[list[list[float]]]) -> str:
    worst = np.array([max(map(abs, errors)) for errors, _ in by_leg])
    holds = np.array([np.mean(np.abs(scores) <= 1.96) for _, scores in by_leg])
    half = student_quantile(holds.size - 1) * float(np.std(holds, ddof=1)) / math.sqrt(holds.size)
    return (f"| {kind} | {int((worst <= WITHIN).sum())} of {worst.size} | {100 * worst.max():.2f} % | "
            f"{100 * holds.mean():.1f} % +- {100 * half:.1f} % |")


def _fault_lines(cells: Results) -> list[str]:
    out = ["## Faults while the leg is driven", ""]
    for kind in KINDS:
        zero = [v[0] for key, v in cells.items() if key.startswith(f"{kind}|")]
        driving = [v[0] for key, v in cells.items() if key.startswith(f"{kind}|") and key.endswith("|driving")]
        out.append(f"- {kind}: zero torque after {np.median(zero):.0f} ms in the median, {max(zero):.0f} ms at most; "
                   f"{sum(z <= TARGET_MS for z in zero)} of {len(zero)} cells within {TARGET_MS:g} ms. While driving: "
                   f"{np.median(driving):.0f} ms in the median, {max(driving):.0f} ms at most.")
    moments = [m for m in MOMENTS if any(key.endswith(f"|{m}") for key in cells)]
    out += ["", "Virtual time, a watchdog of 100 ms, default `[limits]`. Time in ms from the fault, or from the first "
            "torque if that is later, to the last torque of the motor. `ramp`: 60 ms into the plan. `driving`: 0.85 s "
            "into it. `stopping`: 20 ms after a SIGTERM. The message is that of `driving`.", ""]
    for kind in KINDS:
        out += [f"### {kind}", "", f"| fault | {' | '.join(moments)} | message |",
                "| --- |" + " ---: |" * len(moments) + " --- |"]
        for name in FAULTS:
            row = [cells.get(f"{kind}|{name}|{m}", (math.nan, ""))[0] for m in moments]
            said = cells.get(f"{kind}|{name}|driving", (0.0, ""))[1]
            out.append(f"| {name} | {' | '.join(f'{z:.0f}' for z in row)} | {said} |")
        out.append("")
    return [*out, "[Recording and safety](../safety.md#bought-drives) lists faults that only the hard-wired stop ends.",
            ""]


PARTS: dict[str, Callable[[], Results]] = {
    "faults": lambda: faults(MOMENTS), "watchdogs": watchdogs, "fuzz": lambda: fuzz(FRAMES), "loaded": loaded,
    "lines": lines, "rates": lambda: at_rate(600.0), "legs": lambda: legs(LEGS),
    "springs": springs}
EVIDENCE = (
    Evidence("Bought drives, emulated: faults, watchdogs, broken frames, rates, parameters", "make drives",
             "drives.md", 60, "zero torque within 110 ms, no crash, 500 and 250 samples/s without a loss "
             "below 25 % of a core, parameters within 1 %",
             tuple(rf"- ({kind}: zero torque after \d+ ms in the median, \d+ ms at most)" for kind in KINDS),
             resumes="with `--keep FILE`"),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", default=",".join(PARTS), help=f"some of {', '.join(PARTS)}")
    parser.add_argument("--keep", type=Path, help="JSON file of results, read first and added to")
    parser.add_argument("--out", type=Path, help="the page to write; printed without it")
    args = parser.parse_args(arguments)
    kept: Results = json.loads(args.keep.read_text()) if args.keep and args.keep.exists() else {}
    for part in filter(None, args.parts.split(",")):
        if part not in kept:
            kept[part] = PARTS[part]()
            if args.keep:
                args.keep.write_text(json.dumps(kept))
    if args.out:
        args.out.write_text(page(kept))
    else:
        print(page(kept))
