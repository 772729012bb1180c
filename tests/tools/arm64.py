"""Does every dependency have a wheel for 64-bit Arm Linux? `make arm64` asks the package index."""

import argparse
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.paths import ROOT

PLATFORMS = ("manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64")
EXTRAS = ("live", "parquet", "ros", "notebook")
"""What one would use on the board at the rig."""


def requirements() -> list[str]:
    """Of pyproject.toml: the base, and these extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*project["dependencies"], *(r for extra in EXTRAS for r in project["optional-dependencies"][extra])]


def main(arguments: list[str] | None = None) -> int:
    """Resolve for each version of Python; exit status 1 where something has no wheel."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", nargs="+", default=["3.11", "3.12", "3.13"])
    options = parser.parse_args(arguments)
    status = 0
    for version in options.python:
        with TemporaryDirectory() as folder:
            report = Path(folder) / "report.json"
            done = subprocess.run(
                [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--disable-pip-version-check",
                 "--ignore-installed", "--target", folder, "--only-binary=:all:", "--python-version", version,
                 *(f"--platform={name}" for name in PLATFORMS), "--report", str(report), *requirements()],
                capture_output=True, text=True)
            if done.returncode:
                status = 1
                print(f"Python {version}: {done.stderr.strip().splitlines()[-1]}")
                continue
            urls = [item["download_info"]["url"] for item in json.loads(report.read_text())["install"]]
            arm = sum("aarch64" in url for url in urls)
            print(f"Python {version}: {len(urls)} packages, {arm} of them built for 64-bit Arm, all as wheels")
    return status


if __name__ == "__main__":
    raise SystemExit(main())
