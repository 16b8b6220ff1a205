"""A body with two arms that nothing holds, as MuJoCo moves it, and what its sensors log."""

from pathlib import Path

import mujoco
import numpy as np

from torchid.log.base_motion import NAMES

STEP, SECONDS, RATE = 5e-4, 3.0, 500


def _arm(name: str, y: float, heavier: float) -> str:
    mass = 0.8 + heavier
    return (
        f'<body name="{name}_upper" pos="0.05 {y} 0.1">'
        f'<joint name="{name}_shoulder" axis="0 1 0"/>'
        '<inertial pos="0.02 0.01 -0.12" mass="1.4" diaginertia="0.012 0.013 0.004"/>'
        f'<body name="{name}_turn" pos="0 0 -0.15"><joint name="{name}_yaw" axis="0 0 1"/>'
        '<inertial pos="0.01 0.02 -0.05" mass="0.7" diaginertia="0.004 0.005 0.003"/>'
        f'<body name="{name}_fore" pos="0 0 -0.1"><joint name="{name}_elbow" axis="1 0 0"/>'
        f'<inertial pos="0.01 -0.02 -0.1" mass="{mass}" diaginertia="0.006 0.007 0.002"/>'
        "</body></body></body>"
    )


def model(heavier: float = 0.0) -> str:
    """MJCF; the left forearm heavier by so many kilograms."""
    return (
        '<mujoco model="flyer"><compiler angle="radian"/><worldbody>'
        '<body name="hull" pos="0 0 2"><freejoint name="fly"/>'
        '<inertial pos="0.01 -0.02 0.05" mass="4" fullinertia="0.08 0.06 0.05 0.002 -0.003 0.001"/>'
        f"{_arm('left', 0.15, heavier)}{_arm('right', -0.15, 0.0)}</body></worldbody></mujoco>"
    )


def flights(heavier: float, count: int, seed: int, noise: float) -> dict[str, np.ndarray]:
    """Columns of a log: joints that follow sums of sines while the body falls and tumbles freely.

    Args:
        heavier: of the left forearm [kg].
        count: of trajectories, of `SECONDS` each.
        seed: of the motions and the noise.
        noise: of the torques [N m].
    """
    own = mujoco.MjModel.from_xml_string(model(heavier))
    own.opt.timestep = STEP
    every, n = round(1 / RATE / STEP), own.nv - 6
    draw = np.random.default_rng(seed)
    parts = []
    for number in range(count):
        data = mujoco.MjData(own)
        data.qvel[:6] = draw.uniform(-0.3, 0.3, 6)
        omega = 2 * np.pi * draw.uniform(0.4, 1.6, (n, 3))
        phase, size = draw.uniform(0, 6, (n, 3)), draw.uniform(0.1, 0.4, (n, 3))
        data.qpos[7:] = (size * np.sin(phase)).sum(1)
        rows = []
        for k in range(round(SECONDS / STEP)):
            angle = omega * (k * STEP) + phase
            q, dq = (size * np.sin(angle)).sum(1), (size * omega * np.cos(angle)).sum(1)
            tau = 40 * (q - data.qpos[7:]) + 1.5 * (dq - data.qvel[6:])
            data.qfrc_applied[6:] = tau
            before = data.qpos.copy(), data.qvel.copy()
            mujoco.mj_step(own, data)
            if k % every == 0:
                # The velocity between two steps belongs to the position and torque of this one.
                rows.append(np.r_[k * STEP, before[0], (before[1] + data.qvel) / 2, tau])
        parts.append(np.column_stack([np.array(rows), np.full(len(rows), number)]))
    table = np.concatenate(parts)
    pose, twist = table[:, 1:8], table[:, 8 + n : 14 + n]
    base = np.column_stack([pose[:, :3], pose[:, [4, 5, 6, 3]], twist])
    joints = table[:, 8 : 8 + n], table[:, 14 + n : 14 + 2 * n], table[:, 14 + 2 * n : 14 + 3 * n]
    columns = {"t": table[:, 0], "traj": table[:, -1]} | dict(zip(NAMES, base.T, strict=True))
    for prefix, values in zip(("q", "dq", "tau"), joints, strict=True):
        more = noise * draw.standard_normal(values.shape) if prefix == "tau" else 0.0
        columns |= {f"{prefix}{k + 1}": (values + more)[:, k] for k in range(n)}
    return columns


def write(folder: Path, heavier: float = 0.0) -> Path:
    """The model in a folder."""
    path = folder / "flyer.xml"
    path.write_text(model(heavier))
    return path
