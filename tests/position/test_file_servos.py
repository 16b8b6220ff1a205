"""An answer begins with what the robot's file errs by, and says what of the file is wrong."""

import math
from dataclasses import replace

import pytest
import torch

from tests.marks import some
from tests.position.planted import planted, robot, true_servos
from tests.simulation.bodies import flywheel
from torchid.effects.servo import INDEX, PARAMETERS, TORQUES, ServoMotion
from torchid.position.diagnose import diagnose_positions
from torchid.position.diagnosis import Number
from torchid.position.file_servos import weighing_otherwise
from torchid.position.findings import has_changed, in_degrees
from torchid.position.model import ServoArm
from torchid.position.replay import replay
from torchid.report.brief import model_words
from torchid.results.words import digits
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos

DEGREES = 180 / math.pi


def arm_of(servos: Servos, of: Robot | None = None) -> ServoArm:
    return ServoArm(of or robot(), servos, torch.ones(3, dtype=torch.float64))


def with_value(servos: Servos, name: str, value: float, joint: int | None = None) -> Servos:
    """On one joint, from 1, or on all."""
    table = servos.joint.clone()
    table[slice(None) if joint is None else joint - 1, INDEX[name]] = value
    return replace(servos, joint=table)


@pytest.mark.parametrize(
    ("was", "changed", "perhaps"),
    [(25.0, False, False), (20.0, False, True), (5.0, True, True), (math.nan, False, False)],
)
def test_a_number_that_the_file_has_within_its_interval_has_not_changed(was, changed, perhaps):
    size = Number("kp", "N m/rad", 27.0, (17.0, 37.0), was)
    assert has_changed(size) == changed
    assert has_changed(size, 0.5) == perhaps


@pytest.mark.parametrize(
    ("factor", "degrees"), [(DEGREES, True), (0.9 / DEGREES, True), (40.0, False), (1.0, False)]
)
def test_a_gain_in_degrees_is_told_by_its_factor(factor, degrees):
    assert in_degrees(factor) == degrees


@pytest.mark.parametrize("stiff", [2.0, 12.0, 25.0])
def test_limits_are_tried_however_stiff_the_servo_is(stiff):
    """From some size on that is tried the limit's own slope leads to it: none is further away than
    a factor of two."""
    u = torch.linspace(-1, 1, 1001, dtype=torch.float64)[:, None]
    sizes = PARAMETERS[INDEX["clip"]].sizes
    assert sizes is not None
    kp = torch.tensor([stiff * 2.2], dtype=torch.float64)
    tried = sizes(ServoMotion(u, torch.zeros_like(u), torch.zeros_like(u), kp)).flatten()
    assert float((tried / 2.2).log().abs().min()) < math.log(2.0)


WRONG = {
    # The file's number on joints 1 to 3, and what the arm has.
    "proportional_gain": ("kp", [260.0 / DEGREES] * 3, 260.0),
    "saturation": ("clip", [math.inf, 40.0, math.inf], math.inf),
    "viscous_friction": ("damping", [22.0, 66.0, 22.0], 22.0),
}


@pytest.mark.parametrize("cause", some(WRONG, 1))
def test_the_first_number_is_the_files(cause):
    name, values, true = WRONG[cause]
    file = arm_of(with_value(true_servos(3), name, true))
    file.servos.joint[:, INDEX[name]] = torch.tensor(values).double()
    log, start = planted(true_servos(3), motions=3, seconds=12.0, seed=4), file
    if cause == "saturation":  # of the arm, and the file has none
        log = planted(file.servos, motions=3, seconds=12.0, seed=4)
        start = arm_of(true_servos(3))
    found = diagnose_positions(robot(), log, start=start)
    answer = found.answer
    # The diagnosis has the body near the measured motion, the replay where it goes.
    assert answer.before.value == pytest.approx(float(replay(start, log).error.mean()), rel=0.1)
    assert answer.error == "the error of the file's servos"
    assert answer.status == "explained"
    joints = {j for j in range(3) if values[j] != true}
    named = {(c.effect, c.joints[0]) for c in answer.causes}
    assert named == {(cause, j) for j in joints}
    assert all("180/pi" in c.remedy for c in answer.causes) == (cause == "proportional_gain")
    (size,) = answer.causes[0].sizes
    if cause == "saturation":
        # The gain is the file's, so that a torque is one: no share of the gain.
        assert (size.name, size.unit, size.was) == ("clip", "N m", None)
        assert size.value == pytest.approx(40.0, rel=0.03)
        assert "new" in {c.state for c in found.changes if c.parameter == "clip"}
    else:
        at = answer.causes[0].joints[0]
        assert size.was == pytest.approx(values[at])
        assert size.value == pytest.approx(true, rel=0.1)
        assert f"{digits(size.was)} -> " in answer.headline
    assert not bool(found.ratio_only.any())
    assert found.record.how_far.file.whole_mrad == answer.before.value
    assert "as it is" not in model_words(answer, None, "arm.xml")


@pytest.mark.slow
@pytest.mark.parametrize("light", [True, False])
def test_gravity_that_a_controller_takes_out(light):
    """An arm whose servos do not feel its weight, or do, and a file that says the other thing."""
    plain = robot()
    other = replace(plain, compensated=plain.require_parameters("a test").pi[:, :4])
    true, wrong = (other, plain) if light else (plain, other)
    log = planted(true_servos(3), motions=3, seconds=12.0, robot=true, seed=4)
    right = diagnose_positions(true, log, start=arm_of(true_servos(3), true))
    assert right.status == "no_gap"
    assert right.answer.before.value == right.answer.after.value < 1.5
    assert "gives no better model" in model_words(right.answer, None, "arm.xml")
    found = diagnose_positions(wrong, log, start=arm_of(true_servos(3), wrong))
    assert [c.effect for c in found.answer.causes] == ["gravity_compensation"]
    assert found.answer.before.value > 10 * found.answer.after.value
    assert found.status == "explained"
    assert (found.corrected.robot.compensated is None) == (true.compensated is None)
    data = found.data
    assert (weighing_otherwise(data).robot.compensated is None) != (true.compensated is None)


@pytest.mark.slow
def test_torques_that_nothing_anchors_stand_beside_the_files_gain():
    """All torques of a balanced joint are three times the file's, which no motion shows, and its
    damping is twice that."""
    body = flywheel()
    light = body.with_parameters(InertialParameters(1e-5 * body.require_parameters("it").pi))
    servos = Servos.neutral(1, kp=15.0, damping=0.6, armature=0.03, delay=0.02, coulomb=0.08)
    true = replace(servos, joint=servos.joint.clone())
    true.joint[:, [INDEX[name] for name in TORQUES]] *= 3.0
    true = with_value(true, "damping", 6 * 0.6)
    log = planted(true, motions=3, seconds=12.0, robot=light)
    start = ServoArm(light, servos, torch.ones(1, dtype=torch.float64))
    found = diagnose_positions(light, log, start=start)
    assert float(found.servos.of("kp")) == 15.0
    assert [(c.effect, c.joints) for c in found.answer.causes] == [("viscous_friction", (0,))]
    # No motion tells it from a gain that is half of the file's.
    assert found.answer.causes[0].ambiguous_with == ("proportional_gain",)
    (size,) = found.answer.causes[0].sizes
    assert (size.was, size.unit) == (pytest.approx(0.6), "N m s/rad")
    assert size.value == pytest.approx(1.2, rel=0.05)
    assert found.corrected.unanchored == ()
    # Without servos in the file the same is a ratio, and no export has it as a number.
    plain = diagnose_positions(light, log)
    assert plain.corrected.unanchored == (0,)
    assert "plain servo" in plain.answer.error
