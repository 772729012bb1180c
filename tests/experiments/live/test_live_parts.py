"""What stands behind the dashboard: the recorder's line, an emulated rig for other processes, who may look in."""

import errno
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest
from smbus2 import i2c_msg

from daq import WorkError, parse_rig
from daq.recording import EMERGENCY, STOP, Ended, Heard, Remote, Row, Status
from daq.recording.host_load import HostLoad, busy_words
from daq.runs import read_run
from drivers import DeviceAbsent, Lsm9ds1, open_bus
from drivers.i2c_socket import SocketBus
from drivers.mock import I2cServer, MockRig
from experiments.live.charts import CHARTS
from experiments.live.jobs import Tail, past_jobs
from experiments.live.readings import limit_rows, readings
from experiments.live.session import Phase, Session
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK, until
from tests.support.still_plant import StillPlant
from tests.support.watched_bench import RIG, Bench

pytestmark = REAL_CLOCK
EMULATED = parse_rig(RIG)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path / "rig.toml", tmp_path)


def test_a_watcher_sees_the_whole_run_at_most_five_times_a_second(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 3.0)
    bench.record()
    first, *between, last = bench.read()
    assert isinstance(first, Status) and first.phase == "opening"
    assert last == Ended("done", "", "torque off, the controller says DISARMED")
    statuses = [one for one in between if isinstance(one, Status)]
    assert [one.phase for one in statuses] == sorted((one.phase for one in statuses), key="waiting driving ending".find)
    assert {one.phase for one in statuses} == {"waiting", "driving", "ending"}
    rows = [row for one in statuses for row in one.rows]
    times = np.array([row.time_s for row in rows])
    assert (np.diff(times) >= 0.04).all() and times[-1] == pytest.approx(4.3, abs=0.3)
    assert len(statuses) <= 5 * times[-1] + 2
    assert {row.torque_cmd_nm for row in rows} == {0.0, 0.4}
    assert rows[-1].accel_y_mps2 == pytest.approx(-9.81, abs=0.3) and rows[-1].q2_rad is not None
    driving = [one for one in statuses if one.phase == "driving"][-1]
    assert driving.controller == "armed" and driving.total_s == pytest.approx(3.0) and driving.imu_samples > 500
    assert ("torque_nm", "commanded torque in N m", 0.4, 2.0) in driving.watched
    assert read_run(bench.path).complete


@pytest.mark.parametrize("hall", [True, False])
def test_a_watcher_is_told_whether_q1_is_measured_or_estimated(hall: bool, tmp_path: Path) -> None:
    """Without a sensor at the pivot q1 is the IMU's, and stands in a column of its own."""
    bench = Bench(tmp_path)
    bench.mock.firmware.pivot_hall_ok = hall
    bench.clock.sleep(0.02)
    bench.controller.poll()  # what was under way before
    bench.record()
    rows = [row for one in bench.read() if isinstance(one, Status) for row in one.rows][5:]
    assert len(rows) > 30
    assert {row.q1_rad is not None for row in rows} == {hall} and {row.q1_imu_rad is None for row in rows} == {hall}
    told = np.array([row.q1_rad if hall else row.q1_imu_rad for row in rows])
    assert np.abs(told).max() < 0.05


def test_a_watcher_that_reads_nothing_delays_and_loses_nothing(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 12.0)
    bench.line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    bench.record()
    raw = read_run(bench.path)
    assert raw.complete and 1 < len(bench.read()) < 40  # of sixty
    assert (np.diff(raw.streams["/leg/telemetry"]["seq"].astype(int)) % 65536 == 1).all()
    assert raw.streams["/leg/command"].size >= 1200


def struck(bench: Bench, act: Callable[[], object], why: str) -> None:
    """A recording that ends so, half a second after it began."""
    def happens(now_s: float, remote: Remote) -> None:
        if now_s > 0.5 and not remote.asked:
            act()
            assert until(lambda: remote.asked)  # the listening thread runs on the machine's own clock

    with pytest.raises(WorkError, match=why):
        bench.record(happens)


def test_stop_ramps_and_an_emergency_does_not(tmp_path: Path) -> None:
    for packet, kind, why in ((STOP, "stopped", "stopped by the dashboard"),
                              (EMERGENCY, "emergency", "stopped by the emergency stop")):
        bench = Bench(tmp_path / kind)
        struck(bench, partial(bench.watcher.send, packet), why)
        ended = bench.read()[-1]
        assert isinstance(ended, Ended) and ended.kind == kind
        assert ended.motor == "torque off, the controller says DISARMED"
        assert (Heard() in bench.packets) is (kind == "emergency")
        assert bench.ramped() is (kind == "stopped")


def test_no_command_follows_an_emergency_and_the_stop_waits_for_nobody(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    order = []
    stop, command = bench.controller.stop, bench.controller.command
    bench.controller.stop = lambda: (order.append("stop"), stop())[1]
    bench.controller.command = lambda torque_nm: (order.append("command"), command(torque_nm))[1]

    def happens(now_s: float, remote: Remote) -> None:
        if now_s > 0.5 and not remote.asked:
            bench.watcher.send(EMERGENCY)
            assert until(lambda: order[-1] == "stop")  # while the recorder's own thread is held up right here

    with pytest.raises(WorkError, match="emergency"):
        bench.record(happens)
    assert "command" not in order[order.index("stop"):]


def test_a_watcher_that_has_gone_ends_the_run(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    struck(bench, bench.watcher.close, "silence of the dashboard")
    raw = read_run(bench.path)
    assert raw.complete and "silence of the dashboard" in raw.events[-1].text
    assert bench.mock.firmware.drive.torque_nm == 0.0


def test_a_watcher_that_hangs_costs_the_torque_at_once(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    stopped_ns = []
    stop = bench.controller.stop
    bench.controller.stop = lambda: (stopped_ns.append(time.monotonic_ns()), stop())[1]
    struck(bench, lambda: setattr(bench, "beating", False), "silence of the dashboard")
    assert (stopped_ns[0] - bench.beat_ns) * 1e-9 < 0.2
    ended = bench.read()[-1]
    assert isinstance(ended, Ended) and ended.kind == "stopped" and "torque off" in ended.motor
    assert not bench.ramped()


def test_a_limit_and_a_lost_device_are_told_apart(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    def hot(now_s: float, remote: Remote) -> None:
        bench.mock.firmware.motor_degc = 80.0

    with pytest.raises(WorkError, match="temperature"):
        bench.record(hot)
    assert bench.read()[-1].kind == "limit"
    bench = Bench(tmp_path / "lost")
    with pytest.raises(WorkError, match="no acknowledge"):
        bench.record(lambda now_s, remote: bench.mock.imu.fail(errno.EREMOTEIO, 20) if now_s > 0.5 else None)
    assert bench.read()[-1].kind == "lost"


# -- an emulated rig for other processes ---------------------------------------------------------------------------


def test_a_bus_behind_a_socket_is_the_bus(tmp_path: Path) -> None:
    mock = MockRig(StillPlant())
    with I2cServer(mock.imu, tmp_path / "i2c") as server:
        bus = open_bus(server.path)
        assert isinstance(bus, SocketBus)
        reply = i2c_msg.read(0x6B, 1)
        bus.i2c_rdwr(i2c_msg.write(0x6B, [0x0F]), reply)
        assert bytes(reply) == b"\x68"
        with pytest.raises(OSError) as wrong:
            bus.i2c_rdwr(i2c_msg.write(0x1E, [0x0F]))
        assert wrong.value.errno == errno.EREMOTEIO
        imu = Lsm9ds1(bus)
        imu.open()
        assert until(lambda: len(imu.drain().raw))
        imu.close()
        bus = open_bus(server.path)
        server.close()
        with pytest.raises(OSError) as gone:
            bus.i2c_rdwr(i2c_msg.write(0x6B, [0x0F]), i2c_msg.read(0x6B, 1))
        assert gone.value.errno == errno.ENODEV
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    dead.bind(str(tmp_path / "dead"))
    with dead, pytest.raises(DeviceAbsent, match="start the emulated rig again"):
        open_bus(str(tmp_path / "dead"))


def test_the_emulated_rig_serves_until_it_is_told_to_end(tmp_path: Path) -> None:
    child = subprocess.Popen([sys.executable, "-m", "legid.cli", "emulate", "--out", tmp_path / "rig"], cwd=ROOT,
                             stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline().startswith(str(tmp_path / "rig/rig.toml"))
    assert len(list((tmp_path / "rig").glob("plan*.csv"))) == 8
    child.send_signal(signal.SIGTERM)
    assert child.wait(10) == 0
    child.stdout.close()


# -- what the page shows -------------------------------------------------------------------------------------------


def test_readings_follow_the_recorder(session: Session) -> None:
    assert readings(session, EMULATED, 0)["text"]["controller"] == "closed: a recording opens it"
    session.phase, session.heard_s = Phase.RECORDING, time.monotonic()
    row = Row(1.0, None, 0.123456789, float("nan"), 0.0, 0.0, 0.0, 0.0)
    session._hear(msgspec.json.encode(Status(
        "driving", [row, row], 1.0, 4.0, "armed", 0.002, 0.011, 476, frames_lost=3, clock_bound_s=70e-6,
        watched=[("speed_radps", "knee speed in rad/s", -12.0, 15.0), ("clock_bound_s", "clock uncertainty in s", 7e-5,
                                                                      0.005)])))
    shown = readings(session, EMULATED, 1)
    assert shown["rows"] == [[1.0, None, 0.12346, None, 0.0, 0.0, 0.0, 0.0, None]]
    assert shown["progress"] == 0.25 and shown["running"]
    text = shown["text"]
    assert text["controller"] == "armed, heard 2 ms ago" and text["imu"] == "476 samples, heard 11 ms ago"
    assert text["clock"] == "70 µs" and text["drops"].startswith("3: telemetry 3 lost")
    assert text["limit-q2_speed_radps"] == "-12.0" and shown["bars"]["limit-q2_speed_radps"] == pytest.approx(0.8)
    assert text["limit-clock_bound_s"] == "0.0001" and text["silence"] == ""
    session.heard_s -= 5.0
    assert "No message from the recorder for 5 s" in readings(session, EMULATED, 2)["text"]["silence"]
    assert {key for key, _, _ in limit_rows(EMULATED.limits)} == set(shown["bars"])


def test_the_room_sees_whether_the_leg_may_move_and_what_is_unknown_counts_as_danger(session: Session, tmp_path: Path
                                                                                     ) -> None:
    def shown() -> tuple[str, str]:
        found = readings(session, EMULATED, 0)
        return found["drive"], found["driveWords"]

    assert shown() == ("off", "NOT DRIVEN")
    session.phase = Phase.OPENING
    assert shown() == ("unknown", "UNCLEAR")
    session.phase, session.heard_s = Phase.RECORDING, time.monotonic()
    for phase, controller, drive in (("waiting", "disarmed", "off"), ("waiting", "armed", "armed"),
                                     ("driving", "armed", "driving"), ("ending", "disarmed", "off")):
        session._hear(msgspec.json.encode(Status(phase, [], 1.0, 4.0, controller)))  # type: ignore[arg-type]
        assert shown()[0] == drive
    session.heard_s -= 5.0
    assert shown() == ("unknown", "UNCLEAR")
    for motor, drive in (("torque off, the controller says DISARMED", "off"),
                         ("stop sent, the firmware's watchdog stops it", "unknown")):
        session._ended = Ended("lost", "gone", motor)
        session._end(1, "", tmp_path / "r.mcap")
        assert shown()[0] == drive


def test_a_run_with_gaps_is_not_simply_finished_and_a_busy_computer_is_no_lost_device(session: Session, tmp_path: Path
                                                                                      ) -> None:
    for gaps, tone in ((0, "good"), (69, "busy")):
        session.phase = Phase.RECORDING
        session._hear(msgspec.json.encode(Status("driving", [], 4.0, 4.0, "armed", imu_gaps=gaps)))
        session._ended = Ended("done", "", "torque off")
        session._end(0, "", tmp_path / "r.mcap")
        assert readings(session, EMULATED, 0)["tone"] == tone and ("69 gaps" in session.words) == bool(gaps)
    session._ended = Ended("overload", f"silence of the IMU; {busy_words(0.2)}", "torque off")
    session._end(1, "", tmp_path / "r.mcap")
    shown = readings(session, EMULATED, 0)
    assert shown["phase"] == "Computer too busy" and "LOST" not in shown["text"].values()


@pytest.mark.parametrize("waited_ms, turn_ms, busy", [(200, 210, True), (1, 210, False), (30, 31, False)])
def test_only_waiting_for_a_processor_is_overload(tmp_path: Path, waited_ms: int, turn_ms: int, busy: bool) -> None:
    """A turn that a device blocks takes as long, and nobody waited for a processor."""
    source = tmp_path / "schedstat"
    source.write_text("1000 5000000 7")
    load, now = HostLoad(0, source), 0
    for _ in range(300):
        now += 1_000_000
        load.look(now)
    source.write_text(f"1000 {5_000_000 + waited_ms * 1_000_000} 7")
    now += turn_ms * 1_000_000
    load.look(now)
    assert bool(busy_words(load.stalled_s(now + 100_000_000))) == busy
    assert not busy_words(load.stalled_s(now + 3_000_000_000))
    assert not HostLoad(0, tmp_path / "none").stalled_s(now)


def test_a_silence_while_the_computer_was_busy_is_told_as_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same silence twice, of half a second: of a device, and of a recorder that got no processor."""
    def silence(now_s: float, remote: Remote) -> None:
        if now_s > 0.5:
            bench.mock.imu.push = lambda raw: None

    for stalled_s, kind in ((0.0, "lost"), (0.2, "overload")):
        monkeypatch.setattr(HostLoad, "stalled_s", lambda self, now_ns, s=stalled_s: s)
        bench = Bench(tmp_path / kind)
        with pytest.raises(WorkError, match="silence" if kind == "lost" else "silence.*too busy"):
            bench.record(silence)
        assert bench.read()[-1].kind == kind


def test_verdicts_of_an_earlier_session_come_back(tmp_path: Path) -> None:
    origin = {"version": "1", "commit": "c", "runs": [{"file": "a.mcap", "sha256": "0"}]}
    fit = {"schema": "legid.fit/1", "converged": True, "iterations": 8, "samples": 20, "torque_residual_rms_nm": [0.1],
           "trust": {"sentence": "TRUST nobody."}, "provenance": origin}
    for name, document in (("fit-1.json", fit), ("fit-2.json", fit | {"converged": False}),
                           ("diagnosis-3.json", {"schema": "legid.diagnosis/1", "verdict": "none",
                                                 "sentence": "Nothing.", "provenance": origin}),
                           ("fit-4.json", {"schema": "other"}), ("fit-5.json", [1])):
        (tmp_path / name).write_text(json.dumps(document))
        os.utime(tmp_path / name, (1e9 + int(name[-6]),) * 2)
    (tmp_path / "fit-1.html").write_text("")
    found = past_jobs(tmp_path / "rig.toml", tmp_path)
    assert [(job.kind, job.state) for job in found] == [("diagnose", "done"), ("fit", "failed"), ("fit", "done")]
    assert found[0].verdict == "none: Nothing." and found[2].verdict == "TRUST nobody."
    assert found[2].report == tmp_path / "fit-1.html" and found[0].report is None
    assert found[2].runs == [tmp_path / "a.mcap"] and found[2].when


def test_every_curve_is_a_column_of_a_row() -> None:
    columns = [column for chart in CHARTS for _, column in chart.series]
    assert sorted(columns) == list(range(1, len(Row._fields)))


def test_progress_bars_are_read_from_a_terminal() -> None:
    tail, pieces = Tail(), []
    for text in ("\rdiagnosing:   0%|   | 00:00", "\rdiagnosing: scoring effects  3", "4%|##  | 00:02\r",
                 "\x1b[A\rlegid diag", "nose: too few runs\r\n"):
        pieces += tail.feed(text)
    assert "diagnosing: scoring effects  34%|##  | 00:02" in pieces
    assert tail.line == "legid diagnose: too few runs"
