"""What stands behind the dashboard: the recorder's line, an emulated rig for other processes, who may look in."""

import errno
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import pytest
from smbus2 import i2c_msg

from daq.errors import InputError, WorkError
from daq.recording.plan import Plan
from daq.recording.recorder import record_run
from daq.recording.remote import ALIVE, EMERGENCY, PACKET_BYTES, STOP, Ended, Heard, Remote, Row, Status, watched_by
from daq.rig import parse_rig
from daq.runs.mcap_run import read_run
from drivers.errors import DeviceAbsent, DeviceBusy
from drivers.i2c_bus import open_bus
from drivers.i2c_socket import SocketBus
from drivers.leg_controller import LegController
from drivers.lsm9ds1 import Lsm9ds1
from drivers.mock.clock import VirtualClock
from drivers.mock.i2c_server import I2cServer
from drivers.mock.link import EmulatorLink
from drivers.mock.plant import StillPlant
from drivers.mock.rig import MockRig
from experiments import cli
from experiments.live.access import Access, is_loopback
from experiments.live.charts import CHARTS
from experiments.live.jobs import Tail, fit_verdict
from experiments.live.readings import limit_rows, readings
from experiments.live.session import Phase, Session
from tests.support.paths import ROOT

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[devices.imu]\n[devices.controller]\n'


class Bench:
    """A recording on virtual time with a watcher at the other end of the line."""

    def __init__(self, folder: Path, seconds: float = 2.0) -> None:
        self.clock = VirtualClock()
        self.mock = MockRig(StillPlant(), self.clock)
        self.controller = LegController(EmulatorLink(self.mock.firmware, self.clock), self.clock.now_ns)
        self.controller.open()
        self.imu = Lsm9ds1(self.mock.imu, now_ns=self.clock.now_ns, sleep=self.clock.sleep)
        self.imu.open()
        t = np.arange(0.0, seconds, 0.01)
        self.plan = Plan(t, np.full(t.size, 0.4))
        self.path = folder / "run.mcap"
        self.watcher, self.line = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.watcher.setblocking(False)
        self.packets: list[Status | Heard | Ended] = []

    def record(self, happens: Callable[[float, Remote], None] = lambda now_s, remote: None) -> None:
        """Under `watched_by`, as the command does it; `happens` is called before every command of the plan."""
        descriptor = self.line.detach()
        self.beating = True
        threading.Thread(target=self._beat, daemon=True).start()
        with watched_by(descriptor) as remote:
            assert remote is not None

            def progress(now_s: float, _: float) -> None:
                happens(now_s, remote)

            record_run(self.path, parse_rig(RIG), RIG, self.plan, self.imu, self.controller, self.clock.now_ns,
                       threaded=False, progress=progress, remote=remote)

    def _beat(self) -> None:
        with suppress(OSError):  # a test may have closed it
            while True:
                if self.beating:
                    with suppress(BlockingIOError):
                        self.watcher.send(ALIVE)
                self.beat_ns = time.monotonic_ns() if self.beating else self.beat_ns
                time.sleep(0.02)

    def read(self) -> list[Status | Heard | Ended]:
        """Everything that the watcher was told."""
        while True:
            try:
                packet = self.watcher.recv(PACKET_BYTES)
            except BlockingIOError:
                return self.packets
            if not packet:
                return self.packets
            self.packets.append(msgspec.json.decode(packet, type=Status | Heard | Ended))


def until(condition: Callable[[], object]) -> None:
    """The listening thread runs on the machine's own clock."""
    deadline = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


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


def test_a_watcher_that_reads_nothing_delays_and_loses_nothing(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 12.0)
    bench.line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    bench.record()
    raw = read_run(bench.path)
    assert raw.complete and 1 < len(bench.read()) < 40  # of sixty
    assert (np.diff(raw.streams["/leg/telemetry"]["seq"].astype(int)) % 65536 == 1).all()
    assert raw.streams["/leg/command"].size >= 1200


def test_stop_ramps_and_an_emergency_does_not(tmp_path: Path) -> None:
    for packet, kind, why in ((STOP, "stopped", "stopped by the dashboard"),
                              (EMERGENCY, "emergency", "stopped by the emergency stop")):
        (folder := tmp_path / kind).mkdir()
        bench = Bench(folder)

        def happens(now_s: float, remote: Remote, bench: Bench = bench, packet: bytes = packet) -> None:
            if now_s > 1.0 and not remote.asked:
                bench.watcher.send(packet)
                until(lambda: remote.asked)

        with pytest.raises(WorkError, match=why):
            bench.record(happens)
        ended = bench.read()[-1]
        assert isinstance(ended, Ended) and ended.kind == kind
        assert ended.motor == "torque off, the controller says DISARMED"
        assert (Heard() in bench.packets) is (kind == "emergency")
        commanded = read_run(bench.path).streams["/leg/command"]["torque_nm"]
        between = commanded[(commanded > 0) & (commanded < 0.4)]
        assert bool(between.size) is (kind == "stopped")  # a ramp, or none


def test_no_command_follows_an_emergency_and_the_stop_waits_for_nobody(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    order: list[str] = []
    stop, command = bench.controller.stop, bench.controller.command
    bench.controller.stop = lambda: (order.append("stop"), stop())[1]  # type: ignore[method-assign]
    bench.controller.command = lambda nm: (order.append("command"), command(nm))[1]  # type: ignore[method-assign]

    def happens(now_s: float, remote: Remote) -> None:
        if now_s > 0.5 and not remote.asked:
            bench.watcher.send(EMERGENCY)
            until(lambda: order[-1] == "stop")  # while the recorder's own thread is held up right here

    with pytest.raises(WorkError, match="emergency"):
        bench.record(happens)
    assert "command" not in order[order.index("stop"):]


def test_a_watcher_that_has_gone_ends_the_run(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    def happens(now_s: float, remote: Remote) -> None:
        if now_s > 0.5 and not remote.asked:
            bench.watcher.close()
            until(lambda: remote.asked)

    with pytest.raises(WorkError, match="silence of the dashboard"):
        bench.record(happens)
    raw = read_run(bench.path)
    assert raw.complete and "silence of the dashboard" in raw.events[-1].text
    assert bench.mock.firmware.drive.torque_nm == 0.0


def test_a_watcher_that_hangs_costs_the_torque_at_once(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    stopped_ns: list[int] = []
    stop = bench.controller.stop
    bench.controller.stop = lambda: (stopped_ns.append(time.monotonic_ns()), stop())[1]  # type: ignore[method-assign]

    def happens(now_s: float, remote: Remote) -> None:
        if now_s > 0.5 and not remote.asked:
            bench.beating = False
            until(lambda: remote.asked)

    with pytest.raises(WorkError, match="silence of the dashboard"):
        bench.record(happens)
    assert (stopped_ns[0] - bench.beat_ns) * 1e-9 < 0.2
    ended = bench.read()[-1]
    assert isinstance(ended, Ended) and ended.kind == "stopped" and "torque off" in ended.motor
    commanded = read_run(bench.path).streams["/leg/command"]["torque_nm"]
    assert not ((commanded > 0) & (commanded < 0.4)).any()  # no ramp


def test_a_limit_and_a_lost_device_are_told_apart(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    def hot(now_s: float, remote: Remote) -> None:
        bench.mock.firmware.motor_degc = 80.0

    with pytest.raises(WorkError, match="temperature"):
        bench.record(hot)
    assert bench.read()[-1].kind == "limit"  # type: ignore[union-attr]
    (tmp_path / "lost").mkdir()
    bench = Bench(tmp_path / "lost")
    with pytest.raises(WorkError, match="no acknowledge"):
        bench.record(lambda now_s, remote: bench.mock.imu.fail(errno.EREMOTEIO, 20) if now_s > 0.5 else None)
    assert bench.read()[-1].kind == "lost"  # type: ignore[union-attr]


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
        until(lambda: len(imu.drain().raw))
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
    child = subprocess.Popen([sys.executable, "-m", "experiments.cli", "emulate", "--out", tmp_path / "rig"], cwd=ROOT,
                             stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline().startswith(str(tmp_path / "rig" / "rig.toml"))
    assert len(list((tmp_path / "rig").glob("plan*.csv"))) == 8
    child.send_signal(signal.SIGTERM)
    assert child.wait(10) == 0
    child.stdout.close()


# -- what the page shows -------------------------------------------------------------------------------------------


def test_readings_follow_the_recorder(tmp_path: Path) -> None:
    rig, session = parse_rig(RIG), Session(tmp_path / "rig.toml", tmp_path)
    assert readings(session, rig, 0)["text"]["controller"] == "closed: a recording opens it"
    session.phase, session.heard_s = Phase.RECORDING, time.monotonic()
    row = Row(1.0, None, 0.123456789, float("nan"), 0.0, 0.0, 0.0, 0.0)
    session._hear(msgspec.json.encode(Status(
        "driving", [row, row], 1.0, 4.0, "armed", 0.002, 0.011, 476, frames_lost=3, clock_bound_s=70e-6,
        watched=[("speed_radps", "knee speed in rad/s", -12.0, 15.0), ("clock_bound_s", "clock uncertainty in s", 7e-5,
                                                                      0.005)])))
    shown = readings(session, rig, 1)
    assert shown["rows"] == [[1.0, None, 0.12346, None, 0.0, 0.0, 0.0, 0.0]]
    assert shown["progress"] == 0.25 and shown["running"]
    text = shown["text"]
    assert text["controller"] == "armed, heard 2 ms ago" and text["imu"] == "476 samples, heard 11 ms ago"
    assert text["clock"] == "70 µs" and text["drops"].startswith("3: telemetry 3 lost")
    assert text["limit-q2_speed_radps"] == "-12.0" and shown["bars"]["limit-q2_speed_radps"] == pytest.approx(0.8)
    assert text["limit-clock_bound_s"] == "0.0001" and text["silence"] == ""
    session.heard_s -= 5.0
    assert "nothing for 5 s" in readings(session, rig, 2)["text"]["silence"]
    assert {key for key, _, _ in limit_rows(rig.limits)} == set(shown["bars"])


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


def test_a_fit_in_one_line() -> None:
    document = {"iterations": 8, "samples": 2000, "torque_residual_rms_nm": [0.01, 0.0203], "undetermined": ["beta4"]}
    assert fit_verdict(document) == ("Converged in 8 iterations on 2000 samples; not determined: beta4; torque "
                                     "residual by joint 0.01, 0.0203 N m rms.")


def test_only_who_pressed_releases_or_somebody_at_the_machine(tmp_path: Path) -> None:
    session = Session(tmp_path / "rig.toml", tmp_path)
    session.emergency("a1")
    assert session.latched and session.phase is Phase.EMERGENCY
    assert not session.release("b2") and not session.release("") and session.latched
    session.emergency("b2")
    assert session.release("b2") and session.latched  # the other has pressed, too
    assert session.release("a1") and not session.latched
    assert session.phase is Phase.IDLE
    session.emergency()
    assert not session.release("") and session.latched
    assert session.release("", at_machine=True) and not session.latched


# -- who may look in -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("host", "own"), [
    ("127.0.0.1", True), ("localhost", True), ("::1", True), ("[::1]", True), ("0.0.0.0", False),
    ("192.168.1.5", False), ("127.0.0.1.example", False), ("", False)])
def test_only_this_machines_names_are_its_own(host: str, own: bool) -> None:
    assert is_loopback(host) is own


@pytest.mark.parametrize(("kind", "headers", "token", "passes"), [
    ("websocket", {"host": "localhost:1"}, None, True),
    ("websocket", {"host": "localhost:1", "origin": "http://localhost:1"}, None, True),
    ("websocket", {"host": "localhost:1", "origin": "http://evil.example"}, None, False),
    ("websocket", {"host": "evil.example"}, None, False),
    ("websocket", {"host": "leg:1", "cookie": "legid_live_1=s3"}, "s3", True),
    ("websocket", {"host": "leg:1", "cookie": "legid_live_1=s4"}, "s3", False),
    ("websocket", {"host": "leg:1"}, "s3", False), ("http", {"host": "leg:1"}, "s3", False),
    ("http", {"host": "leg:1", "cookie": "legid_live_1=s3; other=1"}, "s3", True),
    ("http", {"host": "leg:1", "cookie": "legid_live_1=é"}, "s3", False)])
def test_sockets_and_pages_of_strangers_are_refused(kind: str, headers: dict[str, str], token: str | None,
                                                    passes: bool) -> None:
    import asyncio

    reached: list[str] = []
    sent: list[dict] = []

    async def app(scope: dict, receive: object, send: object) -> None:
        reached.append(scope["type"])

    async def send(message: dict) -> None:
        sent.append(message)

    scope = {"type": kind, "path": "/", "query_string": b"",
             "headers": [(k.encode(), v.encode("latin-1")) for k, v in headers.items()]}
    asyncio.run(Access(app, token, 1)(scope, None, send))  # type: ignore[arg-type]
    assert bool(reached) is passes
    assert passes or sent[0].get("status", 403) == 403


def test_without_the_extra_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch,
                                                         capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert cli.main(["live", "--demo"]) == 1
    assert capsys.readouterr().err == "legid live: needs the extra: pip install legid[live]\n"


def test_bad_arguments_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("nicegui")
    out = ["--out", str(tmp_path / "o")]
    assert cli.main(["live", "--rig", str(tmp_path / "none.toml"), *out]) == 2
    (tmp_path / "rig.toml").write_text(RIG)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert cli.main(["live", "--rig", str(tmp_path / "rig.toml"), "--port", port, *out]) == 2
    assert cli.main(["live", "--rig", str(tmp_path / "rig.toml"), "--host", "nowhere.invalid", *out]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3 and "none.toml" in said[0] and "give another, or 0" in said[1] and "--host" in said[2]


@pytest.mark.parametrize(("error", "kind"), [
    (InputError("plan.csv, line 3", "time runs backwards", "sort it"), "failed"),
    (DeviceAbsent("leg controller on /dev/x: no such port; plug it in"), "lost"),
    (DeviceBusy("leg controller on /dev/x: another program holds the port; close it"), "failed")])
def test_what_ends_a_run_before_it_began_reaches_the_watcher(error: Exception, kind: str) -> None:
    watcher, line = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with watcher:
        with pytest.raises(type(error)), watched_by(line.detach()):
            raise error
        packets = []
        while select.select([watcher], [], [], 1.0)[0] and (packet := watcher.recv(PACKET_BYTES)):
            packets.append(msgspec.json.decode(packet, type=Status | Heard | Ended))
    assert packets[-1] == Ended(kind, str(error), "never driven")  # type: ignore[arg-type]
