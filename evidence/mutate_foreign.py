"""Files of other programs for the study of broken files: whole ones, and others that are broken in structure.

A file broken in structure is valid in its format: a tree of mappings, lists and arrays of any depth, shape, type and
name, links in circles and out of the file, counts that do not fit.
"""

import io
import json
import sqlite3
import warnings
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from rosbags.rosbag2 import StoragePlugin

from daq import Column, Dataset, parse_rig
from experiments.exchange import load_map, map_text, read_imported
from experiments.rig import prior_table
from experiments.simulators import read_robot
from tests.support.imported_files import ros2_bag

Make = Callable[[Generator, Path], None]
TYPES = ("f8", "f4", "f2", "i8", "i4", "i2", "u1", "?", "c16", "S3", "U3", "M8[ns]", "m8[s]", ">f8")
NAMES = ("t", "time", "q1", "q2", "log", "", "a.b", "a/b", "#refs#", "__x", "\n[limits]", "é", "x" * 300, "0")
NUMBERS = (0, -1, 1, 2**31, 2**63 - 1, 10**30, 0.0, -0.0, 1e308, 1e-320, float("nan"), float("inf"))


def pick(rng: Generator, words: Sequence[str]) -> str:
    return str(rng.choice(words))


def some(rng: Generator, most: float, least: float = 0) -> int:
    """A count from 2^least to 2^most, evenly by its logarithm."""
    return int(2 ** rng.uniform(least, most))


def array(rng: Generator) -> np.ndarray:
    """Of any type and shape, empty ones too; one of 500 is large."""
    most = 7 if rng.random() < 0.002 else 3
    shape = tuple(some(rng, most) if rng.random() < 0.9 else 0 for _ in range(rng.integers(0, 4)))
    kind = pick(rng, TYPES)
    values = rng.standard_normal(shape) * 10.0 ** rng.integers(-3, 4)
    with np.errstate(all="ignore"):
        return np.asarray(values).astype("i8").astype(kind) if kind[0] in "mMSU" else np.asarray(values).astype(kind)


def tree(rng: Generator, depth: int = 0) -> Any:
    """Mappings, lists, arrays, texts and numbers within each other."""
    kind = rng.integers(7) if depth < 6 else 6
    count = some(rng, 3 if depth else 4)
    if kind < 2:
        return {pick(rng, NAMES): tree(rng, depth + 1) for _ in range(count)}
    if kind == 2:
        return [tree(rng, depth + 1) for _ in range(count)]
    if kind == 3:
        return [{str(name): float(rng.choice([0.1, 1e308])) for name in rng.choice(NAMES, 3)} for _ in range(count * 3)]
    if kind < 6:
        return array(rng)
    return [None, "text", *NUMBERS][rng.integers(len(NUMBERS) + 2)]


def named(rng: Generator) -> dict[str, Any]:
    """Trees, with two columns of numbers."""
    t = np.arange(60.0)
    return {f"v{k}": tree(rng) for k in range(rng.integers(1, 5))} | {"t": t, "q2": np.sin(t)}


def make_json(rng: Generator, path: Path) -> None:
    path.write_text(json.dumps(named(rng), default=lambda value: (
        value.astype(str) if value.dtype.kind in "cMmS" else value).tolist()))


def make_npz(rng: Generator, path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED if rng.random() < 0.5 else zipfile.ZIP_STORED) as archive:
        for k in range(rng.integers(1, 6)):
            data = io.BytesIO()
            np.lib.format.write_array(data, array(rng), allow_pickle=False)
            archive.writestr(pick(rng, NAMES) + f"{k}.npy", data.getvalue())


def make_mat(rng: Generator, path: Path) -> None:
    from scipy.io import savemat
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of names that it leaves out
            savemat(path, named(rng), do_compression=bool(rng.random() < 0.5), long_field_names=True)
    except Exception:  # a tree that the format does not know
        savemat(path, {"t": np.arange(60.0)})


def make_hdf5(rng: Generator, path: Path) -> None:
    import h5py  # type: ignore[import-untyped,import-not-found,unused-ignore]
    with h5py.File(path, "w") as file:
        groups = [file]
        for k in range(rng.integers(1, 12)):
            group, name = groups[rng.integers(len(groups))], f"n{k}"
            match rng.integers(8):
                case 0 | 1:
                    groups.append(group.create_group(name))
                case 2:
                    group[name] = groups[rng.integers(len(groups))]  # circles, too
                case 3:
                    group[name] = h5py.SoftLink(pick(rng, ["/", "/n0", "..", "/nothing", "."]))
                case 4:
                    group[name] = h5py.ExternalLink(pick(rng, ["other.h5", "/etc/passwd", path.name]), "/n0")
                case 5:
                    most = 40 if rng.random() < 0.1 else 16
                    group.create_dataset(name, (some(rng, most),), "f8", chunks=(1024,),
                                         maxshape=(None,))
                case _:
                    values = array(rng)
                    group.create_dataset(name, data=values if values.dtype.kind in "fiub" else np.arange(5.0))


def make_parquet(rng: Generator, path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet
    n = some(rng, 10)
    columns = {}
    for k in range(rng.integers(1, 8)):
        values = np.resize(array(rng).ravel(), n) if rng.random() < 0.8 else np.zeros(n)
        plain = values.real.astype("f8") if values.dtype.kind == "c" else values.tolist()
        columns[pick(rng, NAMES) + str(k)] = pa.array(plain)
    parquet.write_table(pa.table(columns), path, compression=pick(rng, ["none", "zstd", "snappy", "gzip"]))


def make_text(rng: Generator, path: Path) -> None:
    separator = pick(rng, [",", ";", "\t", "|", " "])
    odd = ["1", "1,5", "2.5e300", "", "nan", '"', "'", "word", "-", "1_0", "é", "0x1"]
    rows = [[pick(rng, odd) if rng.random() < 0.1 else f"{rng.standard_normal():.4f}"
             for _ in range(rng.integers(1, 9) if rng.random() < 0.05 else 5)]
            for _ in range(some(rng, 8, 1))]
    head = [separator.join(pick(rng, NAMES) for _ in range(5)) for _ in range(rng.integers(0, 4))]
    text = "\n".join([*head, *(separator.join(row) for row in rows)])
    path.write_bytes(text.encode(pick(rng, ["utf-8", "utf-16", "cp1252"]), "replace"))


def make_can(rng: Generator, path: Path) -> None:
    """Frames of an ODrive; a few of other drives, lengths and kinds; in a third of the files lines that are none."""
    lines, odd = [], 0.1 if rng.random() < 0.3 else 0.0
    for k in range(some(rng, 8, 1)):
        number = int(rng.choice([0x09, 0x14, 0x1C, 0x29, 0x10000])) if rng.random() < 0.9 else rng.integers(2**29)
        size = 8 if rng.random() < 0.9 else int(rng.integers(0, 9))
        mark = pick(rng, ["##1", "#R", "##", ""]) if rng.random() < odd else "#"
        code = f"{number:03X}" if number < 0x800 else f"{number:08X}"
        data = rng.bytes(size).hex().upper()
        lines.append(f"({1e9 + k * 0.01:.6f}) can{rng.integers(3)} {code}{mark}{data}")
    path.write_text("\n".join(lines) + "\n")


def make_db3(rng: Generator, path: Path) -> None:
    path.unlink(missing_ok=True)
    base = sqlite3.connect(path)
    base.execute("pragma synchronous = off")
    base.execute("pragma journal_mode = off")
    base.execute("create table topics(id integer primary key, name text, type text, serialization_format text, "
                 "offered_qos_profiles text, type_description_hash text)")
    base.execute("create table messages(id integer primary key, topic_id integer, timestamp integer, data blob)")
    base.execute("create table schema(schema_version integer, ros_distro text)")
    for k in range(rng.integers(0, 4)):
        kind = rng.choice(["sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu", "std_msgs/msg/Float64", "no/msg/Such"])
        name = f"/{rng.choice(NAMES)}{k}"
        base.execute("insert into topics values(?,?,?,?,?,?)", (k, name, str(kind), "cdr", "", ""))
    for k in range(some(rng, 6)):
        base.execute("insert into messages values(?,?,?,?)", (k, int(rng.integers(5)), some(rng, 63),
                                                              b"\0\1\0\0" + rng.bytes(some(rng, 9))))
    base.commit()
    base.close()


def make_urdf(rng: Generator, path: Path) -> None:
    """Joints between any links: chains, trees, circles."""
    n, odd = rng.integers(1, 6), 0.3 if rng.random() < 0.5 else 0.0
    names = [pick(rng, NAMES) if rng.random() < odd else f"l{k}" for k in range(n + 1)]
    quoted = [name.replace("\n", "&#10;").replace("<", "") for name in names]
    links = "".join(f'<link name="{q}"><inertial><mass value="{number(rng, odd)}"/><inertia ixx="1" izz="1" ixy="0" '
                    f'ixz="0" iyz="0" iyy="{number(rng, odd)}"/></inertial></link>' for q in quoted)
    ends = [(quoted[k], quoted[k + 1]) if rng.random() >= odd else (pick(rng, quoted), pick(rng, quoted))
            for k in range(n)]
    joints = "".join(f'<joint name="j{k}" type="continuous"><parent link="{a}"/><child link="{b}"/><axis xyz="0 1 0"/>'
                     f'<origin xyz="0 0 -0.3" rpy="{number(rng, odd)} 0 0"/></joint>' for k, (a, b) in enumerate(ends))
    path.write_text(f'<robot name="r">{links}{joints}</robot>')


def number(rng: Generator, odd: float) -> str:
    """1, or with probability `odd` something else."""
    return pick(rng, ["0", "-1", "1e308", "nan", "x", "0.1 0.2 0.3", ""]) if rng.random() < odd else "1"


def make_mjcf(rng: Generator, path: Path) -> None:
    """Bodies in bodies with any joints and shapes, copies, textures, height fields and files."""
    odd = 0.2 if rng.random() < 0.5 else 0.0
    big = str(int(2 ** rng.uniform(0, 30 if rng.random() < 0.002 else 6)))
    extra = {"asset": (f'<texture type="2d" builtin="flat" width="{big}" height="8"/>',
                       f'<hfield name="h" nrow="{big}" ncol="2" size="1 1 1 1"/>', '<mesh name="m" file="m.stl"/>'),
             "include": ("../../etc/passwd", path.name, "other.xml")}
    head = f'<compiler angle="{"degree" if rng.random() < 0.5 else "radian"}"/>'
    if rng.random() < odd:
        head += f'<asset>{rng.choice(extra["asset"])}</asset>'
    if rng.random() < odd:
        head += f'<include file="{rng.choice(extra["include"])}"/>'
    inner = ""
    for k in range(rng.integers(1, 5)):
        kind = pick(rng, ["slide", "ball", "free", "x"]) if rng.random() < odd else "hinge"
        shape = f'<inertial pos="0 0 -{number(rng, odd)}" mass="1" diaginertia="1 1 1"/>'
        if rng.random() < odd:
            form = rng.choice(["sphere", "capsule", "box", "mesh", "plane"])
            shape = f'<geom type="{form}" size="{number(rng, odd)} 1 1"/>'
        many = f'<replicate count="{big}"><geom size="0.1"/></replicate>' if rng.random() < odd else ""
        spin = f' euler="{number(rng, odd)} 0 0"' if rng.random() < odd else ""
        inner = (f'<body name="{quoted_name(rng, odd, k)}"{spin}><joint type="{kind}" axis="0 1 0" '
                 f'damping="{number(rng, odd)}"/>{shape}{many}{inner}</body>')
    path.write_text(f"<mujoco>{head}<worldbody>{inner}</worldbody></mujoco>")


def quoted_name(rng: Generator, odd: float, k: int) -> str:
    """Of a body, for an attribute."""
    return pick(rng, NAMES).replace("\n", "&#10;") + str(k) if rng.random() < odd else f"b{k}"


def read_bodies(path: Path) -> None:
    parse_rig('[mechanism]\nmodel = "chain"\nlinks = 5\nactuated = [1]\n' + prior_table(read_robot(path), path.name))


MAKERS: dict[str, tuple[str, Make]] = {
    "json": (".json", make_json), "npz": (".npz", make_npz), "mat": (".mat", make_mat), "hdf5": (".h5", make_hdf5),
    "parquet": (".parquet", make_parquet), "text": (".txt", make_text), "can": (".log", make_can),
    "db3": (".db3", make_db3), "urdf": (".urdf", make_urdf), "mjcf": (".xml", make_mjcf)}


def foreign(folder: Path) -> dict[str, tuple[str, list[bytes], Callable[[Path], object], Make | None]]:
    """Name of a format -> ending, whole files, what reads them, what makes files broken in structure."""
    out: dict[str, tuple[str, list[bytes], Callable[[Path], object], Make | None]] = {}
    for name, (ending, make) in MAKERS.items():
        whole = []
        for seed in range(4):
            make(default_rng(seed), folder / f"w{ending}")
            whole.append((folder / f"w{ending}").read_bytes())
        out[name] = (ending, whole, read_bodies if name in ("urdf", "mjcf") else read_imported, make)
    t = np.arange(60.0)
    run = Dataset("run", 10.0, t, {name: np.sin(t + k) for k, name in enumerate(
        ("q2_rad", "tau2_nm", "gyro_radps", "accel_x_mps2", "accel_y_mps2"))})
    bag = next(ros2_bag(run, folder / "bag", StoragePlugin.MCAP).glob("*.mcap"))
    base = next(ros2_bag(run, folder / "base", StoragePlugin.SQLITE3).glob("*.db3"))
    out["db3"] = (*out["db3"][:1], [base.read_bytes()], *out["db3"][2:])
    columns = map_text({"q2_rad": Column(name="knee", unit="deg")}).encode()
    out["bag"] = (".mcap", [bag.read_bytes()], read_imported, None)
    out["map"] = (".toml", [columns], load_map, None)
    return out
