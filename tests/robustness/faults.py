"""Kill commands at random times, fill their disk, and look at what is left.

    python -m tests.robustness.faults --kills 20 --seed 1 --of gap

What is on disk must be whole or absent, and the same command afterwards must give the same bits as
one that nothing has happened to.
"""

import argparse
import contextlib
import io
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import joblib
import yaml

from tests.fleet.simulated import Plan, make
from tests.gap.small_logs import Recording, arm, friction, logged
from torchid.log.readers import write_log
from torchid.robot.library import load_robot

TEMPORARY = ".torchid-"
"""Begin of the names of files that are not yet what they will be; nothing reads them."""
NOT_COMPARED = ("duration", "seconds", "time", "saved", "elapsed", "started")
"""Entries of results that are times of the run."""


@dataclass(frozen=True)
class Scene:
    """One command, run in a folder of its own.

    Attributes:
        name: of the command.
        arguments: of the program.
        again: more arguments after what was interrupted.
    """

    name: str
    arguments: tuple[str, ...]
    again: tuple[str, ...] = ()


def scenes(inputs: Path) -> dict[str, Scene]:
    """All of them, their inputs written; each takes seconds."""
    log = logged(arm(friction(2, Fc=0.6)), Recording(duration=5.0, rate=100.0))
    write_log(log, inputs / "log.parquet")
    fleet = Plan(units=4, sessions=2, seconds=5.0)
    make(load_robot("3r_friction"), fleet, inputs / "fleet")
    effects = "viscous_friction,coulomb_friction,torque_offset"
    few = "--stages 5 --generations 30 --runs"
    fleet_of = ("fleet", "identify", "3r_friction", str(inputs / "fleet"), "--effects", effects)
    commands = (
        Scene("extract", (*f"extract 3r {few} 8 --out out".split(),), ("--overwrite",)),
        Scene(
            "extract by two",
            (
                *("extract", "kuka_lwr4", "--runs", "250", "--stages", "5", "--generations", "5"),
                "--no-certificate",
                *("--workers", "2", "--out", "out"),
            ),
            ("--overwrite",),
        ),
        Scene(
            "gap",
            (
                *("gap", "3r", str(inputs / "log.parquet")),
                *("--effects", effects, "--save-model", "made.yaml", "--out", "out"),
            ),
            ("--overwrite",),
        ),
        Scene(
            "identify",
            ("identify", "3r", str(inputs / "log.parquet"), "--effects", effects, "--out", "out"),
            ("--overwrite",),
        ),
        Scene(
            "export",
            ("export", "3r_friction", "--to", "urdf", "--out", "out"),
            ("--overwrite",),
        ),
        Scene(
            "correct",
            (
                *("correct", "3r", str(inputs / "log.parquet"), "--effects", effects),
                *("--to", "mjcf", "--with-effects", "--out", "out"),
            ),
            ("--overwrite",),
        ),
        Scene(
            "fleet identify by two",
            (*fleet_of, "--workers", "2", "--out", "out"),
            ("--overwrite",),
        ),
    )
    return {scene.name: scene for scene in commands}


@dataclass(frozen=True)
class Ended:
    """How a run ended: its exit code (minus the signal that ended it), what it said, how long it
    took."""

    code: int
    said: str
    seconds: float


class Child:
    """A command in a process that is forked from this one, where torch is loaded already."""

    def __init__(self, folder: Path, arguments: Sequence[str], *, file: int = 0) -> None:
        self.began = time.monotonic()
        self.said = tempfile.TemporaryFile()  # noqa: SIM115, it outlives this function
        self.number = os.fork()
        if self.number == 0:
            try:
                self._be(folder, arguments, file)
            finally:
                os._exit(99)

    def _be(self, folder: Path, arguments: Sequence[str], file: int) -> None:
        os.setpgid(0, 0)  # with the processes that it starts
        os.chdir(folder)
        for stream in (1, 2):
            os.dup2(self.said.fileno(), stream)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w", buffering=1)
        sys.argv = ["torchid", *arguments]
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if file:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (file, file))
        from torchid.app import main

        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        sys.stdout.flush()
        os._exit(code)

    def ended(self, within: float = 600.0) -> Ended:
        """Wait for its end; killed where that takes too long."""
        while not (state := os.waitpid(self.number, os.WNOHANG))[0]:
            if time.monotonic() - self.began > within:
                self.kill()
            time.sleep(0.002)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.number, signal.SIGKILL)
        self.said.seek(0)
        said = self.said.read().decode(errors="replace")
        self.said.close()
        return Ended(os.waitstatus_to_exitcode(state[1]), said, time.monotonic() - self.began)

    def kill(self) -> None:
        """As `kill -9` does."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.number, signal.SIGKILL)


def run(scene: Scene, folder: Path, more: Sequence[str] = (), *, file: int = 0) -> Ended:
    """Run a scene's command to its end."""
    return Child(folder, (*scene.arguments, *more), file=file).ended()


def fragments(folder: Path) -> list[str]:
    """Files that are not whole, by their names."""
    return [f"{path.relative_to(folder)}: {why}" for path in _files(folder) if (why := _half(path))]


def half_sets(folder: Path, whole: Iterable[str], before: float) -> list[str]:
    """JSON of a run without all of its other files, and other files of it where its JSON is absent
    or of an earlier run.

    Args:
        folder: of the run.
        whole: names of what a run leaves.
        before: time [s], by the clock of files, at which the run began.
    """
    names = [name for name in whole if "store" not in Path(name).parts]
    new = {n: (folder / n).exists() and (folder / n).stat().st_mtime >= before for n in names}
    answers = [name for name in names if name.endswith(".json")]
    if any(new[name] for name in answers) and not all(new.values()):
        return [f"half a set: without {', '.join(n for n in names if not new[n])}"]
    return []


def _files(folder: Path) -> list[Path]:
    every = sorted(path for path in folder.rglob("*") if path.is_file())
    return [path for path in every if not path.name.startswith(TEMPORARY)]


def _half(path: Path) -> str | None:
    """Why a file is no whole one of its kind."""
    import pyarrow.parquet
    from matplotlib.image import imread

    content = path.read_bytes()
    readers: dict[str, Callable[[], object]] = {
        ".json": lambda: json.loads(content),
        ".pkl": lambda: joblib.load(path),
        ".yaml": lambda: next(x for x in ("name", "of") if x in yaml.safe_load(content)),
        ".png": lambda: imread(io.BytesIO(content)),
        ".parquet": lambda: pyarrow.parquet.read_table(path),
        ".svg": lambda: content.index(b"</svg>"),
        ".html": lambda: content.index(b"</html>"),
    }
    try:
        readers.get(path.suffix, lambda: None)()
    except Exception as error:
        return f"{len(content)} bytes, {type(error).__name__}: {error}"[:200]
    return None


def results(folder: Path) -> dict[str, str]:
    """What a command has left, but for times: by file, in a form that is the same for the same
    bits."""
    found = {}
    for path in _files(folder):
        name = str(path.relative_to(folder))
        if path.suffix == ".json":
            found[name] = json.dumps(_timeless(json.loads(path.read_bytes())))
        elif path.suffix == ".yaml":
            found[name] = path.read_text()
        else:
            found[name] = "there"
    return found


def _timeless(value: object) -> object:
    if isinstance(value, dict):
        return {k: _timeless(v) for k, v in value.items() if k not in NOT_COMPARED}
    return [_timeless(v) for v in value] if isinstance(value, list) else value


@dataclass
class Faults:
    """Faults to one scene.

    Attributes:
        scene: which.
        place: folder for its runs.
        random: what decides when it is killed.
        whole: what a run to which nothing happens leaves.
        seconds: that it takes.
        wrong: what was not as it should be.
    """

    scene: Scene
    place: Path
    random: random.Random
    whole: dict[str, str]
    seconds: float
    wrong: list[str]

    @classmethod
    def of(cls, scene: Scene, place: Path, seed: int) -> "Faults":
        """After two runs to the end: their results must agree."""
        found = cls(scene, place, random.Random(f"{seed} {scene.name}"), {}, 0.0, [])
        for _ in range(2):  # the first one loads modules
            with found.folder() as folder:
                done = run(scene, folder)
                assert done.code == 0, done.said
                other, found.whole, found.seconds = found.whole, results(folder), done.seconds
        assert other == found.whole
        return found

    @contextlib.contextmanager
    def folder(self) -> Iterator[Path]:
        """A fresh folder for one run and those that continue it."""
        with tempfile.TemporaryDirectory(dir=self.place) as name:
            yield Path(name)

    def look(self, folder: Path, what: str) -> None:
        """That all files are whole."""
        self.wrong += [f"{what}: {name}" for name in fragments(folder)]

    def goes_on(self, folder: Path, what: str) -> None:
        """That the same command, with --overwrite, ends well and with the same bits."""
        done = run(self.scene, folder, self.scene.again)
        if done.code:
            self.wrong.append(f"{what}, then: exit code {done.code}: {done.said[-400:]}")
            return
        self.look(folder, f"{what}, then")
        found = results(folder)
        for name in sorted({*found, *self.whole}):
            # A store may hold answers to other questions: of the logs that there were so far.
            other = name not in self.whole and "store" in Path(name).parts
            if found.get(name) != self.whole.get(name) and not other:
                both = name in found and name in self.whole
                kind = "differs" if both else "is there, too" if name in found else "is missing"
                self.wrong.append(f"{what}, then: {name} {kind}")

    def refused(self, done: Ended, what: str) -> bool:
        """Whether a run failed; if so, with one error."""
        if done.code == 0:
            return False
        errors = f"\n{done.said}".count("\nerror: ")
        if done.code != 1 or errors != 1 or "Traceback" in done.said:
            self.wrong.append(f"{what}: exit code {done.code}, {errors} errors: {done.said[-600:]}")
        return True

    def killed(self, times: int) -> int:
        """Kill it at random times, some in the runs that continue it, until it was so often."""
        done = 0
        while done < times:
            with self.folder() as folder:
                more: tuple[str, ...] = ()
                what = "killed"
                while True:
                    after = self.random.uniform(0.0, self.seconds)
                    begun = time.time()
                    child = Child(folder, (*self.scene.arguments, *more))
                    time.sleep(after)
                    child.kill()
                    child.ended()
                    done += 1
                    what += f" {after:.3f} s"
                    self.look(folder, what)
                    self.wrong += [f"{what}: {x}" for x in half_sets(folder, self.whole, begun)]
                    more = self.scene.again
                    if done >= times or self.random.random() < 0.6:
                        break
                self.goes_on(folder, what)
        return done

    def full(self, times: int) -> int:
        """Fill its disk: let files be of so many bytes at most. How many runs were refused."""
        with self.folder() as folder:
            run(self.scene, folder)
            largest = max(path.stat().st_size for path in _files(folder))
        refused = 0
        for k in range(times):
            with self.folder() as folder:
                most = max(64, int((k + self.random.random()) / times * largest))
                what = f"files of {most} bytes at most"
                refused += self.refused(run(self.scene, folder, file=most), what)
                self.look(folder, what)
                self.goes_on(folder, what)
        return refused


def loaded() -> None:
    """What all commands import, here, so that each fork has it."""
    from torchid.app import set_environment

    set_environment(())
    import matplotlib.pyplot
    import torch

    import torchid
    import torchid.app.commands

    torch.set_num_threads(1)
    matplotlib.pyplot.figure().savefig(io.BytesIO())
    for name in torchid.__all__:
        getattr(torchid, name)


def main() -> None:
    """The command line; exits 1 where something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--disks", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--of", action="append", help="commands; all by default")
    given = parser.parse_args()
    loaded()
    bad = False
    with tempfile.TemporaryDirectory() as name:
        inputs, place = Path(name) / "inputs", Path(name) / "runs"
        inputs.mkdir()
        place.mkdir()
        for scene in scenes(inputs).values():
            if given.of and scene.name not in given.of:
                continue
            one = Faults.of(scene, place, given.seed)
            killed = one.killed(given.kills)
            full = one.full(given.disks)
            print(
                f"{scene.name} ({one.seconds:.1f} s, {len(one.whole)} files): {killed} kills, "
                f"{full} of {given.disks} disks full: {len(one.wrong)} wrong",
                flush=True,
            )
            for text in one.wrong:
                print(f"  {text}", flush=True)
            bad |= bool(one.wrong)
    sys.exit(bad)


if __name__ == "__main__":
    main()
