"""A file's gain beside the file's other numbers: doubted where most of these say another one."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from tests.position.planted import planted, robot, true_servos
from torchid.effects.servo import INDEX
from torchid.position.data import WINDOW_S, prepare
from torchid.position.diagnose import diagnose_positions
from torchid.position.judge import equations
from torchid.position.known_numbers import contradicted, doubt_of
from torchid.position.model import ServoArm
from torchid.position.search import plain
from torchid.position.servo_model import Motions
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of

CLIP = 120.0


@cache
def fitted():
    """Motions, and the equations of plain servos there."""
    data = prepare(robot(), planted(true_servos(3, clip=(2, CLIP)), motions=3))
    windows = windows_of(data.tracks, WINDOW_S)
    model = plain(Motions(data, windows))
    return data, equations(data, model.servos, model.free, windows)


def file_of(**factors: float) -> Servos:
    """The true servos, all joints' numbers of these names times a factor."""
    servos = true_servos(3, clip=(2, CLIP))
    joint = servos.joint.clone()
    for name, factor in factors.items():
        joint[:, INDEX[name]] *= factor
    return replace(servos, joint=joint)


@pytest.mark.parametrize("factor", [50.0, 5.0, 0.1])
def test_a_gain_that_all_else_contradicts_is_doubted(factor):
    gains = contradicted(fitted()[0], file_of(kp=factor), fitted()[1])
    assert gains.tolist() == pytest.approx([260.0] * 3, rel=0.3)


@pytest.mark.parametrize(
    "factors",
    [{}, {"kp": 1.5}, {"kp": 0.7}, {"clip": 0.5}, {"damping": 10.0}, {"coulomb": 30.0}],
    ids=str,
)
def test_no_other_number_makes_a_gain_doubted(factors):
    """Nor a gain that may be a unit's own, nor one that a cause of its own explains."""
    gains = contradicted(fitted()[0], file_of(**factors), fitted()[1])
    assert bool(gains.isnan().all())


def test_units_of_one_type_that_come_out_far_apart_are_a_doubt():
    none, file = torch.full((3,), math.nan), file_of()
    here, open_ = torch.tensor([260.0, 70.0, 250.0]), torch.zeros(3, dtype=torch.bool)
    assert "come out with 70 to 260:" in doubt_of(file, none, here, open_)
    assert not doubt_of(file, none, here, torch.tensor([False, True, False]))


@pytest.mark.slow
def test_a_placeholder_takes_no_limit_away():
    """Of a gain fifty times too large the file's own limit of torque is the other victim."""
    log = planted(true_servos(3, clip=(2, CLIP)), motions=4)
    file = ServoArm(robot(), file_of(kp=50.0), torch.ones(3, dtype=torch.float64))
    found = diagnose_positions(robot(), log, start=file)
    assert found.answer.headline.startswith("The file's gain of 13000 N m/rad")
    assert "saturation" not in {c.effect for c in found.answer.causes if c.how_sure > 0.5}
    assert float(found.servos.of("clip")[1]) == pytest.approx(CLIP, rel=0.35)
    assert found.answer.after.value < 0.3 * found.answer.before.value
