"""Payloads from changes of base parameters: planted ones are found, and honestly."""

import json
import math
import re
from dataclasses import replace
from functools import lru_cache

import cvxpy as cp
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as some

from tests.arms import arm, consistent_parameters, states
from tests.identification.test_paper_tables import plan
from tests.marks import quick_first
from tests.oracles import PinocchioOracle
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.errors import RobotError, TorchidError
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.base_parameters import base_parameters
from torchid.identification.identify import Identification, Settings, identify
from torchid.identification.payload import (
    estimate_payload,
    payload,
    payload_from_evidence,
    with_payload,
)
from torchid.identification.payload_fit import known_rows, nearest_consistent
from torchid.log.model import Log
from torchid.report.identification import payload_tables
from torchid.robot.inertia import InertialParameters, move, paper_order
from torchid.robot.library import load_robot
from torchid.robot.model import JointType, Limits, Robot
from torchid.robot.placement import pose, roll_pitch_yaw
from torchid.robot.shapes import reach

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
EXACT = Settings(cutoff=None, reversal=0.0, method="ols", signs="free", effects=FRICTION)
# The report's LWR has a negative Fv6, so its signs are free.
QUICK = Settings(cutoff=5.0, reversal=0.0, signs="free")
ROBOTS = ("3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction")
MASS, COM, SIDES = 1.2, (0.03, -0.02, 0.08), (0.06, 0.1, 0.2)


def tensor(*values) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def body(mass: float, com, sides) -> torch.Tensor:
    """A box of the given sides (10,), axes along the frame's."""
    x, y, z = (s**2 for s in sides)
    inertia = mass / 12 * tensor([y + z, 0, 0, x + z, 0, x + y])
    return InertialParameters.from_com(tensor(mass), tensor(com), inertia).pi[0]


BOX = body(MASS, COM, SIDES)
TOOL = pose(roll_pitch_yaw([0.3, -0.5, 1.1]), tensor(0.02, -0.01, 0.11))


@lru_cache
def exact(name: str, payload: tuple[float, ...] | None) -> Identification:
    """Identified from a log without noise, with a tool that is not the last link's frame."""
    robot = replace(load_robot(name), tool=TOOL)
    if payload is not None:
        robot = with_payload(robot, tensor(*payload))
    names = FRICTION if robot.effects else ()
    return identify(
        robot, synthetic_log(robot, plan(robot)), settings=replace(EXACT, effects=names)
    )


def without_noise(name: str, payload: torch.Tensor, model: str = "general"):
    return estimate_payload(exact(name, None), exact(name, tuple(payload.tolist())), model=model)


@pytest.mark.parametrize("name", ROBOTS)
def test_without_noise_the_box_is_recovered_in_both_frames(name):
    found = without_noise(name, BOX)
    assert bool(found.determined.all())
    torch.testing.assert_close(found.parameters, move(BOX, TOOL), rtol=0, atol=1e-9)
    torch.testing.assert_close(found.tool.parameters.value, BOX, rtol=0, atol=1e-9)
    torch.testing.assert_close(
        found.tool.com.value, torch.tensor(COM, dtype=torch.float64), rtol=0, atol=1e-9
    )
    x, y, z = (s**2 for s in SIDES)
    box = MASS / 12 * torch.tensor([y + z, 0, 0, x + z, 0, x + y], dtype=torch.float64)
    torch.testing.assert_close(found.tool.inertia_about_com.value, box, rtol=0, atol=1e-9)
    here = TOOL[:3, :3] @ torch.tensor(COM, dtype=torch.float64) + TOOL[:3, 3]
    torch.testing.assert_close(found.link.com.value, here, rtol=0, atol=1e-9)
    assert found.seen
    assert found.consistent
    assert found.margin > 0
    assert not found.friction_changes
    assert not found.unexplained
    assert not found.warnings


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4"])
def test_models_with_fewer_parameters_recover_bodies_of_their_kind(name):
    disc = body(0.7, (0, 0, 0.05), (0.1, 0.1, 0.04))
    found = without_noise(name, disc, "symmetric")
    torch.testing.assert_close(found.tool.parameters.value, disc, rtol=0, atol=1e-9)
    point = body(0.7, (0.01, -0.04, 0.05), (0, 0, 0))
    found = without_noise(name, point, "point_mass")
    torch.testing.assert_close(found.tool.parameters.value, point, rtol=0, atol=1e-9)
    assert found.consistent
    assert found.tool.inertia_about_com.value.abs().max() < 1e-12
    table, *_ = payload_tables(found)
    assert [row[1].startswith("0 ") for row in table.rows] == [False] * 4 + [True] * 6


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_a_body_that_is_not_of_the_model_is_noticed(name):
    found = without_noise(name, BOX, "symmetric")
    assert found.unexplained
    assert any("does not explain" in w for w in found.warnings)


def test_with_payload_is_pinocchios_appended_body(robot):
    robot = replace(robot, tool=TOOL)
    oracle = PinocchioOracle(robot)
    pin = oracle.pin
    m = pin.Inertia(MASS, np.array(COM), np.diag(_box_inertia()))
    place = pin.SE3(TOOL[:3, :3].numpy(), TOOL[:3, 3].numpy())
    state = states(robot, 5)
    tau = inverse_dynamics(with_payload(robot, BOX), *state)
    alone = inverse_dynamics(robot, *state)
    oracle.model.appendBodyToJoint(robot.n, m, pin.SE3(robot.after[-1].numpy()) * place)
    oracle.data = oracle.model.createData()
    expected = oracle.inverse_dynamics(*state)
    torch.testing.assert_close(tau, expected, rtol=0, atol=1e-9)
    assert float((tau - alone).abs().max()) > 1e-2


def _box_inertia() -> np.ndarray:
    x, y, z = (s**2 for s in SIDES)
    return MASS / 12 * np.array([y + z, x + z, x + y])


def test_only_a_robot_with_parameters_carries():
    with pytest.raises(RobotError, match="payload"):
        with_payload(load_robot("3r").with_parameters(None), BOX)


def noiseless_change(robot: Robot, payload: torch.Tensor):
    """Base parameters' structure and the change a payload in the last link's frame makes."""
    base = base_parameters(robot)
    full = torch.zeros(robot.n, 10, dtype=torch.float64)
    full[-1] = payload
    return base, base.project(full.flatten()[paper_order(robot.n)])


@pytest.mark.slow
@examples(max_examples=25)
@given(
    name=some.sampled_from(["3r", "kuka_lwr4", "panda", "ur10e", "mixed"]),
    seed=some.integers(0, 999),
)
def test_any_consistent_payload_on_any_arm_with_a_wrist(name, seed):
    robot = arm(name)
    payload = consistent_parameters(1, seed).pi[0]
    base, change = noiseless_change(robot, payload)
    b = len(base)
    found = from_change(robot, base, change, 1e-6 * torch.eye(b, dtype=torch.float64), 30.0)
    assert bool(found.determined.all())
    torch.testing.assert_close(found.parameters, payload, rtol=0, atol=1e-8)
    assert found.consistent
    assert torch.equal(found.nearest, found.parameters)


def from_change(robot, base, change, covariance, degrees=math.inf, model="general"):
    """The payload behind a change of base parameters with a covariance."""
    found = known_rows(torch.eye(len(change), dtype=torch.float64), change, degrees)
    return payload_from_evidence(robot, base, (), (replace(found, covariance=covariance),), model)


def planar(n: int, gravity=(0.0, -9.81, 0.0)) -> Robot:
    """Parallel vertical-plane joints."""
    step = pose(torch.eye(3, dtype=torch.float64), tensor(0.4, 0.0, 0.0))
    return Robot(
        name=f"planar{n}",
        joint_names=tuple(f"j{i}" for i in range(n)),
        link_names=tuple(f"l{i}" for i in range(n)),
        joint_types=(JointType.REVOLUTE,) * n,
        before=torch.eye(4, dtype=torch.float64).repeat(n, 1, 1),
        after=step.repeat(n, 1, 1),
        gravity=tensor(*gravity),
        tool=pose(),
        limits=Limits(),
    )


@pytest.mark.parametrize("robot", [planar(1), planar(2), planar(2, (0.0, 0.0, -9.81)), planar(3)])
def test_what_a_planar_arm_cannot_tell_is_said(robot):
    """A parameter is determined exactly if no payload with another value of it has the same
    torques: checked on torques, not on base parameters."""
    base, change = noiseless_change(robot, BOX)
    found = from_change(robot, base, change, 1e-8 * torch.eye(len(base), dtype=torch.float64), 30.0)
    state = states(robot, 40)
    unit = torch.zeros(10, robot.n, 10, dtype=torch.float64)
    unit[torch.arange(10), -1, torch.arange(10)] = 1.0
    torque = torch.stack([inverse_dynamics(robot, *state, InertialParameters(u)) for u in unit])
    _, sizes, v = torch.linalg.svd(torque.flatten(1).T)
    null = v[int((sizes > 1e-9 * sizes[0]).sum()) :]
    expected = (null.abs() < 1e-9).all(0)
    assert torch.equal(found.determined, expected)
    assert not bool(expected.all())
    torch.testing.assert_close(found.parameters[expected], BOX[expected], rtol=0, atol=1e-9)
    torch.testing.assert_close(
        torque.flatten(1).T @ found.parameters, torque.flatten(1).T @ BOX, rtol=0, atol=1e-8
    )
    assert set(found.undetermined) == {
        n for n, e in zip(_NAMES, expected.tolist(), strict=True) if not e
    }
    value = found.link.com.value
    assert torch.equal(torch.isnan(value), ~(expected[0] & expected[1:4]))
    assert any("not determined" in w for w in found.warnings)
    assert found.consistent
    torch.testing.assert_close(
        torque.flatten(1).T @ found.nearest, torque.flatten(1).T @ BOX, rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("gravity", [(0.0, -9.81, 0.0), (0.0, 0.0, -9.81)])
def test_a_point_whose_mass_no_base_parameter_has_is_known_or_open_and_never_zero(gravity):
    """One axis tells m c across it by gravity and m c^2 by inertia: m = |m c|^2 / (m c^2). Without
    gravity across it, m c^2 alone is told, and nothing of m or of m c."""
    robot = replace(planar(1, gravity), after=torch.eye(4, dtype=torch.float64).unsqueeze(0))
    point = body(0.7, (0.01, -0.04, 0.05), (0, 0, 0))
    base, change = noiseless_change(robot, point)
    spread = 1e-12 * torch.eye(len(base), dtype=torch.float64)
    found = from_change(robot, base, change, spread, 30.0, model="point_mass")
    inertia = found.parameters[9]
    assert float(inertia) == pytest.approx(0.7 * (0.01**2 + 0.04**2), rel=1e-6)
    if gravity[1]:
        assert float(found.link.mass.value) == pytest.approx(0.7, rel=1e-4)
        torch.testing.assert_close(found.parameters[1:3], point[1:3], rtol=1e-4, atol=0)
        assert set(found.undetermined) >= {"mcz"}
    else:
        assert {"m", "mcx", "mcy", "mcz"} <= set(found.undetermined)
        assert bool(found.link.parameters.value[:4].isnan().all())
        assert not found.seen


_NAMES = ("m", "mcx", "mcy", "mcz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")


@pytest.mark.slow
def test_standard_deviations_are_those_of_a_thousand_repetitions():
    """The delta method against sampling, in the tool frame of an arm."""
    robot = replace(arm("kuka_lwr4"), tool=TOOL)
    base, change = noiseless_change(robot, move(BOX, TOOL))
    g = torch.Generator().manual_seed(3)
    b = len(base)
    root = 1e-3 * torch.randn(b, b, generator=g, dtype=torch.float64) / b**0.5
    covariance = root @ root.T
    found = from_change(robot, base, change, covariance)
    # The estimator is linear in the change, so ten unit responses make all the repetitions.
    zero = found.parameters
    response = torch.stack(
        [
            (from_change(robot, base, change + e, covariance).parameters - zero) / 1e-6
            for e in 1e-6 * torch.eye(b, dtype=torch.float64)
        ],
        -1,
    )
    noise = root @ torch.randn(b, 20000, generator=g, dtype=torch.float64)
    bodies = move((zero.unsqueeze(-1) + response @ noise).T, torch.linalg.inv(TOOL))
    p = InertialParameters(bodies.unsqueeze(1))
    for estimate, sample in (
        (found.tool.mass, p.mass),
        (found.tool.com, p.com[:, 0]),
        (found.tool.inertia_about_com, p.inertia_about_com[:, 0]),
    ):
        torch.testing.assert_close(estimate.std, sample.std(0), rtol=0.03, atol=0)
    assert found.quantile == pytest.approx(1.96, abs=1e-3)


def sdp_distance(parameters: torch.Tensor, covariance: torch.Tensor) -> float:
    """The squared distance to the consistent bodies as a semidefinite programme."""
    whiten = torch.linalg.inv(torch.linalg.cholesky(covariance)).numpy()
    scale = np.array([1.0] + [0.1] * 3 + [0.01] * 6)
    x = cp.Variable(10)
    m, h, xx, xy, xz, yy, yz, zz = x[0], x[1:4], *(x[k] for k in range(4, 10))
    s = [
        [(yy + zz - xx) / 2, -xy, -xz],
        [-xy, (xx + zz - yy) / 2, -yz],
        [-xz, -yz, (xx + yy - zz) / 2],
    ]
    p = cp.bmat([[*s[k], h[k]] for k in range(3)] + [[h[0], h[1], h[2], m]])
    residual = (whiten * scale) @ x - whiten @ parameters.numpy()
    problem = cp.Problem(cp.Minimize(cp.sum_squares(residual)), [p >> 0])
    return float(problem.solve(solver="CLARABEL"))


@pytest.mark.parametrize("seed", range(8))
def test_the_nearest_consistent_payload_is_that_of_the_semidefinite_programme(seed):
    g = torch.Generator().manual_seed(seed)
    scale = tensor(0.05, *[0.005] * 3, *[0.002] * 6)
    root = scale.unsqueeze(-1) * (
        torch.eye(10, dtype=torch.float64)
        + 0.3 * torch.randn(10, 10, generator=g, dtype=torch.float64)
    )
    covariance = root @ root.T
    truth = body(0.5, (0.02, 0.01, 0.05), (0.03, 0.03, 0.01))
    for away in (1.0, 5.0):
        parameters = truth + away * root @ torch.randn(10, generator=g, dtype=torch.float64)
        margin = InertialParameters(parameters.unsqueeze(0)).consistency_margin()
        found, distance, directions = nearest_consistent(
            parameters, covariance, torch.zeros(10, 0, dtype=torch.float64)
        )
        assert directions == 10
        assert float(InertialParameters(found.unsqueeze(0)).consistency_margin()) > -1e-12
        off = found - parameters
        assert distance == pytest.approx(float(off @ torch.linalg.solve(covariance, off)), rel=1e-6)
        expected = sdp_distance(parameters, covariance)
        assert distance == pytest.approx(expected, rel=1e-5, abs=1e-6)
        assert (distance < 1e-6) == (float(margin) > 0)


@lru_cache
def noisy(name: str, seed: int, mass: float, shaken: str = "") -> Identification:
    """Identified with honest noise; `shaken` says what else differs from the nominal robot."""
    robot = load_robot(name)
    motion = trajectory_log(
        random_trajectory(robot, seed, count=2, fill=True), 200.0 if robot.n == 3 else 100.0
    )
    carrying = with_payload(robot, body(mass, COM, SIDES)) if mass else robot
    if shaken == "friction":
        harder = [
            {**e, "Fc": 1.5 * e["Fc"]} if e["effect"] == "coulomb_friction" else e
            for e in robot.effects
        ]
        carrying = replace(carrying, effects=tuple(harder))
    if shaken == "arm":
        pi = carrying.parameters.pi.clone()
        pi[1] += body(1.0, (-0.05, 0.1, 0.03), SIDES)
        carrying = carrying.with_parameters(InertialParameters(pi))
    noise_seed = seed + (5000 if mass or shaken else 0)
    return identify(
        robot, synthetic_log(carrying, motion, HonestNoise(), noise_seed), settings=QUICK
    )


TRUE = tensor(MASS, *COM, *[0.0] * 6)
TRUE[[4, 7, 9]] = torch.from_numpy(_box_inertia())


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "runs"), [("3r_friction", 40), ("kuka_lwr4_friction", 30)])
def test_intervals_hold_the_truth_as_often_as_they_say(name, runs):
    """Of the 95 % intervals of all ten quantities in the tool frame."""
    hits = []
    for seed in range(runs):
        found = estimate_payload(noisy(name, seed, 0.0), noisy(name, seed, MASS))
        parts = (found.tool.mass, found.tool.com, found.tool.inertia_about_com)
        low, high = (torch.cat([getattr(x, end) for x in parts]) for end in ("low", "high"))
        hits.append((low <= TRUE) & (high >= TRUE))
        assert found.seen
        assert found.consistent_within
    share = torch.stack(hits).double()
    assert 0.93 < float(share.mean()) < 0.995
    assert float(share.mean(0).min()) > 0.82


@pytest.mark.slow
@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction"])
def test_with_honest_noise_the_box_is_near(name):
    found = estimate_payload(noisy(name, 0, 0.0), noisy(name, 0, MASS))
    assert float(found.tool.mass.value) == pytest.approx(MASS, rel=0.01)
    torch.testing.assert_close(found.tool.com.value, TRUE[1:4], rtol=0, atol=2e-3)
    parts = (found.tool.mass, found.tool.com, found.tool.inertia_about_com)
    z = torch.cat([x.value for x in parts]) - TRUE
    assert float((z / torch.cat([x.std for x in parts])).abs().max()) < 4
    assert found.consistent_within
    assert found.nearest is not None


@pytest.mark.parametrize("name", quick_first(["3r_friction", "kuka_lwr4_friction"], 1))
def test_without_payload_none_is_seen(name):
    other = identify(
        load_robot(name),
        synthetic_log(
            load_robot(name),
            trajectory_log(random_trajectory(load_robot(name), 0, count=2, fill=True), 100.0),
            HonestNoise(),
            77,
        ),
        settings=QUICK,
    )
    found = estimate_payload(noisy(name, 0, 0.0), other)
    assert not found.seen
    assert float(found.link.mass.low) <= 0 <= float(found.link.mass.high)
    assert bool(torch.isnan(found.tool.com.value).all())
    assert found.warnings[0].startswith("no payload can be seen")
    assert json.dumps(found.plain(), allow_nan=False)


def test_exchanged_logs_are_noticed():
    found = estimate_payload(noisy("3r_friction", 0, MASS), noisy("3r_friction", 0, 0.0))
    assert not found.seen
    assert any("exchanged" in w for w in found.warnings)


def test_friction_that_grew_with_the_load_is_a_finding_and_not_payload():
    found = estimate_payload(
        noisy("3r_friction", 0, 0.0), noisy("3r_friction", 0, MASS, "friction")
    )
    changed = {c.name: c for c in found.friction_changes}
    assert {"Fc1", "Fc2", "Fc3"} <= set(changed)
    assert changed["Fc1"].change == pytest.approx(0.5 * 0.245, rel=0.3)
    assert float(found.tool.mass.value) == pytest.approx(MASS, rel=0.01)
    assert any("not part of the payload" in w for w in found.warnings)


def test_a_change_elsewhere_in_the_arm_is_noticed():
    found = estimate_payload(
        noisy("kuka_lwr4_friction", 0, 0.0), noisy("kuka_lwr4_friction", 0, MASS, "arm")
    )
    assert found.unexplained
    assert all(c.significant for c in found.unexplained)


def test_parameters_without_information_are_named():
    one, two = exact("kuka_lwr4", None), exact("kuka_lwr4", tuple(BOX.tolist()))
    hidden = one.free.clone()
    hidden[[0, 5]] = False
    found = estimate_payload(replace(one, free=hidden), two)
    assert found.excluded == (one.base.names[0], one.base.names[5])


def weak_log(robot: Robot, moving: list[int], seed: int, digits: int = 0, rate: float = 100.0):
    """Only some joints move, the others sag in the first 0.3 s and are then held by friction."""
    g = torch.Generator().manual_seed(seed)
    motion = trajectory_log(random_trajectory(robot, 1, duration=12.0, fill=True), rate)
    q, dq, ddq = motion.q.clone(), motion.dq.clone(), motion.ddq.clone()
    still = [j for j in range(robot.n) if j not in moving]
    s = (motion.t / 0.3).clamp(0, 1).unsqueeze(1)
    q[:, still] = q[0, still] + 0.03 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    dq[:, still] = 0.03 * 30 * s**2 * (1 - s) ** 2 / 0.3
    ddq[:, still] = 0.03 * 60 * s * (1 - s) * (1 - 2 * s) / 0.09
    tau = inverse_dynamics(robot, q, dq, ddq) + 0.3 * dq + 0.5 * dq.sign()
    tau[:, still] += 0.5 * (dq[:, still] == 0) * torch.rand(len(still), generator=g).double()
    tau += 0.02 * torch.randn(tau.shape, generator=g, dtype=torch.float64)
    if digits:
        q, tau = (torch.tensor([[float(f"{x:.{digits}g}") for x in r] for r in y.tolist()],
                               dtype=torch.float64) for y in (q, tau))  # fmt: skip
    return Log(motion.t, q, tau=tau)


@pytest.mark.parametrize("model", quick_first(["general", "point_mass"], 1))
def test_a_joint_that_moves_alone_leaves_the_mass_open_and_says_which_others_tell_it(model):
    robot = load_robot("3r")
    logs = [weak_log(arm, [0], k) for k, arm in enumerate((robot, with_payload(robot, BOX)))]
    found = payload(robot, *logs, model=model, settings=Settings(cutoff=8.0))
    assert bool(found.tool.mass.value.isnan())
    assert not found.seen
    assert "m" in found.undetermined
    assert any(w.startswith("the payload's mass is not known") for w in found.warnings)
    (said,) = (w for w in found.warnings if w.startswith("m, mc"))
    others = [int(k) - 1 for k in re.findall(r"joints? ([\d, ]+) as well", said)[0].split(",")]
    logs = [
        weak_log(arm, [0, *others], k) for k, arm in enumerate((robot, with_payload(robot, BOX)))
    ]
    moved = payload(robot, *logs, settings=Settings(cutoff=8.0))
    assert float(moved.tool.mass.low) < MASS < float(moved.tool.mass.high)
    assert json.dumps(found.plain(), allow_nan=False)


@pytest.mark.parametrize("digits", [0, 5])
def test_a_weak_motion_that_tells_the_mass_holds_it_in_its_interval(digits):
    robot = load_robot("3r")
    logs = [
        weak_log(arm, [1, 2], k, digits) for k, arm in enumerate((robot, with_payload(robot, BOX)))
    ]
    found = payload(robot, *logs, settings=Settings(cutoff=8.0))
    assert float(found.tool.mass.low) < MASS < float(found.tool.mass.high)
    assert float(found.tool.mass.std) < 0.2 * MASS
    # The first link's axis is vertical, and nothing turns about it.
    assert found.undetermined


def test_joints_that_hold_a_point_at_rest_tell_its_mass_to_their_dry_friction():
    robot, wrist = load_robot("kuka_lwr4"), [5, 6]
    place = torch.tensor([[0.05, 0.0, 0.02]], dtype=torch.float64)
    point = InertialParameters.from_com(place.new_tensor([MASS]), place, place.new_zeros(1, 6))
    loaded = weak_log(with_payload(robot, point.pi[0]), wrist, 1, rate=50.0)
    asked = {"model": "point_mass", "settings": Settings(cutoff=8.0)}
    found = payload(robot, weak_log(robot, list(range(7)), 0, rate=50.0), loaded, **asked)
    mass = found.tool.mass
    assert float(mass.low) < MASS < float(mass.high)
    # Four joints whose half newton metres at the arm's length agree are the least error.
    assert 0.5 * 0.5 / (9.81 * reach(robot)) < float(mass.std) < 0.1 * MASS
    assert any(w.startswith("joints 1, 2, 3, 4, 5 stand") for w in found.warnings)
    # Without the dry friction nothing says how much of the torque is the load's.
    alone = payload(robot, weak_log(robot, wrist, 0, rate=50.0), loaded, **asked)
    assert bool(alone.tool.mass.value.isnan())


def test_what_is_not_known_of_the_gain_is_in_every_interval_but_the_place():
    """All of a body scales with the torque; its centre of mass stays where it is."""
    two = exact("3r", None), exact("3r", tuple(BOX.tolist()))
    known, unsure = (estimate_payload(*two, gain_std=share) for share in (0.0, 0.05))
    mass = float(unsure.tool.mass.value)
    assert float(unsure.tool.mass.std) == pytest.approx(0.05 * mass, rel=1e-3)
    assert float(known.tool.mass.std) < 1e-6
    assert float((unsure.tool.com.std - known.tool.com.std).abs().max()) < 1e-6


def test_two_runs_must_mean_the_same():
    robot = load_robot("3r_friction")
    other = identify(
        robot, synthetic_log(robot, plan(robot)), settings=replace(EXACT, effects=FRICTION[:2])
    )
    with pytest.raises(TorchidError, match="same base parameters"):
        estimate_payload(exact("3r_friction", None), other)
    with pytest.raises(TorchidError, match="same base parameters"):
        estimate_payload(exact("3r", None), exact("kuka_lwr4", None))
    longer = replace(exact("3r", None), robot=replace(load_robot("3r"), tool=pose()))
    with pytest.raises(TorchidError, match="lengths"):
        estimate_payload(exact("3r", None), longer)


@pytest.mark.usefixtures("types_unchecked")
def test_wrong_choices_are_refused():
    run = exact("3r", None)
    with pytest.raises(TorchidError, match="model"):
        estimate_payload(run, run, model="sphere")


def test_the_record_is_complete_json():
    found = estimate_payload(noisy("3r_friction", 0, 0.0), noisy("3r_friction", 0, MASS))
    data = json.loads(json.dumps(found.plain(), allow_nan=False))
    assert data["schema"] == "torchid.payload/1"
    mass = data["frames"]["tool"]["mass"]
    assert mass["ci95"][0][0] < MASS < mass["ci95"][0][1]
    assert len(data["effect_changes"]) == len(found.effect_changes) > 0
    assert data["consistent_within_interval"]
    assert data["parameters"]["names"] == list(_NAMES)


def test_a_change_that_no_rigid_payload_makes_is_not_sure_of_a_mass():
    """A change of 0.3 kg less with inertias of 0.9 kg more is neither a payload nor exchanged
    logs: the nearest body is given, and its interval is as wide as it is away."""
    robot = load_robot("3r")
    other = BOX.clone()
    other[0] = -0.3
    base, change = noiseless_change(robot, other)
    spread = 1e-6 * torch.eye(len(base), dtype=torch.float64)
    found = from_change(robot, base, change, spread, 30.0)
    assert found.rejected
    assert not found.consistent_within
    mass = found.link.mass
    assert float(mass.low) < 0 < float(mass.high), "nothing of a mass is sure"
    assert float(InertialParameters(found.parameters.unsqueeze(0)).consistency_margin()) > 0
    assert any(w.startswith("no rigid body within the 95 % region") for w in found.warnings)
    assert not any("exchanged" in w for w in found.warnings)
    # Exchanged logs make such a change, and keep their interval.
    base, change = noiseless_change(robot, -BOX)
    found = from_change(robot, base, change, spread, 30.0)
    assert not found.rejected
    assert float(found.link.mass.high) < 0
    assert any("exchanged" in w for w in found.warnings)
