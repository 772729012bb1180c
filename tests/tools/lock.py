"""Lock files anew: every version with the hashes of all its files, so that pip refuses what is not them.

    python -m tests.tools.lock --uv build/tools/bin/uv        # what `make lock` does

Versions stay as they are where pyproject.toml still allows them. The hashes are the package index's own, of the wheels
for every platform and of the source.
"""

import argparse
import re
import subprocess
import tomllib
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.paths import ROOT

MAIN = "requirements.lock"
LOCKS = {MAIN: "test", "requirements-bench.lock": "bench",
         "requirements-counterparts.lock": "counterparts", "requirements-docs.lock": "docs",
         "requirements-release.lock": "release", "requirements-build.lock": ""}
"""Lock file to the extra that it is of; nothing: what building this package needs."""
ALONE = {"requirements-release.lock", "requirements-build.lock"}
"""Installed by themselves or first; the others come on top of the main one and leave out what it has."""
SOURCE_ONLY = ("cobs", "readability")
"""Packages whose pinned version has no wheel for Linux: built where they are installed. The second is pure Python."""
PLATFORMS = ("x86_64-manylinux_2_28", "aarch64-manylinux_2_28")
PYTHONS = ("3.11", "3.12", "3.13")
HEAD = "# Made by `make lock`. Installed by: pip install --require-hashes -r {name}\n"


def entries(text: str) -> dict[str, str]:
    """Requirement (`name==version`, with its marker) -> its whole entry with the hashes, of a lock file's text."""
    lines = [line for line in text.splitlines(keepends=True) if line.strip() and not line.startswith("#")]
    found = re.split(r"^(?=\S)", "".join(lines), flags=re.MULTILINE)
    return {entry.split("\\\n")[0].strip(): entry for entry in found if entry}


def compile_lock(uv: str, name: str, extra: str, upgrade: bool) -> str:
    """One lock's text. Raises `subprocess.CalledProcessError` where nothing satisfies pyproject.toml."""
    seen = [ROOT / name, *(ROOT / other for other in LOCKS if name not in ALONE and other not in ALONE)]
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out.txt"
        # What stands here already is preferred: a lock's own versions, then those of the ones it is installed beside.
        kept: dict[str, str] = {}
        for requirement in (r for path in seen if path.is_file() for r in entries(path.read_text(encoding="utf-8"))):
            kept.setdefault(requirement.split("==")[0], requirement)
        out.write_text("".join(f"{requirement}\n" for requirement in kept.values()))
        source, what = ROOT / "pyproject.toml", ["--extra", extra]
        if name in ALONE:
            project = tomllib.loads(source.read_text(encoding="utf-8"))
            extras, build = project["project"]["optional-dependencies"], project["build-system"]["requires"]
            source, what = Path(folder) / "in.txt", []
            source.write_text("\n".join(extras[extra] if extra else build))
        subprocess.run([uv, "pip", "compile", "--quiet", "--no-config", "--universal", "--generate-hashes",
                        "--no-annotate", "--no-header", "--python-version", PYTHONS[0], *what,
                        *(["--upgrade"] if upgrade else []), "--output-file", str(out), str(source)],
                       check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
        made = entries(out.read_text(encoding="utf-8"))
    known = set() if name == MAIN or name in ALONE else set(entries((ROOT / MAIN).read_text(encoding="utf-8")))
    return HEAD.format(name=name) + "".join(entry for requirement, entry in made.items() if requirement not in known)


def wheels(uv: str, name: str) -> str:
    """"" where each platform has a wheel of everything but `SOURCE_ONLY`, else what the resolver says."""
    text = (ROOT / name).read_text(encoding="utf-8")
    pins = "".join(f"{r}\n" for r in entries(text) if r.split("==")[0] not in SOURCE_ONLY)
    for platform, python in product(PLATFORMS, PYTHONS):
        done = subprocess.run([uv, "pip", "compile", "--quiet", "--no-config", "--no-build", "--no-deps",
                               "--no-python-downloads", "--python-platform", platform, "--python-version", python, "-"],
                              input=pins, capture_output=True, text=True)
        if done.returncode:
            return f"{name}, {platform}, Python {python}: {done.stderr.strip()}"
    return ""


def main(arguments: list[str] | None = None) -> int:
    """Write all; exit status 1 where a platform lacks a wheel."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--uv", default="uv", help="the uv program")
    parser.add_argument("--upgrade", action="store_true", help="the newest versions that pyproject.toml allows")
    options = parser.parse_args(arguments)
    missing = []
    for name, extra in LOCKS.items():
        (ROOT / name).write_text(compile_lock(options.uv, name, extra, options.upgrade), encoding="utf-8")
        missing.append(wheels(options.uv, name))
        print(f"{name}: {len(entries((ROOT / name).read_text(encoding='utf-8')))} packages"
              + (f"; {missing[-1]}" if missing[-1] else ""))
    return int(any(missing))


if __name__ == "__main__":
    raise SystemExit(main())
