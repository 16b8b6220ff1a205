"""Real logs of which something is known: does a diagnosis with default settings say it?

    python -m torchid_bench.benchmarks.gap_truths DATA [--questions sim,payload,...] [--json FILE]

DATA is the folder of torchid_bench/benchmarks/real_logs.py. What is known is what the logs' sources say: what was
mounted, what the maker's model lacks, what was published for the arm. A question is asked of the
robot's file as it is, or of a model that a diagnosis of another log has corrected first. Everything
else that is named beside the truth is listed too: nobody knows whether it is there.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.yaml_data import parsed_yaml
from torchid_bench.benchmarks.gap_real import FRICTION, logs


@dataclass(frozen=True)
class Truth:
    """One effect that is known to be there.

    Attributes:
        effects: any of these names says it.
        joint: from 1; None for an effect of the whole arm.
        parameter: of which a value is known.
        value: that value.
    """

    effects: tuple[str, ...]
    joint: int | None = None
    parameter: str | None = None
    value: float | None = None


@dataclass(frozen=True)
class Question:
    """What is asked of which log.

    Attributes:
        known: in words.
        robot, log: files below the data folder.
        truths: what should be named.
        first: files of the logs with which the model is corrected before.
        rigid: whether the robot's parameters and effects are left out and fitted.
        tip: last link, where the model has more.
        silent: joints, from 1, of which nothing may be named.
    """

    known: str
    robot: str
    log: tuple[str, ...]
    truths: tuple[Truth, ...] = ()
    first: tuple[str, ...] = ()
    rigid: bool = False
    tip: str | None = None
    silent: tuple[int, ...] = ()


def _question(truths: Sequence[Sequence[Any]] = (), **given: Any) -> Question:
    listed = {key: tuple(x) if isinstance(x, list) else x for key, x in given.items()}
    return Question(truths=tuple(Truth(tuple(names), *at) for names, *at in truths), **listed)


_FILE = Path(__file__).with_suffix(".yaml")
QUESTIONS = {key: _question(**own) for key, own in parsed_yaml(_FILE.read_text()).items()}


def asked(question: Question, data: Path) -> dict[str, Any]:
    """The diagnosis' JSON, with its CPU seconds."""
    started = time.process_time()
    robot: Robot = load_robot(str(data / question.robot), tip=question.tip)
    if question.rigid:
        robot = replace(robot.with_parameters(None), effects=())
    settings = GapSettings(rollout=False)
    if question.first:
        background = FRICTION if question.rigid else ()
        fitted = replace(settings, background=background)
        robot = diagnose_torque(robot, logs(data, question.first), settings=fitted).corrected
    found = diagnose_torque(robot, logs(data, question.log), settings=settings).plain()
    return {**found, "seconds": time.process_time() - started}


def says(entry: dict[str, Any], truth: Truth, among: tuple[str, ...]) -> bool:
    """Whether an entry names the truth, or holds it among its alternatives."""
    here = truth.joint is None or truth.joint in entry["joints"]
    return here and bool(set(truth.effects) & {entry["effect"], *among})


def table_row(name: str, question: Question, found: dict[str, Any]) -> str:
    """What is known, how much of it is named, what else is."""
    named, held, values = 0, 0, []
    true: list[int] = []
    for truth in question.truths:
        direct = [k for k, w in enumerate(found["which"]) if says(w, truth, ())]
        in_set = [
            k for k, w in enumerate(found["which"]) if says(w, truth, tuple(w["ambiguous_with"]))
        ]
        named, held = named + bool(direct), held + bool(in_set)
        true += direct or in_set[:1]
        for w in (found["which"][k] for k in direct[:1] if truth.parameter):
            value, std = w["parameters"].get(truth.parameter), w["std"].get(truth.parameter)
            values.append(f"{truth.parameter} {value:.4g} ± {std:.2g} ({truth.value:g})")
    others = [w for k, w in enumerate(found["which"]) if k not in true]
    wrong = [w for w in others if set(w["joints"]) & set(question.silent)]
    listed = ", ".join(f"{w['effect']} {' '.join(map(str, w['joints']))}".strip() for w in others)
    before, after = (found["how_far"][k] for k in ("rms_before", "rms_after"))
    cells = (
        name,
        question.known,
        f"`{found['status']}`",
        f"{before:.3g} -> {after:.3g}",
        f"{named} of {len(question.truths)}" if question.truths else f"{len(wrong)} false",
        f"{held} of {len(question.truths)}" if question.truths else "",
        "; ".join(values),
        listed or "nothing",
        f"{found['seconds']:.0f}",
    )
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--questions", default=",".join(QUESTIONS))
    parser.add_argument("--json", type=Path, help="write the answers to this folder")
    given = parser.parse_args()
    torch.set_num_threads(1)
    headings = "log", "known", "answer", "error", "named", "in a set", "value (known)", "beside it"
    print("| " + " | ".join((*headings, "CPU s")) + " |")
    print("|---|---|---|---|---|---|---|---|--:|")
    for name in given.questions.split(","):
        found = asked(QUESTIONS[name], given.data)
        if given.json:
            given.json.mkdir(parents=True, exist_ok=True)
            (given.json / f"{name}.json").write_text(json.dumps(found))
        print(table_row(name, QUESTIONS[name], found), flush=True)


if __name__ == "__main__":
    main()
