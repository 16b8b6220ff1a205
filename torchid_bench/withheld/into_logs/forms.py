"""Effects of forms that no effect of the library has: a Hertzian table under a tool tip that the
model does not know, a soft knee of the drive, a friction that rises smoothly with the bearing's
load, a stop that stiffens. Each is named right by some effects of the library."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from torchid.design.columns import together
from torchid.dynamics.newton_euler import joint_wrenches
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import Robot, tool_pose
from torchid_bench.withheld.into_logs.drawing import Key, Scene


@dataclass
class Along:
    """Measured motions and the model's torque along them.

    Attributes:
        robot: the arm.
        q, dq, ddq, tau: (T, n).
        motions: rows of each motion.
        rate: [Hz].
        rng: random numbers.
    """

    robot: Robot
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    motions: list[slice]
    rate: float
    rng: np.random.Generator

    def on(self, joint: int, torque: np.ndarray) -> np.ndarray:
        """A torque (T,) of a joint as that of all (T, n)."""
        out = np.zeros_like(self.tau)
        out[:, joint] = torque
        return out


def tip(m: Along, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, 3) and Jacobians (T, 3, n) of a point in front of the tool's origin."""
    q = torch.from_numpy(m.q)
    pose, jacobian = tool_pose(m.robot, q).numpy(), tool_jacobian(m.robot, q).numpy()
    arm = offset * pose[:, :3, 2]
    cross = np.cross(jacobian[:, 3:].transpose(0, 2, 1), arm[:, None])
    return pose[:, :3, 3] + arm, jacobian[:, :3] + cross.transpose(0, 2, 1)


def plane(m: Along, axis: int) -> np.ndarray:
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


def soft_knee(m: Along, joint: int) -> np.ndarray:
    """Logged torque over a knee that bends softly."""
    tau = m.tau[:, joint]
    knee = 0.6 * np.quantile(np.abs(tau), 0.99)
    width = 0.1 * knee
    return m.on(joint, np.sign(tau) * width * np.log1p(np.exp((np.abs(tau) - knee) / width)))


def loaded(m: Along, joint: int, axial: bool) -> np.ndarray:
    """Friction by the bearing's load, smooth through zero speed, a little more at low speed."""
    q, dq, ddq = (torch.from_numpy(x) for x in (m.q, m.dq, m.ddq))
    wrench = joint_wrenches(m.robot, q, dq, ddq)[:, joint].numpy()
    axis = m.robot.after[joint].numpy()[:3, :3].T[:, 2]
    force, moment = wrench[:, :3], wrench[:, 3:]
    load = np.abs(force @ axis) if axial else np.linalg.norm(np.cross(moment, axis), axis=1)
    speed = m.dq[:, joint]
    return m.on(joint, load * np.tanh(speed / 0.02) * (1 + 0.15 * np.exp(-np.abs(speed) / 0.1)))


def asymmetric(m: Along, joint: int) -> np.ndarray:
    """More friction forwards than backwards, resting in between."""
    speed = m.dq[:, joint]
    size = np.where(speed > 0, 1.0, 0.3) * (1 + 0.2 * np.abs(speed))
    return m.on(joint, size * np.tanh(speed / 0.01))


def stop(m: Along, joint: int) -> np.ndarray:
    """A stop whose stiffness grows with depth."""
    q = m.q[:, joint]
    depth = np.clip(q - np.quantile(q, 0.93), 0, None)
    return m.on(joint, depth + 10 * depth**2)


def push(m: Along) -> np.ndarray:
    """A force at the tip in one or two motions, for 0.1 to 3 s, in any direction."""
    _, jacobian = tip(m, 0.05)
    out = np.zeros_like(m.tau)
    some = min(len(m.motions), int(m.rng.integers(1, 3)))
    for k in m.rng.choice(len(m.motions), some, replace=False):
        rows = m.motions[k]
        length = rows.stop - rows.start
        count = min(int(m.rate * m.rng.uniform(0.1, 3.0)), length // 2)
        first = rows.start + int(m.rng.integers(length - count))
        inside = slice(first, first + count)
        shape = np.sin(np.pi * np.arange(count) / count) ** 0.5
        way = m.rng.standard_normal(3)
        force = shape[:, None] * way / np.linalg.norm(way)
        out[inside] += np.einsum("tkj,tk->tj", jacobian[inside], force)
    return out


@dataclass(frozen=True)
class Form:
    """A law of no library.

    Attributes:
        torque: (T, n), of any size, along motions and on a joint.
        right: names that are right for it.
        of_arm: whether it is at no joint.
    """

    torque: Callable[[Along, int], np.ndarray]
    right: tuple[str, ...]
    of_arm: bool = False


FORMS: Mapping[str, Form] = {
    "table": Form(lambda m, j: plane(m, 2), ("plane_contact",), True),
    "wall": Form(lambda m, j: plane(m, int(m.rng.integers(2))), ("plane_contact",), True),
    "push": Form(lambda m, j: push(m), ("contact",), True),
    "soft_knee": Form(soft_knee, ("drive_saturation",)),
    "moment": Form(lambda m, j: loaded(m, j, False), ("bearing_moment_friction",)),
    "axial": Form(lambda m, j: loaded(m, j, True), ("axial_load_friction",)),
    # A sum of both.
    "asymmetric": Form(asymmetric, ("asymmetric_friction", "coulomb_friction")),
    "stop": Form(stop, ("end_stop",)),
}


def formed(scene: Scene, name: str, size: float, joint: int) -> tuple[list[torch.Tensor], Key]:
    """Torques of a form on the scene's grid, and its key; its size is over what the joint that
    feels it most leaves, while it acts."""
    form, every = FORMS[name], together(scene.motions)
    ends = np.cumsum([0, *(len(m.q) for m in scene.motions)]).tolist()
    motions = [slice(a, b) for a, b in itertools.pairwise(ends)]
    signals = (*every.state, every.require("torque", "a form"))
    q, dq, ddq, tau = (x.numpy() for x in signals)
    rng = np.random.default_rng([sorted(FORMS).index(name), joint])
    along = Along(scene.robot, q, dq, ddq, tau, motions, scene.rate, rng)
    torque = form.torque(along, joint)
    acts = np.abs(torque) > 1e-12 * np.abs(torque).max()
    mean = (torque**2).sum(0) / np.maximum(acts.sum(0), 1)
    felt = np.sqrt(mean) / scene.noise.numpy()
    scaled = torch.from_numpy(torque * size / max(felt.max(), 1e-300))
    own = [] if form.of_arm else [joint]
    feels = (felt > felt.max() / size).nonzero()[0].tolist()
    key: Key = {
        "name": name, "acceptable": list(form.right), "joints": [j + 1 for j in own],
        "felt_by": [j + 1 for j in sorted({*own, *feels})], "size": size,
    }  # fmt: skip
    return [scaled[rows] for rows in motions], key
