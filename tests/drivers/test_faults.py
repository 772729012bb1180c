"""Whatever happens on wire or bus: nothing invented is delivered, nothing missing goes unsaid, nothing hangs."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import DriverError, ImuConfig, LinkLost, Lsm9ds1, State, Telemetry
from drivers.can_codec import CanCodec
from drivers.protocol import Decoder, encode
from tests.support.counted_chip import CountedChip
from tests.support.device_faults import KINDS, FaultyI2C, FaultyWire, WireFaults
from tests.support.virtual_rig import VirtualRig

TELEMETRY = Telemetry(0, 0, 1, 0, 0.5, -0.25, 0.5, 0.125, 24.0, 30.5, 0.125)


def numbered(count: int) -> list[Telemetry]:
    """Messages each of which no other can be mistaken for, in any of its parts."""
    return [replace(TELEMETRY, seq=k, tick_us=2000 * k, knee_rad=k / 1e3, pivot_hall_rad=-k / 1e3, current_a=k / 1e4)
            for k in range(count)]


def wild(seed: int) -> FaultyWire:
    return FaultyWire(WireFaults(**{kind: 0.3 / len(KINDS) for kind in KINDS}), np.random.default_rng(seed))


def broken(decoder: Decoder) -> int:
    """Frames that were counted as such."""
    return decoder.bad_crc + decoder.bad_length + decoder.unknown


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), cut=st.integers(1, 200))
def test_serial_frames_through_a_wild_wire(seed: int, cut: int) -> None:
    sent, wire, decoder = numbered(80), wild(seed), Decoder()
    decoder.feed(b"\0")  # from here on every broken frame counts
    stream = b"".join([part for m in sent for part in wire.pass_on(encode(m))] + wire.release()) + b"\0"
    got = [m for at in range(0, len(stream), cut) for m in decoder.feed(stream[at: at + cut])]
    assert set(got) <= set(sent)
    done = wire.injected
    merged = done["flip"] + done["garbage"]  # a lost delimiter joins two broken frames into one
    hurt = merged + done["cut"]
    assert hurt - merged // 2 <= broken(decoder) + done["garbage"]
    assert len(got) >= len(sent) - done["drop"] - 2 * hurt
    missing = len(set(sent) - set(got))
    assert decoder.lost >= missing - 1 - done["swap"] * 2 - hurt  # none at the ends; swaps hide a step back


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_can_frames_through_a_wild_wire(seed: int) -> None:
    sent, wire, codec = numbered(80), wild(seed), CanCodec()
    arrived = [part for m in sent for frame in codec.encode(m) for part in wire.pass_on(frame)] + wire.release()
    got = codec.feed(arrived)
    assert {m for m in got if isinstance(m, Telemetry)} <= set(sent)
    assert len(sent) - 2 * sum(wire.injected.values()) <= len(got) == len(set(got))
    assert codec.bad_length >= wire.injected["flip"] + wire.injected["cut"]


@pytest.mark.parametrize("kind", KINDS)
def test_each_fault_alone_shows_in_a_count_or_costs_nothing(kind: str) -> None:
    wire = FaultyWire(WireFaults(**{kind: 0.1}), np.random.default_rng(7))
    decoder, sent = Decoder(), numbered(2000)
    decoder.feed(b"\0")
    got = decoder.feed(b"".join(part for m in sent for part in wire.pass_on(encode(m))) + b"\0")
    n = wire.injected[kind]
    assert 150 < n < 250
    if kind in ("duplicate", "swap", "drop"):
        more = {"duplicate": n, "swap": -len(wire.release()), "drop": -n}[kind]
        assert (broken(decoder), len(got)) == (0, 2000 + more)
        assert kind != "drop" or decoder.lost == n - (sent[-1] not in got) - (sent[0] not in got)
    else:
        assert n * 0.8 <= broken(decoder) <= n * 2.5 and set(got) <= set(sent)


def test_a_stalled_device_says_everything_afterwards() -> None:
    rig = VirtualRig()
    rig.controller.open()
    rig.link.stall(0.2)
    assert rig.poll_for(0.195) == []
    seqs = [m.seq for m, *_ in rig.poll_for(0.02) if isinstance(m, Telemetry)]
    assert len(seqs) >= 100 and set(np.diff(seqs)) == {1} and rig.controller.stats.lost == 0


def test_unplugged_and_plugged_in_again_the_drive_is_off_and_the_loss_is_counted() -> None:
    rig = VirtualRig()
    controller, firmware = rig.controller, rig.firmware
    controller.open()
    controller.arm(100)
    rig.poll_for(0.1, 0.5)
    rig.link.unplug()
    for use in (lambda: controller.command(0.5), controller.poll):
        with pytest.raises(LinkLost):
            use()
    rig.clock.sleep(0.3)
    rig.mock.advance_to(rig.clock.now_ns())
    assert firmware.drive.state == State.FAULT
    rig.link.replug()
    assert controller.open().boot_id == firmware.boot_id  # stops first
    controller.poll()
    assert controller.telemetry.torque_cmd_nm == 0.0 and controller.stats.lost > 100
    t_ns, _, acting = firmware.record
    assert acting[t_ns > rig.clock.now_ns() - 150_000_000].max() < 1e-9


class Numbered(CountedChip):
    """Drained through a faulty bus."""

    def __init__(self, rate_hz: float) -> None:
        super().__init__()
        self.schedule: dict = {}
        self.bus = FaultyI2C(self.chip, self.schedule)
        self.driver = Lsm9ds1(self.bus, config=ImuConfig(rate_hz), now_ns=self.clock.now_ns, sleep=self.clock.sleep)


ERRNOS = [121, 110, 11, 5, 6, 19]
numbers = st.sampled_from(ERRNOS)
happenings = st.one_of(*(st.tuples(st.just(what), numbers, st.integers(1, most)) for what, most in (
    ("nack", 9), ("partial", 380), ("stall", 80), ("brown out", 1))))


@settings(max_examples=80, deadline=None)
@given(rate=st.sampled_from([119.0, 238.0, 952.0]),
       events=st.lists(st.tuples(st.integers(0, 400), happenings), min_size=1, max_size=5))
def test_whatever_the_bus_does_no_sample_is_doubled_and_no_gap_goes_unsaid(rate: float, events: list) -> None:
    bench = Numbered(rate)
    bench.driver.open()
    actions = {"nack": lambda number, n: bench.chip.fail(number, times=n),
               "partial": lambda number, n: bench.chip.fail(number, after_bytes=n),
               "stall": lambda _, ms: bench.clock.sleep(ms * 1e-3),
               "brown out": lambda *_: bench.chip.brown_out()}
    for at, (what, *how) in events:
        bench.schedule[bench.bus.transfers + at] = partial(actions[what], *how)
    batches, end = [], bench.clock.now_ns() + 3_000_000_000
    while bench.clock.now_ns() < end:
        bench.clock.sleep(0.01)
        try:
            batches.append(bench.driver.drain())
        except DriverError as error:
            assert "\n" not in str(error)
            break  # a chip that stays away for longer than the retries is said to be away
    filled = [b for b in batches if len(b.raw)]
    assert all((b.raw == b.raw[:, :1]).all() for b in filled)  # no sample is put together from two
    for a, b in pairwise(filled):
        step = (int(b.raw[0, 0]) - int(a.raw[-1, 0])) % 30000
        assert step == 1 or (b.gap_before and 0 < step < 15000)
        assert (np.diff(b.raw[:, 0]) == 1).all()
