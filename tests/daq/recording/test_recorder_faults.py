"""Faults while recording: every gap is marked and reaches the Dataset as a gap; slow, full disks and stepped clocks."""

import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daq import WorkError, parse_rig
from daq.recording import Plan
from daq.runs import mcap_run, read_run
from drivers import ImuConfig, State, Telemetry
from drivers.mock import FirmwareSettings, ImuSettings, MockRig
from tests.support.device_faults import FaultyDisk, FaultyWire, WireFaults
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK
from tests.support.recordings import threaded
from tests.support.runs import load_run
from tests.support.still_plant import MovingPlant
from tests.support.virtual_rig import VirtualRig

pytestmark = REAL_CLOCK

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[sampling]\nrate_hz = 100.0\n[devices.controller]\n'
DATED = {"daq/runs/mcap_run.py", "daq/recording/facts.py"}
"""Where a recording says when it was made."""
CLEAN = WireFaults()
GYRO_S = 1.0 / (2.0 * math.pi * 100.0)
"""Age of the gyro behind its low pass at 476 and 952 Hz."""
FULL = r"r\.mcap: cannot be written \(No space left on device\); free space on the disk"


def swing(t: float) -> SimpleNamespace:
    """q2 = sin(3t) and q1d = cos(2t), so that every value of a Dataset can be checked against its time."""
    return SimpleNamespace(q1=0.5 * math.sin(2 * t), q2=math.sin(3 * t), q1d=math.cos(2 * t), q2d=3 * math.cos(3 * t),
                           q1dd=-2 * math.sin(2 * t))


class Bench(VirtualRig):
    """A swinging leg, its link through the fault injector."""

    def __init__(self, wire: WireFaults = CLEAN, can: bool = False) -> None:
        settings = FirmwareSettings(telemetry_hz=1000, current_noise_a=0.0, encoder_counts=10**7)
        quiet = ImuSettings(gyro_noise_radps=0.0, accel_noise_mps2=0.0)
        super().__init__(MovingPlant(swing), quiet, settings, config=ImuConfig(952.0), can=can,
                         wire=FaultyWire(wire, np.random.default_rng(3)))
        self.start_ns = self.clock.now_ns()
        self.open()

    def record(self, path: Path, seconds: float, happens=lambda now_s: None) -> mcap_run.RawRun:
        t = np.arange(0, seconds, 0.01)
        self.save(path, RIG + "[limits]\nstaleness_s = 0.4\n", Plan(t, np.zeros(t.size)),
                  progress=lambda now, total: happens(now))
        return read_run(path)


def check_truth(bench: Bench, path: Path) -> np.ndarray:
    """Rows of the Dataset with a hole; every value that is there must be the leg's own at that time."""
    raw, run = read_run(path), load_run(path, parse_rig(RIG))
    t = run.time_s + (int(raw.streams["/leg/telemetry"]["host_ns"][0]) - bench.start_ns) * 1e-9
    for name, truth, allowed in (("q2_rad", np.sin(3 * t), 1e-3), ("gyro_radps", np.cos(2 * (t - GYRO_S)), 2e-3)):
        here = np.isfinite(run[name])
        assert np.abs(run[name] - truth)[here].max() < allowed, name
    return run.gap()


def test_losses_on_the_wire_and_the_bus_are_holes_and_never_values(path: Path) -> None:
    bench = Bench()

    def wire(**faults: float) -> None:
        bench.link.wire._faults = WireFaults(**faults)

    due = [(1.0, lambda: wire(drop=1.0)), (1.1, wire), (2.0, lambda: bench.mock.imu.fail(121, times=6)),
           (3.2, bench.mock.imu.brown_out)]

    def happens(now_s: float) -> None:
        if due and now_s > due[0][0]:
            due.pop(0)[1]()

    raw = bench.record(path, 4.0, happens)
    gap = check_truth(bench, path)
    assert 8 <= gap.sum() <= 80
    assert raw.streams["/imu"]["gap_before"].sum() == [e.kind for e in raw.events].count("imu gap") == 2
    lost = np.diff(raw.streams["/leg/telemetry"]["seq"].astype(int)) - 1
    assert (lost > 0).sum() == 1 and 80 <= lost.max() <= 130


def test_what_the_fifo_lost_before_the_recording_is_no_gap_in_it(path: Path) -> None:
    bench = Bench()
    bench.clock.sleep(0.3)  # the file is being made, the devices wait
    raw = bench.record(path, 0.5)
    assert raw.streams["/imu"]["gap_before"].sum() == 0
    assert [e.kind for e in raw.events] == ["start", "stop"]


@pytest.mark.parametrize("can", [False, True])
def test_a_wild_wire_leaves_no_wrong_value_in_the_dataset(path: Path, can: bool) -> None:
    wild = WireFaults(flip=0.03, drop=0.03, duplicate=0.03, swap=0.03, garbage=0.03, cut=0.03)
    bench = Bench(wild, can)
    bench.record(path, 3.0)
    check_truth(bench, path)
    assert bench.link.wire.injected.total() > 300
    stats = bench.controller.stats
    assert stats.bad_crc + stats.bad_length > 100


def test_a_controller_that_only_beats_its_heart_is_stale(path: Path) -> None:
    bench = Bench(can=True)
    codec: Any = bench.controller._codec
    feed = codec.feed

    def deaf(now_s: float) -> None:
        if now_s > 0.5:
            codec.feed = lambda chunk: [m for m in feed(chunk) if not isinstance(m, Telemetry)]

    with pytest.raises(WorkError, match="limit staleness_s tripped: silence of the leg controller"):
        bench.record(path, 3.0, deaf)


def test_a_wall_clock_that_steps_changes_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, steps = Bench(), iter([3600.0, -7200.0, 1e6] * 10_000)
    wall, wall_ns = time.time, time.time_ns
    monkeypatch.setattr(time, "time", lambda: wall() + next(steps))
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns() + int(next(steps) * 1e9))
    raw = bench.record(path, 1.0)
    assert raw.complete
    assert not check_truth(bench, path).any()


def test_no_interval_of_a_recording_is_of_the_wall_clock() -> None:
    """It steps; where it stands at all it is a date for people."""
    asks = re.compile(r"\btime\.time(_ns)?\b|datetime\.(now|utcnow|today)|CLOCK_REALTIME|from time import .*\btime\b")
    found = {str(path.relative_to(ROOT)) for floor in ("drivers", "daq") for path in (ROOT / floor).rglob("*.py")
             if asks.search(path.read_text(encoding="utf-8"))}
    assert found == DATED


@pytest.fixture
def on_disk(path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., object]:
    """Records on the real clock with a file on a faulty disk."""
    create = mcap_run._create

    def run(seconds: float, **disk: Any) -> None:
        monkeypatch.setattr(mcap_run, "_create", lambda p: FaultyDisk(create(p), **disk))
        t = np.arange(0, seconds, 0.01)
        threaded(path, Plan(t, 0.1 * np.sin(t)), limits="staleness_s = 5.0\nclock_bound_s = 5.0\n")

    return run


def test_a_slow_disk_delays_no_device(path: Path, on_disk: Callable[..., object]) -> None:
    on_disk(1.0, delay_s=0.02)
    raw = read_run(path)
    assert raw.complete
    frames = raw.streams["/leg/telemetry"]
    lost = int((np.diff(frames["seq"].astype(int)) - 1).sum())
    assert lost < 0.05 * frames.size  # some, where the machine itself stands still for longer than a port buffers
    assert frames.size > 800


def test_a_full_disk_ends_the_run_with_the_motor_off_and_what_fitted_kept(
        path: Path, mocks: list[MockRig], on_disk: Callable[..., object]) -> None:
    with pytest.raises(WorkError, match=FULL + ", then repair the file with legid recover"):
        on_disk(20.0, room=150_000)
    drive = mocks[0].firmware.drive
    assert drive.torque_nm == 0.0 and drive.state != State.ARMED
    raw = read_run(path)
    assert not raw.complete and raw.streams["/leg/telemetry"].size > 300


def test_a_disk_that_is_full_from_the_start_leaves_no_file_and_the_name_free(
        tmp_path: Path, on_disk: Callable[..., object]) -> None:
    with pytest.raises(WorkError, match=FULL + "$"):
        on_disk(1.0, room=100)
    assert list(tmp_path.iterdir()) == []
