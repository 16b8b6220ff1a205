"""Wrenches of many sets: against the recursion, Pinocchio, and Newton's law for the whole arm."""

from dataclasses import fields, replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.arms import arm, consistent_parameters, mixed_arm, relative, states
from tests.oracles import PinocchioOracle
from torchid.dynamics.newton_euler import inverse_dynamics, joint_wrenches
from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot, link_poses
from torchid.robot.placement import pose, roll_pitch_yaw
from torchid.wrenches import regressor
from torchid.wrenches.deviation import WrenchErrors, wrench_errors
from torchid.wrenches.regressor import internal_wrenches

KINDS = ["R", "P", "RP", "PR", "PPP", "RRPPRR", "PRRRPRRP", "RRRRRRR"]


def any_sets(robot: Robot, k: int, seed: int = 0) -> InertialParameters:
    """Sets without physical sense: the wrenches do not ask for any."""
    g = torch.Generator().manual_seed(seed)
    return InertialParameters(torch.randn(k, robot.n, 10, generator=g, dtype=torch.float64))


def by_recursion(robot: Robot, motion: tuple[Tensor, ...], sets: InertialParameters) -> Tensor:
    return joint_wrenches(robot, *motion, InertialParameters(sets.pi[:, None]))


def same_torques(robot: Robot, reference: InertialParameters, k: int) -> InertialParameters:
    """Sets with the reference's joint torques on every motion: moved along the null space of a
    generic torque regressor made of unit parameters."""
    motion = states(robot, 60, seed=11)
    units = torch.eye(10 * robot.n, dtype=torch.float64).reshape(-1, 1, robot.n, 10)
    columns = inverse_dynamics(robot, *motion, InertialParameters(units))
    _, s, v = torch.linalg.svd(columns.flatten(1).T, full_matrices=True)
    null = v[(s > 1e-10 * s[0]).sum() :]
    g = torch.Generator().manual_seed(5)
    shift = torch.randn(k, null.shape[0], generator=g, dtype=torch.float64) @ null
    return InertialParameters(reference.pi + shift.reshape(k, robot.n, 10))


def test_equals_the_recursion(robot: Robot) -> None:
    motion, sets = states(robot, 40), any_sets(robot, 6)
    wrenches = internal_wrenches(robot, *motion, sets)
    assert wrenches.shape == (6, 40, robot.n, 6)
    assert relative(wrenches, by_recursion(robot, motion, sets)) < 1e-14


@pytest.mark.parametrize("kinds", KINDS)
@pytest.mark.parametrize("seed", [1, 2])
def test_equals_the_recursion_on_random_arms(kinds: str, seed: int) -> None:
    robot = mixed_arm(kinds, seed)
    motion, sets = states(robot, 20, seed=seed), any_sets(robot, 4, seed)
    wrenches = internal_wrenches(robot, *motion, sets)
    assert relative(wrenches, by_recursion(robot, motion, sets)) < 1e-13


def test_equals_pinocchio(robot: Robot, pinocchio: PinocchioOracle) -> None:
    motion = states(robot, 15)
    assert robot.parameters is not None
    ours = internal_wrenches(robot, *motion, InertialParameters(robot.parameters.pi[None]))[0]
    theirs = pinocchio.wrenches(*motion)
    # Pinocchio: about the moved joint frame's origin, in its axes.
    turn = robot.after[:, :3, :3].transpose(-1, -2)
    force = (turn @ theirs[..., :3, None])[..., 0]
    moment = theirs[..., 3:].clone()
    for i, kind in enumerate(robot.joint_types):
        if kind is JointType.PRISMATIC:
            arm_z = torch.zeros(15, 3, dtype=torch.float64)
            arm_z[:, 2] = motion[0][:, i]
            moment[:, i] += torch.linalg.cross(arm_z, theirs[:, i, :3])
    moment = (turn @ moment[..., None])[..., 0]
    assert relative(ours, torch.cat([force, moment], -1)) < 1e-13


def test_base_force_is_mass_times_acceleration_of_the_whole_arm(robot: Robot) -> None:
    """Newton's law for the total centre of mass, whose acceleration is a second difference of its
    path q + dq s + ddq s^2 / 2: no part of the recursion is used."""
    q, dq, ddq = states(robot, 12)
    sets = consistent_parameters(robot.n, 4, (3,))
    h = 1e-3

    def first_moment(s: float) -> Tensor:
        poses = link_poses(robot, q + dq * s + ddq * s * s / 2)
        return torch.einsum("tnij,knj->kti", poses[..., :3, :3], sets.first_moment) + torch.einsum(
            "tni,kn->kti", poses[..., :3, 3], sets.mass
        )

    samples = [first_moment(j * h) for j in (-3, -2, -1, 0, 1, 2, 3)]
    weights = [2, -27, 270, -490, 270, -27, 2]
    inertial = sum(w * x for w, x in zip(weights, samples, strict=True)) / (180 * h * h)
    expected = inertial - sets.mass.sum(-1)[:, None, None] * robot.gravity
    force = internal_wrenches(robot, q, dq, ddq, sets)[:, :, 0, :3]
    in_base = torch.einsum("tij,ktj->kti", link_poses(robot, q)[:, 0, :3, :3], force)
    assert relative(in_base, expected) < 1e-7


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.sampled_from(["RRR", "RPR", "PRRP"]))
def test_norms_do_not_depend_on_the_frames(seed: int, kinds: str) -> None:
    """The same bodies described in other link frames: other numbers, the same norms."""
    robot = mixed_arm(kinds, seed=seed % 11)
    motion = states(robot, 5, seed=seed)
    g = torch.Generator().manual_seed(seed)
    other = torch.stack(
        [
            pose(
                roll_pitch_yaw(torch.randn(3, generator=g, dtype=torch.float64).tolist()),
                torch.randn(3, generator=g, dtype=torch.float64),
            )
            for _ in range(robot.n)
        ]
    )
    before = robot.before.clone()
    before[1:] = torch.linalg.inv(other[:-1]) @ before[1:]
    described = replace(robot, before=before, after=robot.after @ other)
    sets = consistent_parameters(robot.n, seed, (2,))
    inverse = torch.linalg.inv(other)
    moved = InertialParameters(_moved(sets.pi, inverse))
    here, there = (
        internal_wrenches(one, *motion, own).unflatten(-1, (2, 3)).norm(dim=-1)
        for one, own in ((robot, sets), (described, moved))
    )
    assert relative(here[..., 0], there[..., 0]) < 1e-12
    assert relative(here[..., 1], there[..., 1]) < 1e-12


def _moved(pi: Tensor, transform: Tensor) -> Tensor:
    """Parameters of point clouds in other frames, from their second moments (4 x 4 congruence)."""
    pseudo = transform @ InertialParameters(pi).pseudo_inertia @ transform.transpose(-1, -2)
    second, h, m = pseudo[..., :3, :3], pseudo[..., :3, 3], pseudo[..., 3, 3]
    trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    j = trace * torch.eye(3, dtype=torch.float64) - second
    entries = [j[..., a, b] for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    return torch.cat([m[..., None], h, torch.stack(entries, -1)], -1)


def errors_by_definition(
    robot: Robot, motion: tuple[Tensor, ...], sets: InertialParameters, reference: Tensor
) -> WrenchErrors:
    w = by_recursion(robot, motion, sets).unflatten(-1, (2, 3))
    r = joint_wrenches(robot, *motion, InertialParameters(reference)).unflatten(-1, (2, 3))
    force, moment = (w - r).norm(dim=-1).unbind(-1)
    force_norm, moment_norm = (w.norm(dim=-1) - r.norm(dim=-1)).unbind(-1)
    torque = inverse_dynamics(robot, *motion, InertialParameters(sets.pi[:, None]))
    torque = torque - inverse_dynamics(robot, *motion, InertialParameters(reference))

    def rms(x: Tensor) -> Tensor:
        return x.square().mean(-2).sqrt()

    return WrenchErrors(
        force_rms=rms(force),
        moment_rms=rms(moment),
        force_max=force.amax(-2),
        moment_max=moment.amax(-2),
        force_norm_rms=rms(force_norm),
        moment_norm_rms=rms(moment_norm),
        torque_rms=rms(torque),
        reference_force_rms=rms(r[:, :, 0].norm(dim=-1)),
        reference_moment_rms=rms(r[:, :, 1].norm(dim=-1)),
    )


@pytest.mark.parametrize(("k", "instants"), [(1, 1), (5, 30), (regressor.SETS + 1, 3)])
def test_errors_equal_their_definition(robot: Robot, k: int, instants: int) -> None:
    check_errors(robot, k, instants)


@pytest.mark.parametrize("size", [(2, 7), (3, 1), (100, 1000)])
def test_tiles_do_not_matter(size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regressor, "SETS", size[0])
    monkeypatch.setattr(regressor, "INSTANTS", size[1])
    robot = arm("mixed")
    check_errors(robot, 7, 31)
    motion, sets = states(robot, 31), any_sets(robot, 7)
    wrenches = internal_wrenches(robot, *motion, sets)
    assert relative(wrenches, by_recursion(robot, motion, sets)) < 1e-13


def check_errors(robot: Robot, k: int, instants: int) -> None:
    motion, sets = states(robot, instants), any_sets(robot, k)
    assert robot.parameters is not None
    found = wrench_errors(robot, *motion, sets, robot.parameters)
    expected = errors_by_definition(robot, motion, sets, robot.parameters.pi)
    for f in fields(WrenchErrors):
        a, b = getattr(found, f.name), getattr(expected, f.name)
        assert a.shape == b.shape
        assert torch.allclose(a, b, rtol=1e-10, atol=1e-12 * float(b.max())), f.name


def test_no_difference_is_exactly_zero(robot: Robot) -> None:
    reference = robot.require_parameters("the test")
    errors = wrench_errors(
        robot, *states(robot, 20), InertialParameters(reference.pi[None]), reference
    )
    for f in fields(WrenchErrors)[:7]:
        assert (getattr(errors, f.name) == 0).all(), f.name
    assert (errors.reference_force_rms > 0).all()


def test_equal_base_parameters_give_equal_torques_but_other_wrenches(robot: Robot) -> None:
    reference = robot.require_parameters("the test")
    sets = same_torques(robot, reference, 4)
    errors = wrench_errors(robot, *states(robot, 50), sets, reference)
    assert (errors.torque_rms < 1e-12 * errors.moment_rms.max()).all()
    assert errors.force_rms[:, 0].min() > 1e-2
    assert (errors.force_norm_rms <= errors.force_rms + 1e-11).all()


def test_a_bad_set_leaves_the_others_alone(lwr: Robot) -> None:
    motion, good = states(lwr, 30), any_sets(lwr, 6)
    pi = good.pi.clone()
    pi[2, 3, 5], pi[4, 0, 0] = torch.nan, torch.inf
    bad = InertialParameters(pi)
    keep = [0, 1, 3, 5]
    reference = lwr.require_parameters("the test")
    found, expected = (wrench_errors(lwr, *motion, s, reference) for s in (bad, good))
    for f in fields(WrenchErrors)[:7]:
        a, b = getattr(found, f.name), getattr(expected, f.name)
        torch.testing.assert_close(a[keep], b[keep], rtol=1e-12, atol=1e-12)
    assert found.moment_rms[2, :4].isnan().all()
    torch.testing.assert_close(
        found.moment_rms[2, 4:], expected.moment_rms[2, 4:], rtol=1e-12, atol=1e-12
    )  # beyond the bad link
    assert not found.force_rms[4, 0].isfinite()
    wrenches = internal_wrenches(lwr, *motion, bad)
    torch.testing.assert_close(
        wrenches[keep], internal_wrenches(lwr, *motion, good)[keep], rtol=1e-12, atol=1e-12
    )
    assert wrenches[2, :, 0, 3:].isnan().all()


def test_single_precision(lwr: Robot) -> None:
    motion, sets = states(lwr, 30), any_sets(lwr, 3)
    reference = lwr.require_parameters("the test")
    single = [x.float() for x in motion]
    wrenches = internal_wrenches(lwr, *single, sets.to(dtype=torch.float32))
    assert wrenches.dtype == torch.float32
    assert relative(wrenches.double(), internal_wrenches(lwr, *motion, sets)) < 1e-5
    errors = wrench_errors(
        lwr, *single, sets.to(dtype=torch.float32), reference.to(dtype=torch.float32)
    )
    exact = wrench_errors(lwr, *motion, sets, reference)
    assert relative(errors.moment_norm_rms.double(), exact.moment_norm_rms) < 1e-5


def test_too_large_a_result_says_what_to_do(lwr: Robot) -> None:
    motion, sets = states(lwr, 100), any_sets(lwr, 50)
    with pytest.raises(TorchidError, match=r"(?s)takes 1\.6 MiB.*at most.*wrench_errors"):
        internal_wrenches(lwr, *motion, sets, memory_limit=10**6)


def test_bad_input_is_refused(lwr: Robot, types_unchecked: None) -> None:
    motion, sets = states(lwr, 5), any_sets(lwr, 2)
    reference = lwr.require_parameters("the test")
    with pytest.raises(TorchidError, match="instants, 7 joints"):
        internal_wrenches(lwr, *[x[:, :6] for x in motion], sets)
    with pytest.raises(TorchidError, match="sets, 7 links"):
        internal_wrenches(lwr, *motion, reference)
    with pytest.raises(TorchidError, match="one set"):
        wrench_errors(lwr, *motion, sets, sets)
    broken = motion[1].clone()
    broken[3, 4] = torch.nan
    with pytest.raises(TorchidError, match=r"dq is not finite at instant 3 .*joint 5"):
        wrench_errors(lwr, motion[0], broken, motion[2], sets, reference)
    with pytest.raises(TorchidError, match="no instants"):
        wrench_errors(lwr, *[x[:0] for x in motion], sets, reference)
    nan = InertialParameters(reference.pi * torch.nan)
    with pytest.raises(TorchidError, match="reference"):
        wrench_errors(lwr, *motion, sets, nan)
