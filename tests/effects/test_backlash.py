"""The play operator against a loop, the column against the torque of the lagging arm; how the link
crosses the play is in `test_gear.py`."""

import pytest
import torch

from tests.arms import arm
from tests.effects.exact_logs import smooth_motion
from tests.oracles import PinocchioOracle
from torchid.effects.backlash import STEP, Backlash
from torchid.effects.gear import Gear, joint_load, link_lag


@pytest.mark.parametrize("width", [2e-3, 1e-2])
def test_column_is_a_secant_of_pinocchios_torque(width: float) -> None:
    robot = arm("panda")
    motion = smooth_motion(robot, 600)
    assert motion.t is not None
    effect = Backlash(4, at=width)
    load, column = (x[:, None] for x in joint_load(robot, motion.state, 4))
    column = column[..., 4]
    gear = Gear.ringing(float(column.mean()), effect.contact, effect.ratio, width)
    lagging = [x.clone() for x in motion.state]
    for x, lag in zip(lagging, link_lag(load, column, motion.t, gear), strict=True):
        x[:, 4] -= lag[:, 0]
    oracle = PinocchioOracle(robot)
    change = oracle.inverse_dynamics(*lagging) - oracle.inverse_dynamics(*motion.state)
    column = effect.torque_columns(motion, robot)[..., 0]
    torch.testing.assert_close(width * column, change, rtol=1e-8, atol=1e-8)


def test_widths_around_one_come_closer() -> None:
    effect = Backlash(4, at=2e-3)
    first, third = (effect.around(level, 0.05) for level in (0, 2))
    assert {e.identity for e in first} == {effect.identity}
    assert max(e.at for e in first) == pytest.approx(2e-3 * STEP ** (2 / 3))
    assert max(e.at for e in third) < 2e-3 * STEP**0.1
    assert effect.unsure([2.5e-3]) == [pytest.approx(5e-4)]


def test_columns_of_several_are_those_of_each() -> None:
    robot = arm("3r")
    motion = smooth_motion(robot, 400, rate=250.0)
    plays = [e for e in Backlash.starts(robot) if e.joints == (1,)]
    # Along two trajectories, too, of which the second is a part of the first.
    part = motion.part(slice(100, 350))
    together, shorter = zip(*Backlash.columns_along(plays, [motion, part], robot), strict=True)
    assert len(together) == len(plays) > 8
    for k in (0, len(plays) - 1):
        alone = plays[k].torque_columns(motion, robot)
        torch.testing.assert_close(together[k], alone, rtol=1e-9, atol=1e-9)
        alone = plays[k].torque_columns(part, robot)
        torch.testing.assert_close(shorter[k], alone, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rotor", [0.0, 0.3])
def test_a_rotor_stays_with_its_motor(rotor: float) -> None:
    """Without play in sight of the motion the two masses are one, whichever has how much."""
    robot = arm("3r")
    motion = smooth_motion(robot, 400, rate=250.0)
    held = Backlash(2, at=1e-9, rotor=rotor).all_torques(motion, [1e-9], robot)
    scale = Backlash(2, at=1e-2, rotor=rotor).all_torques(motion, [1e-2], robot)
    assert float(held.abs().mean()) < 0.1 * float(scale.abs().mean())


def test_sharp_shapes_keep_size_and_place() -> None:
    effect = Backlash(1, at=3e-3)
    shapes = effect.sharp()
    assert {(e.identity, e.at) for e in shapes} == {(effect.identity, 3e-3)}
    assert len(set(shapes)) == len(shapes)
