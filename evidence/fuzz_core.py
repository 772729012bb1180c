"""The firmware's core under broken frames, built with address and undefined behaviour sanitizers: `make fuzz`.

    python -m evidence fuzz-core --frames 20000000 --seed 1

With clang there is libFuzzer besides: `--libfuzzer SECONDS` lets it search by coverage for so long.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from evidence.registry import Evidence
from tests.support.paths import ROOT

CORE = ROOT / "firmware"
PARTS = ("core", "config", "codec", "can")
SOURCES = [ROOT / "evidence/fuzz_core.c", *(CORE / f"leg_{part}.c" for part in PARTS)]
STRICT = ["-std=c99", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-fno-sanitize-recover=all"]


def build(compiler: str, out: Path, libfuzzer: bool = False) -> Path:
    """The fuzzer's program at `out`."""
    more = ["-DLIBFUZZER", "-fsanitize=fuzzer,address,undefined"] if libfuzzer else ["-fsanitize=address,undefined"]
    subprocess.run([compiler, *STRICT, *more, "-I", str(CORE), "-o", str(out), *map(str, SOURCES)], check=True)
    return out


EVIDENCE = (
    Evidence("The firmware's core under broken frames, with sanitizers", "make fuzz FRAMES=20000000", "fuzz.md", 1,
             "no crash, no finding, no check that fails",
             (r"(crashes, findings of a sanitizer, checks that failed) \| (\d+)",), r"--seed (\d+)",
             resumes="no: a minute"),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000, help="serial and CAN together, half of them each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--libfuzzer", type=int, metavar="SECONDS", default=0)
    args = parser.parse_args(arguments)
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        sys.exit("make fuzz needs a C compiler with sanitizers: the Debian package gcc or clang")
    with tempfile.TemporaryDirectory() as folder:
        program = build(compiler, Path(folder) / "fuzz")
        started = time.perf_counter()
        done = subprocess.run([program, str(args.frames), str(args.seed)], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"seed {args.seed}: status {done.returncode}\n{done.stderr}")
        print(f"{done.stdout.strip()}, 0 crashes, {time.perf_counter() - started:.0f} s")
        if args.libfuzzer:
            clang = shutil.which("clang")
            if clang is None:
                sys.exit("--libfuzzer needs clang: the Debian package clang")
            subprocess.run([build(clang, Path(folder) / "libfuzzer", True), f"-max_total_time={args.libfuzzer}"],
                           check=True)
