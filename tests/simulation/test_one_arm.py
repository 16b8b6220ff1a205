"""One arm in plain numbers moves as the same arm in tensors does."""

import math

import pytest
import torch

from tests.arms import arm
from tests.simulation.bodies import bare, reference
from torchid.effects.registry import KINDS
from torchid.robot.library import load_robot
from torchid.simulation import closed_loop as simulation
from torchid.simulation.closed_loop import closed_loop
from torchid.simulation.controller import Controller
from torchid.simulation.loads import changes_measurement
from torchid.simulation.straight_line import NotStraightError, StraightLine


def both(robot, log, effects, monkeypatch, **how):
    """The log in plain numbers, and in tensors; how often plain numbers did."""
    asked = []

    def counted(*arguments):
        asked.append(plain(*arguments))
        return asked[-1]

    plain = simulation.stepped
    monkeypatch.setattr(simulation, "stepped", counted)
    (fast,) = closed_loop(robot, [log], [effects], **how)
    monkeypatch.setattr(simulation, "stepped", lambda *_: None)
    (slow,) = closed_loop(robot, [log], [effects], **how)
    return fast, slow, asked[0] is not None


def same(fast, slow):
    for name in ("q", "dq", "ddq", "tau"):
        one, other = getattr(fast, name), getattr(slow, name)
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


def acting(name, robot):
    """An effect of a kind on joint 2 as its example has it, or None where it needs more."""
    kind = KINDS[name]
    given = {"joint": 1} if "joint" in kind.__dataclass_fields__ else {}
    effect = kind(**given, **kind.example.given)
    values = [0.1 * v for v in kind.example.values]
    return None if changes_measurement(effect) else (effect, values)


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction", "ur10e"])
def test_robots_with_friction(name, monkeypatch):
    robot = load_robot(name)
    fast, slow, plain = both(robot, reference(robot, 0.3), [], monkeypatch)
    assert plain
    same(fast, slow)


@pytest.mark.parametrize("name", KINDS)
def test_every_effect_that_acts_on_an_arm(name, monkeypatch):
    robot = bare("3r")
    law = acting(name, robot)
    if law is None:
        pytest.skip("in the sensors alone")
    fast, slow, _ = both(robot, reference(robot, 0.2), [law], monkeypatch)
    same(fast, slow)


def test_a_joint_that_sticks_and_a_drive_at_its_limit(monkeypatch):
    robot = arm("3r")
    held = Controller(1.5, torque_limit=(20.0, 8.0, 1.0))
    stiff = [(KINDS["coulomb_friction"](joint=k), [3.0]) for k in range(3)]
    fast, slow, plain = both(robot, reference(robot, 0.4), stiff, monkeypatch, controller=held)
    assert plain
    assert bool((fast.dq[:, 2] == 0.0).any())
    same(fast, slow)


def test_what_branches_is_not_straight():
    with pytest.raises(NotStraightError):
        StraightLine(lambda x: [x if bool(x > 0) else -x], {"x": ()})


def test_early_numbers_are_kept_for_late_ones():
    code = StraightLine(
        lambda a, b: [a.sin() * b, a.sin() + 0.0 * b], {"a": (2,), "b": (2,)}, ["b"]
    )
    known = code.early(0.5, 1.0)
    sines = [math.sin(0.5), math.sin(1.0)]
    assert known == tuple(sines)
    assert code.late(known, 3.0, 3.0) == (3 * sines[0], 3 * sines[1], *sines)
