"""The dashboard in a real headless Chromium, the rig that it records from, and what went over the network."""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

import pytest

from tests.support.paths import ROOT
from tests.support.processes import favoured

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
PATIENCE_S = 30.0
LAPTOP, PHONE = (1280, 900), (390, 844)
needs_browser = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no chromium with its chromedriver here")


class Browser:
    """One window. Every line of its console is kept and, with `network`, every request: that takes memory in it."""

    def __init__(self, size: tuple[int, int] = LAPTOP, network: bool = True) -> None:
        webdriver = pytest.importorskip("selenium.webdriver")
        if CHROMIUM is None or DRIVER is None:
            pytest.skip("no chromium with its chromedriver here")
        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu",
                         "--disable-background-networking", "--disable-component-update", "--no-first-run",
                         "--force-color-profile=srgb"):
            options.add_argument(argument)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"} | ({"performance": "ALL"} if network else {}))
        with favoured():
            self.driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
        self.driver.set_script_timeout(PATIENCE_S)
        self._network = network
        self.requests: list[str] = []
        self.console: list[str] = []
        self.resize(size)

    def resize(self, size: tuple[int, int]) -> None:
        """A window of that size in CSS pixels, as a phone's or a laptop's."""
        self.cdp("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1,
                 mobile=size[0] < 600)

    def show(self, page: Path, size: tuple[int, int] = LAPTOP) -> None:
        """A page from the disk, in a window of that size."""
        self.resize(size)
        self.driver.get(page.as_uri())

    def media(self, kind: str) -> None:
        """The page as it is printed ("print") or seen ("")."""
        self.cdp("Emulation.setEmulatedMedia", media=kind)

    def cdp(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the browser's own protocol."""
        return self.driver.execute_cdp_cmd(method, parameters)

    def js(self, code: str, *arguments: Any) -> Any:
        """The value of `return CODE`."""
        return self.driver.execute_script(f"return {code}", *arguments)

    def text(self, element: str) -> str:
        """Text of the element with this id."""
        return self.js("document.getElementById(arguments[0])?.textContent ?? ''", element)

    def wait(self, condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
        """The first true value of `condition`."""
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            if value := condition():
                return value
            time.sleep(0.05)
        raise AssertionError(f"{what}: not within {patience_s:g} s; phase {self.text('phase')!r}, "
                             f"words {self.text('words')!r}")

    def phase(self, *wanted: str) -> str:
        """Wait until the page is in one of these states."""
        self.wait(lambda: self.text("phase") in wanted, " or ".join(wanted), PATIENCE_S)
        return self.text("phase")

    def click(self, element: str) -> None:
        """A real click, on the middle of an element that can be clicked."""
        self.wait(lambda: self.enabled(element), f"#{element} can be clicked")
        self.js("document.getElementById(arguments[0]).scrollIntoView({block: 'center'})", element)
        self.mouse(element)

    def enabled(self, element: str) -> bool:
        """Whether the element with this id can be clicked."""
        return bool(self.js("(e => e && !e.disabled && e.offsetParent !== null)"
                            "(document.getElementById(arguments[0]))", element))

    def mouse(self, element: str) -> None:
        """Press and release where the element is now."""
        x, y = self.js("(r => [r.x + r.width / 2, r.y + r.height / 2])"
                       "(document.getElementById(arguments[0]).getBoundingClientRect())", element)
        for kind in ("mousePressed", "mouseReleased"):
            self.cdp("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def touch(self, kind: str, element: str, *shares: float) -> None:
        """Fingers on the first element of this selector, by their shares of its width; `kind` is Start, Move or End."""
        x, y, width = self.js("(r => [r.x, r.y + r.height / 2, r.width])"
                              "(document.querySelector(arguments[0]).getBoundingClientRect())", element)
        self.cdp("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=[
            {"x": x + share * width, "y": y, "id": k} for k, share in enumerate(shares)])

    def key(self, key: str, code: str, number: int) -> None:
        """Press and release a key."""
        for kind in ("rawKeyDown", "keyUp"):
            self.cdp("Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number)

    def collect(self) -> None:
        """Take what the browser has logged since the last time."""
        for entry in self.driver.get_log("performance") if self._network else ():
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
            elif message["method"] == "Network.webSocketCreated":
                self.requests.append(message["params"]["url"])
        self.console += [f"{entry['level']}: {entry['message']}" for entry in self.driver.get_log("browser")]

    def outgoing(self) -> list[str]:
        """Requests to anything but this machine."""
        self.collect()
        here = {"127.0.0.1", "localhost", None}
        return [url for url in self.requests
                if urlsplit(url).scheme not in ("data", "blob", "file", "chrome", "about")
                and urlsplit(url).hostname not in here]

    def complaints(self) -> list[str]:
        """Errors and warnings of the console."""
        self.collect()
        return [line for line in self.console if line.startswith(("SEVERE", "WARNING"))]

    def sideways(self) -> int:
        """By how many pixels the page is wider than the window."""
        return self.js("document.documentElement.scrollWidth - document.documentElement.clientWidth")

    def shot(self, path: Path) -> None:
        """A picture of the whole page."""
        height = self.js("document.documentElement.scrollHeight")
        width = self.js("document.documentElement.clientWidth")
        before = self.js("[innerWidth, innerHeight]")
        self.resize((width, min(height, 4000)))
        time.sleep(0.4)
        self.driver.save_screenshot(str(path))
        self.resize(tuple(before))

    def close(self) -> None:
        """End the browser."""
        self.driver.quit()


class Live:
    """`legid live` as a process of its own."""

    def __init__(self, *arguments: str, module: str = "legid.cli") -> None:
        with favoured():
            self.child = subprocess.Popen(
                [sys.executable, "-m", module, "live", *arguments, "--port", "0"], cwd=ROOT,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
        assert self.child.stdout is not None
        line = self.child.stdout.readline()
        if not line.startswith("legid live: http://"):
            raise AssertionError(f"did not start: {line}{self.child.communicate(timeout=10)[1]}")
        self.url = line.split()[2]
        self._said = ""

    def end(self, number: int = signal.SIGINT) -> tuple[int, str]:
        """Exit status, and what it had to complain about; may be called twice."""
        if self.child.poll() is None:
            self.child.send_signal(number)
            self._said = self.child.communicate(timeout=PATIENCE_S)[1]
        return self.child.returncode, self._said


    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


@contextmanager
def open_page(live: Live, network: bool = True) -> Iterator[Browser]:
    """The dashboard in a window, connected."""
    with closing(Browser(network=network)) as browser:
        browser.driver.get(live.url)
        browser.wait(lambda: browser.text("controller"), "the page comes up")
        yield browser
