"""Process 1 of the guest: mounts, kernel modules, buses, then pytest; its output and status go to the host's folder.

Started by `tests/kernel/uml.py` as: guest.py PACKAGES MODULE OUT PROJECT TESTS...
"""

import ctypes
import errno
import os
import subprocess
import sys
import traceback
from pathlib import Path

FINIT_MODULE = 313
POWER_OFF = 0x4321FEDC
MODULES = ("i2c-dev", "i2c-stub chip_addr=0x6b,0x1e", "at24", "can-raw", "vcan", "slcan", "cuse")
libc = ctypes.CDLL(None, use_errno=True)


def mount(kind: str, where: str, options: str = "") -> None:
    """mount -t KIND."""
    os.makedirs(where, exist_ok=True)
    if libc.mount(kind.encode(), where.encode(), kind.encode(), 0, options.encode()):
        if ctypes.get_errno() == errno.EBUSY:
            return  # the kernel has mounted it itself
        raise OSError(ctypes.get_errno(), f"mount {kind} on {where}")


def load(modules: Path, wanted: str) -> None:
    """A module and what modules.dep says that it needs."""
    name, _, parameters = wanted.partition(" ")
    lines = (modules / "modules.dep").read_text().splitlines()
    line = next(line for line in lines if line.partition(":")[0].endswith(f"/{name}.ko"))
    path, _, needs = line.partition(":")
    for part in [*reversed(needs.split()), path]:
        if Path("/sys/module", Path(part).stem.replace("-", "_")).exists():
            continue
        insert(modules / part, parameters if part == path else "")


def insert(path: Path, parameters: str) -> None:
    """insmod."""
    with open(path, "rb") as file:
        if libc.syscall(FINIT_MODULE, file.fileno(), parameters.encode(), 0):
            raise OSError(ctypes.get_errno(), f"module {path}")


def main(packages: Path, module: Path, out: Path, project: Path, tests: list[str]) -> int:
    """Bring the machine up and run the tests; returns their status."""
    for kind, where in (("proc", "/proc"), ("sysfs", "/sys"), ("devtmpfs", "/dev"), ("tmpfs", "/dev/shm"),
                        ("tmpfs", "/run"), ("tmpfs", "/mnt")):
        mount(kind, where)
    mount("devpts", "/dev/pts", "ptmxmode=0666")
    mount("hostfs", "/run/out", str(out))
    for wanted in MODULES:
        load(packages / "usr/lib/uml/modules" / os.uname().release, wanted)
    if module.exists():
        insert(module, "")
    busybox = next(str(packages / place) for place in ("bin/busybox", "usr/bin/busybox")
                   if (packages / place).exists())
    os.makedirs("/mnt/bin")
    os.symlink(busybox, "/mnt/bin/ip")
    for command in ("link set lo up", "link add vcan0 type vcan", "link set vcan0 up"):
        subprocess.run(["/mnt/bin/ip", *command.split()], check=True)
    env = {**os.environ, "PATH": "/mnt/bin:/usr/bin:/bin", "HOME": "/mnt", "TMPDIR": "/mnt", "LANG": "C.UTF-8",
           "PYTHONDONTWRITEBYTECODE": "1", "LEGID_KERNEL_GUEST": "1", "OMP_NUM_THREADS": "1"}
    with open("/run/out/log", "ab", buffering=0) as log:
        log.write(f"kernel {os.uname().release}\n".encode())
        return subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist",
                               "--durations=3", *tests], cwd=project, env=env, stdout=log, stderr=log,
                              check=False).returncode


if __name__ == "__main__":
    try:
        packages, module, out, project = map(Path, sys.argv[1:5])
        status = main(packages, module, out, project, sys.argv[5:])
        Path("/run/out/status").write_text(str(status))
    except BaseException:
        with open("/run/out/log", "a") if Path("/run/out").is_dir() else sys.stdout as log:
            traceback.print_exc(file=log)
    os.sync()
    libc.reboot(ctypes.c_int(POWER_OFF - (1 << 32) if POWER_OFF >> 31 else POWER_OFF))
