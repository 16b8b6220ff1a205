"""Effects planted into the second half of real logs, the first half being the model's.

    python -m torchid_bench.benchmarks.gap_planted DATA --work DIR [--logs panda,ur10e] [--sizes 2]
                                     [--effects coulomb_friction,...] [--part 1/2]
    python -m torchid_bench.benchmarks.gap_planted DATA --work DIR --score

Each log is cut in two. From the first half a model is fitted (base parameters, friction, and what
the diagnosis names). The second half is diagnosed with that model as it is: whatever is named there
is a false name, or a change of the arm between the halves. Then an effect of the library is added
to its torque, `size` times as large as what the model leaves on the joint, and it is diagnosed again.
Causes of `gap_hard.py` (table, wall, stop, soft_knee, moment, axial) are planted in the forms of that
file, and their size is that while they act.

An answer is right if it names the effect on its joint; in its set, if it says that what it names
cannot be told from it; a name that is neither there nor in the unplanted half's answer is false.
Answers are kept in DIR, so that a run can be taken up again.
"""

import argparse
import itertools
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.effects.registry import KINDS, model_torque, nominal_effects
from torchid.gap.data import prepare
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.statistics.criteria import SET_MASS
from torchid.statistics.proportion import wilson
from torchid.withheld.planted import with_torque
from torchid_bench.benchmarks.gap_hard import CAUSES, RIGHT, Truth
from torchid_bench.benchmarks.gap_plant import Scene, gap, generator, plant
from torchid_bench.benchmarks.gap_real import FRICTION, UR10E, logs

FINEST = 125.0
"""Rate at which sizes are measured [Hz]."""

PLANTED = (
    "viscous_friction",
    "power_law_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "torque_offset",
    "joint_spring",
    "rotor_inertia",
    "presliding_hysteresis",
    "cogging",
    "motor_ripple",
    "position_dependent_friction",
    "torque_gain",
    "torque_crosstalk",
    "encoder_offset",
    "payload",
    "link_inertia",
    "filter_lag",
    "contact",
    "gear_coupling",
)


HARD = ("table", "wall", "stop", "soft_knee", "moment", "axial")
"""Causes of `gap_hard.py` that are planted, too; and `PAIRED` of the library's forms."""

PAIRED = ("backlash", "joint_elasticity", "saturation")


@dataclass(frozen=True)
class Source:
    """A real log.

    Attributes:
        robot, logs: files below the data folder.
        tip: last link, where the model has more.
        cutoff: of the fit [Hz], where the default is not the arm's.
    """

    robot: str
    logs: tuple[str, ...]
    tip: str | None = None
    cutoff: float | None = None


SOURCES = {
    "panda": Source("panda_gaz/robot.yaml", ("panda_gaz/log_exciting_traj1.parquet",)),
    "ur10e": Source("ur10e/robot.urdf", UR10E[1:]),
    "ur10": Source("ur10_unisa/robot.yaml", ("ur10_unisa/log_exciting.parquet",)),
    "xmate": Source(
        "xmate7p/robot.urdf", ("xmate7p/log_traj1.parquet", "xmate7p/log_traj2.parquet")
    ),
    "unisa": Source("panda_unisa/robot.yaml", ("panda_unisa/log_exciting.parquet",)),
    "airbot": Source("airbot_play/robot.urdf", ("airbot_play/log_trapez_real.parquet",)),
    "baxter": Source("baxter_left/robot.urdf", ("baxter_left/log_random.parquet",), cutoff=3.0),
    "kr300": Source(
        "kuka_kr300/kin.yaml",
        tuple(f"kuka_kr300/log_{k}.parquet" for k in ("A_ident", "B_val1", "C_val2")),
    ),
    "tiago": Source("tiago/robot.urdf", ("tiago/log_identification.parquet",), tip="arm_7_link"),
}


def halves(source: Source, data: Path) -> tuple[Robot, Log, Log]:
    """The arm without parameters, and both halves of its log."""
    robot = load_robot(str(data / source.robot), tip=source.tip)
    return replace(robot, parameters=None, effects=()), *logs(data, source.logs).split(0.5)


def settings_of(source: Source, **more: Any) -> GapSettings:
    return GapSettings(cutoff=source.cutoff or "auto", **more)


def answer(robot: Robot, log: Log, settings: GapSettings) -> dict[str, Any]:
    """The diagnosis' JSON, with its CPU seconds; of what was refused or failed, the error."""
    started = time.process_time()
    try:
        found = diagnose_torque(robot, log, settings=settings).plain()
    except Exception as error:  # one case must not end a night's run
        found = {"status": "error", "which": [], "error": f"{type(error).__name__}: {error}"}
    return {**found, "seconds": time.process_time() - started}


def scene_of(robot: Robot, log: Log, noise: Sequence[float], band: float, finest: float) -> Scene:
    """Measured motions as a scene, in which effects are drawn."""
    segments = prepare(robot, log, None).segments
    step = max(1, round(segments[0].rate / finest))
    motions, starts = [], []
    for s in segments:
        q, dq, ddq, t = (x[::step] for x in (*s.motion.state, s.motion.require("t", "a scene")))
        motion = s.motion._replace(q=q, dq=dq, ddq=ddq, t=t - t[0], direction=None, age=None)
        motion = motion._replace(torque=model_torque(robot, nominal_effects(robot), motion))
        motions.append(motion)
        starts.append(float(t[0]))
    rate = segments[0].rate / step
    return Scene(
        robot,
        (log,),
        tuple(starts),
        tuple(motions),
        torch.tensor(noise, dtype=torch.float64),
        rate,
        min(band, 0.4 * rate),
        min(m.q.shape[0] for m in motions) / rate,
    )


def modelled(
    label: str, source: Source, data: Path, work: Path
) -> tuple[Robot, Log, dict[str, Any]]:
    """The arm as the first half of its log makes it, the second half, and what is answered there
    without anything planted; kept in the folder of the log."""
    rigid, first, second = halves(source, data)
    folder = work / label
    folder.mkdir(parents=True, exist_ok=True)
    model = folder / "model.yaml"
    if not model.exists():
        found = diagnose_torque(rigid, first, settings=settings_of(source, background=FRICTION))
        write_robot(found.corrected, model)
    robot = load_robot(str(model))
    empty = folder / "none.json"
    if not empty.exists():
        empty.write_text(json.dumps(answer(robot, second, settings_of(source))))
    return robot, second, json.loads(empty.read_text())


def run(label: str, source: Source, data: Path, work: Path, args: argparse.Namespace) -> None:
    """All cases of one log that are not there yet."""
    robot, second, unplanted = modelled(label, source, data, work)
    folder = work / label
    noise = [j["after"] for j in unplanted["how_far"]["per_joint"]]
    coarse = scene_of(robot, second, noise, args.band, FINEST)
    fine = scene_of(robot, second, noise, args.band, 1e6)
    moving = [j for j in range(robot.n) if float(coarse.fast[j]) > 0.02]
    missing = prepare(robot, second, None).missing
    part, of = (int(x) for x in args.part.split("/"))
    for number, name in enumerate(args.effects):
        for size in args.sizes:
            file = folder / f"{name}-{size:g}.json"
            untestable = name in KINDS and KINDS[name].needs & missing
            if number % of != part - 1 or file.exists() or untestable:
                continue
            g = generator("planted", label, name)
            joint = moving[int(torch.randint(len(moving), (1,), generator=g))]
            if name in HARD:
                added, key = formed(fine, name, size, joint)
            else:
                try:
                    planted = plant(coarse, name, size, g, joint, usual=2.0)
                except ValueError:  # no place for it on this arm
                    continue
                added = gap(fine, [planted.valued])
                key = {
                    "effect": name,
                    "joint": joint,
                    "joints": list(planted.effect.joints),
                    "felt_by": list(planted.joints),
                    "values": planted.values,
                    "size": planted.size,
                }
            if not max(float(x.abs().max()) for x in added) > 0:
                continue  # no torque shows it there
            log = with_torque(second, [fine.rate] * len(added), added)
            if name == "filter_lag":  # positions say by how much velocities are late
                log = with_late_velocities(second, planted.values[0])
            found = answer(robot, log, settings_of(source))
            file.write_text(json.dumps({"planted": key, "answer": found}))
            names = [(w["effect"], w["joints"]) for w in found["which"]]
            print(label, name, joint + 1, f"{key['size']:.1f}", found["status"], names, flush=True)


def with_late_velocities(log: Log, lag: float) -> Log:
    """The log with velocities that are so much later [s]."""
    assert log.dq is not None
    parts = []
    for rows in log.slices():
        t = log.t[rows].numpy()
        late = [np.interp(t - lag, t, x) for x in log.dq[rows].T.numpy()]
        parts.append(np.stack(late, 1))
    return log.replace(dq=torch.from_numpy(np.concatenate(parts)))


def formed(
    scene: Scene, kind: str, size: float, joint: int
) -> tuple[list[torch.Tensor], dict[str, Any]]:
    """Torques of a cause in a form of `gap_hard.py` on the scene's grid, and its key; `size` is
    over what the joint that feels it most leaves, while it acts."""
    ends = np.cumsum([0, *(len(m.q) for m in scene.motions)]).tolist()
    every = scene.together
    signals = (x.numpy() for x in (*every.state, every.require("torque", "a cause")))
    rng = np.random.default_rng([sorted(RIGHT).index(kind), joint])
    motions = [slice(a, b) for a, b in itertools.pairwise(ends)]
    torque = CAUSES[kind](Truth(scene.robot, *signals, motions, rng), joint)
    acts = np.abs(torque) > 1e-12 * np.abs(torque).max()
    mean = (torque**2).sum(0) / np.maximum(acts.sum(0), 1)
    felt = np.sqrt(mean) / scene.noise.numpy()
    scaled = torch.from_numpy(torque * size / max(felt.max(), 1e-300))
    own = [] if kind in ("table", "wall") else [joint]
    feels = (felt > felt.max() / size).nonzero()[0].tolist()
    key = {"effect": kind, "right": sorted(RIGHT[kind]), "joint": joint, "joints": own,
           "felt_by": sorted({*own, *feels}), "size": size}  # fmt: skip
    return [scaled[rows] for rows in motions], key


def score(work: Path, sizes: Sequence[float]) -> None:
    """A table, a line a size; and a line a log of what is named without anything planted."""
    unplanted = {p.parent: json.loads(p.read_text()) for p in sorted(work.glob("*/none.json"))}
    heads = ("planted, times what the model leaves", "named first on its joint", "named", "in a set",
             "first of names and suspects", "anywhere", "its branch", "above .9: right")  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    false = []
    for size in sizes:
        rows = []
        for folder, none in unplanted.items():
            for file in sorted(folder.glob(f"*-{size:g}.json")):
                case = json.loads(file.read_text())
                if abs(case["planted"]["size"] / size - 1) > 0.3:
                    continue  # no plausible value is as large
                rows.append(judged(case, none))
                false.append(rows[-1][-1])
        if rows:
            cells = [f"{sum(r[k] for r in rows)} of {len(rows)}" for k in range(len(heads) - 2)]
            cells.append("{} of {}".format(*(sum(r[-2][k] for r in rows) for k in (0, 1))))
            print(f"| {size:g} | {' | '.join(cells)} |")
    low, high = wilson(sum(map(bool, false)), len(false))
    print(
        f"\nnames that are neither planted nor there without: {sum(false)} in {len(false)} cases,"
    )
    print(f"in {sum(map(bool, false))} of them ({low:.0%} - {high:.0%})\n")
    for folder, none in unplanted.items():
        names = ", ".join(f"{w['effect']} {w['joints']}" for w in none["which"])
        print(f"- {folder.name}: {none['status']}: {names or 'nothing'}")


def names_it(
    key: dict[str, Any], claim: dict[str, Any], *, in_set: bool = False, branch: bool = False
) -> bool:
    """Whether a claim names what was planted at a joint that feels it; or holds it in its set, or
    is of its branch of the tree of causes."""
    places = {j + 1 for j in (*key["joints"], *key["felt_by"])}
    right = set(key.get("right", [key["effect"]]))
    also = claim.get("ambiguous_with", ()) if in_set else ()
    # Felt by no joint as much as by another: it is the whole arm's.
    near = not claim["joints"] or not places or bool(places & set(claim["joints"]))
    if branch and key["effect"] in KINDS:
        return near and KINDS[key["effect"]].branch == claim.get("branch")
    return near and bool(right & {claim["effect"], *also})


def identity(claim: dict[str, Any]) -> tuple[str, ...]:
    """Effect and joints of a claim."""
    return claim["effect"], *map(str, claim["joints"])


Verdict = tuple[bool, bool, bool, bool, bool, bool, tuple[int, int], int]


def judged(case: dict[str, Any], none: dict[str, Any]) -> Verdict:
    """Whether the first new name is right, any name is, any set holds it, the first of new names
    and suspects is right, any entry of the answer holds it, a name of its branch is there; how many
    new names above .9 at the effect's own level are right, and of how many; false names."""
    key, answer = case["planted"], case["answer"]
    before = {identity(w) for w in none["which"]}
    suspected = {identity(s) for s in none.get("suspects", ())}
    new = [w for w in answer["which"] if identity(w) not in before]
    likely = answer.get("suspects", [])
    listed = [*new, *(s for s in likely if identity(s) not in suspected or names_it(key, s))]
    every = [*answer["which"], *likely, *answer.get("small", ())]
    named = [w for w in answer["which"] if names_it(key, w)]
    sure = [w for w in new if w["how_sure"] >= SET_MASS and not w.get("one_of_a_set")]
    # Known on the joint before it was planted, it can only change its size.
    known = any(names_it(key, w) for w in none["which"] if w["joints"])
    first = (bool(new) and names_it(key, new[0])) or (known and bool(named))
    return (
        first,
        bool(named),
        any(names_it(key, w, in_set=True) for w in answer["which"]),
        first or (bool(listed) and names_it(key, listed[0])),
        any(names_it(key, c, in_set=True) for c in every),
        any(names_it(key, w, branch=True) for w in answer["which"]),
        (sum(names_it(key, w) for w in sure), len(sure)),
        sum(not names_it(key, w, in_set=True) for w in new),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--logs", type=lambda s: s.split(","), default=list(SOURCES))
    parser.add_argument("--sizes", type=float, nargs="+", default=[1.0, 2.0, 5.0])
    parser.add_argument(
        "--effects", type=lambda s: s.split(","), default=[*PLANTED, *PAIRED, *HARD]
    )
    parser.add_argument("--band", type=float, default=8.0, help="sizes are measured below it [Hz]")
    parser.add_argument("--part", default="1/1", help="k/n: the k-th of n parts of the effects")
    parser.add_argument("--score", action="store_true")
    args = parser.parse_args()
    if args.score:
        score(args.work, args.sizes)
        return
    torch.set_num_threads(1)
    for label in args.logs:
        run(label, SOURCES[label], args.data, args.work, args)


if __name__ == "__main__":
    main()
