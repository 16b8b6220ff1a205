"""Effects planted into the second half of real logs, the first half being the model's.

    python -m torchid_bench.benchmarks.gap_planted DATA --work DIR [--logs panda,ur10e] [--sizes 2]
                                     [--effects coulomb_friction,...] [--jobs 2]
                                     [--plants DIR]
    python -m torchid_bench.benchmarks.gap_planted DATA --work DIR --score

Each log is cut in two. From the first half a model is fitted (base parameters, friction, and what
the diagnosis names). The second half is diagnosed with that model as it is: whatever is named there
is a false name, or a change of the arm between the halves. Then an effect of the library is added
to its torque, `size` times as large as what the model leaves on the joint, and it is diagnosed again.
Causes of `gap_hard.py` (table, wall, stop, soft_knee, moment, axial) are planted in the forms of that
file, and their size is that while they act.

Answers are kept in DIR/LOG/EFFECT-SIZE.json, beside the models and the planted logs
(`planted_cases.py`); those of another DIR, with `--plants`. Another diagnosis than torchid's is asked
by `main(answer)`.

What can be known of a case an oracle says (`planted_oracle.py`, whose answers are stored). Right is
to name a decidable effect first, on its joint; of an ambiguous one a set of four at most that holds
it; of the others nothing new. A name that is neither in the set nor in the unplanted half's answer
is false.
"""

import itertools
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torchid.effects.parameters import travel
from torchid.effects.periodic import Wave
from torchid.effects.registry import KINDS, model_torque, nominal_effects
from torchid.effects.spring import JointSpring
from torchid.gap.data import prepare
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.statistics.criteria import SET_MASS
from torchid.withheld.planted import with_torque
from torchid_bench.benchmarks.gap_hard import CAUSES, RIGHT, Truth
from torchid_bench.benchmarks.gap_plant import Planted, Scene, gap, generator, plant
from torchid_bench.benchmarks.gap_real import FRICTION
from torchid_bench.benchmarks.planted_cases import SOURCES, Case, Source, cases, halves, unpack
from torchid_bench.benchmarks.planted_oracle import stored
from torchid_bench.benchmarks.runner import command, results, share, table

DRAWS = 6
"""Times that an effect is drawn at most, until it is a cause."""


PLANTED = (
    "viscous_friction", "power_law_friction", "coulomb_friction", "stribeck_friction",
    "load_dependent_friction", "torque_offset", "joint_spring", "rotor_inertia",
    "presliding_hysteresis", "cogging", "motor_ripple", "position_dependent_friction",
    "torque_gain", "torque_crosstalk", "encoder_offset", "payload", "link_inertia", "filter_lag",
    "contact", "gear_coupling",
)  # fmt: skip


HARD = ("table", "wall", "stop", "soft_knee", "moment", "axial")
"""Causes of `gap_hard.py` that are planted, too; and `PAIRED` of the library's forms."""

PAIRED = ("backlash", "joint_elasticity", "saturation")


def settings_of(source: Source, **more: Any) -> GapSettings:
    return GapSettings(cutoff=source.cutoff or "auto", **more)


def answer(robot: Robot, log: Log, settings: GapSettings) -> dict[str, Any]:
    """The diagnosis' JSON, with its CPU seconds; of what was refused or failed, the error."""
    started = time.process_time()
    try:
        answered = diagnose_torque(robot, log, settings=settings).plain()
    except Exception as error:  # one case must not end a night's run
        answered = {"status": "error", "which": [], "error": f"{type(error).__name__}: {error}"}
    return {**answered, "seconds": time.process_time() - started}


Answer = Callable[[Robot, Log, GapSettings], dict[str, Any]]
"""A diagnosis: of an arm, a log and settings, what `torchid gap --json` writes, of which `status`
and `which` are read (and `how_far` where something is planted), and `seconds`."""


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
    label: str,
    source: Source,
    data: Path,
    work: Path,
    answer: Answer = answer,
    plants: Path | None = None,
) -> tuple[Robot, Log, dict[str, Any]]:
    """The arm as the first half of its log makes it, the second half, and what is answered there
    without anything planted; kept in the folder of the log, the model in that of `plants`."""
    rigid, first, second = halves(source, data)
    folder = work / label
    folder.mkdir(parents=True, exist_ok=True)
    model = (plants or work) / label / "model.yaml"
    if not model.exists():
        diagnosis = diagnose_torque(rigid, first, settings=settings_of(source, background=FRICTION))
        write_robot(diagnosis.corrected, model)
    robot = load_robot(str(model))
    empty = folder / "none.json"
    if not empty.exists():
        empty.write_text(json.dumps(answer(robot, second, settings_of(source))))
    return robot, second, json.loads(empty.read_text())


def well_posed(scene: Scene, planted: Planted) -> bool:
    """Whether what was drawn is a cause: it makes torque, no spring pushes away from its rest
    position, and the joint passes through a period of a wave once at least."""
    effect = planted.effect
    # 1e-3: size below which an effect is none, over what the model leaves
    if not planted.size > 1e-3 or not any(planted.values):
        return False
    if isinstance(effect, JointSpring):
        return planted.values[0] > 0
    if isinstance(effect, Wave):
        return effect.k * travel(scene.motions, effect.joint) >= 2 * math.pi
    return True


def drawn(scene: Scene, name: str, size: float, g: torch.Generator, joint: int) -> Planted | None:
    """An effect of this name, drawn again while it is no cause; None where none is found."""
    for _ in range(DRAWS):
        try:
            planted = plant(scene, name, size, g, joint, usual=2.0)
        except ValueError:  # no place for it on this arm
            return None
        if well_posed(scene, planted):
            return planted
    return None


def draw(
    label: str,
    data: Path,
    plants: Path,
    effects: Sequence[str],
    sizes: Sequence[float],
    band: float,
) -> None:
    """Plant what is not there yet, at sizes over what this code's answer leaves."""
    unpack(label, plants / label)
    robot, second, unplanted = modelled(label, SOURCES[label], data, plants)
    folder = plants / label
    noise = [j["after"] for j in unplanted["how_far"]["per_joint"]]
    # 125.0: rate at which sizes are measured [Hz]
    coarse = scene_of(robot, second, noise, band, 125.0)
    fine = scene_of(robot, second, noise, band, 1e6)
    moving = [j for j in range(robot.n) if float(coarse.fast[j]) > 0.02]
    missing = prepare(robot, second, None).missing
    for name, size in itertools.product(effects, sizes):
        untestable = name in KINDS and KINDS[name].needs & missing
        if untestable or (folder / f"{name}-{size:g}.npz").exists():
            continue
        g = generator("planted", label, name)
        joint = moving[int(torch.randint(len(moving), (1,), generator=g))]
        planted = None if name in HARD else drawn(coarse, name, size, g, joint)
        if name in HARD:
            added, key = formed(fine, name, size, joint)
        elif planted is None:
            continue
        else:
            added = gap(fine, [planted.valued])
            key = {
                "effect": name,
                "joint": joint,
                "joints": list(planted.effect.joints),
                "felt_by": list(planted.joints),
                "values": planted.values,
                "record": planted.effect.record(planted.values),
                "size": planted.size,
            }
        if not max(float(x.abs().max()) for x in added) > 0:
            continue  # no torque shows it there
        log, late = with_torque(second, [fine.rate] * len(added), added), None
        if planted is not None and name == "filter_lag":
            # Positions say by how much velocities are late.
            log = with_late_velocities(second, planted.values[0])
            late = None if log.dq is None else log.dq.numpy()
        assert log.tau is not None
        Case(f"{name}-{size:g}", key, log.tau.numpy(), late).write(folder)


def asked(
    label: str, data: Path, work: Path, plants: Path, name: str, answer: Answer
) -> dict[str, Any]:
    """What is answered of one case, by this diagnosis or another."""
    source = SOURCES[label]
    robot, second, _ = modelled(label, source, data, work, answer, plants)
    case = Case.read(plants / label / f"{name}.npz")
    answered = answer(robot, case.log(second), settings_of(source))
    names = [(w["effect"], w["joints"]) for w in answered["which"]]
    size = f"{case.key['size']:.1f}"
    print(label, name, case.key["joint"] + 1, size, answered["status"], names, flush=True)
    return {"planted": case.key, "answer": answered}


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
    signals = (*every.state, every.require("torque", "a cause"))
    q, dq, ddq, tau = (x.numpy() for x in signals)
    rng = np.random.default_rng([sorted(RIGHT).index(kind), joint])
    motions = [slice(a, b) for a, b in itertools.pairwise(ends)]
    torque = CAUSES[kind](Truth(scene.robot, q, dq, ddq, tau, motions, rng), joint)
    acts = np.abs(torque) > 1e-12 * np.abs(torque).max()
    mean = (torque**2).sum(0) / np.maximum(acts.sum(0), 1)
    felt = np.sqrt(mean) / scene.noise.numpy()
    scaled = torch.from_numpy(torque * size / max(felt.max(), 1e-300))
    own = [] if kind in ("table", "wall") else [joint]
    feels = (felt > felt.max() / size).nonzero()[0].tolist()
    key = {"effect": kind, "right": sorted(RIGHT[kind]), "joint": joint, "joints": own,
           "felt_by": sorted({*own, *feels}), "size": size}  # fmt: skip
    return [scaled[rows] for rows in motions], key


HEADS = ("log", "decidable: named first", "ambiguous: in a set of 4 at most",
         "undecidable or below 1 %: no new name", "false names, in cases", "above .9: right",
         "nothing planted: names above .9", "named first, of all")  # fmt: skip


def scored(work: Path, names: Sequence[str], sizes: Sequence[float]) -> None:
    """A table: a line a log, and one of all; and what is named without anything planted."""
    classes, total, rows, lines = stored()["cases"], Counter[str](), [], []
    for folder in (work / name for name in names if (work / name / "none.json").exists()):
        none, counts = json.loads((folder / "none.json").read_text()), Counter[str]()
        counts["named above .9"] = sum(w["how_sure"] >= SET_MASS for w in none["which"])
        for file in (f for size in sizes for f in sorted(folder.glob(f"*-{size:g}.json"))):
            known = classes.get(f"{folder.name}-{file.stem}", {})
            counts += counted(json.loads(file.read_text()), none, known.get("class", ""))
        rows.append(row(folder.name, counts))
        total += counts
        before = ", ".join(f"{w['effect']} {w['joints']}" for w in none["which"])
        lines.append(f"- {folder.name}: {none['status']}: {before or 'nothing'}")
    table(HEADS, [*rows, row("all", total)])
    print(f"cases with false names: {share(total['with false'], total['cases'])}")
    print("without anything planted:\n\n" + "\n".join(lines))


def row(name: str, counts: Counter[str]) -> tuple[str, ...]:
    """A row of the table: name, then counts of cases."""
    of = "{} of {}".format
    return (
        name,
        *(of(counts[f"right {c}"], counts[c]) for c in ("decidable", "ambiguous", "silent")),
        f"{counts['false']}, in {of(counts['with false'], counts['cases'])}",
        of(counts["sure and right"], counts["sure"]),
        str(counts["named above .9"]),
        of(counts["first"], counts["cases"]),
    )


def counted(case: dict[str, Any], none: dict[str, Any], known: str) -> Counter[str]:
    """What one case adds to the sums of its line; `known` is its class."""
    verdict = judged(case, none)
    right = {
        "decidable": verdict.first,
        "ambiguous": verdict.small_set,
        "silent": not verdict.new,
    }
    kind = "silent" if known in ("undecidable", "below") else known
    out = Counter({
        "cases": 1, "first": int(verdict.first), "false": verdict.false,
        "with false": int(verdict.false > 0), "sure": verdict.sure,
        "sure and right": verdict.sure_right,
    })  # fmt: skip
    if kind in right:
        out.update({kind: 1, f"right {kind}": int(right[kind])})
    return out


def names_it(key: dict[str, Any], claim: dict[str, Any], *, in_set: bool = False) -> bool:
    """Whether a claim names what was planted at a joint that feels it, or holds it in its set."""
    places = {j + 1 for j in (*key["joints"], *key["felt_by"])}
    right = set(key.get("right", [key["effect"]]))
    also = claim.get("ambiguous_with", ()) if in_set else ()
    # Felt by no joint as much as by another: it is the whole arm's.
    near = not claim["joints"] or not places or bool(places & set(claim["joints"]))
    return near and bool(right & {claim["effect"], *also})


def identity(claim: dict[str, Any]) -> tuple[str, ...]:
    """Effect of a claim, and joints that it is at: none of the whole arm's, whoever feels it."""
    return claim["effect"], *map(str, claim.get("located", claim["joints"]))


class Verdict(NamedTuple):
    """How right an answer is.

    Attributes:
        first: whether the first new name is right, or a name that was there before.
        small_set: whether a set of at most so many holds the truth.
        new: names that were not there before.
        false: those of them whose set does not hold the truth.
        sure, sure_right: new names above .9 at the effect's own level, and how many are right.
    """

    first: bool
    small_set: bool
    new: int
    false: int
    sure: int
    sure_right: int


def judged(case: dict[str, Any], none: dict[str, Any]) -> Verdict:
    """An answer beside that of the log without anything planted."""
    key, names = case["planted"], case["answer"]["which"]
    before = {identity(w) for w in none["which"]}
    new = [w for w in names if identity(w) not in before]
    sure = [w for w in new if w["probabilities"].get(w["effect"], 0.0) >= SET_MASS]
    # Known on the joint before it was planted, it can only change its size.
    known = any(names_it(key, w) for w in none["which"] if w["joints"])
    # 4: members of a set that still says something
    return Verdict(
        (bool(new) and names_it(key, new[0])) or (known and any(names_it(key, w) for w in names)),
        any(
            names_it(key, w, in_set=True) and len({w["effect"], *w.get("ambiguous_with", ())}) <= 4
            for w in names
        ),
        len(new),
        sum(not names_it(key, w, in_set=True) for w in new),
        len(sure),
        sum(names_it(key, w) for w in sure),
    )


def run(
    data: Path,
    *,
    work: Path,
    logs: tuple[str, ...] = tuple(SOURCES),
    sizes: Sequence[float] = (1.0, 2.0, 5.0),
    effects: tuple[str, ...] = (*PLANTED, *PAIRED, *HARD),
    band: float = 8.0,
    plants: Path | None = None,
    score: bool = False,
    jobs: int = 1,
    answer: Answer = answer,
) -> None:
    """Answer all cases that have no answer yet, or count what was answered.

    Args:
        data, work: folders of the real logs, and of the answers.
        logs, sizes, effects: of these cases.
        band: below which sizes are measured [Hz].
        plants: folder of models and planted logs, if not that of the answers.
        score: whether to count.
        jobs: processes.
        answer: a diagnosis.
    """
    if score:
        return scored(work, logs, sizes)
    plants = plants or work
    for label in logs:
        draw(label, data, plants, effects, sizes, band)
        modelled(label, SOURCES[label], data, work, answer, plants)
        names = [case.name for case in cases(plants / label, effects, sizes)]
        todo = {name: (label, data, work, plants, name, answer) for name in names}
        list(results(asked, todo, work / label, jobs=jobs))


def main(answer: Answer = answer, given: Sequence[str] | None = None) -> None:
    """The command; another diagnosis may answer."""
    command(run, words=given, answer=answer)


if __name__ == "__main__":
    main()
