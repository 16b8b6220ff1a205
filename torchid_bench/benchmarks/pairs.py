"""Pairs of logs, a simulator's and an arm's, both made by MuJoCo: set-up faults and effects drawn by seed.

    python -m torchid_bench.benchmarks.pairs --seed 1 --pairs 40 --equal 20 --out pairs     # score of `torchid pair`
    python -m torchid_bench.benchmarks.pairs --seed 1 --only 7                               # one pair

Both sides follow the same commands with the same servo. The simulator is the arm's file with one thing
wrong in its set-up, or one of the two has an effect that the other lacks. Real logs have noise of encoders
and torque, start at another time, and have another rate.
"""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid_bench.benchmarks.runner import command, results, share, table
from torchid_bench.withheld.plant.arms import ARMS, urdf
from torchid_bench.withheld.plant.bodies import Inertial
from torchid_bench.withheld.plant.model import Plant, Spring, compiled, plant_of

STEP = 1e-3
KINDS = {False: "faults and effects", True: "equal"}
"""By whether both sides are the same."""
DEGREE = 180 / math.pi

SETUP = (
    "gain_units", "gravity_compensation", "friction_never_applied", "armature_zero", "clipped_torque",
    "held_control", "joint_order", "sign", "time_step",
)  # fmt: skip
"""Faults of the set-up; those of all joints' friction and rotors are said as effects."""
EFFECTS = (
    "coulomb_friction", "viscous_friction", "stribeck_friction", "torque_offset", "rotor_inertia",
    "joint_spring", "payload",
)  # fmt: skip


@dataclass
class Side:
    """How one of the two is run.

    Attributes:
        plant: the arm in it.
        kp, kd: gains of the servo.
        hold: steps for which a command is held.
        hold_torque: whether the torque is held, not only the command.
        limit: (n,) torque at which it is clipped; inf for none.
        stretch: of the commands in time: steps of the wrong length.
        compensated: whether the servo adds the nominal arm's gravity torque.
        weightless: whether gravity is taken away beside the logged torque.
        law: further torque on the joints from (q, dq).
        rate: of the log [Hz].
        filtered: whether the log's torque is a mean over the time between its samples.
    """

    plant: Plant
    kp: np.ndarray
    kd: np.ndarray
    hold: int = 1
    hold_torque: bool = False
    limit: np.ndarray | None = None
    stretch: float = 1.0
    compensated: bool = False
    weightless: bool = False
    law: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    rate: float = 500.0
    filtered: bool = False


@dataclass
class Pair:
    """Two logs, the robot of the simulator's file, and what is different."""

    robot: Robot
    simulated: Log
    real: Log
    kind: str
    answers: set[str]
    joints: set[int]
    only: str | None
    words: str
    extra: dict = field(default_factory=dict)


def commands(rng: np.random.Generator, n: int, seconds: float, reach: np.ndarray, peak: np.ndarray):
    """Positions of a sum of five harmonics a joint, and the instant they begin with zero speed."""
    base = 2 * math.pi / seconds
    order = rng.integers(1, 11, (n, 5))
    size = rng.normal(size=(n, 5)) / order**0.7
    phase = rng.uniform(0, 2 * math.pi, (n, 5))
    t = np.linspace(0, seconds, 2000)
    q = np.stack(
        [(size[j] * np.sin(base * order[j] * t[:, None] + phase[j])).sum(1) for j in range(n)], 1
    )
    dq = np.gradient(q, t, axis=0)
    scale = np.minimum(reach / np.abs(q).max(0), peak / np.abs(dq).max(0))
    middle = rng.uniform(-0.3, 0.3, n)

    def at(t: np.ndarray) -> np.ndarray:
        own = [
            scale[j] * (size[j] * np.sin(base * order[j] * t[:, None] + phase[j])).sum(1)
            for j in range(n)
        ]
        return middle + np.stack(own, 1)

    return at


def run(side: Side, command: Callable, seconds: float, nominal: Plant) -> dict[str, np.ndarray]:
    """One run: t, u, q, tau at the side's rate."""
    model, motors = compiled(side.plant, 0 * side.kp, 0 * side.kd, STEP)
    if side.weightless:
        model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    gravity_model, gravity_motors = compiled(nominal, 0 * side.kp, 0 * side.kd, STEP)
    gravity = mujoco.MjData(gravity_model)
    count = int(seconds * side.stretch / STEP)
    t = np.arange(count) * STEP
    u = command(t / side.stretch)
    data.qpos[motors] = u[0]
    settle = 500
    rows = {"u": [], "q": [], "tau": []}
    held_u, tau = u[0], np.zeros(len(motors))
    for k in range(-settle, count):
        if k % side.hold == 0:
            held_u = u[max(k, 0)]
        q, dq = data.qpos[motors].copy(), data.qvel[motors].copy()
        if k % side.hold == 0 or not side.hold_torque:
            tau = side.kp * (held_u - q) - side.kd * dq
            if side.compensated:
                gravity.qpos[gravity_motors] = q
                mujoco.mj_fwdPosition(gravity_model, gravity)
                mujoco.mj_fwdVelocity(gravity_model, gravity)
                tau = tau + gravity.qfrc_bias[gravity_motors]
            if side.limit is not None:
                tau = np.clip(tau, -side.limit, side.limit)
        data.qfrc_applied[motors] = tau if side.law is None else tau - side.law(q, dq)
        mujoco.mj_step(model, data)
        if k >= 0:
            rows["u"].append(held_u)
            rows["q"].append(q)
            rows["tau"].append(tau)
    every = round(1 / (side.rate * STEP))
    out = {name: np.array(x) for name, x in rows.items()}
    if side.filtered and every > 1:
        # A drive logs its current's mean about the instant; a simulator logs what it applies.
        kernel = np.ones(every + 1)
        kernel[[0, -1]] = 0.5
        wide = np.pad(out["tau"], ((every // 2, every // 2), (0, 0)), mode="edge")
        out["tau"] = np.stack([np.convolve(x, kernel / every, "valid") for x in wide.T], 1)
    out = {name: x[::every] for name, x in out.items()}
    if not np.abs(out["q"]).max() < 50:
        raise FloatingPointError("the arm diverged")
    return {"t": t[::every], **out}


def stribeck(rng: np.random.Generator, joint: int, size: float):
    vs = rng.uniform(0.1, 0.3)

    def law(q, dq):
        out = np.zeros(len(q))
        out[joint] = size * math.exp(-((dq[joint] / vs) ** 2)) * math.tanh(dq[joint] / 0.004)
        return out

    return law


def drawn(seed: int, number: int, equal: bool = False) -> Pair:
    """The pair of a seed and a number; drawn again where an arm diverges in MuJoCo."""
    for again in range(10):
        try:
            return _drawn(
                np.random.default_rng([seed, number, int(equal), *[again] * bool(again)]), equal
            )
        except FloatingPointError:
            continue
    raise RuntimeError("no pair whose arms do not diverge")


def _drawn(rng: np.random.Generator, equal: bool) -> Pair:
    name = str(rng.choice(["3r", "6r", "7r"], p=[0.5, 0.3, 0.2]))
    arm = ARMS[name]
    n = arm.n
    effort = np.array([j.effort for j in arm.joints])
    speed = np.array([j.velocity for j in arm.joints])
    reach = np.array([j.upper for j in arm.joints])
    friction = effort * rng.uniform(0.02, 0.05, n)
    damping = effort / speed * rng.uniform(0.02, 0.05, n)
    plain = plant_of(arm, damping, friction)
    model, motors = compiled(plain, np.zeros(n), np.zeros(n), STEP)
    inertia = np.zeros((model.nv, model.nv))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    own = inertia.diagonal()[motors]
    # Rotors behind gears: of a wrist they are most of what it accelerates.
    armature = 0.3 * own + effort * 0.003 * rng.uniform(0.5, 1.5, n)
    plain = replace(plain, armature=armature)
    # The servo: a bandwidth of some hertz and nearly critical damping.
    omega = rng.uniform(25, 40)
    kp = (own + armature) * omega**2
    kd = 1.6 * (own + armature) * omega
    compensated = bool(rng.integers(2))
    hold = int(rng.choice([1, 1, 1, 4, 10]))
    base = Side(plain, kp, kd, hold=hold, compensated=compensated)
    simulated, real = replace(base), replace(base)
    seconds = 12.0
    command = commands(rng, n, seconds, 0.6 * reach, 0.5 * speed)
    joint = int(rng.integers(n))
    gravity_joint = 1 if n == 3 else int(rng.choice([1, 2] if n == 6 else [1, 3]))
    kind, answers, joints, only, words = "equal", set(), set(), None, ""
    order, signs, torque_signs = list(range(n)), np.ones(n), np.ones(n)
    if not equal:
        kind = str(rng.choice(SETUP if rng.uniform() < 0.6 else EFFECTS))
        answers = {kind}
    if kind == "gain_units":
        soft = bool(rng.integers(2))
        simulated.kp = kp / DEGREE if soft else kp * DEGREE
        simulated.kd = kd / DEGREE if soft else kd * math.sqrt(DEGREE)
        if not soft:  # an explicit servo must stay stable at a millisecond
            simulated.kd = np.minimum(simulated.kd, 0.5 * (own + armature) / STEP)
        words = "soft" if soft else "stiff"
    elif kind == "gravity_compensation":
        which = int(rng.integers(3))
        if which == 0:
            simulated.weightless = True
        elif which == 1:
            real.weightless = True
        else:
            simulated.compensated = not compensated
        words = ("simulator weightless", "arm compensated beside its log", "feed-forward")[which]
    elif kind == "friction_never_applied":
        simulated.plant = replace(plain, damping=0 * damping, friction=0 * friction)
        answers, only = {"coulomb_friction", "viscous_friction"}, "arm"
    elif kind == "armature_zero":
        simulated.plant = replace(plain, armature=0 * armature)
        answers, only = {"rotor_inertia"}, "arm"
    elif kind == "held_control":
        simulated.hold, real.hold = int(rng.choice([20, 33, 50])), 1
        simulated.hold_torque = bool(rng.integers(2)) and simulated.hold <= 20
        words = f"{simulated.hold} ms"
    elif kind == "joint_order":
        while order == list(range(n)):
            order = rng.permutation(n).tolist() if rng.integers(2) else list(range(n))
            if order == list(range(n)):
                a, b = rng.choice(n, 2, replace=False)
                order[a], order[b] = order[b], order[a]
        words = str([k + 1 for k in order])
    elif kind == "sign":
        which = int(rng.integers(2))
        if which == 0:
            signs[joint] = torque_signs[joint] = -1
        else:
            torque_signs[joint] = -1
        joints = {joint}
        words = ("position and torque", "torque")[which]
    elif kind == "time_step":
        simulated.stretch = float(rng.choice([0.5, 2.0, 4.0, 1.25]))
        words = f"{simulated.stretch}"
    elif kind == "clipped_torque":
        probe = run(replace(real, hold=1), command, seconds, plain)
        limit = np.full(n, np.inf)
        joint = gravity_joint
        limit[joint] = rng.uniform(0.4, 0.7) * np.abs(probe["tau"][:, joint]).max()
        simulated.limit = limit
        answers, joints = {"clipped"}, {joint}
    elif kind in EFFECTS:
        side, only = (real, "arm") if rng.integers(2) else (simulated, "simulator")
        joints = {joint}
        plant = side.plant
        if kind == "coulomb_friction":
            extra = np.zeros(n)
            extra[joint] = friction[joint] * rng.uniform(0.8, 2.0)
            side.plant = replace(plant, friction=friction + extra)
        elif kind == "viscous_friction":
            extra = np.zeros(n)
            extra[joint] = damping[joint] * rng.uniform(1.5, 3.0)
            side.plant = replace(plant, damping=damping + extra)
        elif kind == "rotor_inertia":
            # Of a wrist that hardly accelerates nothing would be seen.
            joint = int(rng.integers((n + 1) // 2))
            joints, extra = {joint}, np.zeros(n)
            extra[joint] = (own + armature)[joint] * rng.uniform(0.3, 0.8)
            side.plant = replace(plant, armature=armature + extra)
            side.kp, side.kd = kp.copy(), kd.copy()
        elif kind == "joint_spring":
            spring = Spring(
                joint,
                float(0.15 * effort[joint] * rng.uniform(0.7, 1.5)),
                float(rng.uniform(-0.3, 0.3)),
            )
            side.plant = replace(plant, springs=(spring,))
        elif kind == "payload":
            size = 0.1 * sum(x.body.mass for x in plain.links) * rng.uniform(0.5, 1.2)
            at = np.array(arm.tool) + rng.uniform(-0.05, 0.05, 3)
            side.plant = replace(plant, payload=Inertial(size, at, np.eye(3) * 2e-3 * size))
            # A body fixed to the last link is another last link.
            answers, joints = {"payload", "link_inertia"}, set()
        elif kind == "stribeck_friction":
            side.law = stribeck(rng, joint, friction[joint] * rng.uniform(1.0, 2.0))
        else:
            size = effort[joint] * rng.uniform(0.04, 0.08) * rng.choice([-1, 1])
            push = np.zeros(n)
            push[joint] = size
            side.law = lambda q, dq: push
    # Of torques that change between two samples a slower log would hold an arbitrary one.
    simulated.rate = float(rng.choice([1000, 500, 250])) if simulated.hold == 1 else 1000.0
    real.rate, real.filtered = float(rng.choice([500, 250])), True
    made = run(simulated, command, seconds, plain)
    measured = run(real, command, seconds, plain)
    # The file that the simulator was made from.
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(urdf(arm, damping, friction))
        robot = load_robot(path)
        rotors = tuple(
            {"effect": "rotor_inertia", "joint": j + 1, "Ia": float(a)}
            for j, a in enumerate(armature)
        )
        robot = replace(robot, effects=(*robot.effects, *rotors))
        file = Path(folder) / "arm.yaml"
        write_robot(robot, file)
        robot = load_robot(file)
    # The arm's log: noise, another beginning.
    first = int(rng.integers(0, len(measured["t"]) // 12))
    last = len(measured["t"]) - int(rng.integers(0, len(measured["t"]) // 12))
    part = {k: v[first:last] for k, v in measured.items()}
    noise = effort * rng.uniform(0.001, 0.004)
    q = part["q"] + 2e-5 * rng.normal(size=part["q"].shape)
    tau = part["tau"] + noise * rng.normal(size=part["tau"].shape)
    real_log = Log(part["t"] + float(rng.uniform(0, 100)), q, tau=tau, u=part["u"], source="real")
    simulated_log = Log(
        made["t"], (made["q"] * signs)[:, order], tau=(made["tau"] * torque_signs)[:, order], u=made["u"],
        source="simulated",
    )  # fmt: skip
    return Pair(robot, simulated_log, real_log, kind, answers, joints, only, words)


def judged(pair: Pair) -> dict:
    """What is said of a pair, and whether its first name is right."""
    from torchid.pair.pair import compare_pair

    began = time.monotonic()
    diagnosis = compare_pair(pair.simulated, pair.real, pair.robot)
    names = [(x.fault, [j + 1 for j in x.joints]) for x in diagnosis.faults]
    effects = [
        (x.effect, [j + 1 for j in x.joints], x.more, round(x.share, 2), list(x.ambiguous_with))
        for x in diagnosis.which
    ]
    if pair.kind == "equal":
        right = not names and not effects
    elif pair.only is None:
        right = bool(names) and names[0][0] in pair.answers
        right = right and (not pair.joints or {j - 1 for j in names[0][1]} == pair.joints)
    else:
        right = (
            not names
            and bool(effects)
            and effects[0][0] in pair.answers
            and effects[0][2] == pair.only
        )
        right = right and (not pair.joints or {j - 1 for j in effects[0][1]} == pair.joints)
    return {
        "kind": pair.kind, "words": pair.words, "only": pair.only, "joints": sorted(j + 1 for j in pair.joints),
        "arm": pair.robot.n, "right": right, "faults": names, "effects": effects,
        "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip


def one(seed: int, number: int, equal: bool) -> dict:
    """A pair and what is said of it; an error is no right name."""
    try:
        row = judged(drawn(seed, number, equal))
    except Exception as error:  # one pair must not end a night's run
        kind = "equal" if equal else "?"
        row = {"kind": kind, "right": False, "error": f"{type(error).__name__}: {error}"}
    print(number, json.dumps(row), flush=True)
    return {"number": number, **row}


def main(
    *,
    seed: int = 1,
    pairs: int = 40,
    equal: int = 20,
    only: int | None = None,
    jobs: int = 1,
    out: Path | None = None,
) -> None:
    """Pairs with a difference and equal ones; what is said is kept in the folder `out`."""
    numbers = {False: range(pairs), True: range(equal)}
    if only is not None:
        numbers = {equal == 1 and pairs == 0: range(only, only + 1)}
    cases = {
        f"{seed}-{'equal-' * same}{k}": (seed, k, same)
        for same, own in numbers.items()
        for k in own
    }
    right: dict[bool, list[bool]] = {False: [], True: []}
    for _, row in results(one, cases, out, jobs=jobs):
        right[row["kind"] == "equal"].append(row["right"])
    rows = [(name, share(sum(right[k]), len(right[k]))) for k, name in KINDS.items()]
    table(("pairs", "right"), rows)


if __name__ == "__main__":
    command(main)
