"""Sizes beside those of the robot: what no such robot has is not offered, and what no motion tells
is not known."""

import math
from dataclasses import replace

import pytest
import torch

from tests.arms import consistent_parameters, mixed_arm
from tests.gap.motions import ROBOT
from tests.gap.problems import measured, motions, problem_of, wanted_of
from torchid.design.columns import Columns, Model
from torchid.design.segments import Samples
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.gravity import TorqueGain
from torchid.effects.inertia import Payload
from torchid.effects.instants import shifted
from torchid.effects.phase import FilterLag
from torchid.effects.transient import Contact
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.scale import Scale
from torchid.robot.inertia import InertialParameters
from torchid.statistics.criteria import BEYOND_ROBOT


def test_sizes_are_those_of_the_robot() -> None:
    data = measured([])
    scale = Scale(Columns(Model(ROBOT, ()), data.samples))
    mass = float(ROBOT.require_parameters("a test").mass.sum())
    sizes = scale.largest([Payload()])
    assert float(sizes[0]) == pytest.approx(BEYOND_ROBOT * max(mass, scale.mass))
    assert scale.mass >= mass
    assert sizes[1:4].tolist() == pytest.approx([float(sizes[0]) * scale.length] * 3)
    torque = max(float(s.tau[:, 1].abs().max()) for s in data.segments)
    assert 0.5 * BEYOND_ROBOT * torque < float(scale.largest([CoulombFriction(1)])[0])
    assert float(scale.largest([CoulombFriction(1)])[0]) <= BEYOND_ROBOT * torque * 1.01
    speed = torch.cat([m.dq[:, 1].abs() for m in motions()]).max()
    assert (
        float(scale.largest([ViscousFriction(1)])[0]) > BEYOND_ROBOT * torque / float(speed) * 0.5
    )


def test_a_limit_of_a_joint_is_its_torque() -> None:
    """Where the file knows one; an unlimited joint has the log's own."""
    ends = torch.tensor([[-40.0, 30.0], [-torch.inf, torch.inf], [-1e-9, 1e-9]]).double()
    limited = ROBOT.with_limits(torque=ends)
    samples = measured([]).samples
    plain, own = (Scale(Columns(Model(r, ()), samples)).torque for r in (ROBOT, limited))
    assert own.tolist() == [max(40.0, float(plain[0])), *plain[1:].tolist()]


def test_a_force_is_one_that_the_arm_can_make_in_either_direction() -> None:
    """Its largest torque over its reach; a joint that slides needs no lever."""
    columns = Columns(Model(ROBOT, ()), measured([]).samples)
    scale = Scale(columns)
    most = BEYOND_ROBOT * float(scale.torque.max()) / scale.length
    assert scale.largest([Contact()]).tolist() == pytest.approx([most] * 3)
    push = Library(problem_of(measured([]), wanted_of(("contact",)))).of_event(Contact(2.0, 3.0))
    assert push is not None
    assert (-push.low).tolist() == push.high.tolist() == pytest.approx([most] * 3)
    gantry = mixed_arm("PPP").with_parameters(consistent_parameters(3, seed=1))
    sliding = Scale(Columns(Model(gantry, ()), columns.samples))
    most = BEYOND_ROBOT * float(sliding.torque.max())
    assert sliding.largest([Contact()]).tolist() == pytest.approx([most] * 3)


@pytest.mark.parametrize("scale", [0.4, 1.6, 2.0, 5.0])
def test_a_gain_of_any_size_is_offered_where_the_log_has_the_models_torque(scale: float) -> None:
    """One joint in percent of its rating; an arm of which all joints are, shares the gain."""
    data = measured([])
    gains = [TorqueGain(j) for j in range(3)]
    for joints in ([1], [0, 1, 2]):
        factor = torch.ones(3, dtype=torch.float64)
        factor[joints] = scale
        scaled = [replace(s, tau=s.tau * factor) for s in data.segments]
        samples = Samples(scaled, data.samples.cutoff)
        sizes = Scale(Columns(Model(ROBOT, ()), samples))
        largest = float(sizes.largest([gains[j] for j in joints])[0])
        assert math.isinf(largest) == (scale > 1.7)
        others = [j for j in range(3) if j not in joints]
        assert all(float(sizes.largest([gains[j]])[0]) == 0.7 for j in others)


def test_a_gain_of_any_size_is_no_stand_in_for_another_torque() -> None:
    """Friction alone, of a joint whose model has next to no torque."""
    data = measured([(CoulombFriction(1), [30.0])])
    weightless = ROBOT.with_parameters(
        InertialParameters(0.01 * ROBOT.require_parameters("a test").pi)
    )
    scale = Scale(Columns(Model(weightless, ()), data.samples))
    assert float(scale.largest([TorqueGain(1)])[0]) == 0.7


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_velocities_are_late_by_what_positions_say(late: float) -> None:
    data = measured([])
    (first, *rest) = data.segments
    t = first.motion.require("t", "a test")
    slow = first.motion._replace(dq=shifted(first.motion.dq, t, -late))
    samples = Samples([replace(first, motion=slow), *rest], data.samples.cutoff)
    most = float(Scale(Columns(Model(ROBOT, ()), samples)).largest([FilterLag()])[0])
    assert most == pytest.approx(late + 1 / samples.rate, abs=1e-3)
