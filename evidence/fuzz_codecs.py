"""Frames broken in every way that the fault injector knows, through both codecs: no crash, nothing wrong taken.

    python -m evidence fuzz-codecs --frames 1000000
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from fastcrc import crc16
from numpy.random import Generator, default_rng

from drivers import FaultReport, Hello, Message, Pong, Telemetry, dynamixel
from drivers.can_codec import CanCodec
from drivers.protocol import Decoder, Fault, encode
from evidence.frame import Lines, program
from evidence.kept import kept
from evidence.registry import Evidence, shares
from tests.support.device_faults import KINDS, FaultyWire, WireFaults

TELEMETRY = Telemetry(0, 0, 1, 0, 0.0, 0.0, 0.0, 0.0, 24.0, 30.5, 0.125)
CRC_ODDS = 2.0**-16
ALIKE_ODDS = (10 + 3 / 2**8) / 2**11 / 9
"""That noise on CAN, where nothing but CAN's own CRC keeps it out, has identifier and length of one of the ten
messages of one frame, or those and the tag of a part that is awaited."""


class Outcome(NamedTuple):
    """What came of it."""

    frames: int
    broken: int
    delivered: int
    wrong: int
    """Messages delivered that nobody sent."""
    expected_wrong: float
    """Mean number by odds alone: 2^-16 for each broken serial frame, which is too many, and `ALIKE_ODDS` on CAN."""
    counted: int
    seconds: float

    def __str__(self) -> str:
        return (f"{self.frames} frames, {self.broken} of them broken, {self.counted} drops counted, {self.delivered} "
                f"delivered, {self.wrong} of these wrong (expected from the odds alone: {self.expected_wrong:.1f}), "
                f"0 crashes, {self.seconds:.0f} s")


def message(rng: Generator, k: int) -> Message:
    """A valid message, different for every k."""
    kind = rng.integers(8)
    angle = (k % 100_000_000) / 1e6
    if kind == 0:
        return Hello(1, k + 1, 500, 50.0, 2.0, 1000)
    if kind == 1:
        return Pong(k % 65536, k, (k + 20) % 2**32)
    if kind == 2:
        fault = int(rng.choice([f.value for f in Fault]))
        return FaultReport(k, fault, fault | 1, angle)
    return replace(TELEMETRY, seq=k % 65536, tick_us=k, knee_rad=angle, pivot_hall_rad=-angle, current_a=angle)


def noise(rng: Generator) -> bytes:
    """A frame of random bytes; half of them whole COBS frames of a known type and length, all but the check sum."""
    if rng.random() < 0.5:
        return rng.bytes(int(rng.integers(1, 90))) + b"\0"
    kind, size = [(0x81, 33), (0x82, 18), (0x83, 10), (0x84, 12)][rng.integers(4)]
    payload = bytes([kind]) + rng.bytes(size) + rng.bytes(2)
    return b"".join(bytes([len(block) + 1]) + block for block in payload.split(b"\0")) + b"\0"


def _stream(frames: int, rng: Generator, decoder: Any, noise: Callable[[], bytes],
            sent: Callable[[int], Any], encoded: Callable[[Any], bytes]) -> Outcome:
    """A third noise, a third valid frames broken by the fault injector, a third whole, all in one stream."""
    started = time.perf_counter()
    wire = FaultyWire(WireFaults(**{kind: 0.5 / len(KINDS) for kind in KINDS}), rng)
    broken = delivered = wrong = 0
    recent: deque[Any] = deque(maxlen=12)
    for k in range(frames):
        if rng.random() < 1 / 3:
            parts, broken = [noise()], broken + 1
        else:
            recent.append(sent(k))
            before = sum(wire.injected.values())
            parts = wire.pass_on(encoded(recent[-1]))
            broken += sum(wire.injected.values()) - before
        stream = b"".join(parts)
        cut = rng.integers(0, len(stream) + 1)
        for chunk in (stream[:cut], stream[cut:]):
            for got in decoder.feed(chunk):
                delivered += 1
                wrong += got not in recent
    counted = sum(getattr(decoder, name, 0) for name in ("bad", "bad_crc", "bad_length", "unknown"))
    return Outcome(frames, broken, delivered, wrong, broken * CRC_ODDS, counted, time.perf_counter() - started)


@kept
def fuzz_serial(frames: int, seed: int) -> Outcome:
    rng, decoder = default_rng(seed), Decoder()
    decoder.feed(b"\0")
    return _stream(frames, rng, decoder, lambda: noise(rng), lambda k: message(rng, k), encode)


@kept
def fuzz_can(frames: int, seed: int) -> Outcome:
    """Half of all frames dropped, doubled, swapped, shortened, or with a frame of noise in front."""
    rng, codec, started = default_rng(seed), CanCodec(), time.perf_counter()
    wire = FaultyWire(WireFaults(**{kind: 0.25 / len(KINDS) for kind in KINDS}), rng)
    delivered = wrong = passed = k = 0
    recent: deque[Message] = deque(maxlen=12)
    while passed < frames:
        sent = message(rng, k)
        k += 1
        recent.append(sent)
        arrived = [part for frame in codec.encode(sent) for part in wire.pass_on(frame)]
        passed += len(arrived)
        for got in codec.feed(arrived):
            delivered += 1
            wrong += got not in recent
    counted = codec.bad_crc + codec.bad_length + codec.unknown
    odds = wire.injected["garbage"] * ALIKE_ODDS
    return Outcome(passed, sum(wire.injected.values()), delivered, wrong, odds, counted, time.perf_counter() - started)


@kept
def fuzz_dynamixel(frames: int, seed: int) -> Outcome:
    rng = default_rng(seed)

    def broken() -> bytes:
        start = dynamixel.HEADER if rng.random() < 0.5 else b""
        return start + rng.bytes(int(rng.integers(1, 90)))

    return _stream(frames, rng, dynamixel.Decoder(), broken, lambda k: dynamixel.Packet(
        k % 253, dynamixel.Instruction.STATUS, 0, rng.bytes(k % 90)),
        lambda sent: dynamixel.status(sent.ident, sent.error, sent.params))


def page(frames: int = 1_000_000, seed: int = 1) -> Lines:
    assert crc16.ibm_3740(b"123456789") == 0x29B1
    yield from [
        "# Fuzz of the codecs",
        "Serial frames that are broken must pass a 16-bit check sum to be taken. On CAN the bus itself checks; "
        "what is wrong there is noise put in behind that check, with an identifier and length that a message "
        "has.",
        f"- serial: {fuzz_serial(frames, seed)}", f"- CAN: {fuzz_can(frames, seed)}",
        f"- Dynamixel: {fuzz_dynamixel(frames, seed)}"]


EVIDENCE = Evidence(
    "The host's codecs under broken frames", "python -m evidence fuzz-codecs --frames 10000000",
    "fuzz.md", 32, "no crash",
    shares(r"\| (?:serial|CAN) (?:\| [\d ,a-z]+ ){6}\| (\d+) \|", "crashes by codec"),
    r"10000000`, seed (\d+)")
main = program(page)
