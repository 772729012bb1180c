"""Stop and Release in a real browser while folder, disk, network, files and parts of the page fail."""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from daq.recording import Plan, write_plan
from daq.recording.workers import real_time
from experiments.emulation import ServedRig
from tests.support.failing_live import ENTRY, PARTS
from tests.support.live_browser import Browser, Live, needs_browser, open_page
from tests.support.processes import REAL_CLOCK, until

pytestmark = [REAL_CLOCK, pytest.mark.slow]

pytest.importorskip("nicegui")
pytest.importorskip("selenium")


class FailingRig:
    """An emulated rig with a dashboard of which parts fail."""

    def __init__(self, folder: Path) -> None:
        with real_time():
            self.served = ServedRig(folder / "rig")
        self.out, self.switch = folder / "out", folder / "failing"
        self.switch.write_text("")
        t = np.arange(0.0, 60.0, 0.01)
        write_plan(Plan(t, 0.3 * np.sin(7.0 * t)), folder / "rig/plan.csv")
        for path in (folder / "rig").glob("plan?.csv"):
            path.unlink()
        os.environ[ENTRY] = str(self.switch)
        self.live = Live("--rig", str(self.served.rig_path), "--out", str(self.out),
                         module="tests.support.failing_live")

    def drives(self) -> bool:
        return abs(self.served.mock.firmware.drive.torque_nm) > 0.01

    def close(self) -> None:
        self.live.end()
        self.served.close()
        del os.environ[ENTRY]


@pytest.fixture(scope="module")
def rig(module_path: Path) -> Iterator[FailingRig]:
    rig = FailingRig(module_path)
    yield rig
    rig.close()


@pytest.fixture(scope="module")
def page(rig: FailingRig) -> Iterator[Browser]:
    with open_page(rig.live) as browser:
        yield browser


@contextmanager
def in_the_folder(make: Callable[[Path], None], out: Path) -> Iterator[None]:
    before = set(out.iterdir())
    make(out)
    try:
        yield
    finally:
        for path in set(out.iterdir()) - before:
            if not (path.name.startswith("run-2") and path.suffix == ".mcap"):
                path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


def dangling(out: Path) -> None:
    (out / "run-0.mcap").symlink_to(out / "nothing")


def circular(out: Path) -> None:
    (out / "run-0.mcap").symlink_to(out / "run-1.mcap")
    (out / "run-1.mcap").symlink_to(out / "run-0.mcap")


def pipes(out: Path) -> None:
    for name in ("run-0.mcap", "fit-0.json"):
        os.mkfifo(out / name)


def folders(out: Path) -> None:
    (out / "run-0.mcap").mkdir()


def names(out: Path) -> None:
    (Path(os.fsdecode(bytes(out) + b"/\xff\n<b>.mcap"))).write_bytes(b"")
    (out / '"><img src=x onerror=alert(1)>.mcap').write_bytes(b"")


REAL: dict[str, Callable[[Path], None]] = {
    "dangling link": dangling, "circular links": circular, "pipes": pipes, "folders": folders, "names": names}


@contextmanager
def vanishing(out: Path) -> Iterator[None]:
    """Run files that come and go all the time."""
    ended = threading.Event()

    def come_and_go() -> None:
        while not ended.is_set():
            for k in range(20):
                (out / f"gone{k}.mcap").write_bytes(b"")
            for k in range(20):
                with suppress(OSError):
                    (out / f"gone{k}.mcap").unlink()
    thread = threading.Thread(target=come_and_go)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def failing(rig: FailingRig, page: Browser, name: str) -> Iterator[None]:
    """This condition, as long as the block lasts."""
    if name in REAL:
        with in_the_folder(REAL[name], rig.out):
            yield
    elif name == "vanishing files":
        with vanishing(rig.out):
            yield
    elif name == "socket of the page":
        page.js("(window.socket.io.reconnection(false), window.socket.io.engine.close(), null)")
        try:
            yield
        finally:
            page.driver.refresh()
            page.wait(lambda: page.text("controller"), "the page comes up")
    else:
        rig.switch.write_text(name)
        try:
            yield
        finally:
            rig.switch.write_text("")


def stop_works(rig: FailingRig, page: Browser) -> None:
    """Stop is enabled in every phase from here to the end of the torque, and ends it."""
    deadline = time.monotonic() + 20.0
    while not rig.drives():
        assert page.enabled("stop") and time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.6)  # some turns of the page
    assert page.enabled("stop")
    page.mouse("stop")
    deadline = time.monotonic() + 5.0
    drive = rig.served.mock.firmware.drive
    while drive.torque_nm != 0.0:
        assert page.enabled("stop") and time.monotonic() < deadline, "still driven after Stop"
    assert until(lambda: drive.state.name != "ARMED", 10.0)


@needs_browser
@pytest.mark.parametrize("name", [*REAL, "vanishing files", "socket of the page", *PARTS])
def test_stop_is_enabled_and_stops_while_something_fails(rig: FailingRig, page: Browser, name: str) -> None:
    page.click("start")
    with failing(rig, page, name):
        stop_works(rig, page)
    page.wait(lambda: page.text("phase") not in ("Opening devices", "Recording", "Stopping"), "the run has ended")


@needs_browser
@pytest.mark.parametrize("name", ["dangling link", "runs: file vanished", "readings", "buttons", "list of runs"])
def test_a_page_opened_while_something_fails_stops_and_releases(rig: FailingRig, page: Browser, name: str) -> None:
    page.click("start")
    with failing(rig, page, name):
        page.wait(rig.drives, "the motor is driven")
        page.driver.refresh()
        page.wait(lambda: page.enabled("stop"), "Stop is enabled")
        page.mouse("estop")
        page.wait(lambda: not rig.drives(), "the torque is off")
        page.click("release")
        page.wait(lambda: page.js("document.getElementById('release').hidden"), "released")
    page.wait(lambda: page.text("phase") == "Idle", "the page is idle")


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of 2 MB at the folder."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)], capture_output=True,
                             check=False)
    if mounted.returncode:
        pytest.skip("this machine lets nobody mount a disk of his own")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@needs_browser
def test_a_disk_that_fills_up_while_the_motor_drives_takes_the_torque_off(tmp_path: Path) -> None:
    with small_disk(tmp_path / "out") as disk:
        rig = FailingRig(tmp_path)
        try:
            with open_page(rig.live) as page:
                page.click("start")
                page.wait(rig.drives, "the motor is driven")
                assert page.enabled("stop")
                filler = os.open(disk / "filler", os.O_WRONLY | os.O_CREAT)
                for size in (4096, 1):
                    with suppress(OSError):
                        while os.write(filler, bytes(size)):
                            pass
                deadline = time.monotonic() + 20.0
                while rig.drives():
                    assert page.enabled("stop") and time.monotonic() < deadline, "still driven on a full disk"
                page.wait(lambda: "No space left" in page.text("words"), "the cause is named")
                os.close(filler)
                (disk / "filler").unlink()
                page.click("start")
                stop_works(rig, page)
        finally:
            rig.close()
