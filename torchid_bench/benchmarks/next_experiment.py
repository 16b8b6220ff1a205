"""Whether the motion of `torchid excite --for gap.json` settles what a diagnosis left open.

    python -m torchid_bench.benchmarks.next_experiment [--scenes 3r-offset,...] [--seeds 1] [--usage 0.5] [--out DIR]

A scene is an arm with one planted effect on a log too poor to name it: `torchid gap` leaves a set
of alternatives. Each member in turn is then the truth, with the size that its own fit to that log
gives. The arm moves along the designed motion and along a plain exciting one (least condition
number) of the same length and limits, each driven twice, with the log's noise; both logs are
diagnosed from nothing, with the whole library. Counted is what stands first:

    right        the truth, and no other member of the set beside it
    unresolved   the truth among several members of the set
    nothing      no effect
    wrong        anything else
"""

import itertools
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from torchid.effects.base import Motion
from torchid.effects.registry import KINDS, Valued, effect_from_record, nominal_effects
from torchid.excitation.design import excite
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.synthetic import nominal_torque
from torchid.excitation.trajectories import random_trajectory
from torchid.gap.cause_records import valued
from torchid.gap.diagnosis import Diagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.next_motion.ambiguity import open_questions, rivals
from torchid.next_motion.separating_motion import Separation, design_separation
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import closed_loop
from torchid.simulation.sensors import HonestNoise, Sensors, measured_log
from torchid_bench.benchmarks.runner import command, results, table

LINK = "link_inertia"
RATE = 100.0
DURATION = 10.0
NOISE = 0.04
"""Standard deviation of the torque noise, as a share of each joint's RMS torque at full excitation;
no joint's RMS torque counts as less than a twentieth of the largest."""

EVALUATIONS, RESTARTS = 600, 8
"""As `torchid excite --for` has them."""


@dataclass(frozen=True)
class Scene:
    """What is planted, and how poor the log is.

    Attributes:
        robot: name.
        effect: as in a robot's yaml.
        poor: share of the limits that the log used, with one harmonic.
    """

    robot: str
    effect: dict[str, Any]
    poor: float = 0.15


SCENES = {
    "3r-offset": Scene("3r", {"effect": "torque_offset", "joint": 2, "F0": 0.2}),
    "3r-viscous": Scene("3r", {"effect": "viscous_friction", "joint": 2, "Fv": 0.4}),
    "3r-coulomb": Scene("3r", {"effect": "coulomb_friction", "joint": 2, "Fc": 0.2}),
    "3r-spring": Scene("3r", {"effect": "joint_spring", "joint": 2, "k": 0.6, "c0": 0.0}),
    "3r-encoder": Scene("3r", {"effect": "encoder_offset", "joint": 2, "offset": 0.03}),
    "lwr-offset": Scene("kuka_lwr4", {"effect": "torque_offset", "joint": 2, "F0": 2.0}),
    "lwr-spring": Scene("kuka_lwr4", {"effect": "joint_spring", "joint": 4, "k": 3.0, "c0": 0.0}),
    "lwr-viscous": Scene("kuka_lwr4", {"effect": "viscous_friction", "joint": 4, "Fv": 1.5}),
}

VERDICTS = ("right", "unresolved", "nothing", "wrong")

Arm = tuple[Robot, list[Valued]]
"""As it is: inertial parameters, and effects that the model lacks."""


def torque_std(robot: Robot) -> tuple[float, ...]:
    """Of the noise (n,) [N m]: the same for every log of an arm."""
    full = random_trajectory(robot, 0, fill=True, duration=DURATION)
    log = closed_loop(robot, [run(full, 0.0)], [[]])[0]
    assert log.tau is not None
    size = log.tau.square().mean(0).sqrt()
    return tuple((NOISE * size.clamp(min=0.05 * float(size.max()))).tolist())


def run(motion: FourierTrajectory, shift: float) -> Log:
    """A reference, the clocks of controller and logger a part of a sample apart: repeats must not
    count the same encoder steps."""
    t = torch.arange(round(motion.duration * RATE), dtype=torch.float64) / RATE
    q, dq, ddq = motion.at((t + shift).clamp(max=motion.duration)).state
    return Log(t, q, dq, ddq)


def driven_twice(arm: Arm, motion: FourierTrajectory, std: tuple[float, ...], seed: int) -> Log:
    """The log of both runs. A link as a fit to a poor log has it may be no body, and no controller
    holds it: without effects the arm follows exactly."""
    robot, effects = arm
    references = [run(motion, 0.0), run(motion, 0.37 / RATE)]
    if effects:
        logs = closed_loop(robot, references, [effects] * 2)
    else:
        logs = [r.replace(tau=nominal_torque(robot, Motion(r.q, r.dq, r.ddq))) for r in references]
    sensed = [*nominal_effects(robot), *effects]
    return measured_log(
        robot, Log.concatenate(logs), sensed, Sensors(HonestNoise(), torque_std=std), seed
    )


def diagnosed(robot: Robot, log: Log, only: tuple[tuple[str, int | None], ...] | None = None):
    return diagnose_torque(robot, log, settings=GapSettings(only=only))


def members(robot: Robot, log: Log, found: Diagnosis, names: tuple[str, ...]) -> dict[str, Arm]:
    """Members of the set, each with the size that it would have had; those that a fit accepts."""
    joints = next(f for f in found.which if f.ambiguous_with and f.effect != LINK).at
    out: dict[str, Arm] = {}
    for name in names:
        fit = diagnosed(robot, log, only=((name, None),))
        here = [f for f in fit.which if not joints or set(joints) & set(f.joints)]
        if name == LINK and any(c.effect == LINK for c in fit.answer.causes):
            out[name] = replace(robot, parameters=fit.corrected.parameters), []
        elif here:
            out[name] = robot, [valued(here[0], robot)]
    return out


def next_motion(robot: Robot, found: Diagnosis, usage: float, seed: int) -> Separation:
    """As `torchid excite --for` designs it."""
    left = open_questions(found.record, robot, "gap.json")
    plain = excite(
        robot, effects=(), seed=seed, restarts=RESTARTS, usage=usage, duration=DURATION
    ).trajectory
    return design_separation(
        left.setting, rivals(left, plain), plain, seed=seed, evaluations=EVALUATIONS, usage=usage
    )


def verdict(found: Diagnosis, truth: str, group: set[str]) -> tuple[str, int]:
    """What stands first, against the truth; and how many members of the set are left."""
    entries: list[tuple[float, str, tuple[str, ...]]] = [
        (c.share, c.effect, c.ambiguous_with) for c in found.answer.causes
    ]
    if not entries:
        return "nothing", len(group)
    _, first, others = max(entries)
    named = {first, *others} & (group | {first})
    if truth not in named:
        return "wrong", len(named)
    return "right" if named == {truth} else "unresolved", len(named)


def play(name: str, seed: int, usage: float) -> dict[str, Any]:
    """One scene: the set, the design, and every member as truth on both motions."""
    scene, start = SCENES[name], time.time()
    robot = load_robot(scene.robot)
    std = torque_std(robot)
    planted = effect_from_record(scene.effect, robot)
    poor = random_trajectory(
        robot, 3 + seed, fill=True, usage=scene.poor, harmonics=1, duration=DURATION
    )
    log = driven_twice((robot, [planted]), poor, std, seed)
    found = diagnosed(robot, log)
    unsure = [f for f in found.which if f.ambiguous_with and f.effect != LINK]
    if not unsure:
        print(f"{name}: nothing ambiguous, {[f.effect for f in found.which]}", flush=True)
        return {"scene": name, "seed": seed, "set": [], "verdicts": []}
    asked = (unsure[0].effect, *unsure[0].ambiguous_with)
    names = tuple(n for n in asked if n not in KINDS or KINDS[n].by_motion)
    arms = members(robot, log, found, names)
    made = next_motion(robot, found, usage, seed)
    verdicts = []
    for truth, arm in arms.items():
        for kind, motion in (("plain", made.plain), ("designed", made.trajectory)):
            again = diagnosed(robot, driven_twice(arm, motion, std, seed + 100))
            said, left = verdict(again, truth, set(names))
            top = [(f.effect, list(f.joints), list(f.ambiguous_with)) for f in again.which[:2]]
            verdicts.append(
                {"truth": truth, "motion": kind, "verdict": said, "left": left, "first": top}
            )
            print(f"  {name} {seed}: {truth:20} {kind:9} {said:11} {top}", flush=True)
    sure = {k: [t.reached for t in x] for k, x in
            (("plain", made.with_plain), ("designed", made.after))}  # fmt: skip
    print(f"{name} {seed}: {time.time() - start:.0f} s, expected {sure}", flush=True)
    return {"scene": name, "seed": seed, "set": names, "verdicts": verdicts, "expected": sure}


def main(
    *,
    scenes: tuple[str, ...] = tuple(SCENES),
    seeds: int = 1,
    usage: float = 0.5,
    out: Path | None = None,
    jobs: int = 1,
) -> None:
    """Play scenes with a share of the limits; verdicts are kept in the folder `out`."""
    cases = {f"{name}-{k}-{usage:g}": (name, k, usage) for name in scenes for k in range(seeds)}
    played, rows = [one for _, one in results(play, cases, out, jobs=jobs)], []
    for name, kind in itertools.product([*scenes, "all"], ("plain", "designed")):
        every = [v for p in played if name in (p["scene"], "all") for v in p["verdicts"]]
        own = [v for v in every if v["motion"] == kind]
        counts = Counter(v["verdict"] for v in own)
        left = sum(v["left"] for v in own) / max(1, len(own))
        rows.append((name, len(own), kind, *(counts[v] for v in VERDICTS), f"{left:.1f}"))
    table(("scene", "truths", "motion", *VERDICTS, "names left"), rows)


if __name__ == "__main__":
    command(main)
