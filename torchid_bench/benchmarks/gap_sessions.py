"""A model fitted on one session of a real arm, asked about another in which nothing has changed.

    python -m torchid_bench.benchmarks.gap_sessions DATA --work DIR [--arms ur10e,kr300]
    python -m torchid_bench.benchmarks.gap_sessions DATA --work DIR --score

Every arm's model (base parameters, friction, and what the diagnosis names) is fitted on each of its
sessions and asked about each of the others; of arms with one session on the first half of it, asked
about the second. Whatever is named there is false, or a change of the arm from one session to the
other. Then about sessions with a known load. Answers are kept in DIR, so that a run can be taken up
again.
"""

import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot
from torchid_bench.benchmarks.gap_planted import answer
from torchid_bench.benchmarks.gap_real import FRICTION
from torchid_bench.benchmarks.real_logs import FILE, read
from torchid_bench.benchmarks.runner import command, results, share, table

ARMS: dict[str, dict[str, Any]] = FILE["sessions"]
BACKGROUND = (*FRICTION, "rotor_inertia")
"""What geared arms have on every joint, fitted with the base parameters."""


def pairs(arm: dict[str, Any]) -> Iterator[tuple[str, str, float]]:
    """Sessions: what is fitted, what is asked about, and its load [kg]."""
    sessions = [*map(_session, arm["sessions"])]
    yield from ((a, b, 0.0) for a, b in itertools.permutations(sessions, 2))
    for a in sessions:
        yield from ((a, _session(file), mass) for file, mass in arm.get("loaded", {}).items())
        if arm.get("halves"):
            yield from ((f"{a}-1", f"{a}-2", 0.0), (f"{a}-2", f"{a}-1", 0.0))


def _session(file: str) -> str:
    return Path(file).stem.removeprefix("log_")


def log_of(arm: dict[str, Any], data: Path, session: str) -> Log:
    """The log of a session, or of half of it: `NAME-1`."""
    files = {_session(file): file for file in (*arm["sessions"], *arm.get("loaded", ()))}
    if session in files:
        return read(data, (files[session],))
    whole, half = session.rsplit("-", 1)
    return read(data, (files[whole],)).split(0.5)[int(half) - 1]


def settings_of(arm: dict[str, Any], **more: Any) -> GapSettings:
    return GapSettings(cutoff=arm.get("cutoff", "auto"), **more)


def modelled(label: str, data: Path, file: Path) -> None:
    """Write the arm as the session makes it that the file is named after, if it is not there."""
    if not file.exists():
        arm = ARMS[label]
        robot = replace(load_robot(str(data / arm["robot"])), parameters=None, effects=())
        settings = settings_of(arm, background=BACKGROUND)
        found = diagnose_torque(robot, log_of(arm, data, file.stem), settings=settings)
        write_robot(found.corrected, file)


def asked(label: str, data: Path, model: Path, session: str, mass: float) -> dict[str, Any]:
    """What is answered of a session by the model of another."""
    arm, robot = ARMS[label], load_robot(str(model))
    found = answer(robot, log_of(arm, data, session), settings_of(arm))
    print(label, f"{model.stem}--{session}", *line(found), flush=True)
    return {"mass": mass, "joints": robot.n, "answer": found}


def line(found: dict[str, Any]) -> tuple[str, ...]:
    """Status, size, names and values, and CPU time of an answer."""
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


def scored(work: Path) -> None:
    """A line a pair, and the rate of false names of each arm."""
    rows, rates = [], []
    for folder in sorted(p for p in work.iterdir() if p.is_dir()):
        false, joints, empty, count = 0, 0, 0, 0
        for file in sorted(folder.glob("*--*.json")):
            case = json.loads(file.read_text())
            a, b = file.stem.split("--")
            load = f", {case['mass']:g} kg" if case["mass"] else ""
            rows.append((folder.name, a, b + load, *line(case["answer"])))
            if not case["mass"]:
                names = len(case["answer"]["which"])
                false, joints = false + names, joints + case["joints"]
                empty, count = empty + (not names), count + 1
        rates.append(
            f"- {folder.name}: {false} names on {joints} joints ({false / max(1, joints):.2f} a "
            f"joint), {share(empty, count)} pairs without"
        )
    table(("arm", "fitted on", "asked about", "answer", "N m", "names", "CPU"), rows)
    print("\n".join(rates))


def main(
    data: Path,
    *,
    work: Path,
    arms: tuple[str, ...] = tuple(ARMS),
    score: bool = False,
    jobs: int = 1,
) -> None:
    """Ask about all pairs that have no answer yet, or count what was answered."""
    if score:
        return scored(work)
    for label in arms:
        folder, todo = work / label, [*pairs(ARMS[label])]
        folder.mkdir(parents=True, exist_ok=True)
        models = {a: (label, data, folder / f"{a}.yaml") for a, _, _ in todo}
        list(results(modelled, models, jobs=jobs))  # before they are asked, each by one process
        cases = {f"{a}--{b}": (*models[a], b, mass) for a, b, mass in todo}
        list(results(asked, cases, folder, jobs=jobs))


if __name__ == "__main__":
    command(main)
