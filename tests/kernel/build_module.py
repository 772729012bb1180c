"""Builds `module/wires.c` for the guest's kernel, from Debian's source of exactly that kernel, into the cache.

It takes a download of 140 MB and half a minute, once. `make test-kernel` does it; the ordinary tests use what is there.
"""

import gzip
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from tests.kernel.uml import APT, CACHE, Unavailable

MODULE = Path(__file__).resolve().parent / "module"
TOOLS = ("flex", "bison", "m4", "bc")
PARTS = ("*/Makefile", "*/Kbuild", "*/Kconfig*", "{0}/include", "{0}/scripts", "{0}/security/selinux/include",
         "{0}/arch/um", "{0}/arch/x86", "*/kernel/bounds.c", "*/kernel/time/timeconst.bc")
"""What of the kernel's source the build of a module needs."""


def built(base: Path) -> Path:
    """Where the module for this kernel is, or would be."""
    text = b"".join((MODULE / name).read_bytes() for name in ("wires.c", "Makefile"))
    return CACHE / f"wires-{release(base)}-{hashlib.sha256(text).hexdigest()[:12]}.ko"


def release(base: Path) -> str:
    """Release of the guest's kernel."""
    return next((base / "usr/lib/uml/modules").iterdir()).name


def build(base: Path) -> Path:
    """The module, built when it is not there. Raises `Unavailable` naming what is missing."""
    out = built(base)
    if out.exists():
        return out
    for tool in ("gcc", "make", "xz", "apt-cache"):
        if shutil.which(tool) is None:
            raise Unavailable(f"the I2C adapter module needs {tool}")
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        work = Path(folder)
        env = _tools(work)
        source = _source(base, work)
        shutil.copytree(MODULE, work / "module")
        make = ["make", "-s", "-C", str(source), "ARCH=um"]
        _call([*make, "olddefconfig", "modules_prepare"], env)
        _call([*make, f"M={work / 'module'}", "modules", "KBUILD_MODPOST_WARN=1"], env)
        (work / "module" / "wires.ko").rename(out)
    return out


def _tools(work: Path) -> dict[str, str]:
    """Environment with the tools of the kernel's build; those that are not installed come unpacked from packages."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if not missing:
        return dict(os.environ)
    unpacked = work / "tools"
    _download(work, *missing)
    for package in work.glob("*.deb"):
        _call(["dpkg-deb", "-x", str(package), str(unpacked)])
        package.unlink()
    env = {**os.environ, "PATH": f"{unpacked / 'usr/bin'}:{os.environ['PATH']}"}
    if "m4" in missing:
        env["M4"] = str(unpacked / "usr/bin/m4")
    if "bison" in missing:
        env["BISON_PKGDATADIR"] = str(unpacked / "usr/share/bison")
    return env


def _source(base: Path, work: Path) -> Path:
    """The needed part of the kernel's source, with the guest's configuration."""
    kernel = release(base)
    package = f"linux-source-{kernel.rpartition('.')[0]}"
    known = subprocess.run(["apt-cache", "madison", package], capture_output=True, text=True, check=False).stdout
    versions = [line.split("|")[1].strip() for line in known.splitlines() if line.count("|") == 2]
    version = next((v for v in versions if v.startswith(f"{kernel}-")), None)
    if version is None:
        raise Unavailable(f"no source of kernel {kernel} among the packages")
    _download(work, f"{package}={version}")
    (archive,) = work.glob("linux-source-*.deb")
    parts = " ".join(f"'{part.format(package)}'" for part in PARTS)
    source = work / "source"
    source.mkdir()
    _call(["sh", "-c", f"dpkg-deb --fsys-tarfile '{archive}' | tar -xO --wildcards './usr/src/linux-source-*.tar.xz' | "
                       f"xz -dc -T0 | tar -C '{source}' -x --wildcards --strip-components=1 {parts}"])
    archive.unlink()
    config = (base / "usr/share/doc/user-mode-linux/config.gz").read_bytes()
    (source / ".config").write_bytes(gzip.decompress(config))
    return source


def _download(work: Path, *packages: str) -> None:
    _call(["apt-get", *APT, "download", *packages], cwd=work)


def _call(command: list[str], env: dict[str, str] | None = None, cwd: Path | None = None) -> None:
    done = subprocess.run(command, env=env, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Unavailable(f"the I2C adapter module cannot be built ({command[0]}: {done.stderr.strip()[-300:]})")
