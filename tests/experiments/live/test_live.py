"""`legid live` in a real browser, on an emulated rig that other processes open: what a person can see and do."""

import re
import signal
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.cookiejar import CookieJar
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest

from daq import load_rig
from daq.recording import Plan, write_plan
from daq.recording.workers import real_time
from daq.runs import RawRun, read_run
from drivers import State
from drivers.mock import STEP_NS
from drivers.protocol import Fault
from experiments.emulation import ServedRig
from experiments.excite import random_multisine
from tests.support.live_browser import LAPTOP, PHONE, Browser, Live, needs_browser, open_page
from tests.support.processes import REAL_CLOCK, until

pytestmark = REAL_CLOCK

pytest.importorskip("nicegui")
pytest.importorskip("selenium")
QUALITY = "document.querySelector('.quality')?.textContent ?? 'looked at'"
TICKED = "document.querySelector('.live-runs .q-checkbox').getAttribute('aria-checked')"
"""Of the newest run."""
PROMISED_MS = 100.0
ENTER, DOWN = ("Enter", "Enter", 13), ("ArrowDown", "ArrowDown", 40)


class Rig:
    """The emulated rig with its dashboard."""

    def __init__(self, folder: Path) -> None:
        with real_time():  # what it starts is not late, where that is granted
            self.served = ServedRig(folder / "rig")
        self.out = folder / "out"
        once = random_multisine(1, 5.0, 0.7)
        write_plan(once, folder / "rig/short.csv")
        write_plan(Plan(np.arange(12 * len(once.time_s)) / 100.0, np.tile(once.torque_nm, 12)),
                   folder / "rig/long.csv")
        self.live = self.start()

    def start(self, *more: str) -> Live:
        return Live("--rig", str(self.served.rig_path), "--out", str(self.out), *more)

    def plug_in(self) -> None:
        with real_time():
            self.served.plug_in()

    def commanded(self) -> tuple[np.ndarray, np.ndarray]:
        """(host time [ns], torque commanded [N m]) of every step of the emulated firmware."""
        with self.served.mock.lock:
            t_ns, commanded, _ = self.served.mock.firmware.record
        return t_ns, commanded

    def driven(self) -> None:
        """Wait until the motor has a torque."""
        drive = self.served.mock.firmware.drive
        assert until(lambda: abs(drive.torque_nm) >= 0.05, 20.0), "the motor is not driven"

    def off_after_ms(self, from_ns: int) -> float:
        """From then until the commanded torque was zero for good [ms]; it must have been driven then."""
        t_ns, commanded = self.commanded()
        last = int(np.flatnonzero(commanded)[-1])
        assert last + 1 < len(t_ns), "still driven"
        assert abs(commanded[t_ns <= from_ns][-1]) > 0.0
        return float(t_ns[last] + STEP_NS - from_ns) * 1e-6

    def newest(self) -> RawRun:
        return read_run(max(self.out.glob("*.mcap"), key=lambda path: path.stat().st_mtime))

    def close(self) -> None:
        self.live.end()
        self.served.close()


@pytest.fixture(scope="module")
def rig(module_path: Path) -> Iterator[Rig]:
    rig = Rig(module_path)
    yield rig
    rig.close()


@pytest.fixture(scope="module")
def window(rig: Rig) -> Iterator[Browser]:
    """One window for all tests here: a dashboard lives long."""
    with open_page(rig.live) as browser:
        yield browser


@pytest.fixture
def page(rig: Rig, window: Browser) -> Iterator[Browser]:
    """Nothing runs, nothing is latched; afterwards the browser has nothing to complain of."""
    rig.plug_in()
    window.wait(lambda: window.text("phase") not in ("Opening devices", "Recording", "Stopping"), "nothing runs")
    if window.text("phase") == "EMERGENCY STOP":
        window.click("release")
        window.phase("Idle")
    yield window
    assert window.outgoing() == []
    assert window.complaints() == []


def start(page: Browser, rig: Rig) -> None:
    """A recording that drives the motor."""
    page.click("start")
    page.phase("Recording")
    rig.driven()


@needs_browser
def test_a_run_by_keyboard_its_curves_its_fit_and_its_report(page: Browser, rig: Rig) -> None:
    page.js("document.getElementById('plan').focus()")
    for key in (DOWN, DOWN, ENTER):
        page.key(*key)
        time.sleep(0.4)
    page.wait(lambda: page.js("document.querySelector('#plan').closest('.q-field').innerText").count("short.csv"),
              "the plan is chosen by keyboard")
    page.wait(lambda: page.enabled("start"), "start is enabled")
    page.js("document.getElementById('start').focus()")
    assert page.js("getComputedStyle(document.getElementById('start')).outlineStyle") == "solid"
    page.key(*ENTER)
    page.phase("Recording")
    rig.driven()
    page.wait(lambda: page.text("drive-words") == "DRIVING", "the leg is driven, to be seen from across the room")
    assert page.js("parseFloat(getComputedStyle(document.getElementById('drive')).fontSize)") >= 38.0  # 1 cm
    page.phase("Finished")
    assert page.text("drive-words") in ("MOTOR OFF", "UNCLEAR")
    page.wait(lambda: "DISARMED" in page.text("motor"), "the controller confirms")
    raw = rig.newest()
    # gaps are the emulated chip's, which shares the test's process
    assert raw.complete and [note.kind for note in raw.events if note.kind != "imu gap"] == ["start", "stop"]
    last = page.js("[...document.querySelectorAll('[data-columns]')].map(box => getElement(Number("
                   "box.querySelector('.nicegui-echart').id.slice(1))).chart.getOption().series"
                   ".map(s => s.data.filter(p => p[1] !== null).length))")
    estimated = last[0].pop()  # this rig has a Hall sensor at its pivot
    assert [len(series) for series in last] == [2, 2, 1, 2] and min(map(min, last)) > 100 and estimated == 0
    legend = page.js("getElement(Number(document.querySelector('.nicegui-echart').id.slice(1))).chart.getOption()"
                     ".legend[0].data")
    assert legend == ["q1, pivot (Hall)", "q2, knee"]
    quality = page.wait(lambda: "looked at" not in page.js(QUALITY) and page.js(QUALITY), "the run is looked at", 60.0)
    flawed = bool(raw.streams["/imu"]["gap_before"].sum()) or "frames lost" in quality
    assert ("not sound" in quality) == flawed and page.js(TICKED) == ("false" if flawed else "true")
    if flawed:
        page.js("document.querySelector('.live-runs .q-checkbox').click()")
    page.click("fit")
    page.wait(lambda: "Fit of 1 run" in page.text("jobs") and ": running" not in page.text("jobs"), "the fit ends",
              180.0)
    assert "of 1 run: done" in page.text("jobs") and "the parameters" in page.text("jobs"), page.text("jobs")
    link = page.js("document.querySelector('#jobs a').href")
    report = Browser()
    try:
        report.driver.get(link)
        assert "Fit of leg2" in report.driver.title
        assert report.js("document.querySelectorAll('.plot canvas').length") == 6  # with the sketch
        assert report.outgoing() == [] and report.complaints() == []
    finally:
        report.close()
    with rig.start() as again, open_page(again) as other:  # what was found is there after a restart
        other.wait(lambda: "Fit of 1 run: done" in other.text("jobs"), "the verdict of the session before")
        assert "the parameters" in other.text("jobs")


@needs_browser
@pytest.mark.parametrize("way", ["Space", "on a phone"])
def test_emergency_stop_is_quick_has_no_ramp_and_latches(page: Browser, rig: Rig, way: str) -> None:
    """A click is measured on a phone, where the plots are drawn beside it; Escape takes the same way as Space."""
    page.resize(PHONE if way == "on a phone" else LAPTOP)
    for _ in range(3):  # a machine that has much else to do may be late once
        start(page, rig)
        page.wait(lambda: page.text("controller").startswith("armed, heard"), "the drive is armed")
        assert "samples, heard" in page.text("imu") and page.text("clock").endswith("µs")
        rig.driven()
        pressed_ns = time.monotonic_ns()
        if way == "Space":
            page.key(" ", "Space", 32)
        else:
            page.mouse("estop")
        page.phase("EMERGENCY STOP")
        if (took_ms := rig.off_after_ms(pressed_ns)) < PROMISED_MS:
            break
        page.click("release")
        page.phase("Idle")
    assert took_ms < PROMISED_MS
    assert "emergency stop" in page.text("words")
    assert page.text("motor") == "torque off, the controller says DISARMED"
    assert rig.served.mock.firmware.drive.state == State.DISARMED
    assert page.js("document.getElementById('start').disabled")
    raw = rig.newest()
    assert raw.complete and "emergency stop" in raw.events[-1].text
    sent_ns = raw.streams["/leg/command"]["host_ns"]
    assert (sent_ns > sent_ns[-1] - 60_000_000).sum() < 12  # the plan's, every 10 ms; a ramp has one every 2 ms
    page.resize(LAPTOP)
    page.click("release")
    page.phase("Idle")


@needs_browser
def test_space_is_an_ordinary_key_while_nothing_runs(page: Browser) -> None:
    page.js("document.querySelector('#stop').blur()")
    page.key(" ", "Space", 32)
    page.key("Escape", "Escape", 27)
    time.sleep(0.5)
    assert page.text("phase") != "EMERGENCY STOP"
    page.mouse("estop")
    page.phase("EMERGENCY STOP")
    assert "No recording was running" in page.text("words")


@needs_browser
def test_a_lost_controller_is_named_its_faults_cleared_and_the_next_run_stopped(page: Browser, rig: Rig) -> None:
    start(page, rig)
    rig.served.unplug_controller()
    page.phase("Device lost")
    page.wait(lambda: page.text("controller") == "LOST", "which device")
    assert page.text("imu") == "closed"
    assert "check cable and power" in page.text("words") and "watchdog stops it" in page.text("motor")
    assert rig.newest().complete
    rig.plug_in()
    page.wait(lambda: rig.served.mock.firmware.drive.latched == Fault.WATCHDOG, "the watchdog")
    page.click("clear")
    page.wait(lambda: "Clearing of faults: done" in page.text("checks"), "cleared")
    assert "disarmed, no fault" in page.text("checks")
    below, window = page.js("[document.querySelector('#checks .job').getBoundingClientRect().bottom"
                            " - document.getElementById('clear').getBoundingClientRect().top, innerHeight]")
    assert 0.0 < below < 0.5 * window  # who pressed the button sees the answer below it, wherever the page has scrolled
    # and the next run starts; Stop ends it in a controlled way
    start(page, rig)
    page.click("stop")
    page.phase("Stopped")
    assert "Stopped by the dashboard" in page.text("words")
    page.wait(lambda: "DISARMED" in page.text("motor"), "the controller confirms")
    commanded = rig.commanded()[1]
    last = int(np.flatnonzero(commanded)[-1])
    assert abs(commanded[last]) < 0.2 * np.abs(commanded[last - 400:]).max()  # ramped down
    raw = rig.newest()
    assert raw.complete and raw.events[-1].kind == "abort" and "dashboard" in raw.events[-1].text


@needs_browser
def test_a_lost_imu_is_named_and_the_motor_is_off(page: Browser, rig: Rig) -> None:
    start(page, rig)
    rig.served.unplug_imu()
    page.phase("Device lost")
    page.wait(lambda: page.text("imu") == "LOST", "which device")
    assert page.text("motor") == "torque off, the controller says DISARMED"
    assert rig.newest().complete


@needs_browser
def test_a_dashboard_that_hangs_says_so_and_its_recorder_stops(page: Browser, rig: Rig) -> None:
    start(page, rig)
    rig.live.child.send_signal(signal.SIGSTOP)
    try:
        page.wait(lambda: not page.js("document.getElementById('cut').hidden"), "the page says that it is cut off")
        assert until(lambda: rig.served.mock.firmware.drive.state != State.ARMED, 10.0), "the recorder goes on"
    finally:
        rig.live.child.send_signal(signal.SIGCONT)
    page.phase("Stopped")
    assert "silence of the dashboard" in page.text("words")
    page.wait(lambda: page.js("document.getElementById('cut').hidden"), "the page is back")


@needs_browser
def test_a_recorder_that_dies_is_said_to_have_died(page: Browser, rig: Rig) -> None:
    start(page, rig)
    (recorder,) = psutil.Process(rig.live.child.pid).children()
    recorder.kill()
    page.phase("Failed")
    assert "killed by signal 9" in page.text("words") and "legid recover" in page.text("words")
    assert "watchdog" in page.text("motor")
    page.wait(lambda: rig.served.mock.firmware.drive.latched == Fault.WATCHDOG, "the watchdog")
    rig.served.mock.firmware.drive.stop()
    rig.served.mock.firmware.drive.clear(Fault(0))


@needs_browser
@pytest.mark.parametrize("size", [PHONE, LAPTOP])
def test_nothing_is_wider_than_the_window_or_hidden_by_the_bar(page: Browser, size: tuple[int, int]) -> None:
    page.resize(size)
    try:
        time.sleep(0.3)
        assert page.sideways() <= 0
        page.js("scrollTo(0, document.documentElement.scrollHeight)")
        bar, last = (page.js(f"document.querySelector('{it}').getBoundingClientRect().{side}")
                     for it, side in (("#estop-bar", "top"), (".nicegui-content", "bottom")))
        cards = page.js("Math.max(...[...document.querySelectorAll('.card')]"
                        ".map(card => card.getBoundingClientRect().bottom))")
        assert cards <= bar + 1 and last >= cards
        assert page.js("document.getElementById('estop').getBoundingClientRect().height") >= 64
    finally:
        page.resize(LAPTOP)


@needs_browser
def test_two_fingers_zoom_all_plots_and_two_taps_show_all(page: Browser) -> None:
    plot = ".plots .nicegui-echart"
    zoomed = ("[...document.querySelectorAll(arguments[0])].map(e => getElement(Number(e.id.replace(/^c/, '')))"
              ".chart.getOption().dataZoom[0]).map(z => z.end - z.start)")
    page.resize(PHONE)
    try:
        page.js(f"document.querySelector('{plot}').scrollIntoView({{block: 'center'}})")
        page.touch("Start", plot, 0.5, 0.6)
        page.touch("Move", plot, 0.3, 0.8)
        page.touch("End", plot)
        assert page.js(zoomed, plot) == pytest.approx(4 * [20.0], rel=0.05)
        assert page.js("visualViewport.scale") == 1.0
        for _ in range(2):
            page.touch("Start", plot, 0.5)
            page.touch("End", plot)
        assert page.js(zoomed, plot) == 4 * [100.0]
    finally:
        page.resize(LAPTOP)


def test_another_host_needs_the_token(rig: Rig) -> None:
    with rig.start("--host", "0.0.0.0") as live:
        parts = urlsplit(live.url)
        here = f"http://127.0.0.1:{parts.port}"
        assert parts.query.startswith("token=") and len(parts.query) > 30
        for path in ("/", "/?token=wrong", "/_nicegui_ws/socket.io/?EIO=4&transport=polling", "/report/a.html"):
            assert status(here + path) == 403
        assert status(here + "/emergency", b"") == 403
        jar = urllib.request.HTTPCookieProcessor(CookieJar())
        opener = urllib.request.build_opener(jar)
        answer = opener.open(f"{here}/?{parts.query}", timeout=10)
        assert answer.status == 200 and "token" not in answer.url
        assert opener.open(f"{here}/", timeout=10).status == 200
        assert status(here + "/", headers={"Cookie": next(f"{c.name}=wrong" for c in jar.cookiejar)}) == 403


def test_without_a_token_only_this_machines_own_names_are_served(rig: Rig) -> None:
    port = urlsplit(rig.live.url).port
    here = f"http://127.0.0.1:{port}/"
    assert status(here) == 200
    assert status(here, headers={"Host": f"rebound.example:{port}"}) == 403
    assert status(here + "emergency", b"", {"Origin": "http://elsewhere.example"}) == 403
    assert status(here + "report/..%2Frig.toml") == 404
    with urllib.request.urlopen(here, timeout=10) as answer:
        assert "connect-src 'self'" in answer.headers["content-security-policy"]


def test_a_report_cannot_act_and_a_token_can_be_had_on_this_machine(rig: Rig) -> None:
    (rig.out / "evil.html").write_text("<script>fetch('/release', {method: 'POST'})</script>")
    with urllib.request.urlopen(f"{rig.live.url}report/evil.html", timeout=10) as answer:
        policies = answer.headers.get_all("content-security-policy")
    assert any(re.fullmatch(r"sandbox allow-scripts; default-src 'none'; script-src 'sha256-[^ ']+'; .*", policy)
               and "connect" not in policy for policy in policies)
    with rig.start("--token") as live:
        parts = urlsplit(live.url)
        assert parts.query.startswith("token=")
        assert status(f"http://127.0.0.1:{parts.port}/") == 403
        assert status(f"http://127.0.0.1:{parts.port}/here", b"") == 403


def test_the_demo_brings_its_own_rig_and_takes_it_away(tmp_path: Path) -> None:
    with Live("--demo", "--out", str(tmp_path)) as live:
        assert status(live.url) == 200
        port = Path(load_rig(tmp_path / "rig/rig.toml").devices.controller.port)
        assert port.is_symlink() and len(list((tmp_path / "rig").glob("plan*.csv"))) == 8
        assert live.end() == (0, "")
    assert not port.is_symlink()


def status(url: str, data: bytes | None = None, headers: dict[str, str] | None = None) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data, headers or {}), timeout=10) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code
