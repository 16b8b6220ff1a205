"""From a log that cannot show an effect, by the designed motion, to a diagnosis that names it."""

from dataclasses import replace

import pytest
import torch
from msgspec import structs

from tests.excitation.usage import full_design
from torchid.effects.base import Motion
from torchid.effects.registry import effect_torque
from torchid.errors import TorchidError
from torchid.excitation.design import InformedDesign
from torchid.excitation.synthetic import nominal_torque
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.next_motion.ambiguity import open_questions, rivals
from torchid.next_motion.design import excite_for
from torchid.next_motion.separating_motion import design_separation
from torchid.robot.library import load_robot

NOISE = torch.tensor([0.006, 0.08, 0.026], dtype=torch.float64)
KNOWN = ("viscous_friction", "coulomb_friction", "torque_offset", "joint_spring")


def driven_twice(robot, trajectory, effects):
    """Torque along the motion with white noise of its own in each run."""
    motion = trajectory_log(trajectory, 100.0)
    state = Motion(motion.q, motion.dq, motion.ddq, t=motion.t)
    tau = nominal_torque(robot, state) + effect_torque(robot, effects, state)
    generator = torch.Generator().manual_seed(1)
    noise = (NOISE * torch.randn(2, *tau.shape, generator=generator, dtype=torch.float64)).unbind()
    return Log.concatenate([motion.replace(ddq=None, tau=tau + e) for e in noise])


def diagnosed(robot, log):
    settings = GapSettings(effects=KNOWN, parameters="free")
    return diagnose_torque(robot, log, settings=settings)


@pytest.mark.slow
def test_what_a_log_could_not_show_is_found_after_the_designed_motion():
    """Joint 3 rests, and joint 2 hardly turns: friction of the one is not excited, and the offset
    of the other is nearly a combination of base parameters."""
    robot = load_robot("3r")
    poor = random_trajectory(robot, 3, fill=True, usage=0.3, harmonics=2, duration=10.0)
    moves = torch.tensor([[1.0], [1.0], [0.0]], dtype=torch.float64)
    found = diagnosed(
        robot, driven_twice(robot, replace(poor, a=poor.a * moves, b=poor.b * moves), [])
    )
    hidden = {(x.effect, *x.joints): x.reason for x in found.not_testable}
    assert hidden["viscous_friction", 2] == "the motion does not excite it"
    assert "indistinguishable from" in hidden["torque_offset", 1]

    left = open_questions(found.record, robot, "gap.json")
    assert left.kind == "not_testable"
    plain = full_design(robot, seed=0, restarts=2, iterations=50, duration=10.0).trajectory
    made = design_separation(left.setting, rivals(left, plain), plain, seed=0, evaluations=200)
    assert all(told.reached >= 1 for told in made.after)
    sizes = {(r.truth.effect.name, r.truth.effect.joint): r.truth for r in made.rivals}
    asked = [sizes["viscous_friction", 2], sizes["torque_offset", 1]]
    planted = [(e.effect, list(e.values)) for e in asked]
    again = diagnosed(robot, driven_twice(robot, made.trajectory, planted))
    named = {(f.effect, f.at[0]): f.sizes[0].value for f in again.which}
    assert set(named) == {("viscous_friction", 2), ("torque_offset", 1)}
    for effect, values in planted:
        assert named[effect.name, effect.joint] == pytest.approx(values[0], rel=0.2)
    assert not {(x.effect, *x.joints) for x in again.not_testable} & set(sizes)


@pytest.mark.slow
def test_a_motion_for_what_a_diagnosis_knows_least() -> None:
    """By its corrected model, which says how sure it is after this log."""
    robot = load_robot("3r")
    still = random_trajectory(robot, 3, fill=True, usage=0.3, harmonics=2, duration=10.0)
    found = diagnose_torque(
        replace(robot, parameters=None),
        driven_twice(robot, still, []),
        settings=GapSettings(effects=KNOWN),
    )
    made = excite_for(found, robot, goal="d_optimal", duration=6.0, restarts=1)
    assert isinstance(made, InformedDesign)
    known = made.prior.known
    assert bool((made.after[known] <= made.before[known] * (1 + 1e-9)).all())
    assert made.shrinks(made.after) < 0.9
    older = structs.replace(found.record, corrected=replace(found.corrected, knowledge=None))
    with pytest.raises(TorchidError, match="how sure the corrected model is"):
        excite_for(older, robot, goal="d_optimal")
