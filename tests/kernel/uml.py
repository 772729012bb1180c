"""Boots Debian's user-mode-linux kernel as an ordinary process and runs the guest's tests in it.

Nothing is installed and no privilege is needed: the package is downloaded, unpacked into a cache and started with this
machine's files as its root, read-only. `tests/kernel/guest.py` is process 1 in there.
"""

import ctypes
import errno
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "legid-kernel"
PACKAGES = ("user-mode-linux", "busybox-static")
APT = ("-qq", "-o", "APT::Sandbox::User=root", "-o", "Acquire::http::Timeout=20", "-o", "Acquire::Retries=1")
MEMORY_MB = 256
LIMIT_S = 300.0
NARROW = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{name}" for name in (
        "AVX", "AVX2", "AVX512F", "AVX512VL", "AVX512BW", "AVX_Usable", "AVX2_Usable", "AVX_Fast_Unaligned_Load",
        "ERMS", "FSRM", "XSAVE", "XSAVEC")),
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENBLAS_CORETYPE": "Nehalem",
}
"""Keeps the guest's programs to SSE, see `hide_wide_registers`."""
PTRACE = 101
PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP = 38, 22


class Unavailable(Exception):
    """The kernel cannot be had on this machine; says why."""


class Outcome(NamedTuple):
    """How the guest's tests ended."""

    status: int
    output: str
    prepared_s: float
    ran_s: float

    def __str__(self) -> str:
        return f"kernel tests: status {self.status}, {self.ran_s:.1f} s (preparing the kernel {self.prepared_s:.1f} s)"


def prepare() -> Path:
    """Folder with the unpacked packages. Raises `Unavailable`."""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        raise Unavailable("user-mode-linux runs on Linux on x86-64 only")
    shared = os.statvfs("/dev/shm")
    if shared.f_bavail * shared.f_frsize < MEMORY_MB * 2**20:
        raise Unavailable(f"the kernel's memory of {MEMORY_MB} MB does not fit into /dev/shm")
    base = CACHE / "unpacked"
    if (base / "complete").exists():
        return base
    for tool in ("apt-get", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise Unavailable(f"no {tool} here: the package user-mode-linux comes from Debian")
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        fetched = Path(folder)
        # Root may refresh the package list; everybody else takes it as it is.
        if not _download(fetched) and not (os.geteuid() == 0 and _runs("apt-get", *APT, "update", cwd=fetched)
                                           and _download(fetched)):
            raise Unavailable("the packages user-mode-linux and busybox-static cannot be downloaded")
        for package in fetched.glob("*.deb"):
            if not _runs("dpkg-deb", "-x", str(package), str(fetched / "out"), cwd=fetched):
                raise Unavailable(f"{package.name} cannot be unpacked")
        (fetched / "out" / "complete").touch()
        if not base.exists():
            (fetched / "out").rename(base)
    return base


def _download(folder: Path) -> bool:
    return _runs("apt-get", *APT, "download", *PACKAGES, cwd=folder)


def _runs(*command: str, cwd: Path) -> bool:
    return subprocess.run(command, cwd=cwd, capture_output=True, check=False).returncode == 0


def hide_wide_registers() -> None:
    """On machines with AMX: let ptrace say that it has no XSTATE, which is larger there than this kernel has room for.

    It falls back to the registers of SSE, so nothing in the guest may use AVX (`NARROW`). Called in the child, which
    gives up new privileges by it.
    """
    if " amx_tile" not in Path("/proc/cpuinfo").read_text():
        return
    load, equal, give = 0x20, 0x15, 0x06  # BPF_LD|W|ABS, BPF_JMP|JEQ|K, BPF_RET|K
    get_regset, nt_x86_xstate = 0x4204, 0x202
    program = [(load, 0, 0, 0), (equal, 0, 5, PTRACE), (load, 0, 0, 16), (equal, 0, 3, get_regset),
               (load, 0, 0, 32), (equal, 0, 1, nt_x86_xstate), (give, 0, 0, 0x00050000 | errno.ENODEV),
               (give, 0, 0, 0x7FFF0000)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("<HBBI", *line) for line in program))
    head = ctypes.create_string_buffer(struct.pack("<H6xQ", len(program), ctypes.addressof(code)))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(PR_SET_SECCOMP, 2, head, 0, 0):
        raise OSError(ctypes.get_errno(), "seccomp")


def boot(base: Path, module: Path, tests: list[str]) -> Outcome:
    """Run pytest on `tests` in the guest, with `module` loaded where it exists.

    Raises `Unavailable` when the kernel does not come up."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="legid-") as folder:
        out = Path(folder)
        init = out / "init"
        # The kernel hands no spaces on: everything that process 1 has to know stands in this script.
        words = [sys.executable, str(HERE / "guest.py"), str(base), str(module), str(out), str(ROOT), *tests]
        exports = [f"export {name}='{value}'" for name, value in NARROW.items()]
        init.write_text("\n".join(["#!/bin/sh", *exports, "exec " + " ".join(f"'{word}'" for word in words), ""]))
        init.chmod(0o755)
        kernel = [str(base / "usr/bin/linux.uml"), f"mem={MEMORY_MB}M", "rootfstype=hostfs", "rootflags=/", "ro",
                  "quiet", "con=null", "con0=null,fd:1", f"uml_dir={out}", "umid=uml", f"init={init}"]
        # Its memory is a file in TMPDIR when that is set, and belongs into /dev/shm.
        env = {key: value for key, value in os.environ.items() if key not in ("TMPDIR", "TMP", "TEMP")}
        with open(out / "console", "wb") as console:
            process = subprocess.Popen(kernel, env=env, stdin=subprocess.DEVNULL, stdout=console, stderr=console,
                                       start_new_session=True, preexec_fn=hide_wide_registers)
            try:
                process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        ran_s = time.monotonic() - started
        text = (out / "log").read_text() if (out / "log").exists() else ""
        if not (out / "status").exists():
            last = (out / "console").read_text(errors="replace").strip()[-3500:]
            if not text and "Traceback" not in last:
                raise Unavailable(f"the kernel did not come up (is ptrace forbidden here?): {last}")
            return Outcome(99, f"{text}\nthe kernel ended before the tests did: {last}", 0.0, ran_s)
        return Outcome(int((out / "status").read_text()), text, 0.0, ran_s)


def run(tests: list[str] | None = None) -> Outcome:
    """Prepare, boot, run. Raises `Unavailable`."""
    from tests.kernel import build_module

    started = time.monotonic()
    base = prepare()
    module = build_module.built(base)
    prepared_s = time.monotonic() - started
    tests = tests or [str(path.relative_to(ROOT)) for path in sorted(HERE.glob("guest_*.py"))]
    return boot(base, module, tests)._replace(prepared_s=prepared_s)
