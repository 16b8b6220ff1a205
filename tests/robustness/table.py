"""The table of bad inputs: which command is given what, and whether it may still succeed."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from tests.app.test_inputs_kept import COMMANDS, _shown
from tests.gap_files import diagnosis, named
from tests.robustness import bad_logs, bad_results, bad_robots
from tests.robustness.bad_logs import ESCAPE, LONG, MARKUP
from tests.robustness.bench import Outcome, outcome
from torchid.app.inputs import PLACE, WRITTEN
from torchid.app.signature import Option

EVERY = 40
"""Of all bad results one in so many goes to a command that computes for long."""
_ROBOTS = ("robot", "params")
_RESULTS = ("result", "results", "sets")
_LOGS = ("logs", "trajectory", "held_out", "loaded", "on", "log")
_EVERYWHERE = ("nan.csv", "back.csv", "nan_time.csv")
"""Logs that every place for a log is given: what is checked of one is checked of all."""
_PAIR = {"simulated": "real", "real": "simulated"}
"""Options that take the place of LOG..., and go together."""
_WHOLE = {"check": 5, "log show": 4, "export": 15}
"""Commands that get all of the first kind of file that they take, or one in so many of them."""
_QUIET = ("log doctor", "log show")
"""Commands that say what is wrong with a log, which is no failure."""
_SLOW = ("excite", "extract", "atlas", "wrenches", "compare")
"""Commands that compute for long where a changed result is still one."""

LATE = ((("correct",), "name"),)
"""Options that are looked at when a command has computed for long."""
_READ = (*_ROBOTS, *_LOGS, *_PAIR, "result", "results", "sets")
"""Options whose bad values are files, in `Table.files`."""


@dataclass(frozen=True)
class Case:
    """One command line.

    Attributes:
        name: what is bad in it.
        arguments: of the program.
        refused: whether it must be refused; else it may do its work, in good order.
        option: that the bad value is given to, as the command line has it.
    """

    name: str
    arguments: tuple[str, ...]
    refused: bool = True
    option: str = ""


@dataclass(frozen=True)
class Table:
    """Where inputs lie, and where commands are run: none of it may change."""

    folder: Path
    robots: dict[str, Path]
    logs: dict[str, Path]
    results: dict[str, Path]
    good: dict[str, str]

    @classmethod
    def made(cls, folder: Path) -> "Table":
        """Write all inputs, good and bad."""
        for name in ("robots", "logs", "results", "good", "work"):
            (folder / name).mkdir()
        good = folder / "good"
        for name, seed in (("log", 0), ("other", 1), ("third", 2)):
            (good / f"{name}.csv").write_bytes(bad_logs.csv(bad_logs.motion(seed=seed)))
        sets, identified = bad_results.good(good)
        diagnosis(good / "gap.json", named(Fc=0.5))
        log, other = good / "log.csv", good / "other.csv"
        by_name = {
            "robot": "3r", "params": "3r", "name": "3r", "seed": 1, "cases": 1, "to": "urdf",
            "result": identified, "results": identified, "sets": sets, "folder": good,
            "logs": log, "trajectory": log, "loaded": other, "held_out": good / "third.csv",
            "on": other, "log": other, "simulated": log, "real": other,
        }  # fmt: skip
        results = bad_results.write_all(folder / "results", sets, identified)
        return cls(
            folder,
            bad_robots.write_all(folder / "robots"),
            bad_logs.write_all(folder / "logs"),
            results,
            {key: str(value) for key, value in by_name.items()},
        )

    def run(self, case: Case) -> str | None:
        """What is wrong with how a case ends; None where all is right."""
        work = self.folder / "work"
        found = outcome(case.arguments, (work, self.folder / "good"))
        # The doctor's verdict on a log that is wrong is a result, with the exit code 1.
        verdict = case.arguments[:2] == ("log", "doctor") and "error: " not in found.err
        if not case.refused and (found.code == 0 or (found.code == 1 and verdict)):
            for made in work.iterdir():
                shutil.rmtree(made) if made.is_dir() else made.unlink()
            found = Outcome(1, found.out, f"{found.err}error: ", ())
        return (
            found.fault and f"{case.name}: torchid {' '.join(case.arguments)[:200]}: {found.fault}"
        )

    def line(self, name: tuple[str, ...], bad: Option | None, value: object) -> tuple[str, ...]:
        """A command line with all that must be given, and one bad value."""
        words, result = list(name), None
        for option in COMMANDS[name]:
            needed = option.parameter.default is option.parameter.empty or (
                option.name in ("to", "out", "result") and option.takes_paths
            )
            if name == ("gap",):
                needed = option.name in ("robot", "logs")
            if bad is not None and bad.name in _PAIR:
                needed = option.name in ("robot", _PAIR[bad.name])
            if option is bad:
                words += _shown(option, value)
            elif WRITTEN in option.said or PLACE in option.said:
                result = option.shown if option.name == "json_file" else result
                if option.name == "to":
                    words += _shown(option, "made.csv")
            elif needed and not (option.name == "result" and name == ("excite",)):
                words += _shown(option, self.good[option.name])
        if result and (bad is None or bad.name != "json_file"):
            words += [result, "result.json"]
        return tuple(words)

    def files(self, name: tuple[str, ...]) -> Iterator[Case]:
        """Bad robots, logs and results, each in the place where a command takes them."""
        for k, option in enumerate(COMMANDS[name]):
            if option.name in _ROBOTS:
                every, kind = self.robots, "robot"
            elif option.name in (*_LOGS, *_PAIR):
                every, kind = self.logs, "log"
            elif option.name in _RESULTS:
                every, kind = self.results, "result"
            else:
                continue
            # Each place takes files that no other takes, so that all are given somewhere; some
            # commands take more of them.
            slot, places = _slot(name, option)
            more = _WHOLE.get(" ".join(name), 0) if k == 0 else 0
            chosen = [
                item
                for i, item in enumerate(every.items())
                if (places and i % places == slot)
                or (more and i % more == 0)
                or (item[0] in _EVERYWHERE and " ".join(name) not in _QUIET)
            ]
            for text, path in chosen:
                broken = path.name.startswith("no_")
                if kind == "result" and " ".join(name) in _SLOW and not broken:
                    continue
                refused = broken or (kind != "result" and " ".join(name) not in _QUIET)
                line = self.line(name, option, path)
                yield Case(f"{kind} {text}", line, refused, option.shown)

    def values(self, name: tuple[str, ...]) -> Iterator[Case]:
        """Bad values of each option."""
        for option in COMMANDS[name]:
            kind = get_args(option.parameter.annotation)[0]
            kinds = {kind, *get_args(kind)}
            if (name, option.name) in LATE or option.name in _READ:
                continue
            bad: dict[Any, bool] = {}
            if any(get_origin(one) is Literal for one in kinds):
                bad = {"no such choice": True}
            elif PLACE in option.said:
                # Nowhere to put a folder: what is above it is a file.
                bad = {str(self.folder / "good" / "log.csv" / "below"): True}
            elif int in kinds:
                bad = dict.fromkeys(("x", "1.5", "-1", "1" * 30), True)
            elif float in kinds:
                bad = dict.fromkeys(("x", "nan", "-inf", "1e300"), True)
            elif WRITTEN in option.said:
                bad = {"absent/x.csv": True, str(self.folder / "good"): True, "n" * 300: True}
            elif option.takes_paths:
                bad = {"absent.csv": True, "/dev/null": True, "\udcff.json": True}
            elif kinds & {str, list[str]} and bool not in kinds:
                texts = (LONG, f"{ESCAPE}{MARKUP}", "=", "nan,nan,nan")
                bad = dict.fromkeys(texts, False)
            for value, refused in bad.items():
                text = f"{option.shown} {str(value)[:20]!r}"
                yield Case(text, self.line(name, option, value), refused, option.shown)

    def cases(self, name: tuple[str, ...]) -> Iterator[Case]:
        """All of a command."""
        yield from self.values(name)
        yield from self.files(name)

    def without(self, name: tuple[str, ...]) -> list[str]:
        """Options of a command that take a value and are given no bad one."""
        rows = {case.option for case in self.cases(name)}
        return [
            option.shown
            for option in COMMANDS[name]
            if {get_args(option.parameter.annotation)[0]} != {bool}
            and (name, option.name) not in LATE
            and option.shown not in rows
        ]


def beside(folder: Path) -> Iterator[Case]:
    """Files that commands read though they are not named first: mappings, sidecars."""
    log = str(folder / "good" / "log.csv")
    mappings = {
        "binary": bytes(range(256)), "deep": b"q: " + b"[" * 900, "list": b"[1]",
        "unknown": b"z: x", "type": b"q: {a: 1}", "date": b"q: 2026-99-99",
        "none": b"q: absent_{j}",
    }  # fmt: skip
    for name, content in mappings.items():
        file = folder / "logs" / f"{name}.yaml"
        file.write_bytes(content)
        line = ("identify", "3r", log, "--columns", str(file), "--json", "result.json")
        yield Case(f"mapping {name}", line)
    for name, content in {
        "empty": b"", "binary": bytes(range(256)), "deep": b"[" * 900, "list": b"[1]",
        "other": b"of: x\njoints: [a]\neffects: []", "effect": b"joints: [j1, j2]\neffects: [7]",
        "gravity": b"joints: [j1, j2]\ngravity: [1e308, 0, .nan]",
    }.items():  # fmt: skip
        file = folder / "robots" / f"beside_{name}.urdf"
        file.write_text(bad_robots.URDF)
        file.with_name(f"{file.name}.effects.yaml").write_bytes(content)
        yield Case(f"sidecar {name}", ("check", str(file), "--json", "result.json"))
    for name, content in {
        "empty": b"", "list": b"[1]", "deep": b"[" * 900, "keys": b"title: x",
        "binary": b"\xff\xfe",
    }.items():  # fmt: skip
        file = folder / "robots" / f"study_{name}.yaml"
        file.write_bytes(content)
        yield Case(f"study {name}", ("study", str(file), "--json", "result.json"))


def _slot(name: tuple[str, ...], option: Option) -> tuple[int, int]:
    """The number of a place among all that take a robot, or a log, or a result, and how many these
    are; none of results where a command is slow."""
    if option.name in _PAIR:
        return 0, EVERY
    kind = next(k for k in (_ROBOTS, _LOGS, _RESULTS) if option.name in k)
    slow = _SLOW if kind is _RESULTS else ()
    places = [
        (n, o.name)
        for n, options in COMMANDS.items()
        for o in options
        if o.name in kind and " ".join(n) not in slow
    ]
    here = (name, option.name)
    return (places.index(here), len(places)) if here in places else (0, EVERY)
