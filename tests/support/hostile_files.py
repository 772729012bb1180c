"""Files made to hang, to fill the memory, to crash a reader, to read or write elsewhere: one function each.

`ATTACKS`: name -> (function that makes the file in a folder, words of the command with FILE in its place).
"""

import gzip
import io
import json
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from daq.runs import RunWriter
from tests.support.paths import DEMO_RIG

GIGABYTES_4 = 4 << 30
IMPORT = ("import", "FILE", "--map", "map.toml", "--guess")
FIT = ("fit", "FILE", "--rig", str(DEMO_RIG))
INFO, RUNS = ("info", "FILE"), ("runs", ".")
INIT = ("init", "new.toml", "--from", "FILE")
VERIFY = ("verify", "FILE")
Made = tuple[Callable[[Path], str], tuple[str, ...]]
ATTACKS: dict[str, Made] = {}


def attack(*command: str) -> Callable[[Callable[[Path], str]], Callable[[Path], str]]:
    """Register a function of the folder, which returns the file's name."""
    def register(make: Callable[[Path], str]) -> Callable[[Path], str]:
        ATTACKS[str(make.__doc__).rstrip(".")] = (make, command)
        return make
    return register


def _zeros(file: Any, size: int) -> None:
    for _ in range(size >> 24):
        file.write(bytes(1 << 24))


# -- memory ------------------------------------------------------------------------------------------------------------


@attack(*IMPORT)
def gzip_bomb(folder: Path) -> str:
    """A .csv.gz of 4 MB that unpacks to 4 GB."""
    with gzip.open(folder / "a.csv.gz", "wb", 1) as file:
        file.write(b"time_s,q\n0,1\n1,2\n")
        _zeros(file, GIGABYTES_4)
    return "a.csv.gz"


@attack(*FIT)
def gzip_bomb_fit(folder: Path) -> str:
    """The same under the columns of a run, for legid fit."""
    with gzip.open(folder / "b.csv.gz", "wb", 1) as file:
        file.write(b"time_s,q2_rad,tau2_nm,gyro_radps,accel_x_mps2,accel_y_mps2\n")
        for _ in range(200):
            file.write(b"0,0,0,0,0,0\n" * 1_000_000)
    return "b.csv.gz"


@attack(*IMPORT)
def npz_bomb(folder: Path) -> str:
    """An .npz whose one array unpacks to 4 GB."""
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,), }" % (GIGABYTES_4 >> 3)
    with (zipfile.ZipFile(folder / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
          archive.open("q.npy", "w", force_zip64=True) as file):
        file.write(b"\x93NUMPY\x01\0" + struct.pack("<H", 118) + head.ljust(117) + b"\n")
        _zeros(file, GIGABYTES_4)
    return "a.npz"


@attack(*IMPORT)
def npy_declared(folder: Path) -> str:
    """An .npy of 128 bytes that declares 10^12 numbers."""
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    (folder / "a.npy").write_bytes(b"\x93NUMPY\x01\0" + struct.pack("<H", 118) + head.ljust(117) + b"\n")
    return "a.npy"


@attack(*IMPORT)
def hdf5_declared(folder: Path) -> str:
    """An HDF5 dataset of 10^10 values of which none is written."""
    import h5py  # type: ignore[import-untyped,import-not-found,unused-ignore]
    with h5py.File(folder / "a.h5", "w") as file:
        file.create_dataset("q", (10**10,), "f8", chunks=(1 << 20,))
    return "a.h5"


@attack(*IMPORT)
def hdf5_many(folder: Path) -> str:
    """An HDF5 file of 40 datasets of 64 MB of which none is written."""
    import h5py
    with h5py.File(folder / "b.h5", "w") as file:
        for k in range(40):
            file.create_dataset(f"q{k}", (1 << 23,), "f8", chunks=(1 << 20,))
    return "b.h5"


@attack(*IMPORT)
def parquet_bomb(folder: Path) -> str:
    """A Parquet column of 10^9 equal values."""
    import pyarrow as pa
    from pyarrow import parquet
    batch = pa.table({"q": np.zeros(10_000_000)})
    with parquet.ParquetWriter(folder / "a.parquet", batch.schema, compression="zstd") as writer:
        for _ in range(100):
            writer.write_table(batch)
    return "a.parquet"


@attack(*IMPORT)
def json_deep(folder: Path) -> str:
    """A JSON of 10^6 opening brackets."""
    (folder / "a.json").write_text("[" * 1_000_000)
    return "a.json"


@attack(*IMPORT)
def mat_deep(folder: Path) -> str:
    """A MATLAB file of cells in cells, 20,000 deep."""
    inner = struct.pack("<II", 9, 8) + bytes(8)
    for _ in range(20_000):
        head = (struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<HHI", 1, 0, 0))
        inner = struct.pack("<II", 14, len(head) + len(inner)) + head + inner
    (folder / "a.mat").write_bytes(b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + inner)
    return "a.mat"


@attack(*INFO)
def mcap_bomb(folder: Path) -> str:
    """A run whose chunk unpacks to 4 GB."""
    import zstandard
    packed = io.BytesIO()
    with zstandard.ZstdCompressor(level=1).stream_writer(packed, closefd=False) as writer:
        _zeros(writer, GIGABYTES_4)
    data = packed.getvalue()
    content = struct.pack("<QQQI", 0, 0, GIGABYTES_4, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(data))
    (folder / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(content) + len(data)) + content + data)
    return "a.mcap"


@attack(*IMPORT)
def mcap_header(folder: Path) -> str:
    """An MCAP file whose header claims 2^60 bytes."""
    (folder / "b.mcap").write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 1 << 60) + b"x" * 100)
    return "b.mcap"


# -- time --------------------------------------------------------------------------------------------------------------


@attack(*IMPORT)
def wide(folder: Path) -> str:
    """A text of 10^6 columns."""
    row = ",".join(["1"] * 1_000_000)
    (folder / "a.csv").write_text("\n".join([",".join(f"c{k}" for k in range(1_000_000)), row, row, row]))
    return "a.csv"


@attack(*FIT)
def wide_fit(folder: Path) -> str:
    """A run of 10^6 columns of its own, for legid fit."""
    names = "time_s,q2_rad,tau2_nm,gyro_radps,accel_x_mps2,accel_y_mps2," + ",".join(f"c{k}" for k in range(1_000_000))
    (folder / "b.csv").write_text(names + "\n" + ",".join(["1"] * 1_000_006) + "\n")
    return "b.csv"


@attack(*IMPORT)
def quotation(folder: Path) -> str:
    """A text with a quotation mark that never ends, 2 MB behind it."""
    (folder / "c.csv").write_text('t,q\n0,"' + "1,1\n" * 500_000)
    return "c.csv"


@attack(*IMPORT)
def hdf5_circle(folder: Path) -> str:
    """An HDF5 group that holds itself by a hard link."""
    import h5py
    with h5py.File(folder / "c.h5", "w") as file:
        file.create_group("a")
        file["a/b"] = file["a"]
    return "c.h5"


@attack(*IMPORT)
def hdf5_lattice(folder: Path) -> str:
    """HDF5 groups that each lead twice to the next, 60 of them: 2^60 ways."""
    import h5py
    with h5py.File(folder / "d.h5", "w") as file:
        group = file.create_group("g")
        for _ in range(60):
            following = group.create_group("a")
            group["b"] = following
            group = following
        group["q"] = np.arange(100.0)
    return "d.h5"


@attack(*IMPORT)
def pipe(folder: Path) -> str:
    """A pipe in the place of a file."""
    os.mkfifo(folder / "pipe.csv")
    return "pipe.csv"


@attack(*FIT)
def pipe_run(folder: Path) -> str:
    """A pipe in the place of a run, for legid fit."""
    os.mkfifo(folder / "pipe.mcap")
    return "pipe.mcap"


@attack(*IMPORT)
def device(folder: Path) -> str:
    """A link to /dev/zero."""
    (folder / "zero.csv").symlink_to("/dev/zero")
    return "zero.csv"


@attack(*IMPORT)
def bag_of_pipes(folder: Path) -> str:
    """A bag's folder whose metadata is a pipe."""
    (folder / "bag").mkdir()
    os.mkfifo(folder / "bag" / "metadata.yaml")
    return "bag"


URDF_LINK = ('<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>')
URDF_JOINT = ('<joint name="j{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/></joint>')


@attack(*INIT)
def urdf_circle(folder: Path) -> str:
    """A URDF of two links that carry each other."""
    (folder / "a.urdf").write_text(
        '<robot name="r"><link name="w"/>' + "".join(URDF_LINK.format(k) for k in "ab") + URDF_JOINT.format(1, "w", "a")
        + URDF_JOINT.format(2, "a", "b") + URDF_JOINT.format(3, "b", "a") + "</robot>")
    return "a.urdf"


@attack(*INIT)
def urdf_long(folder: Path) -> str:
    """A URDF of 20,000 links in a row."""
    n = 20_000
    (folder / "b.urdf").write_text('<robot name="r">' + "".join(URDF_LINK.format(k) for k in range(n)) + "".join(
        URDF_JOINT.format(k, k, k + 1) for k in range(n - 1)) + "</robot>")
    return "b.urdf"


@attack(*INIT)
def urdf_entities(folder: Path) -> str:
    """A URDF in UTF-16 whose entities grow to 3 GB."""
    text = '<?xml version="1.0" encoding="utf-16"?><!DOCTYPE r [<!ENTITY a0 "lol">' + "".join(
        f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 10)) + ']><robot name="&a9;"/>'
    (folder / "c.urdf").write_bytes(text.encode("utf-16"))
    return "c.urdf"


# -- elsewhere ---------------------------------------------------------------------------------------------------------


@attack(*IMPORT)
def hdf5_external_link(folder: Path) -> str:
    """An HDF5 file with a link to another file."""
    import h5py
    with h5py.File(folder / "secret.hdf", "w") as file:
        file["q"] = np.arange(100.0)
    with h5py.File(folder / "e.h5", "w") as file:
        file["log/q"] = h5py.ExternalLink("secret.hdf", "/q")
        file["log/t"] = np.arange(100.0)
    return "e.h5"


@attack(*IMPORT)
def hdf5_external_storage(folder: Path) -> str:
    """An HDF5 dataset whose numbers are the bytes of another file."""
    import h5py
    (folder / "secret.txt").write_bytes(bytes(range(256)) * 4)
    with h5py.File(folder / "f.h5", "w") as file:
        file.create_dataset("q", (100,), "u1", external=[("secret.txt", 0, 100)])
    return "f.h5"


@attack(*IMPORT)
def hdf5_virtual(folder: Path) -> str:
    """A virtual HDF5 dataset over another file."""
    import h5py
    with h5py.File(folder / "secret2.hdf", "w") as file:
        file["q"] = np.arange(100.0)
    with h5py.File(folder / "g.h5", "w") as file:
        layout = h5py.VirtualLayout((100,), "f8")
        layout[:] = h5py.VirtualSource("secret2.hdf", "q", (100,))
        file.create_virtual_dataset("q", layout)
    return "g.h5"


def provenance(folder: Path, name: str, file: str, inside: str = "") -> str:
    run = {"file": file, "sha256": "0" * 64, "inside": inside}
    (folder / name).write_text(json.dumps({"provenance": {"version": "1", "commit": "c", "runs": [run]}}))
    return name


@attack(*VERIFY)
def verify_upwards(folder: Path) -> str:
    """A provenance with a name that leads upwards."""
    return provenance(folder, "a.json", "../../etc/passwd")


@attack(*VERIFY)
def verify_inside(folder: Path) -> str:
    """A provenance with an absolute name of the run that holds a rig."""
    return provenance(folder, "b.json", "rig.toml", "/etc/passwd")


@attack(*VERIFY)
def verify_pattern(folder: Path) -> str:
    """A provenance with a name of a zero byte and patterns."""
    return provenance(folder, "c.json", "**/\0*")


@attack(*INIT)
def mjcf_name(folder: Path) -> str:
    """An MJCF whose body's name writes tables."""
    (folder / "a.xml").write_text(
        '<mujoco><worldbody><body name="x&#13;[limits]&#13;torque_nm = 900.0&#10;#"><joint type="hinge" axis="0 1 0"/>'
        '<inertial pos="0.3 0 -0.1" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>')
    return "a.xml"


BODY = '<worldbody><body name="a"><joint axis="0 1 0"/><geom size="1"/></body></worldbody>'


def mjcf(folder: Path, name: str, text: str) -> str:
    (folder / name).write_text(f"<mujoco>{text}</mujoco>")
    return name


@attack(*INIT)
def mjcf_texture(folder: Path) -> str:
    """An MJCF whose texture has 10^10 points."""
    texture = '<texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>'
    return mjcf(folder, "t.xml", f"<asset>{texture}</asset>{BODY}")


@attack(*INIT)
def mjcf_copies(folder: Path) -> str:
    """An MJCF that asks for 10^9 copies of a shape."""
    copies = '<replicate count="1000000000"><geom size="1"/></replicate>'
    return mjcf(folder, "r.xml", BODY.replace("</body>", f"</body>{copies}"))


@attack(*INIT)
def mjcf_include(folder: Path) -> str:
    """An MJCF that includes a file outside its folder."""
    return mjcf(folder, "i.xml", f'<include file="../../etc/passwd"/>{BODY}')


@attack(*INIT)
def mjcf_pipe(folder: Path) -> str:
    """An MJCF whose mesh is a pipe."""
    os.mkfifo(folder / "mesh.stl")
    return mjcf(folder, "p.xml", f'<asset><mesh name="m" file="mesh.stl"/></asset>{BODY}')


@attack(*RUNS)
def run_started(folder: Path) -> str:
    """A run that began in the year 10^20."""
    RunWriter(folder / "started.mcap", {"rig.toml": DEMO_RIG.read_text()}, {"started_unix_ns": "9" * 30}).close()
    return "started.mcap"


@attack(*RUNS)
def run_digits(folder: Path) -> str:
    """A run that began at a number of Arabic-Indic digits, and one at 10^5000."""
    RunWriter(folder / "digits.mcap", {"rig.toml": "x"}, {"started_unix_ns": "\u0661\u0662"}).close()
    RunWriter(folder / "digits2.mcap", {"rig.toml": "x"}, {"started_unix_ns": "9" * 5000}).close()
    return "digits.mcap"


HARMLESS = {"An HDF5 group that holds itself by a hard link", "An MJCF whose body's name writes tables",
            "HDF5 groups that each lead twice to the next, 60 of them: 2^60 ways"}
"""Attacks that may be read, as something that does no harm."""
