"""A model fitted on one session of a real arm, asked about another in which nothing has changed.

    python -m torchid_bench.benchmarks.gap_sessions DATA --work DIR [--arms ur10e,kr300]
    python -m torchid_bench.benchmarks.gap_sessions DATA --work DIR --score

Every arm's model (base parameters, friction, and what the diagnosis names) is fitted on each of its
sessions and asked about each of the others; of arms with one session on the first half of it, asked
about the second. Whatever is named there is false, or a change of the arm from one session to the
other. Then about sessions with a known load. Answers are kept in DIR, so that a run can be taken up
again.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.statistics.proportion import wilson
from torchid_bench.benchmarks.gap_real import FRICTION, logs


@dataclass(frozen=True)
class Arm:
    """An arm and its sessions.

    Attributes:
        robot: its file.
        sessions: logs in which nothing differs that anybody knows.
        loaded: (log, mass of the load in it [kg]).
        halves: whether the halves of each session are pairs, too.
        cutoff: of the fit [Hz], where the default is not the arm's.
    """

    robot: str
    sessions: tuple[str, ...]
    loaded: tuple[tuple[str, float], ...] = ()
    halves: bool = False
    cutoff: float | None = None


ARMS = {
    "ur10e": Arm(
        "ur10e/robot.urdf",
        tuple(
            f"ur10e/log_{k}.parquet"
            for k in (
                "est_30s_12harm",
                "exc_20s_8harm",
                "exc_40s_12harm",
                "val_ptp10",
                "unloaded_dec23",
            )
        ),
        (("ur10e/log_loaded_2p6kg_jan13.parquet", 2.6),),
    ),
    "kr300": Arm(
        "kuka_kr300/kin.yaml",
        tuple(f"kuka_kr300/log_{k}.parquet" for k in ("A_ident", "B_val1", "C_val2")),
        halves=True,
    ),
    "xmate": Arm("xmate7p/robot.urdf", tuple(f"xmate7p/log_traj{k}.parquet" for k in (1, 2, 3))),
    "airbot": Arm(
        "airbot_play/robot.urdf",
        tuple(f"airbot_play/log_{k}_real.parquet" for k in ("chirp", "trapez")),
        (("airbot_play/log_chirp_real_loaded.parquet", 0.48),),
    ),
    "baxter": Arm(
        "baxter_left/robot.urdf",
        tuple(
            f"baxter_left/log_{k}.parquet"
            for k in ("sin_10s_r18", "sin_12s_r10", "sin_15s_r15", "random")
        ),
        cutoff=3.0,
    ),
    "emps": Arm("emps/robot.yaml", ("emps/log_train.parquet",), halves=True),
    "panda": Arm("panda_gaz/robot.yaml", ("panda_gaz/log_exciting_traj1.parquet",), halves=True),
    "unisa": Arm("panda_unisa/robot.yaml", ("panda_unisa/log_exciting.parquet",), halves=True),
    "ur10": Arm("ur10_unisa/robot.yaml", ("ur10_unisa/log_exciting.parquet",), halves=True),
}


BACKGROUND = (*FRICTION, "rotor_inertia")
"""What geared arms have on every joint, fitted with the base parameters."""


def name_of(file: str) -> str:
    """A session's short name."""
    return Path(file).stem.removeprefix("log_")


def pairs(arm: Arm, data: Path) -> Iterator[tuple[str, Log, str, Log, float]]:
    """(Name of what is fitted, the log, name of what is asked, the log, its load)."""
    read = {name_of(f): logs(data, (f,)) for f in arm.sessions}
    for a, first in read.items():
        for b, second in read.items():
            if a != b:
                yield a, first, b, second, 0.0
        for file, mass in arm.loaded:
            yield a, first, name_of(file), logs(data, (file,)), mass
        if arm.halves:
            one, two = first.split(0.5)
            yield f"{a}-1", one, f"{a}-2", two, 0.0
            yield f"{a}-2", two, f"{a}-1", one, 0.0


def settings_of(arm: Arm, **more: Any) -> GapSettings:
    return GapSettings(cutoff=arm.cutoff or "auto", **more)


def answer(robot: Robot, log: Log, settings: GapSettings) -> dict[str, Any]:
    """The diagnosis' JSON; of what was refused or failed, the error."""
    started = time.process_time()
    try:
        found = diagnose_torque(robot, log, settings=settings).plain()
    except Exception as error:  # one pair must not end a night's run
        found = {"status": "error", "which": [], "error": f"{type(error).__name__}: {error}"}
    return {**found, "seconds": time.process_time() - started}


def run(label: str, arm: Arm, data: Path, work: Path) -> None:
    """All pairs of one arm that are not there yet."""
    folder = work / label
    folder.mkdir(parents=True, exist_ok=True)
    robot = replace(load_robot(str(data / arm.robot)), parameters=None, effects=())
    for a, first, b, second, mass in pairs(arm, data):
        file, model = folder / f"{a}--{b}.json", folder / f"{a}.yaml"
        if file.exists():
            continue
        if not model.exists():
            found = diagnose_torque(robot, first, settings=settings_of(arm, background=BACKGROUND))
            write_robot(found.corrected, model)
        found = answer(load_robot(str(model)), second, settings_of(arm))
        file.write_text(json.dumps({"mass": mass, "joints": robot.n, "answer": found}))
        print(label, a, b, *line(found), flush=True)


def line(found: dict[str, Any]) -> tuple[str, ...]:
    """Status, names and values."""
    names = [
        f"{w['effect']} {w['joints']} {shortly(w)} {100 * (w['how_sure'] or 0):.0f} %"
        for w in found["which"]
    ]
    far = found.get("how_far", {})
    size = f"{far['rms_before']:.3g} -> {far['rms_after']:.3g}" if far else found.get("error", "")
    return found["status"], size, "; ".join(names) or "nothing", f"{found['seconds']:.0f} s"


def shortly(entry: dict[str, Any]) -> str:
    """The first coefficient with its standard deviation."""
    for name, std in entry["std"].items():
        return f"{name} {entry['parameters'][name]:.3g} +- {std if std is None else round(std, 4)}"
    return ""


def score(work: Path) -> None:
    """A line a pair, and the rate of false names of each arm."""
    print(
        "| arm | fitted on | asked about | answer | N m | names | CPU |\n|---|---|---|---|---|---|--:|"
    )
    rates = []
    for folder in sorted(p for p in work.iterdir() if p.is_dir()):
        false, joints, empty, count = 0, 0, 0, 0
        for file in sorted(folder.glob("*--*.json")):
            case = json.loads(file.read_text())
            a, b = file.stem.split("--")
            load = f", {case['mass']:g} kg" if case["mass"] else ""
            print("|", " | ".join((folder.name, a, b + load, *line(case["answer"]))), "|")
            beside = [
                w
                for w in case["answer"]["which"]
                if not (case["mass"] and w["effect"] == "payload")
            ]
            if not case["mass"]:
                false, joints = false + len(beside), joints + case["joints"]
                empty, count = empty + (not beside), count + 1
        low, high = wilson(empty, count)
        rates.append(
            f"- {folder.name}: {false} names on {joints} joints ({false / max(1, joints):.2f} a joint), "
            f"{empty} of {count} pairs without ({low:.0%} - {high:.0%})"
        )
    print("\n" + "\n".join(rates))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--arms", type=lambda s: s.split(","), default=list(ARMS))
    parser.add_argument("--score", action="store_true")
    args = parser.parse_args()
    if args.score:
        score(args.work)
        return
    torch.set_num_threads(1)
    for label in args.arms:
        run(label, ARMS[label], args.data, args.work)


if __name__ == "__main__":
    main()
