"""Which candidates there are."""

from collections import Counter
from dataclasses import replace

import pytest
import torch

from tests.gap.problems import data_of, measured, question_of
from torchid.effects.backlash import IMPACTS, WIDTHS, Backlash
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.gravity import TorqueCrosstalk
from torchid.gap.search.explain import fit_anew
from torchid.gap.search.terms import term_columns


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


def test_crosstalk_has_its_size_although_the_model_lacks_the_friction_of_its_source() -> None:
    """The sensor reads the torque that is there. By the model's the size is 40 % off; noise of the
    source's sensor lowers it as much as the noise's share of the torque that no law spans."""
    size, laws = 0.05, [(CoulombFriction(1), [3.0]), (ViscousFriction(1), [1.5])]
    true, noisy = (measured(laws, noise=noise) for noise in (0.0, 0.05))
    pairs = zip(noisy.segments, true.segments, strict=True)
    read = torch.tensor([size, 0.0, 0.0]).double()
    data = data_of([replace(a, tau=a.tau + b.tau[:, 1:2] * read) for a, b in pairs])
    question = question_of(data, ("torque_crosstalk",))
    (own,) = (t for t in question.candidates.terms if t.effects == (TorqueCrosstalk(0, 1),))
    assert own.place == 0
    fit = fit_anew(question, [own])
    assert float(fit.x[0]) == pytest.approx(size, rel=0.02)
    # The same column, put together again.
    columns = question.candidates.columns
    torque = term_columns(columns, own)
    assert not torque[:, 1:].any()
    left = columns.gap[0] - fit.x[0] * torque[0, 0]
    keep = question.candidates.keep[0]
    assert float(left[keep].square().sum()) == pytest.approx(float(fit.losses[0]), rel=1e-6)
    model = data.samples.of([m.torque.T for m in columns.motions])[1]
    by_model = float(columns.gap[0] @ model / model.square().sum())
    assert by_model > 1.3 * size
