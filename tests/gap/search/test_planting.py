"""What a log would show, against logs that show it."""

import math

import pytest
import torch

from tests.gap.problems import measured, question_of, term
from torchid.effects.friction import ViscousFriction
from torchid.gap.record import Planted
from torchid.gap.search.climb import fitted
from torchid.gap.search.evidence import Question, fit_terms
from torchid.gap.search.planting import SIZES, Planting, planted

# Four sizes of the same cause; the smallest are below what noise lets through.
FV = 0.15
NAMES = ("viscous_friction", "coulomb_friction", "torque_offset")


def question(size: float, seed: int) -> Question:
    effects = [(ViscousFriction(1), [FV * size])]
    return question_of(measured(effects, seed=seed), NAMES)


@pytest.fixture(scope="module")
def shown() -> Planted:
    q = question(1.0, 0)
    rivals = [term(q, name, 1) for name in NAMES]
    return planted(Planting(q, fitted(q, rivals[:1])), rivals)


@pytest.mark.nightly
def test_sizes_are_found_as_often_as_in_other_logs(shown: Planted) -> None:
    """Thirty logs a size, each with noise of its own, told by the evidence of the term alone."""
    expected = dict(shown.found)
    assert list(expected) == list(SIZES)
    between = [s for s, share in shown.found if 0.05 < share < 0.95]
    assert between
    for size in between:
        hits = 0
        for seed in range(1, 31):
            q = question(size, seed)
            rows = q.normal.rows
            own, none = (
                fit_terms(q, terms, rows) for terms in ([term(q, "viscous_friction", 1)], [])
            )
            hits += own.evidence > none.evidence
        share = expected[size]
        spread = math.sqrt(share * (1 - share) / 30)
        assert abs(hits / 30 - share) < 3 * spread + 0.1


def test_every_share_is_one(shown: Planted) -> None:
    told = torch.tensor(shown.told)
    assert told.shape == (3, 4)
    assert torch.allclose(told.sum(1), torch.ones(3))
    assert told[0, 0] > 0.95  # it is large, and its rivals are others
    assert shown.names == NAMES
    assert [s for _, s in shown.found] == sorted(s for _, s in shown.found)


def test_a_cause_of_the_same_torque_is_not_told_instead() -> None:
    """An offset twice: each is found where it is planted."""
    q = question_of(measured([]), ("torque_offset",))
    own = term(q, "torque_offset", 0)
    found = planted(Planting(q, fitted(q, [own])), [own, own])
    assert torch.tensor(found.told)[:, :2].diagonal().tolist() == pytest.approx(
        [1 - found.told[0][2], 1 - found.told[1][2]]
    )


@pytest.mark.parametrize(
    ("found", "smallest"),
    [(((0.5, 0.2), (1.0, 0.6)), None), (((0.5, 0.6), (1.0, 1.0)), 0.75), (((0.5, 1.0),), 0.4)],
)
def test_the_smallest_size_is_told_in_four_of_five_draws(found, smallest) -> None:
    assert Planted(("a",), ((1.0, 0.0),), found).smallest == pytest.approx(smallest)
