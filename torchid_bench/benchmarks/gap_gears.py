"""Backlash and elastic joints of MuJoCo arms: are they named, and how much of the gap closes?

    python -m torchid_bench.benchmarks.gap_gears [--cases 8] [--kinds backlash,elastic] [--robot ur10e]

The arm is built in MuJoCo with one joint of two masses: the rotor, which a controller of 8 Hz
drives, and the link behind it on a hinge of its own, which is limited to the play (backlash) or
sprung (elasticity). Nothing of torchid's own gear is in it: contact, damping and the impact's
reaction on the rotor are MuJoCo's. Sizes are 2 to 8 times the noise. Classes:

    backlash          encoder and torque at the motor
    backlash_sensor   the torque is measured behind the gear
    elastic           encoder and torque at the motor
    elastic_sensor    the torque is measured behind the gear

`closes` is the share of what the oracle closes: the same diagnosis with the true effect as its only
candidate.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import torch

import torchid
from torchid.design.columns import Columns
from torchid.gap.data import prepare
from torchid.gap.wanted import start_of
from torchid.robot.model import Robot
from torchid_bench.benchmarks.gap_hard import RATE, Known, arm, scored
from torchid_bench.benchmarks.runner import command

STEP = 5e-4
"""Of the simulation [s]."""

HERTZ = 8.0
"""Of the controller with the rotor and a rigid link."""

LEAST = {"backlash": 0.015, "elastic": 0.03}
"""Size at least, as a share of the torque of the joint that feels most: a cause is worth a name if
the error falls by 1 % of the torque."""

RIGHT = {
    "backlash": "backlash",
    "backlash_sensor": "backlash",
    "elastic": "joint_elasticity",
    "elastic_sensor": "joint_elasticity",
}


@dataclass
class Gear:
    """One joint's, from 0: play [rad], or compliance [rad/(N m)] and damping ratio of the link."""

    joint: int
    play: float = 0.0
    compliance: float = 0.0
    ratio: float = 0.05


def pose(matrix: torch.Tensor) -> str:
    """A pose as MJCF attributes."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, matrix[:3, :3].numpy().flatten())
    numbers = [" ".join(f"{v:.12g}" for v in x) for x in (matrix[:3, 3].tolist(), quat.tolist())]
    return f'pos="{numbers[0]}" quat="{numbers[1]}"'


def mjcf(robot: Robot, rotors: np.ndarray, inertia: np.ndarray, gear: Gear | None) -> str:
    """The arm with its rotors as armatures, and a second hinge where a joint has a gear."""
    out, closing = [], 0
    pi = robot.require_parameters("a simulation")
    for i in range(robot.n):
        out.append(f'<body {pose(robot.before[i])}><joint name="m{i}" armature="{rotors[i]:.9g}"/>')
        closing += 1
        if gear is not None and gear.joint == i:
            out.append('<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>')
            own = inertia[i]
            if gear.play > 0:
                # A stiff, slightly damped stop at each flank.
                out.append(
                    f'<body><joint name="gear" limited="true" range="{-gear.play / 2:.9g} '
                    f'{gear.play / 2:.9g}" solreflimit="{4 * STEP} 0.6" margin="0" '
                    f'damping="{0.02 * own:.6g}" armature="{1e-3 * own:.6g}"/>'
                )
            else:
                damping = 2 * gear.ratio * np.sqrt(own / gear.compliance)
                out.append(
                    f'<body><joint name="gear" stiffness="{1 / gear.compliance:.9g}" '
                    f'damping="{damping:.9g}"/>'
                )
            closing += 1
        # The link's frame stands behind the joint's own motion.
        after = robot.after[i]
        com = after[:3, :3] @ pi.com[i] + after[:3, 3]
        full = after[:3, :3] @ torchid_inertia(pi.inertia_about_com[i]) @ after[:3, :3].T
        x = [full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]]
        out.append(
            f'<inertial pos="{" ".join(f"{v:.12g}" for v in com.tolist())}" '
            f'mass="{float(pi.mass[i]):.12g}" fullinertia="{" ".join(f"{v:.12g}" for v in x)}"/>'
        )
        # The next body stands in the link's frame.
        out.append(f"<body {pose(after)}>")
        closing += 1
    out.append('<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-12 1e-12 1e-12"/>')
    out.append("</body>" * closing)
    motors = "".join(f'<motor joint="m{i}"/>' for i in range(robot.n))
    gravity = " ".join(f"{v:.9g}" for v in robot.gravity.tolist())
    return (
        f'<mujoco><compiler angle="radian" balanceinertia="false" boundmass="0"/>'
        f'<option timestep="{STEP}" gravity="{gravity}" integrator="implicitfast">'
        f'<flag contact="disable"/></option><worldbody>{"".join(out)}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )


def torchid_inertia(six: torch.Tensor) -> torch.Tensor:
    """(3, 3) of xx xy xz yy yz zz."""
    return six[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)


def driven(
    robot: Robot, rotors: np.ndarray, motion: torchid.Log, gear: Gear | None, sensor: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motor positions, rates and torques (T, n) of the arm that a controller moves."""
    m = torchid.dynamics.forward.mass_matrix(robot, motion.q)
    inertia = m.diagonal(dim1=1, dim2=2).mean(0).numpy()
    model = mujoco.MjModel.from_xml_string(mjcf(robot, rotors, inertia, gear))
    data = mujoco.MjData(model)
    at = np.array([model.joint(f"m{i}").qposadr[0] for i in range(robot.n)])
    hinge = model.joint("gear").dofadr[0] if gear is not None else None
    # The reference and the model's torque on the simulation's instants.
    t = motion.t.numpy()
    times = np.arange(t[0], t[-1], STEP)
    feed = torchid.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq).numpy()
    feed = feed + rotors * motion.ddq.numpy()
    q, dq, ff = (
        np.stack([np.interp(times, t, x[:, j]) for j in range(robot.n)], 1)
        for x in (motion.q.numpy(), motion.dq.numpy(), feed)
    )
    omega = 2 * np.pi * HERTZ
    kp, kd = (inertia + rotors) * omega**2, 2 * 0.7 * (inertia + rotors) * omega
    data.qpos[at], data.qvel[at] = q[0], dq[0]
    if gear is not None:
        # The link begins at rest on its gear.
        load = float(
            torchid.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq)[0, gear.joint]
        )
        where = load * gear.compliance + np.sign(load) * gear.play / 2
        data.qpos[model.joint("gear").qposadr[0]] = -where
    every = round(1 / (RATE * STEP))
    out = []
    for k in range(len(times)):
        own, rate = data.qpos[at], data.qvel[at]
        data.ctrl[:] = ff[k] + kp * (q[k] - own) + kd * (dq[k] - rate)
        mujoco.mj_forward(model, data)
        if k % every == 0:
            torque = data.ctrl.copy()
            if sensor and hinge is not None:
                # What the gear hands on: spring, damper and stops on the hinge.
                passed = data.qfrc_passive[hinge] + data.qfrc_constraint[hinge]
                torque[gear.joint] = passed  # type: ignore[union-attr]
            out.append(np.concatenate([own, rate, torque]))
        mujoco.mj_step(model, data)
    q, dq, tau = np.split(np.array(out), 3, 1)
    return q, dq, tau


def rotors_of(robot: Robot) -> np.ndarray:
    """Of the robot's records (n,) [kg m^2]."""
    out = np.zeros(robot.n)
    for record in robot.effects:
        out[record["joint"] - 1] = record["Ia"]
    return out


def with_rotors(robot: Robot, motion: torchid.Log, but: int | None = None) -> Robot:
    """The robot with rotors of a third of what their joints move on average, which its model knows;
    but for one joint whose torque is measured behind the gear."""
    m = torchid.dynamics.forward.mass_matrix(robot, motion.q).diagonal(dim1=1, dim2=2).mean(0)
    records = [
        {"effect": "rotor_inertia", "joint": j + 1, "Ia": 0.3 * float(m[j])}
        for j in range(robot.n)
        if j != but
    ]
    return replace(robot, effects=tuple(records))


def logged(
    robot: Robot, motions: list[torchid.Log], gear: Gear | None, sensor: bool
) -> torchid.Log:
    """What ideal sensors log of the motions."""
    rotors = rotors_of(robot)
    logs = []
    for motion in motions:
        q, dq, tau = (torch.from_numpy(x) for x in driven(robot, rotors, motion, gear, sensor))
        t = torch.arange(len(q), dtype=torch.float64) / RATE
        logs.append(torchid.Log(t=t, q=q, dq=dq, tau=tau))
    return torchid.Log.concatenate(logs)


def gap_of(robot: Robot, log: torchid.Log) -> torch.Tensor:
    """RMS (n,) of measured minus modelled torque in the fit's band."""
    data = prepare(robot, log, None)
    return Columns(start_of(robot), data.samples).gap.square().mean(1).sqrt()


def case(kind: str, number: int, name: str) -> Known:
    """A log of an arm with one gear, with its size over the noise."""
    rng = np.random.default_rng([7, sorted(RIGHT).index(kind), number])
    robot = arm(name)
    motions = [
        torchid.excite(robot, duration=14.0, seed=100 * number + k, restarts=1, iterations=0).log(
            1000
        )
        for k in (0, 1, 2)
    ]
    motions.append(motions[0])
    robot = with_rotors(robot, motions[0])
    rigid = logged(robot, motions, None, False)

    def noisy(log: torchid.Log) -> torchid.Log:
        noise = torchid.HonestNoise()
        draw = torch.Generator().manual_seed(number)
        step = noise.encoder_step
        q = (log.q / step).round() * step
        scale = noise.torque_relative * log.tau.square().mean(0).sqrt()
        tau = log.tau + scale * torch.randn(log.tau.shape, generator=draw, dtype=torch.float64)
        return log.replace(q=q, dq=None, tau=tau)

    noise = gap_of(robot, noisy(rigid))
    heard = (noise > 0.1 * noise.max()).nonzero().flatten().numpy()
    joint, size = int(rng.choice(heard)), float(rng.uniform(2.0, 8.0))
    sensor = kind.endswith("sensor")
    clean = gap_of(robot, rigid)
    # A torque that is measured behind the gear holds no rotor.
    known = with_rotors(robot, motions[0], but=joint) if sensor else robot
    # The size that makes so large a gap: by the secant, four times.
    gear = Gear(joint, ratio=float(rng.uniform(0.03, 0.1)))
    torque = rigid.tau.square().mean(0).sqrt()
    load = float(torque[joint])
    value = 2e-3 if kind.startswith("backlash") else 1e-3 / load
    field = "play" if kind.startswith("backlash") else "compliance"
    for _ in range(4):
        setattr(gear, field, value)
        log = logged(robot, motions, gear, sensor)
        gap = (gap_of(known, log).square() - clean.square()).clamp(min=0).sqrt()
        now = float((gap / noise).max())
        # No less than is worth a name.
        least = LEAST[kind.split("_")[0]] * now / float((gap / torque).max())
        if abs(now / max(size, least) - 1) < 0.15:
            break
        value *= float(np.clip(max(size, least) / now, 0.2, 5.0))
    size = f"play {1e3 * gear.play:.2g} mrad, compliance {gear.compliance:.2g}, {now:.1f} x noise"
    words = f"joint {joint + 1}, {size}"
    return Known(known, noisy(log), {RIGHT[kind]}, joint, words)


def main(
    *,
    cases: int = 8,
    kinds: tuple[str, ...] = tuple(RIGHT),
    robot: str = "ur10e",
    first: int = 0,
    no_oracle: bool = False,
    out: Path | None = None,
    jobs: int = 1,
) -> None:
    """Cases of every class; answers are kept in the folder `out`."""
    scored(case, kinds, cases, first, robot, not no_oracle, out, jobs)


if __name__ == "__main__":
    command(main)
