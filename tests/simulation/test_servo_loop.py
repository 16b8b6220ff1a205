"""Servo arms in a batch: MuJoCo's closed loop, closed forms, stiction that holds."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numba
import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.documents import ROOT
from tests.marks import some
from tests.oracles import MujocoOracle
from tests.simulation.bodies import INERTIA, flywheel
from tests.trees import two_arms
from torchid.dynamics.forward import bias_torque, gravity_torque, mass_matrix
from torchid.effects.registry import nominal_effects
from torchid.effects.servo import INDEX, NAMES, PARAMETERS
from torchid.effects.spring import JointSpring, stumpff
from torchid.robot.library import load_robot
from torchid.robot.model import link_poses
from torchid.simulation import servo_kernel
from torchid.simulation.replay import replayed
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import (
    Tracks,
    Windows,
    body_near,
    compensation,
    profile_step,
    rollout,
    set_points,
    upwards,
    windows_of,
)
from torchid_bench.withheld.plant.servo_friction import LAWS, GearFriction, gears, published

DT = 0.02


def sines(n: int, samples: int, motions: int, seed: int) -> Tracks:
    """Commands of sums of sines up to 1.5 Hz about random postures, that start at rest."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=g, dtype=torch.float64)

    t = DT * torch.arange(samples, dtype=torch.float64)[:, None]
    parts = []
    for _ in range(motions):
        u = (2 * uniform(n) - 1).expand(samples, n)
        for _ in range(3):
            w = 2 * math.pi * (0.1 + 1.4 * uniform(n))
            u = u + (0.05 + 0.25 * uniform(n)) * (1 - (w * t).cos())
        parts.append(u)
    first = samples * torch.arange(motions)
    return Tracks(torch.cat(parts), first, first + samples - 1, DT)


def drawn(n: int, seed: int) -> Servos:
    """Servos of small and large gains; half of them with dry friction, half with a clip, those that
    have neither with integral action."""
    rng = np.random.default_rng(seed)
    servos = Servos.neutral(n)
    for j in range(n):
        kp = 60 * 10 ** rng.uniform(0, 1)
        armature = rng.uniform(0.1, 0.4)
        values = {
            "kp": kp,
            "armature": armature,
            "damping": rng.uniform(0.3, 1.0) * math.sqrt(kp * armature),
            "kd": rng.uniform(0, 0.5) * math.sqrt(kp * armature),
            "delay": DT * int(rng.integers(0, 3)),
            "offset": rng.normal(),
        }
        if seed % 2:
            values["coulomb"] = rng.uniform(0.2, 2.0)
        if seed % 4 > 1:
            values["clip"] = rng.uniform(60, 90)
        if seed % 4 == 0:
            values["integral"] = kp * rng.uniform(0.3, 3.0)
        for name, value in values.items():
            servos.joint[j, INDEX[name]] = value
    return servos


def by_mujoco(
    robot, servos: Servos, u: np.ndarray, step: float, gears: GearFriction | None = None
) -> np.ndarray:
    """(T, n) positions of MuJoCo's model with the same servos, from rest at the first command;
    their dry friction is the gears' if these are given."""
    import mujoco

    model = MujocoOracle(robot).model
    p = {name: servos.joint[:, k].numpy() for name, k in INDEX.items()}
    model.opt.timestep = step
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_armature[:], model.dof_damping[:] = p["armature"], p["damping"]
    model.dof_frictionloss[:] = p["coulomb"]
    model.dof_solimp[:, :2], model.dof_solref[:] = 0.9999, [2.1 * step, 1.0]
    data = mujoco.MjData(model)
    data.qpos[:] = u[0]
    steps = round(DT / step)
    # Delays are whole samples: the command is the line between two of them.
    now = (np.arange((len(u) - 1) * steps) / steps)[:, None] - p["delay"] / DT
    low = np.floor(now + 1e-9).astype(int)
    a, b = (u[np.clip(low + i, 0, None), range(robot.n)] for i in (0, 1))
    x, dx = a + (b - a) * (now - low), (b - a) / DT * (now > -1e-9)
    kp, kd, ki, clip, offset = (p[name] for name in ("kp", "kd", "integral", "clip", "offset"))
    out = [u[0]]
    left = np.ones(robot.n)
    # An integrating servo bears the load before the motion begins.
    mujoco.mj_forward(model, data)
    summed = np.where(ki > 0, data.qfrc_bias - offset, 0.0)
    for k in range(len(x)):
        summed = summed + ki * step * (x[k] - data.qpos)
        torque = kp * (x[k] - data.qpos) + kd * (dx[k] - data.qvel) + summed
        motor = left * torque.clip(-clip, clip)
        left = 1 - np.abs(motor).sum() / p["supply"]  # of the step after
        if gears is not None:
            model.dof_frictionloss[:] = gears.bound(data.qvel, motor, -data.qfrc_bias)
        data.qfrc_applied[:] = motor + offset
        mujoco.mj_step(model, data)
        if (k + 1) % steps == 0:
            out.append(data.qpos.copy())
    return np.array(out)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "cases", "samples", "bound"),
    [
        ("3r", range(4), 101, 1e-3),
        pytest.param("3r", range(10), 501, 1e-3, marks=pytest.mark.nightly),
        # Motions of 2 rad/s and more: each of the two integrations is right to 1 mrad.
        pytest.param("kuka_lwr4", range(0, 16, 4), 501, 4e-3, marks=pytest.mark.nightly),
    ],
)
def test_the_closed_loop_is_mujocos(name, cases, samples, bound):
    """Drawn servo arms, up to 10 s each; the large arm without dry friction, which creeps in MuJoCo
    while it holds, without a clip, which is less than its weight, and without integral action,
    which drives it to the brink, where errors of a step grow."""
    robot = arm(name)
    tracks = sines(robot.n, samples, len(cases), seed=robot.n)
    each = [drawn(robot.n, seed) for seed in cases]
    for servos in each if name == "kuka_lwr4" else ():
        servos.joint[:, INDEX["integral"]] = 0.0
    batch = Servos(
        torch.stack([s.joint for s in each])[:, None], torch.zeros(len(cases), 1, 5).double()
    )
    whole = windows_of(tracks, None)
    q = tracks.u[tracks.first]
    ours = replayed(robot, batch, tracks, whole, q, torch.zeros_like(q), longest_step=5e-4)
    for k, servos in enumerate(each):
        rows = slice(k * samples, (k + 1) * samples)
        theirs = by_mujoco(robot, servos, tracks.u[rows].numpy(), 2e-4)
        assert np.abs(ours[rows].numpy() - theirs).max() < bound, k


# Of a published gear by a servo's numbers: names of the paper, those of laws of the whole load too.
PAPER = {
    "base": "coulomb", "stribeck": "stiction", "speed": "stribeck_speed",
    "alpha": "stribeck_exponent", "motor": "motor_share", "external": "load_share",
    "motor_stribeck": "stiction_share",
}  # fmt: skip
M2_TO_M4 = [(servo, law) for law in LAWS[3:0:-1] for servo, of in published().items() if law in of]


@pytest.mark.parametrize("first", some(range(0, len(M2_TO_M4), 3), quick=1, slow=5))
def test_friction_of_published_gears_is_the_papers(first: int) -> None:
    """Three gears of models M2 to M4 at a time, as large as the arm: the paper's bound, written
    anew, as MuJoCo's dry friction."""
    robot, tracks = arm("3r"), sines(3, 76, 1, seed=first)
    laws = M2_TO_M4[first : first + 3]
    gear = gears(laws, np.full(3, 60.0))
    servos = Servos.neutral(3, kp=500.0, damping=20.0, armature=0.4)
    for name, own in PAPER.items():
        servos.joint[:, INDEX[own]] = torch.from_numpy(gear.numbers[name])
    q = tracks.u[tracks.first]
    whole, still = windows_of(tracks, None), torch.zeros_like(q)
    ours = replayed(robot, servos, tracks, whole, q, still, longest_step=5e-4).numpy()
    theirs = by_mujoco(robot, servos, tracks.u.numpy(), 2e-4, gear)
    assert np.abs(ours - theirs).max() < 4e-4
    plain = servos.keeping(("kp", "damping", "armature", "coulomb"))
    assert np.abs(replayed(robot, plain, tracks, whole, q, still).numpy() - theirs).max() > 3e-3


@pytest.mark.parametrize("numbers", [
    {"coulomb": 0.2}, {"stiction_share": 0.4}, {"stiction_share": 0.3, "stiction": 0.1},
    {"load_share": 0.1, "motor_share": 0.3}, {"motor_share": 0.3, "stiction_share": 0.2},
])  # fmt: skip
@pytest.mark.parametrize("load", [1.0, -1.0])
def test_a_joint_breaks_away_where_its_law_says(numbers: dict[str, float], load: float) -> None:
    """A motor's torque m beside one of 1 N m from outside: held where |l + m| <= F(l, m)."""
    m, kp = torch.linspace(-3, 3, 241, dtype=torch.float64), 10.0
    servos = Servos.neutral(1, kp=kp, damping=1.0, armature=0.05, **numbers)
    p = {name: float(servos.of(name)) for name in PAPER.values()}
    dry = p["coulomb"] + (p["load_share"] * load - p["motor_share"] * m).abs()
    dry = dry + p["stiction"] + p["stiction_share"] * (load - m).abs()
    # One motion of some samples for each torque, from rest at 0; the load is a spring's.
    first = 4 * torch.arange(len(m))
    tracks = Tracks((m / kp).repeat_interleave(4)[:, None], first, first + 3, DT)
    spring = {"effect": "joint_spring", "joint": 1, "k": 0.0, "c0": -load}
    robot = replace(flywheel(), effects=(spring,))
    still = torch.zeros(len(m), 1, dtype=torch.float64)
    q = replayed(robot, servos, tracks, windows_of(tracks, None), still, still)
    certain = ((load + m).abs() - dry).abs() > 1e-6
    moves = q[tracks.last, 0] != 0
    assert torch.equal(moves[certain], ((load + m).abs() > dry)[certain])
    assert 0 < int(moves.sum()) < len(m)


@pytest.mark.parametrize("clip", [math.inf, 20.0])
def test_a_supply_sags_with_the_sum_of_torques(clip: float) -> None:
    """As of a voltage that each step of MuJoCo lowers by the torques of the step before."""
    robot, tracks = arm("3r"), sines(3, 76, 1, seed=2)
    servos = Servos.neutral(3, kp=300.0, kd=2.0, damping=20.0, armature=0.4, clip=clip)
    servos.joint[:, INDEX["supply"]] = 300.0
    q = tracks.u[tracks.first]
    whole, still = windows_of(tracks, None), torch.zeros_like(q)
    ours = replayed(robot, servos, tracks, whole, q, still, longest_step=5e-4)
    theirs = torch.from_numpy(by_mujoco(robot, servos, tracks.u.numpy(), 2e-4))
    assert float((ours - theirs).abs().max()) < 1e-3
    stiff = replace(servos, joint=servos.joint.clone())
    stiff.joint[:, INDEX["supply"]] = math.inf
    assert float((replayed(robot, stiff, tracks, whole, q, still) - theirs).abs().max()) > 0.02


@pytest.mark.parametrize("share", [0.0, 1.0, -0.5])
def test_a_limit_of_torque_falls_with_speed_by_what_is_beyond_it(share: float) -> None:
    """A motor at full voltage: J dv = clip - (1 - share) b v, towards its speed without load."""
    damping, limit, inertia = 2.0, 3.0, INERTIA + 0.1
    servos = Servos.neutral(
        1, kp=50.0, damping=damping, armature=0.1, clip=limit, damping_share=share
    )
    tracks = steady(20.0, 1.0)
    zero = torch.zeros(2, 1, 1).double()
    q = replayed(flywheel(), servos, tracks, windows_of(tracks, None), *zero, longest_step=1e-3)[
        :, 0
    ]
    t, rate = DT * torch.arange(len(q), dtype=torch.float64), (1 - share) * damping / inertia
    way = t**2 / 2 if rate == 0 else (t - (1 - (-rate * t).exp()) / rate) / rate
    assert torch.allclose(q, limit / inertia * way, atol=1e-3)


def steady(level: float, seconds: float) -> Tracks:
    samples = round(seconds / DT)
    u = torch.full((samples, 1), level, dtype=torch.float64)
    return Tracks(u, torch.tensor([0]), torch.tensor([samples - 1]), DT)


@pytest.mark.nightly
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_stuck_joint_stays_for_minutes(share):
    """Below the dry friction a joint does not move at all; above it goes to where it holds."""
    kp, dry = 20.0, 0.4
    servos = Servos.neutral(
        1, kp=kp, damping=1.0, armature=0.02, coulomb=0.3, stiction=0.1, stribeck_speed=1e-3
    )
    tracks = steady(share * dry / kp, 180.0)
    q = replayed(
        flywheel(), servos, tracks, windows_of(tracks, None), *torch.zeros(2, 1, 1).double()
    )
    if share < 1:
        assert bool((q == 0).all())
    else:
        assert float(q[-1]) > 0.2 * share * dry / kp
        assert bool((q[-500:] == q[-1]).all())
        # It came to rest within the friction band of the command.
        assert abs(float(tracks.u[-1] - q[-1])) < dry / kp


def test_a_profile_accelerates_and_brakes_at_its_limit():
    """A step of 0.4 rad at 10 rad/s^2 takes 0.4 s, with a top speed of 1 rad/s half a second."""
    u = torch.zeros(60, 1, dtype=torch.float64)
    u[5:] = 0.4
    tracks = Tracks(u, torch.tensor([0]), torch.tensor([59]), DT)
    limits = torch.tensor(
        [[[1.0, 10.0, math.inf, 0.0]], [[1.0, 10.0, 1.0, 0.0]]], dtype=torch.float64
    )
    x = set_points(limits, tracks, repeated=False)[0]
    t = DT * (torch.arange(60, dtype=torch.float64) - 5)
    free = torch.where(t < 0.2, 5 * t.clamp(min=0) ** 2, 0.4 - 5 * (0.4 - t).clamp(min=0) ** 2)
    slow = torch.where(t < 0.4, 0.05 + (t - 0.1), 0.4 - 5 * (0.5 - t).clamp(min=0) ** 2)
    slow = torch.where(t < 0.1, 5 * t.clamp(min=0) ** 2, slow)
    assert torch.allclose(x[0], free, atol=1e-12)
    assert torch.allclose(x[1], slow, atol=1e-12)
    # A repeated command ends the profile: one sample later the set-point is the command.
    ended = set_points(limits[:1], tracks, repeated=True)[0, 0]
    assert float(ended[6]) == pytest.approx(5 * DT**2)
    assert bool((ended[7:] == 0.4).all())


def test_a_goal_that_is_faster_than_the_limit_is_chased_for_as_long_as_it_takes() -> None:
    """Ten seconds at twice the speed: the set-point is left behind by half of the way."""
    t = DT * torch.arange(501, dtype=torch.float64)
    tracks = Tracks(2 * t[:, None], torch.tensor([0]), torch.tensor([500]), DT)
    limits = torch.tensor([[[1.0, 50.0, 1.0, 0.0]]], dtype=torch.float64)
    x = set_points(limits, tracks, repeated=False)[0, 0]
    # A sample late, and 1 / 50 s to the speed, half of which is lost.
    assert float((x[5:] - (t[5:] - DT - 0.01)).abs().max()) < 1e-9


def test_a_step_of_a_set_point_is_that_of_simulators() -> None:
    """Of numbers, in compiled code, as of tensors."""
    g = torch.Generator().manual_seed(1)
    e, v, a, top = (2 * torch.rand(4, 300, generator=g, dtype=torch.float64) - 1).unbind()
    limits = 5 * a.abs() + 0.01, top.abs() + 0.01
    expected = profile_step(e, v, *limits, DT)
    given = (x.tolist() for x in (e, v, *limits))
    one = [servo_kernel.profile_step(*numbers, DT) for numbers in zip(*given, strict=True)]
    assert torch.allclose(torch.tensor(one).double(), torch.stack(expected, -1), atol=1e-12)


def test_a_filter_is_late_by_its_time_constant():
    """A ramp is followed tau late, once exp(-t / tau) has faded."""
    tracks, tau, speed = steady(0.0, 2.0), 0.07, 0.5
    ramp = replace(tracks, u=speed * DT * torch.arange(len(tracks.u), dtype=torch.float64)[:, None])
    profile = torch.tensor([[[1.0, math.inf, math.inf, tau]]], dtype=torch.float64)
    x = set_points(profile, ramp, repeated=False)[0, 0]
    t = DT * torch.arange(len(x), dtype=torch.float64)
    assert (x - speed * (t - tau * (1 - (-t / tau).exp()))).abs().max() < 1e-12


@pytest.mark.nightly
def test_an_integrating_servo_leaves_no_error_and_remembers_its_sum():
    """A load of 2 N m: a servo without integral action errs by 2 / kp for ever. Windows that begin
    later know the sum from the errors until then."""
    servos = Servos.neutral(1, kp=20.0, damping=4.0, armature=0.05, integral=30.0, offset=-2.0)
    u = torch.zeros(400, 1, dtype=torch.float64)
    u[60:], u[230:] = 0.4, -0.2
    tracks = Tracks(u, torch.tensor([0]), torch.tensor([399]), DT)
    robot, still = flywheel(), torch.zeros(1, 1, dtype=torch.float64)
    whole = replayed(robot, servos, tracks, windows_of(tracks, None), still, still)
    assert float((whole - u)[225].abs()) < 1e-3
    plain = replace(servos, joint=servos.joint.clone())
    plain.joint[0, INDEX["integral"]] = 0.0
    away = replayed(robot, plain, tracks, windows_of(tracks, None), still, still)
    assert float((whole - away).abs().max()) > 0.02
    windows = windows_of(tracks, 2.0)
    rate = torch.zeros(len(windows.start), 1, dtype=torch.float64)
    for k, row in enumerate(windows.start.tolist()):
        rate[k] = (whole[row + 1] - whole[row - 1]) / (2 * DT) if row else 0.0
    begun = whole[windows.start], rate
    parts = replayed(robot, servos, tracks, windows, *begun, measured=whole)
    assert float((parts - whole).abs().max()) < 2e-3
    unknown = replayed(robot, servos, tracks, windows, *begun)
    assert float((unknown - whole).abs().max()) > 5 * float((parts - whole).abs().max())


@pytest.mark.nightly
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stop_holds(side):
    servos = Servos.neutral(1, kp=20.0, damping=2.0, armature=0.02)
    servos.joint[0, INDEX["stop_high" if side > 0 else "stop_low"]] = 0.2 * side
    tracks = steady(0.5 * side, 3.0)
    zero = torch.zeros(2, 1, 1).double()
    q = replayed(flywheel(), servos, tracks, windows_of(tracks, None), *zero)
    # 20 N m/rad against a stop of 200.
    rest = (20 * 0.5 + 200 * 0.2) / 220
    assert float(q[-1] * side) == pytest.approx(rest, abs=1e-6)


def test_motion_changes_with_the_delay_without_a_jump():
    """A servo that answers to the rate of its set-point, which bends where a command arrives: no
    delay is a step of the integration better than the next."""
    model, tracks = arm("3r"), sines(3, 25, 1, seed=5)
    delays = torch.linspace(0.9 * DT, 1.2 * DT, 31, dtype=torch.float64)
    base = Servos.neutral(3, kp=80.0, damping=2.0, armature=0.3, kd=6.0)
    joint = base.joint.repeat(len(delays), 1, 1)
    joint[:, :, INDEX["delay"]] = delays[:, None]
    sets = replace(base, joint=joint, plane=base.plane.repeat(len(delays), 1))
    start = tracks.u[tracks.first]
    whole = windows_of(tracks, None)
    ways = torch.stack(
        [
            replayed(model, Servos(one, base.plane), tracks, whole, start, torch.zeros_like(start))
            for one in sets.joint
        ]
    )
    change = ways.diff(dim=0).square().mean((1, 2)).sqrt()
    assert float(change.max()) < 1.5 * float(change.median())


@pytest.fixture(scope="module", params=["3r", "mixed", "two_arms"])
def tree(request, tmp_path_factory):
    """A chain with springs, sliding joints, and branches of which one joint mimics another."""
    if request.param == "two_arms":
        return load_robot(str(two_arms(tmp_path_factory.mktemp("tree"))))
    if request.param == "mixed":
        return arm("mixed")
    springs = ((1, 0.0), (2, 1.0), (3, -2.0))
    records = ({"joint": j, "curvature": x, "k": 3.0, "c0": 0.5} for j, x in springs)
    effects = tuple({"effect": "joint_spring", **record} for record in records)
    robot = arm("3r")
    return replace(robot, effects=effects, compensated=0.3 * robot.parameters.pi[:, :4])


def test_the_body_is_that_of_the_recursion(tree):
    """Mass matrix, bias, stiffness, heights and their slopes, beside dynamics that share no line
    with them; what a robot's springs and what its servos do not feel are in it."""
    n, link = tree.n, tree.n_links - 2
    g = torch.Generator().manual_seed(2)
    q, dq = 2 * torch.rand(2, 5, n, generator=g, dtype=torch.float64) - 1
    body = body_near(tree, q, dq, link)
    mass, stiffness, _, _, height, slope = body.rows.split([n * n, n * n, n, n, 4, 4 * n], 1)
    slope = slope.unflatten(1, (n, 4))
    assert torch.allclose(diagonals(mass), mass_matrix(tree, q), atol=1e-12)

    def still(q: torch.Tensor) -> torch.Tensor:
        out = gravity_torque(tree, q) - compensation(tree, q)
        for effect, values in nominal_effects(tree):
            if isinstance(effect, JointSpring):
                c, s = stumpff(effect.curvature * q[:, effect.joint] ** 2)
                out[:, effect.joint] += values[0] * q[:, effect.joint] * s + values[1] * c
        return out

    bias = bias_torque(tree, q, dq) - gravity_torque(tree, q) + still(q)
    assert torch.allclose(body.bias, bias, atol=1e-12)
    assert torch.allclose(height, heights(tree, q, link), atol=1e-12)
    for j, step in enumerate(1e-5 * torch.eye(n, dtype=torch.float64)):
        rises, turns = (
            (of(q + step) - of(q - step)) / 2e-5
            for of in (partial(heights, tree, link=link), still)
        )
        assert torch.allclose(slope[:, j], rises, atol=1e-8)
        assert torch.allclose(diagonals(stiffness)[..., j], turns, atol=1e-4)


def diagonals(rows: torch.Tensor) -> torch.Tensor:
    """Matrices (T, n, n) from their cyclic diagonals."""
    n = math.isqrt(rows.shape[1])
    i = torch.arange(n)
    return rows.unflatten(1, (n, n))[:, (i - i[:, None]) % n, i[:, None]]


def heights(robot, q: torch.Tensor, link: int) -> torch.Tensor:
    """(T, 4) of a homogeneous point of the link."""
    return upwards(robot) @ link_poses(robot, q)[:, link, :3]


@pytest.mark.nightly
def test_an_arm_stops_at_a_plane():
    """The tool's point rests in the plane as deep as the servos press it; without it, far below."""
    robot = arm("3r")
    low = torch.tensor([[0.3, 0.2, -0.4]], dtype=torch.float64)
    tracks = Tracks(low.expand(151, 3), torch.tensor([0]), torch.tensor([150]), DT)
    whole = windows_of(tracks, None)
    servos = Servos.neutral(3, kp=300.0, damping=20.0, armature=0.5)
    start = low + torch.tensor([0.0, 0.6, 0.6])
    heights = []
    for stiffness in (0.0, 1e5):
        pressed = Servos(servos.joint, torch.tensor([0.0, 0.0, 0.0, 0.0, stiffness]).double())
        floor = float(link_poses(robot, start)[0, -1, 2, 3]) - 0.05
        pressed.plane[3] = floor
        q = replayed(robot, pressed, tracks, whole, start, torch.zeros(1, 3).double())
        heights.append(float(link_poses(robot, q[-1])[-1, 2, 3]) - floor)
    # 600 N press it 6 mm deep.
    assert heights[0] < -0.2
    assert -0.01 < heights[1] < 0.0


def test_windows_cover_every_row_once():
    tracks = sines(2, 430, 3, seed=1)
    windows = windows_of(tracks, 2.0)
    rows = [
        row
        for a, length in zip(windows.start.tolist(), windows.length.tolist(), strict=True)
        for row in range(a, a + length)
    ]
    assert rows == list(range(3 * 430))


@pytest.mark.nightly
def test_sets_in_a_batch_do_not_disturb_each_other():
    robot, tracks = arm("3r"), sines(3, 100, 2, seed=4)
    a, b = drawn(3, 1), drawn(3, 2)
    whole = windows_of(tracks, None)
    q = tracks.u[tracks.first]
    both = Servos(torch.stack([a.joint, b.joint])[:, None], torch.zeros(2, 1, 5).double())
    together = replayed(robot, both, tracks, whole, q, torch.zeros_like(q))
    for k, servos in enumerate((a, b)):
        one = whole.some(torch.tensor([k]))
        alone = replayed(robot, servos, tracks, one, q[k : k + 1], torch.zeros(1, 3).double())
        rows = slice(int(tracks.first[k]), int(tracks.last[k]) + 1)
        assert torch.equal(together[rows], alone[rows])


def all_kinds(n: int, sets: int, seed: int) -> Servos:
    """Sets of which each has another effect, and every third so little inertia of its own that
    coupling outweighs it; one in six touches a plane."""
    each = [drawn(n, seed + k) for k in range(sets)]
    joint = torch.stack([servos.joint for servos in each])
    kinds = (
        {"dead_zone": 0.01}, {"stiction": 2.0, "stribeck_speed": 0.1}, {"motor_share": 0.2},
        {"load_share": 0.1, "stiction_share": 0.2, "stribeck_exponent": 1.5},
        {"acceleration": 3.0}, {"lag": 0.05}, {"stop_high": 0.3},
        {"armature": 5.0, "integral": 0.0},
    )  # fmt: skip
    joint[::3, :, INDEX["armature"]] = 1e-3
    for k in range(sets):
        for name, value in kinds[k % len(kinds)].items():
            joint[k, :, INDEX[name]] = value
    plane = torch.zeros(sets, 5, dtype=torch.float64)
    plane[::6, 3:] = torch.tensor([0.3, 500.0], dtype=torch.float64)
    return Servos(joint, plane)


@pytest.mark.parametrize("seed", some(range(8), slow=0, quick=1))
def test_an_answer_hangs_on_nothing_that_is_simulated_beside_it(seed: int) -> None:
    """A set alone is what it is among 24 others, and a window alone what it is among others."""
    robot, tracks = arm("kuka_lwr4"), sines(7, 60, 2, seed=seed)
    servos, windows = all_kinds(7, 25, seed), windows_of(tracks, 0.4)
    q, dq = tracks.u, torch.zeros_like(tracks.u)
    body = body_near(robot, q, dq, 6).midway(tracks.last)

    def run(sets: Servos, some: Windows) -> torch.Tensor:
        return rollout(sets, body, tracks, some, q[some.start], dq[some.start], measured=q)

    together = run(servos, windows).nan_to_num(9.0)
    for k in range(0, 25, 1 if seed else 4):
        one = replace(servos, joint=servos.joint[k, None], plane=servos.plane[k, None])
        alone = run(one, windows).nan_to_num(9.0)
        assert torch.allclose(alone[..., 0], together[..., k], rtol=0, atol=1e-12), k
    for w in range(len(windows.start)):
        alone = run(servos, windows.some(torch.tensor([w])))
        assert torch.allclose(alone[:, 0], together[: len(alone), w], rtol=0, atol=1e-12), w


def test_servos_survive_their_record():
    servos = drawn(3, 3)
    servos.plane[:] = torch.tensor([0.1, 0.0, -0.2, 0.05, 800.0])
    again = Servos.from_record(servos.record(), 3, "model.yaml")
    assert torch.equal(again.joint, servos.joint)
    assert torch.equal(again.plane, servos.plane)
    assert len(NAMES) == len(PARAMETERS)


def test_between_motions_no_command_jumps() -> None:
    """A step within a motion is one, the way from one motion's end to the next's begin is none."""
    t = torch.arange(100, dtype=torch.float64) / 50
    slow, apart = torch.sin(t), 2.0 + torch.sin(2 * t)
    stepped = apart + 0.8 * (t > 1.0)
    u = torch.cat([slow, apart, stepped])[:, None]
    tracks = Tracks(u, torch.tensor([0, 100, 200]), torch.tensor([99, 199, 299]), 0.02)
    assert tracks.jumping.nonzero().flatten().tolist() == [250]


def resting_on_all() -> list[list[float]]:
    """Positions of an arm whose servos have every effect, after some samples."""
    robot, tracks = arm("3r"), sines(3, 6, 1, seed=2)
    servos = all_kinds(3, 25, 1)
    joint = torch.where(servos.joint.isfinite(), servos.joint, math.inf).amin(0)
    one = Servos(joint.nan_to_num(posinf=100.0), servos.plane[0], link=2)
    q = tracks.u[tracks.first]
    return replayed(
        robot, one, tracks, windows_of(tracks, None), q, 0 * q, measured=tracks.u
    ).tolist()


@pytest.mark.slow
def test_compiled_code_does_what_is_written() -> None:
    """The same file as Python, in a process of its own."""
    code = "from tests.simulation.test_servo_loop import resting_on_all; print(resting_on_all())"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    told = subprocess.check_output([sys.executable, "-c", code], cwd=ROOT, env=environment)
    both = (torch.tensor(x).double() for x in (json.loads(told), resting_on_all()))
    assert torch.allclose(*both, rtol=0, atol=1e-12)


def test_code_is_compiled_where_nothing_can_be_kept(monkeypatch) -> None:
    compiled = numba.njit

    def refusing(*given: object, cache: bool = False, **options: object) -> object:
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return compiled(*given, **options)

    monkeypatch.setattr(numba, "njit", refusing)
    assert servo_kernel._compiled(lambda x: 2 * x)(3.0) == 6.0
