"""Which candidates there are."""

from collections import Counter
from dataclasses import replace

import pytest
import torch

from tests.gap.problems import data_of, measured, question_of
from torchid.effects.backlash import IMPACTS, WIDTHS, Backlash
from torchid.effects.friction import CoulombFriction
from torchid.effects.gravity import TorqueCrosstalk


@pytest.mark.parametrize("joint", [0, 1])
def test_a_fine_grid_is_where_a_coarse_one_explains_something(joint: int) -> None:
    """A play between two of the coarse grid, beside friction that is far larger; elsewhere noise
    and friction are all there is."""
    width = WIDTHS[5]
    play = Backlash(joint, width, *IMPACTS[0])
    planted = [(CoulombFriction(j), [3.0]) for j in range(3)]
    data = measured([*planted, (play, [width])], noise=0.05, count=1)
    names = ("coulomb_friction", "backlash")
    found = question_of(data, names).candidates.terms
    plays = [t.effects[0] for t in found if t.name == "backlash"]
    counts = Counter(e.joints[0] for e in plays)
    coarse = len(IMPACTS) * len(WIDTHS[::2])
    assert counts == {j: len(IMPACTS) * len(WIDTHS) if j == joint else coarse for j in range(3)}
    assert play in plays
    # What was refined stands beside the grid once, whether or not the grid has it.
    extra = [play, Backlash(joint, 1.1 * width), Backlash(2, width, *IMPACTS[0])]
    again = question_of(data, names, extra=extra).candidates.terms
    assert all([t.effects for t in again].count((e,)) == 1 for e in extra)


@pytest.mark.parametrize("logged", [1.0, 0.0])
def test_crosstalk_is_of_a_torque_that_is_logged(logged: float) -> None:
    """What a passive joint, or one without a sensor, would need is read by no other sensor."""
    data = measured([(TorqueCrosstalk(0, 1), [0.02])], noise=0.05, count=1)
    keep = torch.tensor([1.0, logged, 1.0]).double()
    data = data_of([replace(s, tau=s.tau * keep) for s in data.segments])
    terms = question_of(data, ("torque_crosstalk",)).candidates.terms
    sources = {t.effects[0].source_joint for t in terms if t.effects}
    assert (1 in sources) == (logged > 0)
    assert {0, 2} <= sources
