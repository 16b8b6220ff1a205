"""Motions that were left out: servos as the others tell them, and what the answer leaves there."""

from dataclasses import replace

import pytest
import torch

from tests.position.planted import planted, robot, true_servos
from torchid.effects.servo import INDEX
from torchid.position.checked import Checked, folds_of
from torchid.position.data import prepare
from torchid.position.effects import CORE
from torchid.position.judge import equations
from torchid.position.record import Accuracy
from torchid.position.servo_model import Motions, ServoModel
from torchid.simulation.servo_loop import windows_of


def test_servos_without_a_motion_are_those_that_are_fitted_to_the_others():
    """One step of the others' normal equations goes where a fit to them does, and of a motion with
    servos of its own it takes these away."""
    log = planted(true_servos(3), motions=3, seconds=10.0)
    other = planted(true_servos(3, damping=(2, 26.0)), motions=3, seconds=10.0)
    mixed = torch.where((log.trajectory == 2)[:, None], other.q, log.q)
    data = prepare(robot(), log.replace(q=mixed))
    windows, every = windows_of(data.tracks, 2.0), torch.ones(3, dtype=torch.bool)
    model = ServoModel(true_servos(3), dict.fromkeys(CORE, every)).fitted(Motions(data, windows), 6)
    gone = torch.arange(3) == 2
    told = equations(data, model.servos, model.free, windows).without(gone)
    others = Motions(data, windows.some(torch.nonzero(~gone[windows.motion]).flatten()))
    fitted = model.fitted(others, 6)
    apart = [x.of("damping")[1] / x.of("kp")[1] for x in (model.servos, told, fitted.servos)]
    assert abs(float(apart[1] / apart[2]) - 1) < 0.2 * abs(float(apart[0] / apart[2]) - 1)
    before, one, best = (others.losses(x).sum(0)[1] for x in (model.servos, told, fitted.servos))
    assert float((before - one) / (before - best)) > 0.9


def test_limits_of_set_points_stay_where_all_motions_have_them():
    servos = true_servos(3, acceleration=(2, 4.0))
    data = prepare(robot(), planted(servos, motions=2, seconds=10.0))
    windows, every = windows_of(data.tracks, 2.0), torch.ones(3, dtype=torch.bool)
    free = dict.fromkeys(CORE, every) | {"acceleration": torch.arange(3) == 1}
    told = equations(data, servos, free, windows).without(torch.tensor([True, False]))
    k = INDEX["acceleration"]
    assert torch.equal(told.joint[:, k], servos.joint[:, k])
    assert not torch.equal(told.of("kp"), servos.of("kp"))


@pytest.mark.parametrize("file", [True, False])
def test_what_the_answer_leaves_is_told_beside_the_servos_before(file):
    def way(*size: float) -> Accuracy:
        error = torch.tensor([*size, torch.nan], dtype=torch.float64)
        return Accuracy.of_joints(error, error)

    none = torch.zeros(1, 3)
    one = Checked(way(9, 9), way(4, 2), way(2, 1), way(8, 4), (none, none), (0.0, 1.0))
    one = one if file else replace(one, file=None)
    left, whole = one.left(torch.tensor([0.0, 1e-3, 1e-3]).double())
    # An error of what calls for no cause, and a joint that never moves, leave nothing.
    assert left.tolist() == pytest.approx([4e-6, 0.0, 0.0])
    assert whole == pytest.approx(4 / (80 if file else 20))


def test_every_fifth_motion_is_in_one_fold():
    assert folds_of(7).tolist() == [0, 1, 2, 3, 4, 0, 1]
    assert folds_of(2).tolist() == [0, 1]
