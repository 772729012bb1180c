"""The documentation's pictures, taken anew: `make screenshots`. Needs chromium with its chromedriver; five minutes.

A demo is recorded, fitted, diagnosed and compared, its pages are opened in a browser, and the dashboard drives an
emulated leg.
"""

import argparse
import io
import time
from contextlib import closing, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from estimator.model import leg2
from experiments.console import write_text
from experiments.models import load_model
from experiments.reports import BLUE, GREEN, ORANGE, Line, plot_lines, standalone, trace_plot, window
from experiments.reports.sketch import draw_mechanism
from experiments.rig import choose_rig
from experiments.session import prepare
from experiments.workflows import run_demo, validate_in_mujoco, validate_prepared
from tests.support.live_browser import Browser, Live, open_page
from tests.support.paths import ROOT
from tests.support.shell import typed

DOCS = ROOT / "docs"
PICTURES = DOCS / "pictures"
WIDE, HIGH = 1100, 900
SECONDS = 10.0
COLOURS = 128


def main(arguments: list[str] | None = None) -> int:
    """Take all, or those asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("why", "pages", "mujoco", "live"), action="append", help="default: all")
    wanted = parser.parse_args(arguments).only or ["why", "pages", "mujoco", "live"]
    PICTURES.mkdir(exist_ok=True)
    with TemporaryDirectory() as folder:
        demo = Path(folder) / "demo"
        if {"why", "pages", "mujoco"} & set(wanted):
            found = run_demo(demo).diagnosis
            trace = next(t for t in found.traces if "q2_rad" in t.after)
            if "why" in wanted:
                write_text(DOCS / "why.svg", standalone(trace_plot(trace, "q2_rad")))
                write_text(DOCS / "leg.svg", standalone(draw_mechanism(leg2(lever_arm=0.2), np.array([1.4, -0.9]))))
        if "mujoco" in wanted:
            write_text(DOCS / "mujoco.svg", standalone(mujoco_plot(demo)))
        if "pages" in wanted:
            take_pages(demo)
        if "live" in wanted:
            take_live(Path(folder) / "live")
    return 0


def mujoco_plot(demo: Path) -> str:
    """The knee of a demo's last run: measured, the nominal model as plain MJCF, the extended one as exported."""
    held = str(max(demo.glob("demo-run*.mcap")))
    rig, found = choose_rig(None, [held]).rig, {}
    for name, label in (("model", "plain MJCF"), ("extended", "exported, with the spring")):
        model = load_model(demo / f"{name}.json")
        prepared = prepare([held], rig, model=model)
        run = validate_in_mujoco(model, validate_prepared(model, prepared, name), name).table.runs[0]
        found[label] = run.trace("q2_rad", 0)
    part = window(run.time_s, SECONDS)
    measured = run.measured[run.channels.index("q2_rad")]
    lines = [Line("measured", measured[part], BLUE, 2.4)]
    lines += [Line(label, values[part], colour) for (label, values), colour in zip(found.items(), (GREEN, ORANGE))]
    return plot_lines(run.time_s[part] - run.time_s[0], lines, "knee [rad], in MuJoCo")


def take_pages(demo: Path) -> None:
    """The first screen of a fit, a diagnosis, a comparison."""
    held = max(demo.glob("demo-run*.mcap"))
    with redirect_stdout(io.StringIO()):
        typed("compare", demo / "model.json", demo / "extended.json", held, "--html", demo / "compare.html")
    with closing(Browser((WIDE, HIGH))) as browser:
        for name, page in (("fit", "fit.html"), ("diagnosis", "report.html"), ("compare", "compare.html")):
            browser.driver.get((demo / page).as_uri())
            save(browser, name)


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
    path = PICTURES / f"{name}.png"
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    raise SystemExit(main())
