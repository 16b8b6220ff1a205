"""Torque along a motion that is given, by MuJoCo's inverse dynamics: what the motors of an arm with
effects must have exerted. Beside the forward simulation of `simulate` it costs a tenth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.model import Plant, compiled, mujoco
from torchid_bench.withheld.plant.plan import Live, Plan, Scene
from torchid_bench.withheld.plant.scene import low_passed

STEP = 2e-3
"""Of the instants at which torques are computed [s]."""

_SLIDES = 5e-3  # rad/s over which friction of a motor that turns with two joints comes in


@dataclass(frozen=True)
class Path:
    """A motion of the motors, where encoders take them to be.

    Attributes:
        number: of the trajectory.
        start: its beginning on the log's clock [s].
        t: (T,) since its beginning [s].
        q, dq, ddq: (T, n).
        bent: (T, n) of the presliding of their dry friction, -1 to 1.
    """

    number: int
    start: float
    t: Array
    q: Array
    dq: Array
    ddq: Array
    bent: Array

    def every(self, k: int) -> "Path":
        """Each k-th instant."""
        rows = (self.t, self.q, self.dq, self.ddq, self.bent)
        return Path(self.number, self.start, *(x[::k] for x in rows))

    @property
    def step(self) -> float:
        """Between two instants [s]."""
        return float(self.t[1] - self.t[0])


def paths_of(scene: Scene, lengths: Array) -> list[Path]:
    """The motions of a scene, at rest before each.

    Args:
        scene: of whole motions.
        lengths: (n, m) displacements at which elements of each joint's friction slide [rad].
    """
    out = []
    for number, (shape, start) in enumerate(zip(scene.order, scene.starts, strict=True)):
        t = np.arange(0, scene.shapes[shape].seconds, STEP)
        q, dq, ddq = scene.shapes[shape].state(t)
        out.append(Path(number, start, t, q, dq, ddq, slipping(q, lengths).mean(2)))
    return out


def slipping(q: Array, lengths: Array) -> Array:
    """How far (T, n, m) Maxwell-slip elements are bent along positions (T, n), -1 to 1 where they
    slide: springs in parallel, each with a slider (Al-Bender et al. 2005), unbent at first.

    Args:
        q: positions [rad].
        lengths: (n, m) displacement at which each of m elements begins to slide [rad].
    """
    out = np.diff(q, axis=0, prepend=q[:1])[:, :, None] / lengths
    z = np.zeros_like(lengths)
    for row in out:
        np.add(z, row, out=row)
        np.minimum(row, 1.0, out=row)
        z = np.maximum(row, -1.0, out=row)
    return out


def torque_along(plan: Plan, path: Path, like: tuple[Plan, Array] | None = None) -> Array:
    """Torque (T, n) of the motors [N m].

    Args:
        plan: the arm with its effects, their sensors left out; nothing in it gives way.
        path: of the motors.
        like: another plan, with its torque without laws, which is this one's where only laws and
            sensors differ.
    """
    same = like is not None and plan.plant is like[0].plant
    same &= plan.offset is None and plan.push is None
    tau = like[1] if like is not None and same else rigid_along(plan, path)
    q = path.q + (0.0 if plan.offset is None else plan.offset)
    return tau + _resisting(plan, path, q, tau) if plan.laws else tau


def rigid_along(plan: Plan, path: Path) -> Array:
    """Torque (T, n) without the laws that effects add."""
    plant = plan.plant
    q = path.q + (0.0 if plan.offset is None else plan.offset)
    zero = np.zeros(plant.n)
    # Dry friction that stays where nothing moves is no function of the motion: it is added here.
    smooth = replace(
        plant, friction=zero, couplings=tuple(replace(c, friction=0.0) for c in plant.couplings)
    )
    tau = _inverse(smooth, path, q) + plant.friction * path.bent
    for c in plant.couplings:
        turns = np.tanh((path.dq[:, c.joint] + c.ratio * path.dq[:, c.source]) / _SLIDES)
        tau[:, c.joint] += c.friction * turns
        tau[:, c.source] += c.ratio * c.friction * turns
    if plan.push is not None:
        tau -= _pushed(smooth, q, plan.push(path.t, path.number))
    return tau


def _inverse(plant: Plant, path: Path, q: Array) -> Array:
    """MuJoCo's inverse dynamics (T, n) of what is smooth."""
    zero = np.zeros(plant.n)
    model, _ = compiled(plant, zero, zero, 1e-3)
    data, inverse = mujoco().MjData(model), mujoco().mj_inverse
    out = np.empty_like(q)
    for k, (position, velocity, acceleration) in enumerate(zip(q, path.dq, path.ddq, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = position, velocity, acceleration
        inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def _pushed(plant: Plant, q: Array, force: Array) -> Array:
    """Torque (T, n) of forces (T, 3) at the tool [N]."""
    zero = np.zeros(plant.n)
    model, _ = compiled(plant, zero, zero, 1e-3)
    module, data = mujoco(), mujoco().MjData(model)
    tool, jacobian = model.body("tool").id, np.zeros((3, model.nv))
    out = np.zeros_like(q)
    for k in np.flatnonzero(force.any(1)):
        data.qpos[:] = q[k]
        module.mj_kinematics(model, data)
        module.mj_comPos(model, data)
        module.mj_jacBody(model, data, jacobian, None, tool)
        out[k] = jacobian.T @ force[k]
    return out


def _resisting(plan: Plan, path: Path, q: Array, tau: Array) -> Array:
    """Torque (T, n) of the motors against the laws that effects add; `tau` (T, n) is what they
    exert otherwise."""
    n, zero = plan.plant.n, np.zeros(plan.plant.n)
    # Laws that ask for a motor's torque see what they made it in the step before, in columns that
    # are theirs to read.
    motor = np.asfortranarray(tau.copy())
    live = Live(
        q[0].copy(), path.dq[0].copy(), np.zeros(n), plan.plant.friction.copy(),
        plan.plant.damping.copy(), np.arange(n), motor, zero, zero, path.t + path.start, path.step,
    )  # fmt: skip
    acts = [law(live) for law in plan.laws]
    out = np.empty_like(q)
    for k in range(len(q)):
        live.q[:], live.dq[:], live.applied[:] = q[k], path.dq[k], 0.0
        if k:
            motor[k] += out[k - 1]
        for act in acts:
            act(k)
        dry, wet = live.friction - plan.plant.friction, live.damping - plan.plant.damping
        out[k] = dry * path.bent[k] + wet * path.dq[k] - live.applied
    return out


def together(parts: Sequence[Array], step: float, every: int = 1) -> Array:
    """Signals of all paths below the band, one after another, each k-th instant (T, n)."""
    smooth = (low_passed(uniform_filter1d(x, every, axis=0), step)[::every] for x in parts)
    return np.concatenate(list(smooth))
