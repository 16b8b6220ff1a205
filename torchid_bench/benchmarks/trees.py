"""Robots with branches: what an identification of a humanoid costs, and whether the arm that
carries a wrong load is named.

    python -m torchid_bench.benchmarks.trees identify [--robot g1_29dof_rev_1_0] [--seconds 60] [--rate 500]
    python -m torchid_bench.benchmarks.trees arms [--cases 8]

`identify`: a URDF of the package example-robot-data moves along sums of sines; its torque is
Pinocchio's, with friction, rotors and 1 % noise. Printed are CPU seconds and the largest memory of
the process, and how far base parameters and coefficients are from what was put in.

`arms`: two arms with grippers (`torchid withheld make --robots two_arms`), one forearm, hand or jaw
of which is heavier than the model says, at five times the noise; the simulator is MuJoCo. Counted
is whether a link of that arm is named first, and of the other arm none.
"""

import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import torchid
from torchid.effects.base import Motion
from torchid.effects.registry import effect_torque, nominal_effects
from torchid.identification.base_parameters import nominal_values
from torchid.results.cause import LINK
from torchid.robot.model import Robot
from torchid_bench.benchmarks.runner import command


def sines(robot: Robot, seconds: float, rate: float, seed: int) -> tuple[np.ndarray, ...]:
    """t, q, dq, ddq of sums of sines within the position limits."""
    draw = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    limits = robot.limits.position
    low, high = (np.full(robot.n, x) for x in (-1.0, 1.0))
    if limits is not None:
        bounded = np.clip(limits.numpy(), -2.0, 2.0)
        low, high = bounded[:, 0], bounded[:, 1]
    harmonics = 4
    omega = 2 * np.pi * draw.uniform(0.1, 0.9, (robot.n, harmonics))
    phase = draw.uniform(0, 2 * np.pi, omega.shape)
    size = draw.uniform(0.3, 1.0, omega.shape) * 0.4 * ((high - low) / 2)[:, None] / harmonics**0.5
    angle = omega * t[:, None, None] + phase
    middle = (low + high) / 2
    q = middle + (size * np.sin(angle)).sum(-1)
    dq = (size * omega * np.cos(angle)).sum(-1)
    return t, q, dq, -(size * omega**2 * np.sin(angle)).sum(-1)


def pinocchios(path: Path, robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray):
    """Rigid torque (T, n) by Pinocchio, joints by name; of robots without mimics."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in robot.joint_names]
    out, at, v, a = np.empty_like(q), pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    rates = [joint.idx_v for joint in joints]
    for k in range(len(q)):
        for joint, x in zip(joints, q[k], strict=True):
            where = slice(joint.idx_q, joint.idx_q + joint.nq)
            at[where] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
        v[rates], a[rates] = dq[k], ddq[k]
        out[k] = pin.rnea(model, data, at, v, a)[rates]
    return out


def published(name: str) -> Path:
    """A URDF of the package example-robot-data."""
    import cmeel

    share = Path(cmeel.__path__[0]).parent / "cmeel.prefix" / "share" / "example-robot-data"
    files = sorted((share / "robots").rglob(f"{name}.urdf"))
    if not files:
        sys.exit(f"example-robot-data has no {name}.urdf")
    return files[0]


def identify(
    *, robot: str = "g1_29dof_rev_1_0", seconds: float = 60.0, rate: float = 500.0, seed: int = 0
) -> None:
    """Cost and errors of an identification."""
    path = published(robot)
    arm = torchid.load_robot(path)
    draw = np.random.default_rng(seed)
    records = [
        {"effect": name, "joint": j + 1, key: float(draw.uniform(low, high))}
        for name, key, low, high in (
            ("viscous_friction", "Fv", 0.05, 0.3),
            ("coulomb_friction", "Fc", 0.1, 0.6),
            ("rotor_inertia", "Ia", 0.005, 0.03),
        )
        for j in range(arm.n)
    ]
    arm = replace(arm, effects=tuple(records))
    t, q, dq, ddq = sines(arm, seconds, rate, seed)
    rigid = torch.from_numpy(pinocchios(path, arm, q, dq, ddq))
    motion = Motion(*map(torch.from_numpy, (q, dq, ddq)))
    tau = rigid + effect_torque(arm, nominal_effects(arm), motion, rigid)
    # 0.01: of a joint's torque, as a share of its RMS
    noise = torch.from_numpy(draw.standard_normal(tau.shape)) * 0.01 * tau.square().mean(0).sqrt()
    log = torchid.Log(t, q, tau=tau + noise)
    names = ("viscous_friction", "coulomb_friction", "rotor_inertia")
    before, begun = time.process_time(), time.perf_counter()
    model = torchid.identify(arm, log, settings=torchid.Settings(effects=names))
    cpu, wall = time.process_time() - before, time.perf_counter() - begun
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    off = (model.values - nominal_values(arm, model.base)) / model.covariance.diagonal().sqrt()
    held = model.held_out or model.fit
    print(f"{arm.name}: {arm.n} joints, {len(model.base)} base parameters and coefficients")
    print(f"{seconds:g} s at {rate:g} Hz: {cpu:.1f} CPU s ({wall:.1f} s), {memory:.2f} GB at most")
    print(
        f"held-out error: {float(held.relative_percent.nanmedian()):.2f} % in the median joint, "
        f"{float(held.relative_percent.max()):.2f} % in the worst"
    )
    print(f"errors in standard deviations: {float(off.square().mean().sqrt()):.2f} RMS")


def arms(*, cases: int = 8, seed: int = 0) -> None:
    """Which arm carries the wrong load."""
    from torchid_bench.withheld.case_set import write_case

    right, other, costs = 0, 0, []
    for number in range(cases):
        draw = np.random.default_rng([seed, number])
        side, link = int(draw.integers(2)), int(draw.integers(3, 8))
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / "case"
            # Drawn as any case with one effect, but for the joint.
            key = _heavier(place, seed, number, 8 * side + link, write_case)
            robot = torchid.load_robot(place / "robot.urdf")
            log = torchid.read_log(place / "log.parquet")
            before = time.process_time()
            diagnosis = torchid.diagnose(robot, log)
            costs.append(time.process_time() - before)
        # Links of bodies, and joints of other causes, by the arm that they are of: 8 joints each.
        links = [k for one in diagnosis.which if one.effect == LINK for k in one.at]
        named = [k // 8 for k in links]
        beside = [j // 8 for one in diagnosis.which if one.effect != LINK for j in one.joints]
        right += bool(named) and named[0] == side
        other += any(k != side for k in [*named, *beside])
        print(
            f"{number}: joint {key['effects'][0]['joints']}, said links "
            f"{[k + 1 for k in links]}, {diagnosis.status}",
            flush=True,
        )
    print(
        f"the arm named {right} of {cases}; the other arm {other} times; "
        f"{np.mean(costs):.0f} CPU s a case"
    )


def _heavier(place: Path, seed: int, number: int, joint: int, write_case) -> dict:
    from torchid_bench.withheld.plant import draw as drawing
    from torchid_bench.withheld.plant.plan import EffectSpec

    draws = {f"mass_{joint}": 0.4} | {f"shift_{a}_{joint}": 0.3 for a in "xyz"}
    draws |= {f"stretch_{k}_{joint}": 0.05 for k in range(6)}
    kept = drawing.drawn_effect
    drawing.drawn_effect = lambda *_, **__: EffectSpec("link_inertia", (joint,), draws)
    try:
        return write_case(place, seed, number, effects=["link_inertia"], arm="two_arms", mix="tree")
    finally:
        drawing.drawn_effect = kept


if __name__ == "__main__":
    command(identify, arms)
