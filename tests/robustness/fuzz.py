"""Damage files of every format that is read, a little at a time, and read them.

    python -m tests.robustness.fuzz --minutes 60 --seed 1

Each file is changed where its structure is (counts, sizes, names, ends of its parts), read under
limits of time and memory, and may end in a Log, a Robot, a result, or a TorchidError. What ends
otherwise is kept in `tests/robustness/corpus`, which the tests replay. HDF5 and .mat files are left
out: the C code of their libraries may crash on a damaged one.
"""

import argparse
import os
import random
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import yaml

from tests.gap_files import diagnosis, hidden, named
from tests.log.recordings import BAGS, START_NS, write_bag, write_lerobot
from tests.robustness import bad_logs, bad_results, bad_robots
from tests.robustness.bench import TooLongError, limited
from torchid import inverse_dynamics
from torchid.effects.model import ArmModel
from torchid.errors import TorchidError
from torchid.export.model import load_model
from torchid.fleet.manifest import read_manifest
from torchid.gap.record import GapRecord
from torchid.inputs import as_log
from torchid.log.checks import check_log
from torchid.log.mapping import read_mapping
from torchid.log.model import Log
from torchid.log.readers import log_from_columns, read_log, write_log
from torchid.report.explain import report_of_file
from torchid.results.files import load
from torchid.results.record import Record
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot

COLUMNS = """t: time ms
q: pos_{j} deg
tau: {columns: [a, b, c], unit: mN m, factor: [1, -1, 1]}
"""
MERGED = "a: &a {x: 1, y: 2}\nb: &b {<<: [*a, *a], z: 3}\nname: {<<: [*a, *b, *b]}\n"
CORPUS = Path(__file__).parent / "corpus"
WORDS = tuple(
    [struct.pack(f"{order}{kind}", value & (2 ** (8 * size) - 1))
     for kind, size in (("B", 1), ("H", 2), ("I", 4), ("Q", 8))
     for order in "<>"
     for value in (0, 1, -1, 2 ** (8 * size - 1), 2 ** (8 * size - 1) - 1, 255)]
    + [b'"colour"', b"backlash", b"null", b"[]", b"{}"]
    + [b"nan", b"inf", b"1e308", b"-1", b"\xff\xfe", b"\0", b"\x1b[31m", b'"', b"'", b"[" * 500,
       b"{", b"}", b",", b"\n", b"<", b">", b"&a;", b"9" * 400, b"null", b"true", b"*", b"&", b":"]
)  # fmt: skip


def seeds(folder: Path) -> dict[str, bytes]:
    """A small good file of every format, by name; those of datasets and bags that are folders with
    their places in it, and all of them there."""
    table = bad_logs.motion(40)
    gap = diagnosis(
        folder / "gap.json", named(), hidden=[hidden("backlash", 1)], robot="3r_friction"
    )
    sets, identified = bad_results.good(folder)
    states = [
        {"stamp": START_NS + round(1e9 * t), "name": ["a", "b", "c"], "position": q, "velocity": q}
        for t, q in zip(table["t"], np.stack([table[f"q{j}"] for j in (1, 2, 3)], -1), strict=True)
    ]
    bags = {kind: write_bag(folder / kind, kind, {"/joint_states": states}) for kind in BAGS}
    frames = log_from_columns(table, folder)
    write_lerobot(
        folder / "lerobot", "v3.0", frames, {"observation.state": (None, frames.q.numpy())}
    )
    inside = [
        *(folder / "mcap").iterdir(), *(folder / "sqlite3").iterdir(),
        *(file for file in (folder / "lerobot").rglob("*") if file.is_file()),
    ]  # fmt: skip
    return {
        **{str(file.relative_to(folder)): file.read_bytes() for file in sorted(inside)},
        "log.bag": bags["ros1"].read_bytes(),
        "log.mcap": next((folder / "mcap").glob("*.mcap")).read_bytes(),
        "log.db3": next((folder / "sqlite3").glob("*.db3")).read_bytes(),
        "columns.yml": COLUMNS.encode(),
        "log.csv": bad_logs.csv(table),
        "log.npz": bad_logs.npz(table),
        "log.parquet": bad_logs.parquet(table),
        "arm.yaml": yaml.safe_dump(bad_robots.GOOD).encode(),
        "arm.urdf": bad_robots.URDF.encode(),
        "arm.xml": bad_robots.MJCF.encode(),
        "merged.yaml": MERGED.encode(),
        "fleet.csv": b"log,unit,session\na.csv,007,1.10\nb.csv,7,1e5\n",
        "gap.json": gap.read_bytes(),
        "sets.json": sets.read_bytes(),
        "identified.json": identified.read_bytes(),
    }


def placed(folder: Path, name: str, content: bytes) -> tuple[Path, Path]:
    """Write a file of a name of `seeds`; what was written, and what a reader is given: the folder
    that it is in, where it is in one."""
    if os.sep in name:
        (folder / name).write_bytes(content)
        return folder / name, folder / name.partition(os.sep)[0]
    path = folder / f"changed_{name}"
    path.write_bytes(content)
    return path, path


def changed(content: bytes, others: bytes, choose: random.Random) -> bytes:
    """A file with one to four changes."""
    data = bytearray(content)
    for _ in range(choose.choice((1, 1, 1, 2, 2, 4))):
        # Headers and footers, where sizes and names stand, more often than what lies between.
        near = choose.choice((64, 256, 1024, len(data)))
        place = choose.randrange(max(1, min(near, len(data))))
        place = place if choose.random() < 0.6 else max(0, len(data) - 1 - place)
        word = choose.choice(WORDS)
        length = choose.choice((1, 4, 8, 30, 300))
        kind = choose.randrange(7)
        if kind == 0:
            data[place : place + 1] = bytes([choose.randrange(256)])
        elif kind == 1:
            data[place : place + len(word)] = word
        elif kind == 2:
            data[place:place] = word
        elif kind == 3:
            del data[place : place + length]
        elif kind == 4:
            data[place:place] = data[place : place + length] * choose.choice((1, 3))
        elif kind == 5:
            del data[place:]
        else:
            start = choose.randrange(max(1, len(others)))
            data[place : place + length] = others[start : start + length]
    return bytes(data)


def read(path: Path) -> None:
    """A file with the reader of its suffix; what could be read is used."""
    readers: dict[str, Callable[[Path], object]] = {
        ".json": load, ".yaml": load_model, ".urdf": load_robot, ".xml": load_robot,
        ".yml": read_mapping,
    }  # fmt: skip
    found = readers.get(path.suffix, read_log)(path)
    if path.suffix == ".csv":
        with suppress(TorchidError):
            read_manifest(path)
    with suppress(TorchidError):  # what is no log of this arm, or too old, may say so
        use(found, path)


def use(found: object, path: Path) -> None:
    """What people do first with a log, a robot, a model or a result that was read."""
    if isinstance(found, Log):
        as_log(found)
        write_log(found, path.with_name("written.csv"))
        check_log(found, n=found.n, robot_name="arm")
    elif isinstance(found, Robot):
        zero = np.zeros((2, found.n))
        if found.parameters is not None:
            inverse_dynamics(found, zero, zero, zero)
        write_robot(found, path.with_name("written.yaml"))
    elif isinstance(found, ArmModel):
        zero = np.zeros((3, found.robot.n))
        found.torque(zero, zero, zero, [0.0, 0.1, 0.2])
        found.sample(2)
    elif isinstance(found, Record):
        report_of_file(path)
        found.plain()
        if isinstance(found, GapRecord):
            load_model(path)


def fault(path: Path) -> str | None:
    """What is wrong with how reading a file ends; None where all is right."""
    try:
        with limited(10):
            read(path)
    except TorchidError as error:
        text = str(error)
        if len(text) > 12_000 or not all(c.isprintable() or c in "\n\t\ufffd" for c in text):
            return "an error that no terminal should show"
    except TooLongError:
        return "no end in time"
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}"
    return None


def fuzz(folder: Path, seed: int, *, minutes: float, count: int, keep: Path | None) -> Counter[str]:
    """Read changed files until the time or the count is over.

    Args:
        folder: to work in.
        seed: of the changes.
        minutes, count: the most of them.
        keep: folder for one file of each new fault.

    Returns:
        How often which fault was met; under "" the number of files that were read.
    """
    choose, found = random.Random(seed), Counter[str]()
    good = seeds(folder)
    names = list(good)
    end = time.monotonic() + 60 * minutes
    while time.monotonic() < end and found[""] < count:
        name = choose.choice(names)
        content = changed(good[name], good[choose.choice(names)], choose)
        file, path = placed(folder, name, content)
        found[""] += 1
        wrong = fault(path)
        file.write_bytes(good[name])
        if wrong is None:
            continue
        found[f"{name}: {wrong}"] += 1
        if keep is not None and found[f"{name}: {wrong}"] == 1:
            keep.mkdir(exist_ok=True)
            (keep / f"{len(found):03}_{name.replace(os.sep, '-')}").write_bytes(content)
            sys.stderr.write(f"{name}: {wrong}\n")
    return found


def main() -> None:
    """The command line; exits 1 where a fault was met, and by itself where a reader kills it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--count", type=int, default=10**9)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        found = fuzz(
            Path(folder), given.seed, minutes=given.minutes, count=given.count, keep=CORPUS
        )
    read_files = found.pop("")
    print(f"{read_files} files read, {sum(found.values())} faults, {len(found)} kinds")
    for name, times in found.most_common():
        print(f"{times:6} {name}")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
