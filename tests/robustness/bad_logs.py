"""Logs that are none, or that nothing can be identified from."""

import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

Table = dict[str, np.ndarray]

LONG, ESCAPE, MARKUP = "n" * 5000, "\x1b[31mred\x1b]0;title\x07\x9b2J", "[/left][bold]"
HUGE, DEEP = 10**400, 100_000


def motion(samples: int = 600, joints: int = 3, seed: int = 0) -> Table:
    """A plausible log of the 3R, sampled at 100 Hz; its torque is nobody's."""
    t = np.arange(samples) / 100
    random = np.random.default_rng(seed)
    columns = {"t": t}
    for j in range(1, joints + 1):
        w, phase = 1.0 + 0.7 * j, random.uniform(0, 6)
        columns[f"q{j}"] = 0.8 * np.sin(w * t + phase)
        columns[f"dq{j}"] = 0.8 * w * np.cos(w * t + phase)
        columns[f"tau{j}"] = 5 * np.sin(w * t + phase) + np.sign(np.cos(w * t + phase))
    return columns


def csv(columns: Table) -> bytes:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def npz(columns: Table) -> bytes:
    file = io.BytesIO()
    np.savez(file, **columns)
    return file.getvalue()


def npz_of(**members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file.getvalue()


def npy(header: str, data: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) & 0xFFFF) + text + data


def parquet(columns: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    pa.parquet.write_table(pa.table(columns), file)
    return file.getvalue()


def mat(columns: Table) -> bytes:
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, {**columns, "run": {"q": columns["q1"], "name": "text"}})
    return file.getvalue()


def hdf5(build: Callable[[Any, Any], None]) -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w") as root:
        build(h5py, root)
    return file.getvalue()


def _columns(_: Any, root: Any) -> None:
    for name, column in motion().items():
        root[name] = column


def _endless(_: Any, root: Any) -> None:
    for name in ("t", "q1", "q2", "q3", "tau1", "tau2", "tau3"):
        root.create_dataset(name, shape=(2**38,), chunks=(2**10,), dtype="f8")


def _links(h5py: Any, root: Any) -> None:
    root["t"] = h5py.SoftLink("/q1")
    root["q1"] = h5py.SoftLink("/t")
    root["q2"] = h5py.ExternalLink("/etc/passwd", "/x")
    root["loop"] = h5py.SoftLink("/")
    root["q3"] = np.zeros(3)


def _kinds(h5py: Any, root: Any) -> None:
    root["t"] = np.array(["a", "b"], dtype="S1")
    root["q"] = np.zeros((2, 3), dtype=complex)
    root.create_dataset("tau", data=[root["t"].ref] * 2, dtype=h5py.ref_dtype)


def lerobot(info: Any, columns: dict[str, Any] | None) -> dict[str, bytes]:
    files = {"meta/info.json": info if isinstance(info, bytes) else json.dumps(info).encode()}
    return files if columns is None else files | {"data/chunk-000/a.parquet": parquet(columns)}


def _frames(**others: Any) -> dict[str, Any]:
    n = 50
    state = [[0.1 * k, 0.2, 0.3] for k in range(n)]
    counted = {"episode_index": [0] * n, "frame_index": list(range(n))}
    return counted | {"observation.state": state} | others


def _datasets() -> Iterator[tuple[str, dict[str, bytes]]]:
    def info(fps: Any = 30, **feature: Any) -> dict[str, Any]:
        state = {"dtype": "float32", "shape": [3], "names": ["a.pos", "b.pos", "c.pos"]} | feature
        return {"fps": fps, "features": {"observation.state": state}}

    yield "no data", lerobot(info(), None)
    for fps in (0, -1, "x", None, [1], 1e400, HUGE):
        yield f"fps {str(fps)[:8]}", lerobot(info(fps), _frames())
    for shape in ([1e30], [-1], ["x"], [[3]], {"a": 1}, 7, [None], [10**12], "abc", [True, True]):
        yield f"shape {shape}", lerobot(info(shape=shape), _frames())
    for names in ([LONG] * 3, [ESCAPE] * 3, [None] * 3, {"motors": {"motors": 3}}, 5):
        yield f"names {str(names)[:9]!r}", lerobot(info(names=names), _frames())
    yield "features", lerobot({"fps": 30, "features": [1]}, _frames())
    yield "deep", lerobot(b'{"fps": ' + b"[" * DEEP, _frames())
    yield "null", lerobot(b"null", _frames())
    yield "not utf-8", lerobot(b'{"fps": "\xff"}', _frames())
    yield "no rows", lerobot(info(), {key: pa.array([], "f8") for key in _frames()})
    yield "text", lerobot(info(), _frames(frame_index=["x"] * 50))
    yield (
        "uneven",
        lerobot(info(), _frames(**{"observation.state": [[0.1] * (k % 3) for k in range(50)]})),
    )


def _changed(**columns: Any) -> bytes:
    return csv(motion() | {name: np.asarray(column) for name, column in columns.items()})


def _files() -> Iterator[tuple[str, bytes]]:
    good = motion()
    whole = csv(good)
    t, n = good["t"], len(good["t"])
    yield "empty.csv", b""
    yield "header.csv", whole.split(b"\n")[0] + b"\n"
    yield "one_row.csv", b"\n".join(whole.split(b"\n")[:2]) + b"\n"
    yield "two_rows.csv", b"\n".join(whole.split(b"\n")[:3]) + b"\n"
    yield "binary.csv", bytes(range(256)) * 40
    yield "zeros.csv", bytes(4000)
    yield "utf16.csv", whole.decode().encode("utf-16")
    yield "latin.csv", whole.replace(b"q2", b"\xe9")
    yield "quote.csv", whole.replace(b"\n", b'\n"', 3)
    yield "ragged.csv", whole.replace(b"\n0.1,", b"\n0.1,7,")
    yield "text.csv", whole.replace(b"\n0.1,", b"\nten,")
    yield "dates.csv", b"t;q1;q2;q3\n" + b"2026-01-01T00:00:00,5;1,0;2,0;3,0\n" * 30
    yield "commas.csv", b"t;q1;q2;q3\n" + b"0,5;1,0;2,0;zwei,0\n" * 30
    yield "huge.csv", whole.replace(b"\n0.1,", b"\n%d," % HUGE)
    yield "long_names.csv", whole.replace(b"q1,", LONG.encode() + b",", 1)
    yield "escapes.csv", whole.replace(b"q1,", ESCAPE.encode() + b",", 1)
    yield "markup.csv", whole.replace(b"q1,", MARKUP.encode() + b",", 1)
    yield "many_names.csv", ",".join(f"c{k}" for k in range(20_000)).encode() + b"\n"
    yield "repeated.csv", whole.replace(b"q2", b"q1", 1)
    yield "no_header.csv", whole.split(b"\n", 1)[1]
    yield "no_q.csv", csv({k: v for k, v in good.items() if not k.startswith("q")})
    yield "nan_time.csv", _changed(t=np.where(np.arange(n) == 40, np.nan, t))
    yield "back.csv", _changed(t=np.where(np.arange(n) == 40, 0.0, t))
    yield "same_time.csv", _changed(t=np.zeros(n))
    yield "late.csv", _changed(t=t * 1e300)
    yield "early.csv", _changed(t=t - 1e300)
    yield "nan.csv", _changed(q2=np.full(n, np.nan))
    yield "infinite.csv", _changed(q2=np.full(n, np.inf))
    yield "far.csv", _changed(q2=np.full(n, 1e308))
    yield "farther.csv", _changed(q2=1e308 * np.sin(t))
    yield "fewer.csv", csv({k: v for k, v in good.items() if not k.endswith("3")})
    yield "more.csv", csv(motion(joints=40))
    yield "traj.csv", _changed(traj=np.arange(n))
    yield "traj_nan.csv", _changed(traj=np.full(n, np.nan))
    yield "traj_huge.csv", _changed(traj=np.full(n, 1e300))

    archive = npz(good)
    yield "empty.npz", b""
    yield "garbage.npz", b"\x00\x01\x02 no archive"
    yield "cut.npz", archive[: len(archive) // 2]
    yield "holes.npz", archive[:200] + b"\xff" * 900 + archive[1100:]
    yield "nothing.npz", npz({})
    yield "objects.npz", npz(good | {"q1": np.array([{}, []] * (n // 2), dtype=object)})
    yield "complex.npz", npz(good | {"q1": np.zeros(n, complex)})
    yield "texts.npz", npz(good | {"t": np.array(["x"] * n)})
    yield "cube.npz", npz({"t": t, "q": np.zeros((n, 3, 2))})
    yield "point.npz", npz({"t": np.array(1.0), "q": np.zeros((n, 3))})
    yield "no_rows.npz", npz({"t": np.zeros(0), "q": np.zeros((0, 3)), "tau": np.zeros((0, 3))})
    yield "wide.npz", npz({"t": np.zeros(0), "q": np.zeros((3, 0))})
    yield "names.npz", npz({LONG: t, ESCAPE: t, MARKUP: t, "q/../x": t})
    shape = "{'descr': '<f8', 'fortran_order': False, 'shape': %s, }"
    for k, claimed in enumerate(
        ("(1000000000000,)", "(-1,)", "(1e3,)", "'x'", "(2**70,)", "(99999999999999999999999,)")
    ):
        yield f"claims{k}.npz", npz_of(t=npy(shape % claimed, bytes(80)), q=npy(shape % claimed))
    yield "nested.npz", npz_of(t=npy("(" * 5000), q=npy("["))
    yield "no_npy.npz", npz_of(t=b"just text", q=b"")
    yield "dtype.npz", npz_of(t=npy("{'descr': [('a', 'O')], 'fortran_order': 0, 'shape': (3,)}"))

    table = parquet(good)
    yield "empty.parquet", b""
    yield "garbage.parquet", b"PAR1 but no more PAR1"
    yield "cut.parquet", table[: len(table) // 2]
    yield "holes.parquet", table[:300] + bytes(900) + table[1200:]
    yield "foot.parquet", table[:-200] + b"\xff" * 100 + table[-100:]
    yield "bad_name.parquet", table.replace(b"dq3", b"\xff\xfe3")
    yield "names.parquet", parquet({LONG: t, ESCAPE: t, MARKUP: t})
    yield "no_rows.parquet", parquet({name: column[:0] for name, column in good.items()})
    yield "uneven.parquet", parquet({"t": t, "q1": [[0.0] * (k % 3) for k in range(n)]})
    yield "structs.parquet", parquet({"t": t, "q1": [{"a": 1}] * n})
    yield "texts.parquet", parquet(good | {"q1": ["x"] * n})
    yield "nulls.parquet", parquet(good | {"q1": pa.nulls(n)})

    arrays = mat(good)
    yield "empty.mat", b""
    yield "garbage.mat", b"MATLAB 5.0 MAT-file" + bytes(range(256)) * 4
    yield "cut.mat", arrays[: len(arrays) // 2]
    yield "head.mat", arrays[:128]
    for k, (place, word) in enumerate(
        [(128, 0xFFFFFFFF), (132, 0x7FFFFFFF), (144, 0), (144, 99), (164, 0), (168, 0),
         (176, 99), (176, 0xFFFF0001)]
    ):  # fmt: skip
        yield f"word{k}.mat", arrays[:place] + struct.pack("<I", word) + arrays[place + 4 :]
    yield "v7_3.mat", b"MATLAB 7.3 MAT-file" + bytes(600)

    store = hdf5(_columns)
    yield "empty.h5", b""
    yield "garbage.h5", b"\x89HDF\r\n\x1a\n" + bytes(range(256))
    yield "cut.h5", store[: len(store) // 2]
    yield "holes.h5", store[:600] + b"\xff" * 300 + store[900:]
    yield "endless.h5", hdf5(_endless)
    yield "links.h5", hdf5(_links)
    yield "kinds.h5", hdf5(_kinds)
    yield "nothing.h5", hdf5(lambda *_: None)

    for name in ("bag.bag", "bag.mcap", "bag.db3"):
        yield f"empty_{name}", b""
        yield f"garbage_{name}", b"#ROSBAG V2.0\n" + bytes(range(256)) * 3
    yield "mcap.mcap", b"\x89MCAP0\r\n" + b"\xff" * 500
    yield "sqlite.db3", b"SQLite format 3\0" + bytes(2000)
    yield "unknown.xlsx", b"PK"
    yield "suffixless", whole


def write_all(folder: Path) -> dict[str, Path]:
    """All bad logs, by a name of each."""
    found: dict[str, Path] = {}
    for name, content in _files():
        found[name] = folder / name
        found[name].write_bytes(content)
    for k, (name, files) in enumerate(_datasets()):
        found[f"lerobot {name}"] = folder / f"lerobot_{k}"
        for part, content in files.items():
            target = folder / f"lerobot_{k}" / part
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
    outside = b"{version: 5, storage_identifier: sqlite3, relative_file_paths: [../../x]}"
    for k, text in enumerate((b"", b"[" * 300, b"7", b"\xff\xfe", outside)):
        bag = folder / f"bag_{k}"
        bag.mkdir()
        (bag / "metadata.yaml").write_bytes(b"rosbag2_bagfile_information: " + text)
        found[f"bag {k}"] = bag
    found["folder"] = folder
    found["absent"] = folder / "absent.csv"
    found["not utf-8"] = folder / "\udcff\udcfe.csv"
    return found
