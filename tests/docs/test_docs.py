"""The documentation's pages against the code: messages, links, the worked effect, and the built site in a browser."""

import ast
import json
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from importlib import invalidate_caches
from importlib.util import find_spec
from pathlib import Path

import pytest
from msgspec import structs

from daq import ControllerDevice, Devices, ImuDevice, Mechanism, PivotDevice, Rig, ShuntDevice, parse_rig
from tests.style.words import FILES, text_of
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
RIG_PAGE, EFFECT_PAGE = ((DOCS / name).read_text(encoding="utf-8") for name in ("rig.md", "effect.md"))
HOLE = "\N{HORIZONTAL ELLIPSIS}"
"""In a message of a page, for each value that is put into it."""
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]*)?\)")


def test_every_message_that_is_explained_is_in_the_code() -> None:
    messages = re.findall(r"^`(.+)`\n: ", (DOCS / "troubleshooting.md").read_text(encoding="utf-8"), re.MULTILINE)
    known = [text for path in FILES for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
             if (text := text_of(node, HOLE)) is not None]
    assert len(messages) >= 40
    assert [m for m in messages if not any(m in text for text in known)] == []


def test_no_code_cites_a_document_that_is_not_here() -> None:
    """A name with a folder, or one that stands in docs/ or at the top; `contracts` and `design` were of elsewhere."""
    cited = re.compile(r"(?<![\w/<>.-])((?:docs/)?[A-Za-z_][\w-]*\.md)\b|\b(contracts)\b[:,]")
    for path in FILES:
        for name, other in cited.findall(path.read_text(encoding="utf-8")):
            assert not other and (ROOT / name).is_file(), f"{path}: {name or other}"


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *PAGES],
                         ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target, anchor in LINK.findall(page.read_text(encoding="utf-8")):
        if target.startswith(("generated/", "../generated/", "https:")):
            continue
        there = page.parent / target if target else page
        assert there.exists(), target
        assert not anchor or anchor[1:] in anchors(there), target + anchor


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as the site and code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_page_is_in_the_contents() -> None:
    for folder in (DOCS, DOCS / "evidence"):
        listed = (folder / "index.md").read_text(encoding="utf-8") + (DOCS / "index.md").read_text(encoding="utf-8")
        for page in folder.glob("*.md"):
            assert page.stem == "index" or re.search(rf"^(evidence/)?{page.stem}$", listed, re.MULTILINE), page.name


def test_the_rig_s_defaults_are_those_that_its_page_shows() -> None:
    (shown,) = re.findall(r"```toml\n(\[mechanism\].*?)```", RIG_PAGE, re.DOTALL)
    rig, defaults = parse_rig(shown), Rig(mechanism=Mechanism(model="leg2", actuated=(2,)),
                                          devices=Devices(imu=ImuDevice(), controller=ControllerDevice(),
                                                          pivot=PivotDevice(), shunt=ShuntDevice(shunt_ohm=0.01)))
    assert rig.imus == defaults.imus and structs.replace(rig, imu=None) == defaults


@pytest.mark.slow
def test_the_how_to_s_effect_is_found_in_simulated_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's class, installed as pip would leave it, and docs/own_effect.py."""
    code = re.findall(r"```python\n(.*?)```", EFFECT_PAGE, re.DOTALL)[0]
    (tmp_path / "my_effects-1.0.dist-info").mkdir()
    for name, text in (("my_effects.py", code),
                       ("my_effects-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: my_effects\nVersion: 1.0\n"),
                       ("my_effects-1.0.dist-info/entry_points.txt",
                        "[legid.effects]\nhose_pull = my_effects:HosePull\n")):
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    invalidate_caches()
    found = runpy.run_path(str(DOCS / "own_effect.py"))["found"]
    monkeypatch.delitem(sys.modules, "my_effects")
    assert found.verdict == "named" and [(c.effect, c.joint) for c in found.causes] == [("hose_pull", 2)]
    assert found.causes[0].size[0].value == pytest.approx(0.1, rel=0.05)


def test_example_s_output_is_of_the_example() -> None:
    """Its first words line by line; the numbers are tests/test_api.py's."""
    shown = (DOCS / "example.txt").read_text(encoding="utf-8")
    assert [line.split()[0].rstrip(":") for line in shown.splitlines()] == [
        "run1.mcap", *(f"beta{k}" for k in range(1, 10)), "nominal", "named", "extended", "simulated"]


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    """Built anew; every page by its text, and from file:// in a browser, by its logs of network and console."""
    if any(find_spec(tool) is None for tool in ("sphinx", "furo", "myst_parser", "latex2mathml")):
        pytest.skip("the documentation's tools are not installed: make docs")
    site = tmp_path / "html"
    done = subprocess.run([sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", "-d", str(tmp_path / "trees"),
                           str(DOCS), str(site)], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    pages = sorted(site.rglob("*.html"))
    assert len(pages) >= 18
    for page in pages:
        look_at_text(page)
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\([\"']?(https?:)?//|@import", sheet.read_text(encoding="utf-8")), sheet
    formulas = (site / "theory.html").read_text(encoding="utf-8")
    assert formulas.count("<math") > 60 and "\\frac" not in formulas and "<merror" not in formulas
    if BROWSER is None:
        pytest.skip("no browser; the pages' text alone was looked at")
    for address in [*(f"file://{page}" for page in pages), f"file://{site / 'search.html'}?q=friction"]:
        dom, console, asked = browse(address, tmp_path)
        assert "</html>" in dom and console == [] and asked == set(), address
    assert "matching the search query" in dom


def look_at_text(page: Path) -> None:
    """What a browser would fetch is in the site itself."""
    for address in re.findall(r'<(?:link|script|img|source|iframe)[^>]*?(?:href|src)="([^"]+)"',
                              page.read_text(encoding="utf-8")):
        assert not re.match(r"(https?:)?//", address), (page.name, address)
        if not address.startswith("data:"):
            assert (page.parent / re.sub(r"[?#].*", "", address)).exists(), (page.name, address)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser")
def test_the_browser_s_logs_would_show_it(tmp_path: Path) -> None:
    """A page that does what no page may do."""
    page = tmp_path / "bad.html"
    page.write_text('<script>console.error("oh")</script><img src="http://127.0.0.1:9/picture.png">', encoding="utf-8")
    _, console, asked = browse(f"file://{page}", tmp_path)
    assert any("oh" in line for line in console) and asked == {"http://127.0.0.1:9/picture.png"}


def browse(address: str, folder: Path) -> tuple[str, list[str], set[str]]:
    """The page after its scripts ran, lines of its console, addresses that it asked for over any network.

    What the browser asks for on its own account (updates, the time) has no origin, and finds no host.
    """
    log = folder / "net.json"
    done = subprocess.run(
        [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-component-update",
         "--disable-background-networking", "--disable-sync", "--host-resolver-rules=MAP * ~NOTFOUND",
         "--enable-logging=stderr", f"--log-net-log={log}", f"--user-data-dir={folder / 'profile'}",
         "--virtual-time-budget=2000", "--dump-dom", address],
        capture_output=True, text=True, timeout=120)
    events = json.loads(log.read_text(encoding="utf-8"))["events"]
    requests = [event["params"] for event in events if "initiator" in event.get("params", {})]
    asked = {str(request["url"]) for request in requests if request["initiator"] != "not an origin"}
    return (done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line],
            {url for url in asked if re.match(r"(https?|wss?|ftp):", url)})
