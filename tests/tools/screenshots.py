"""The documentation's pictures, taken anew: `make screenshots`. Needs chromium with its chromedriver; five minutes.

A demo is recorded, fitted, diagnosed and compared, its pages are opened in a browser, and the dashboard drives an
emulated leg.
"""

from __future__ import annotations

import argparse
import io
import time
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from estimator.model import leg2
from experiments import cli
from experiments.console import write_text
from experiments.reports import standalone, trace_plot
from experiments.reports.sketch import draw_mechanism
from experiments.workflows import run_demo
from tests.support.live_browser import Browser, Live, open_page
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
PICTURES = DOCS / "pictures"
WIDE, HIGH = 1100, 900
COLOURS = 128


def main(arguments: list[str] | None = None) -> int:
    """Take all, or those asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("why", "pages", "live"), action="append", help="default: all")
    wanted = parser.parse_args(arguments).only or ["why", "pages", "live"]
    PICTURES.mkdir(exist_ok=True)
    with TemporaryDirectory() as folder:
        demo = Path(folder) / "demo"
        if "why" in wanted or "pages" in wanted:
            found = run_demo(demo).diagnosis
            trace = next(t for t in found.traces if "q2_rad" in t.after)
            write_text(DOCS / "why.svg", standalone(trace_plot(trace, "q2_rad")))
            write_text(DOCS / "leg.svg", standalone(draw_mechanism(leg2(lever_arm=0.2), np.array([1.4, -0.9]))))
        if "pages" in wanted:
            take_pages(demo)
        if "live" in wanted:
            take_live(Path(folder) / "live")
    return 0


def take_pages(demo: Path) -> None:
    """The first screen of a fit, a diagnosis, a comparison."""
    held = sorted(map(str, demo.glob("demo-run*.mcap")))[-1]
    with redirect_stdout(io.StringIO()):
        assert cli.main(["compare", str(demo / "model.json"), str(demo / "extended.json"), held, "--html",
                         str(demo / "compare.html")]) == 0
    browser = Browser((WIDE, HIGH))
    try:
        for name, page in (("fit", "fit.html"), ("diagnosis", "report.html"), ("compare", "compare.html")):
            browser.driver.get((demo / page).as_uri())
            save(browser, name)
    finally:
        browser.close()


def take_live(out: Path) -> None:
    """The dashboard while it drives."""
    with Live("--demo", "--out", str(out)) as live, open_page(live) as browser:
        browser.resize((1280, HIGH))
        browser.click("start")
        browser.wait(lambda: browser.text("drive-words") == "DRIVING", "the leg is driven")
        time.sleep(6.0)
        browser.js("document.querySelector('.live-title .soft').textContent = 'rig.toml \u2192 runs'")
        save(browser, "live")
        browser.click("stop")
        browser.phase("Stopped")


def save(browser: Browser, name: str) -> None:
    """As a PNG of few colours: pages are flat, and the repository keeps every version."""
    time.sleep(0.5)
    picture = Image.open(io.BytesIO(browser.driver.get_screenshot_as_png())).convert("RGB")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(PICTURES / f"{name}.png", optimize=True)
    print(f"{PICTURES / f'{name}.png'}: {(PICTURES / f'{name}.png').stat().st_size // 1024} KiB")


if __name__ == "__main__":
    raise SystemExit(main())
