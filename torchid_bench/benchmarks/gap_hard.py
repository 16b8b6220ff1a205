"""Causes of other forms than the library's columns: are they named, and how much of the gap closes?

    python -m torchid_bench.benchmarks.gap_hard [--cases 8] [--kinds table,wall] [--robot ur10e]

A motion is drawn, its torque is the robot's with honest sensor noise, and one cause is added to the
torque by formulas of this file: a Hertzian table under a tool tip that the model does not know, a
soft knee of the drive, a friction that rises smoothly with the bearing's load, ... Sizes are 2 to 8
times the noise of the joint that feels it most. `first` is the name that closes most, `set` the
same with what the answer cannot separate from it, `small` those that it lists as small effects
(below 1 % of the joint's torque), `beside` other names a case.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

import torchid
from torchid.design.columns import Columns, Model
from torchid.dynamics.newton_euler import joint_wrenches
from torchid.gap.data import prepare
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import Robot, tool_pose
from torchid_bench.benchmarks.runner import command, digest, results, table

RATE = 250
"""Of the logs [Hz]."""

RIGHT = {
    "table": {"plane_contact"},
    "wall": {"plane_contact"},
    "soft_knee": {"drive_saturation"},
    "moment": {"bearing_moment_friction"},
    "axial": {"axial_load_friction"},
    "asymmetric": {"asymmetric_friction", "coulomb_friction"},  # of which it is a sum
    "stop": {"end_stop"},
    "push": {"contact"},
    "control": set(),
}


LEAST = {"asymmetric": 0.04}
"""Least size as a share of the joint's torque, where it is not 1.5 %: each of two parts counts."""


@dataclass
class Truth:
    """The true motions: q, dq, ddq, tau (T, n), and the rows of each."""

    robot: Robot
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    motions: list[slice]
    rng: np.random.Generator


class Known(NamedTuple):
    """A case.

    Attributes:
        robot, log: what is diagnosed.
        right: names of its cause.
        words: on its size and place.
    """

    robot: Robot
    log: torchid.Log
    right: set[str]
    words: str


def tip(m: Truth, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, 3) and Jacobians (T, 3, n) of a point in front of the tool's origin."""
    q = torch.from_numpy(m.q)
    pose, jacobian = tool_pose(m.robot, q).numpy(), tool_jacobian(m.robot, q).numpy()
    arm = offset * pose[:, :3, 2]
    cross = np.cross(jacobian[:, 3:].transpose(0, 2, 1), arm[:, None])
    return pose[:, :3, 3] + arm, jacobian[:, :3] + cross.transpose(0, 2, 1)


def plane(m: Truth, axis: int) -> np.ndarray:
    """Hertz: force by depth to the power 1.5, damped by Hunt and Crossley."""
    place, jacobian = tip(m, 0.03)
    sign = 1.0 if axis == 2 else m.rng.choice([-1.0, 1.0])
    own = sign * place[:, axis]
    # 0.1: depth to which nothing that an arm meets gives way [m]
    height = min(np.quantile(own, 0.06), own.min() + 0.1)
    depth = np.clip(height - own, 0, None)
    rate = -sign * np.einsum("tj,tj->t", jacobian[:, axis], m.dq)
    force = depth**1.5 * np.clip(1 + 0.3 * rate, 0, None)
    return -sign * jacobian[:, axis] * force[:, None]


def soft_knee(m: Truth, joint: int) -> np.ndarray:
    """Logged torque over a knee that bends softly."""
    tau, out = m.tau[:, joint], np.zeros_like(m.tau)
    knee = 0.6 * np.quantile(np.abs(tau), 0.99)
    width = 0.1 * knee
    excess = width * np.log1p(np.exp((np.abs(tau) - knee) / width))
    out[:, joint] = np.sign(tau) * excess
    return out


def loaded(m: Truth, joint: int, axial: bool) -> np.ndarray:
    """Friction by the bearing's load, smooth through zero speed, a little more at low speed."""
    q, dq, ddq = (torch.from_numpy(x) for x in (m.q, m.dq, m.ddq))
    wrench = joint_wrenches(m.robot, q, dq, ddq)[:, joint].numpy()
    axis = m.robot.after[joint].numpy()[:3, :3].T[:, 2]
    force, moment = wrench[:, :3], wrench[:, 3:]
    load = np.abs(force @ axis) if axial else np.linalg.norm(np.cross(moment, axis), axis=1)
    speed = m.dq[:, joint]
    out = np.zeros_like(m.tau)
    out[:, joint] = load * np.tanh(speed / 0.02) * (1 + 0.15 * np.exp(-np.abs(speed) / 0.1))
    return out


def asymmetric(m: Truth, joint: int) -> np.ndarray:
    """More friction forwards than backwards, resting in between."""
    out = np.zeros_like(m.tau)
    speed = m.dq[:, joint]
    out[:, joint] = (
        np.where(speed > 0, 1.0, 0.3) * np.tanh(speed / 0.01) * (1 + 0.2 * np.abs(speed))
    )
    return out


def stop(m: Truth, joint: int) -> np.ndarray:
    """A stop whose stiffness grows with depth."""
    out, q = np.zeros_like(m.tau), m.q[:, joint]
    limit = np.quantile(q, 0.93)
    depth = np.clip(q - limit, 0, None)
    out[:, joint] = depth + 10 * depth**2
    return out


def push(m: Truth, joint: int) -> np.ndarray:
    """One to three forces at the tip, in windows of 0.1 to 3 s, in any direction."""
    _, jacobian = tip(m, 0.05)
    out = np.zeros_like(m.tau)
    for k in m.rng.choice(len(m.motions), int(m.rng.integers(1, 4)), replace=False):
        rows = m.motions[k]
        count = int(RATE * m.rng.uniform(0.1, 3.0))
        first = rows.start + int(m.rng.integers(3 * RATE, rows.stop - rows.start - 6 * RATE))
        inside = slice(first, first + count)
        shape = np.sin(np.pi * np.arange(count) / count) ** 0.5
        way = m.rng.standard_normal(3)
        force = shape[:, None] * way / np.linalg.norm(way)
        out[inside] += np.einsum("tkj,tk->tj", jacobian[inside], force)
    return out


CAUSES: dict[str, Callable[[Truth, int], np.ndarray]] = {
    "table": lambda m, j: plane(m, 2),
    "wall": lambda m, j: plane(m, int(m.rng.integers(2))),
    "soft_knee": soft_knee,
    "moment": lambda m, j: loaded(m, j, False),
    "axial": lambda m, j: loaded(m, j, True),
    "asymmetric": asymmetric,
    "stop": stop,
    "push": push,
    "control": lambda m, j: np.zeros_like(m.tau),
}


def arm(name: str) -> Robot:
    """A built-in robot; UR10e with the maker's masses and centres of mass, and links as rods."""
    robot = torchid.load_robot(name)
    if name != "ur10e":
        return robot
    mass = torch.tensor([7.369, 13.051, 3.989, 2.1, 1.98, 0.615], dtype=torch.float64)
    com = [[21, 0, 27], [380, 0, 158], [240, 0, 68], [0, 7, 18], [0, 7, 18], [0, 0, -26]]
    centre = 1e-3 * torch.tensor(com, dtype=torch.float64)
    size = mass * (centre.square().sum(1) / 3 + 0.05**2)
    inertia = torch.zeros(6, 6, dtype=torch.float64)
    inertia[:, [0, 3, 5]] = size[:, None] * torch.tensor([0.6, 1.0, 1.0], dtype=torch.float64)
    robot = robot.with_parameters(torchid.InertialParameters.from_com(mass, centre, inertia))
    return robot.with_limits(acceleration=[3.0, 3.0, 5.0, 8.0, 8.0, 8.0])


def case(kind: str, number: int, name: str) -> Known:
    """A log with one cause, with its size over the noise and the joint that feels it most."""
    rng = np.random.default_rng([sorted(RIGHT).index(kind), number])
    robot = arm(name)
    logs = []
    # Three motions, the first of them twice: so the noise is known.
    for k in (0, 1, 2, 0):
        motion = torchid.excite(
            robot, duration=14.0, seed=100 * number + k, restarts=1, iterations=0
        ).log(RATE)
        logs.append(motion)
    clean = torchid.Log.concatenate(logs)
    noisy = torchid.simulate(robot, clean, noise=torchid.HonestNoise(), seed=number)
    exact = torchid.simulate(robot, clean, noise=None)
    # What a right model leaves in the band of the fit: noise of torque and of positions.
    data = prepare(robot, noisy, None)
    noise = Columns(Model.of(robot), data.samples).gap.square().mean(1).sqrt().numpy()
    # The wrist's own torque, of which its noise is a share, is next to nothing.
    heard = noise > 0.1 * noise.max()
    joint = 0 if kind in ("moment", "axial") else int(rng.choice(heard.nonzero()[0]))
    heard[joint] = True
    size = rng.uniform(2.0, 8.0)
    q, dq, ddq, tau = (x.numpy() for x in (clean.q, clean.dq, clean.ddq, exact.tau))
    m = Truth(robot, q, dq, ddq, tau, clean.slices(), rng)
    torque = CAUSES[kind](m, joint)
    # While it acts: a push is short.
    acts = np.abs(torque) > 1e-12 * np.abs(torque).max()
    mean = (torque**2).sum(0) / np.maximum(acts.sum(0), 1)
    rms = np.where(heard, np.sqrt(mean) / np.maximum(noise, 1e-12), 0.0)
    worst = int(rms.argmax())
    scale = size / rms[worst] if rms[worst] > 0 else 0.0
    # No less than is worth a name, over all of the log.
    over_all = scale * np.sqrt((torque[:, worst] ** 2).mean())
    least = LEAST.get(kind, 0.015) * np.sqrt((exact.tau.numpy()[:, worst] ** 2).mean())
    if 0 < over_all < least:
        scale, size = scale * least / over_all, size * least / over_all
    log = noisy.replace(tau=noisy.tau + torch.from_numpy(scale * torque))
    return Known(robot, log, RIGHT[kind], f"{size:.1f} x noise on joint {worst + 1}")


def asked(kind: str, number: int, name: str) -> dict[str, Any]:
    """What is named in a case, and the share that is closed."""
    known = case(kind, number, name)
    begun = time.process_time()
    answer = torchid.diagnose(known.robot, known.log)
    seconds = time.process_time() - begun
    causes, closed = answer.answer.causes, answer.how_far.closed or 0.0
    right = [c.effect in known.right for c in causes]
    covered = bool(causes) and bool(known.right & {causes[0].effect, *causes[0].ambiguous_with})
    listed = [c.effect for c in answer.answer.small]
    said = ", ".join(f"{c.effect}{[j + 1 for j in c.at]}" for c in causes)
    small = f"small: {', '.join(listed)}"
    print(f"  {kind} {number}: {known.words}: {answer.status}; {said}; {small}; {closed:.2f}")
    return {
        "first": right[:1] == [True], "set": covered,
        "small": not covered and bool(known.right & set(listed)), "beside": right.count(False),
        "closed": closed, "seconds": seconds,
    }  # fmt: skip


def main(
    *,
    cases: int = 8,
    kinds: tuple[str, ...] = tuple(RIGHT),
    robot: str = "ur10e",
    first: int = 0,
    out: Path | None = None,
    jobs: int = 1,
) -> None:
    """Ask about so many cases of each class, and print a line a class; answers are kept in the
    folder `out`."""
    rows = []
    for kind in kinds:
        numbers = range(first, first + cases)
        todo = {f"{kind}-{k}-{digest(robot)}": (kind, k, robot) for k in numbers}
        answers = [one for _, one in results(asked, todo, out, jobs=jobs)]
        hits = (
            f"{sum(one[key] for one in answers)} of {cases}" for key in ("first", "set", "small")
        )
        beside, seconds = (sum(x[key] for x in answers) / cases for key in ("beside", "seconds"))
        closed = float(np.median([one["closed"] for one in answers]))
        rows.append((kind, *hits, f"{beside:.1f}", f"{seconds:.1f}", f"{closed:.2f}"))
    heads = "class", "first", "in the set", "listed as small", "other names a case", "CPU s a case"
    table((*heads, "closed"), rows)


if __name__ == "__main__":
    command(main)
