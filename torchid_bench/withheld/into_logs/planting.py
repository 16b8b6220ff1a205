"""Real logs with effects planted, as files that a diagnosis is asked of.

    WORK/LOG/model.yaml          the arm, as one half of its log makes it
    WORK/LOG/first.parquet       this half
    WORK/LOG/none/log.parquet    the other half as it is
    WORK/LOG/CASE/log.parquet    the same with an effect planted; CASE is its name and its size
    WORK/LOG/CASE/key.json       what was planted

Halves are of time, or of motions: then the model is made of other motions than it is asked of.
Models that stored classes belong to are kept, and so is what was planted: every diagnosis that is
scored sees the same torques, whatever has become of the code that fits a model or draws an effect.
"""

import gzip
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.design.columns import together
from torchid.effects.registry import KINDS, effect_from_record
from torchid.gap.data import prepare
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.json_data import read_json, write_json
from torchid.log.model import Log
from torchid.log.readers import read_log, write_log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.withheld.planted import with_torque
from torchid.yaml_data import parsed_yaml
from torchid_bench.withheld.case_set import LOG
from torchid_bench.withheld.into_logs.drawing import Key, Planted, Scene, drawn, gap
from torchid_bench.withheld.into_logs.forms import FORMS, formed
from torchid_bench.withheld.oracle.classes import Class, Truth, already_there, in_practice
from torchid_bench.withheld.oracle.library import half_of
from torchid_bench.withheld.run import Job

NONE = "none"
"""The case in which nothing is planted."""

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
"""Fitted with the base parameters, before any cause is looked for in the model's half."""


@dataclass(frozen=True)
class Source:
    """A real log; paths are below the folder of the data.

    Attributes:
        robot: file.
        logs: that the model is made of; their first half where none is `asked`.
        asked: logs that effects are planted into, other motions; none: the second half of `logs`.
        tip: last link, where the file has more.
        cutoff: of the fit [Hz], where the default is not the arm's.
        gain: of currents [N m/A].
        left: what the model leaves on each joint [N m; N]; none: the error of its half.
    """

    robot: str
    logs: Sequence[str]
    asked: Sequence[str] = ()
    tip: str | None = None
    cutoff: float | None = None
    gain: Sequence[float] = ()
    left: Sequence[float] = ()

    def settings(self, background: tuple[str, ...] = ()) -> GapSettings:
        """Of a diagnosis."""
        return GapSettings(cutoff=self.cutoff or "auto", background=background)

    def halves(self, data: Path) -> tuple[Robot, Log, Log]:
        """The arm without parameters, the log of its model, and the one that is asked."""
        robot = load_robot(data / self.robot, tip=self.tip)
        logs = [read_log([data / x for x in some]) for some in (self.logs, self.asked) if some]
        if self.gain:
            logs = [x.with_torque(torch.tensor(self.gain, dtype=torch.float64)) for x in logs]
        first, second = logs if self.asked else logs[0].split(0.5)
        return replace(robot, parameters=None, effects=()), first, second


FILE = parsed_yaml(Path(__file__).with_name("sources.yaml").read_text())
SOURCES = {label: Source(**given) for label, given in FILE["sources"].items()}
SETS: dict[str, Any] = FILE["sets"]


@dataclass(frozen=True)
class Bed:
    """A real log with its model.

    Attributes:
        label, source: where it is from.
        folder: of its files.
        robot: the model.
        asked: the log that effects are planted into.
    """

    label: str
    source: Source
    folder: Path
    robot: Robot
    asked: Log

    @classmethod
    def of(cls, label: str, data: Path, work: Path) -> "Bed":
        """A bed, its files written where they are not there yet."""
        folder, source = work / label, SOURCES[label]
        model, log = folder / "model.yaml", folder / NONE / LOG
        if not log.exists():
            rigid, first, second = source.halves(data)
            log.parent.mkdir(parents=True, exist_ok=True)
            write_log(first, folder / "first.parquet")
            kept = Path(__file__).with_name("kept") / f"{label}.yaml.gz"
            if kept.exists():
                model.write_bytes(gzip.decompress(kept.read_bytes()))
            else:
                found = diagnose_torque(rigid, first, settings=source.settings(FRICTION))
                write_robot(found.corrected, model)
            write_log(second, log)  # at last: what is there is whole
        return cls(label, source, folder, load_robot(model), read_log(log))

    def cases(self, effects: Sequence[str], sizes: Sequence[float]) -> list[str]:
        """Names of what was planted, of these effects and sizes, in this order."""
        names = (f"{name}-{size:g}" for name in effects for size in sizes)
        return [name for name in names if (self.folder / name / "key.json").exists()]

    def key(self, case: str) -> Key:
        """What was planted."""
        return read_json(self.folder / case / "key.json", "a key")

    def job(self, case: str, before: bool) -> Job:
        """What is asked of a case: with the log of the model as an earlier one, or without."""
        folder = self.folder / case
        answer = folder / ("before.json" if before else "answer.json")
        earlier = self.folder / "first.parquet" if before else None
        model, settings = self.folder / "model.yaml", self.source.settings()
        return Job(f"{self.label}-{case}", model, (folder / LOG,), answer, settings, earlier)

    def plant(self, effects: Sequence[str], sizes: Sequence[float]) -> None:
        """Plant what is not there yet, on joints that move."""
        half = half_of(self.robot, self.asked, self.source.cutoff)
        left = self.source.left or half.size.tolist()
        # 125.0: rate at which sizes are measured [Hz]
        coarse, fine = (Scene.of(self.robot, self.asked, left, rate) for rate in (125.0, 1e6))
        missing = prepare(self.robot, self.asked, None).missing
        # 0.02: speed of a joint that moves [rad/s; m/s]
        fast = together(coarse.motions).dq.abs().quantile(0.99, dim=0)
        moving = (fast > 0.02).nonzero().flatten().tolist()
        stored = known_classes()
        for name, size in itertools.product(effects, sizes):
            case = f"{name}-{size:g}"
            untestable = name in KINDS and KINDS[name].needs & missing
            if untestable or (self.folder / case / "key.json").exists():
                continue
            rng = np.random.default_rng([*f"{self.label}/{name}".encode()])
            joint, late = int(rng.choice(moving)), 0.0
            if name in FORMS:
                added, key = formed(fine, name, size, joint)
            else:
                record = stored.get(f"{self.label}-{case}", {}).get("planted")
                if record is None:
                    planted = drawn(coarse, name, size, rng, joint)
                else:
                    planted = Planted.of(coarse, *effect_from_record(record, self.robot))
                if planted is None:
                    continue
                added, key = gap(fine, planted.effect, planted.values), planted.key
                late = planted.values[0] if name == "filter_lag" else 0.0
            if max(float(x.abs().max()) for x in added) > 0:  # else no torque shows it there
                log = with_torque(self.asked, [fine.rate] * len(added), added)
                (self.folder / case).mkdir(exist_ok=True)
                log = with_late_velocities(self.asked, late) if late else log
                write_log(log, self.folder / case / LOG)
                write_json(key, self.folder / case / "key.json")

    def classify(self, cases: Sequence[str], work: Path) -> None:
        """Ask the oracle of those cases that have no class yet; what it says is kept in `work`."""
        known = known_classes(work)
        cases = [case for case in cases if f"{self.label}-{case}" not in known]
        bare = half_of(self.robot, self.asked, self.source.cutoff)
        there = already_there(bare) if cases else []
        for case in cases:
            key, log = self.key(case), read_log(self.folder / case / LOG)
            planted = half_of(self.robot, log, like=bare)
            names = [key["name"], *key.get("acceptable", ())]
            joints = [j - 1 for j in (*key["joints"], *key["felt_by"])]
            truth = Truth.of(names, joints, planted, bare)
            (one,) = in_practice(planted, bare, [truth], there)
            one |= {"planted": key.get("record"), "size": round(key["size"], 3)}
            known[f"{self.label}-{case}"] = one
            write_json(known, work / "classes.json")  # at once: a night may be interrupted


def with_late_velocities(log: Log, lag: float) -> Log:
    """The log with velocities that are so much later [s]: positions say by how much."""
    assert log.dq is not None
    parts = []
    for rows in log.slices():
        t = log.t[rows].numpy()
        late = [np.interp(t - lag, t, x) for x in log.dq[rows].T.numpy()]
        parts.append(np.stack(late, 1))
    return log.replace(dq=torch.from_numpy(np.concatenate(parts)))


def known_classes(work: Path | None = None) -> dict[str, Class]:
    """Classes by log and case: stored ones, which are frozen, and those of a folder."""
    places = [Path(__file__).parent, *([] if work is None else [work])]
    files = [place / "classes.json" for place in reversed(places)]
    parts = [read_json(file, "classes") for file in files if file.exists()]
    return {case: one for part in parts for case, one in part.items()}
