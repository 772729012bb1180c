"""Lock files: each version pinned and hashed, each dependency of pyproject.toml among them, no place named."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.tools.lock import ALONE, LOCKS, MAIN, entries

PIN = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*==[\w.!+]+( ; .+)?")
HASH = re.compile(r"    --hash=sha256:[0-9a-f]{64}")


def read(name: str) -> dict[str, str]:
    return entries((ROOT / name).read_text(encoding="utf-8"))


def pinned(name: str) -> dict[str, set[str]]:
    """Package to its pinned versions."""
    out: dict[str, set[str]] = {}
    for requirement in read(name):
        package, version = requirement.split(" ;")[0].split("==")
        out.setdefault(package, set()).add(version)
    return out


def wanted(requirements: list[str]) -> set[str]:
    """Names of packages, as a lock writes them."""
    return {re.match(r"[\w.-]+", r).group().lower().replace("_", "-").replace(".", "-")  # type: ignore[union-attr]
            for r in requirements} - {"legid"}


def test_every_lock_is_known_and_made_by_the_same_command() -> None:
    assert {path.name for path in ROOT.glob("*.lock")} == set(LOCKS)


@pytest.mark.parametrize("name", LOCKS)
def test_every_package_is_pinned_and_hashed(name: str) -> None:
    assert len(read(name)) >= 4
    for requirement, entry in read(name).items():
        first, *hashes = entry.rstrip("\n").split(" \\\n")
        assert PIN.fullmatch(requirement) and first == requirement and hashes, requirement
        assert all(map(HASH.fullmatch, hashes)) and len(set(hashes)) == len(hashes), requirement


@pytest.mark.parametrize("name", LOCKS)
def test_no_lock_names_a_host_or_a_folder(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    assert not re.search(r"://|index-url|find-links|trusted-host|@ |/(?!.*`)", text)


def test_what_pyproject_asks_for_is_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras, base = project["project"]["optional-dependencies"], project["project"]["dependencies"]
    have = {name: set(pinned(name)) for name in LOCKS}
    assert wanted(base) | wanted(extras["test"]) <= have[MAIN]
    for extra in ("parquet", "cluster", "live", "notebook", "ros", "zoom", "hdf5"):
        assert wanted(extras[extra]) <= have[MAIN], extra
    for name, extra in LOCKS.items():
        needs = wanted(extras[extra] if extra else project["build-system"]["requires"])
        assert needs <= have[name] | (set() if name in ALONE else have[MAIN]), name


def test_locks_that_share_an_environment_agree() -> None:
    """But for docutils, of which Sphinx wants an older one."""
    main = pinned(MAIN)
    for name in set(LOCKS) - ALONE - {MAIN}:
        differ = {package for package, versions in pinned(name).items()
                  if package in main and versions != main[package]}
        assert differ <= ({"docutils"} if "docs" in name else set()), (name, differ)
    build = pinned("requirements-build.lock")
    assert all(build[package] == main[package] for package in build.keys() & main.keys())


def test_entries_are_read_with_marker_and_hashes() -> None:
    text = "# head\na==1 ; x < '3' \\\n    --hash=sha256:0 \\\n    --hash=sha256:1\nb==2 \\\n    --hash=sha256:2\n"
    found = entries(text)
    assert list(found) == ["a==1 ; x < '3'", "b==2"]
    assert "# head\n" + "".join(found.values()) == text


def test_pip_refuses_a_file_that_no_hash_is_of(tmp_path: Path) -> None:
    """The rule that `make install` stands on, without a network: a wheel that was changed after it was locked."""
    wheel = tmp_path / "thing-1.0-py3-none-any.whl"
    wheel.write_bytes(b"changed")
    (tmp_path / "r.lock").write_text(f"thing==1.0 \\\n    --hash=sha256:{'0' * 64}\n")
    done = subprocess.run([sys.executable, "-m", "pip", "install", "--require-hashes", "--no-index", "--no-deps",
                           "--find-links", str(tmp_path), "--target", str(tmp_path / "out"),
                           "-r", str(tmp_path / "r.lock")], capture_output=True, text=True)
    assert done.returncode and "DO NOT MATCH THE HASHES" in done.stderr
    assert not (tmp_path / "out").exists()


def test_everything_that_make_installs_is_locked() -> None:
    installs = [line for line in (ROOT / "Makefile").read_text(encoding="utf-8").splitlines() if "pip install" in line
                and "echo" not in line]
    assert len(installs) == 3
    assert all("--require-hashes" in line or "--no-deps -e ." in line for line in installs)


@pytest.mark.slow
def test_the_bill_of_materials_lists_what_is_installed(tmp_path: Path) -> None:
    """The tool from its own lock, on the environment that runs this test."""
    tools, bill = tmp_path / "tools", tmp_path / "sbom.json"
    subprocess.run([sys.executable, "-m", "venv", tools], check=True)
    subprocess.run([tools / "bin/python", "-m", "pip", "install", "--quiet", "--require-hashes",
                    "-r", ROOT / "requirements-release.lock"], check=True)
    subprocess.run([tools / "bin/cyclonedx-py", "environment", "--pyproject", ROOT / "pyproject.toml",
                    "--output-reproducible", "--output-format", "JSON", "--output-file", bill, sys.executable],
                   check=True)
    found = json.loads(bill.read_text(encoding="utf-8"))
    assert found["bomFormat"] == "CycloneDX" and found["metadata"]["component"]["name"] == "legid"
    parts = {part["name"].lower().replace("_", "-"): part for part in found["components"]}
    assert {"numpy", "scipy", "mcap", "pyserial"} <= parts.keys()
    assert parts["numpy"]["purl"].endswith(f"/numpy@{parts['numpy']['version']}")
    assert str(ROOT) not in bill.read_text(encoding="utf-8")
