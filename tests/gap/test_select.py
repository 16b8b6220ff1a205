"""Selection on columns that were planted, and on the 3R."""

from dataclasses import replace

import pytest
import torch

from tests.gap.problems import Case, ar_noise, bank, problem, random
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import StribeckFriction
from torchid.effects.registry import KINDS
from torchid.gap.bank import Bank
from torchid.gap.problem import Problem, Term, term_of
from torchid.gap.select import Search
from torchid.typing import Tensor

N, ROWS = 3, 1000
JUMP = "coulomb_friction"
RICHER = "stribeck_friction"


def named(columns: Tensor, place: int | None, name: str, looks: float = 1.0) -> Bank:
    """A bank of any columns (S, C, R) under an effect's name, all members without an equal key."""
    made = bank(columns, place, name=name, looks=looks)
    effect = {
        JUMP: CoulombFriction,
        "viscous_friction": ViscousFriction,
        "torque_offset": TorqueOffset,
        RICHER: StribeckFriction,
    }.get(name)
    if effect is None or place is None:
        return made
    extra = {"vs": 0.1, "d": 1.0} if name == RICHER else {}
    return replace(made, members=((effect(place, **extra),),) * len(columns))


def searched(y: Tensor, *banks: Bank, most: int = 10, **options) -> tuple[list[Term], Problem]:
    made = problem(y, banks, **options)
    return Search(made).run(most), made


def crowd(seed: int) -> list[Bank]:
    """Candidates that have nothing to do with anything."""
    return [
        named(ar_noise(3, 1, ROWS, pole=0.95, seed=1000 + 10 * seed + j), j, "cogging", looks=20.0)
        for j in range(N)
    ]


@pytest.mark.parametrize("whitened", [True, False])
@pytest.mark.parametrize("place", [0, 2, None])
def test_the_column_that_was_planted_is_found_alone(place, whitened):
    columns = ar_noise(5, 1, ROWS if place is not None else N * ROWS, pole=0.95, seed=1)
    noise = random(N, ROWS, seed=2)
    y = noise.clone()
    if place is None:
        y += 0.7 * columns[3, 0].reshape(N, ROWS)
    else:
        y[place] += 0.7 * columns[3, 0]
    found, made = searched(
        y, *crowd(0), named(columns, place, "base_tilt", looks=5.0), whitened=whitened
    )
    assert [(t.name, t.place) for t in found] == [("base_tilt", place)]
    assert torch.equal(found[0].columns, columns[3])
    left = Search(made, found).model().loss
    assert left == pytest.approx(float(noise.square().sum()), rel=0.01)


@pytest.mark.parametrize("whitened", [True, False])
def test_noise_names_nothing(whitened):
    for seed in range(10):
        y = random(N, ROWS, seed=seed)
        assert not searched(y, *crowd(seed), whitened=whitened)[0]


def test_noise_that_is_not_white_names_nothing_where_rows_are_not_whitened():
    """With the Wald test over blocks, though the largest gains are far beyond chi^2."""
    named_any, largest = 0, 0.0
    for seed in range(10):
        y = ar_noise(N, ROWS, pole=0.95, seed=seed)
        made = problem(y, tuple(crowd(seed)), whitened=False)
        search = Search(made)
        largest = max(largest, *(c.gain for c in search.candidates(search.model())))
        named_any += bool(search.run(10))
    assert largest > 3 * made.threshold(1)
    assert named_any <= 1


def test_several_are_found_the_largest_first():
    columns = ar_noise(4, 1, ROWS, pole=0.9, seed=1)
    y = random(N, ROWS, seed=2)
    y[0] += 2.0 * columns[0, 0]
    y[1] += 0.9 * columns[1, 0]
    y[2] += 0.4 * columns[2, 0]
    banks = [named(columns[k : k + 1], k % N, "cogging") for k in range(4)]
    banks[3] = named(columns[3:4], 0, "torque_offset")
    found, _ = searched(y, *banks)
    assert [t.place for t in found] == [0, 1, 2]
    assert len(searched(y, *banks, most=2)[0]) == 2


def test_parameters_that_held_two_effects_give_way_when_one_is_named():
    """All base parameters explain one effect and a share of the other, so they come first; once
    the other is named, one effect does what they are left with."""
    tilt, offset = ar_noise(2, 1, N * ROWS, pole=0.9, seed=1)
    others = ar_noise(6, N * ROWS, pole=0.9, seed=5)
    base = torch.cat([offset + 1e-3 * others[:1], tilt + others[:1], others[1:]])
    y = random(N, ROWS, seed=2) + 3 * (tilt + 2 * offset)[0].reshape(N, ROWS)
    banks = [
        replace(bank(base[None], None, name="all_base"), members=((),)),
        bank(tilt[None], None, name="base_tilt"),
        bank(offset[None], None, name="encoder_offset"),
    ]
    first = Search(problem(y, tuple(banks))).candidates(Search(problem(y, tuple(banks))).model())
    assert first[0].term.name == "all_base"
    found, _ = searched(y, *banks)
    assert sorted(t.name for t in found) == ["base_tilt", "encoder_offset"]


@pytest.mark.parametrize(("extra", "kept"), [(0.0, JUMP), (0.9, RICHER)])
def test_the_simpler_law_is_kept_unless_the_richer_explains_more(extra, kept):
    """The richer law's column is the simpler one's, and `extra` of something else."""
    simple = ar_noise(1, 1, ROWS, pole=0.9, seed=1)
    rich = torch.cat([simple, ar_noise(1, 1, ROWS, pole=0.9, seed=3)], 1)
    y = random(N, ROWS, seed=2)
    y[1] += rich[0, 0] + extra * rich[0, 1]
    # As an arm does it: the richer law comes first in the list.
    found, _ = searched(y, named(rich, 1, RICHER), named(simple, 1, JUMP))
    assert [t.name for t in found] == [kept]


def test_the_simpler_law_is_kept_while_something_else_is_left():
    """The richer one explains 0.1 % more, which is far beyond noise; but so is what joint 1 leaves,
    and misfit of that kind buys any column."""
    simple = ar_noise(1, 1, ROWS, pole=0.9, seed=1)
    rich = torch.cat([simple, ar_noise(1, 1, ROWS, pole=0.9, seed=3)], 1)
    y = random(N, ROWS, seed=2)
    y[1] += 10 * rich[0, 0] + 10 * 0.001**0.5 * rich[0, 1]
    y[0] *= 3
    made = problem(y, (named(rich, 1, RICHER), named(simple, 1, JUMP)))
    best = Search(made).candidates(Search(made).model())[0]
    assert best.term.name == RICHER
    assert [t.name for t in Search(made).run(5)] == [JUMP]


def test_what_a_few_blocks_hold_is_not_given_to_a_simpler_law():
    """The spread between blocks cannot tell a burst in one of them from anything: the simpler law
    has a gain beyond chance, and a twentieth of the burst's."""
    burst = torch.zeros(1, 1, N * ROWS, dtype=torch.float64)
    burst[0, 0, 400:440] = 1.0
    simple = random(1, 1, ROWS, seed=5)
    simple[0, 0, 400:440] += 1.0
    y = random(N, ROWS, seed=2) + 10 * burst[0].reshape(N, ROWS)
    made = problem(y, (named(burst, None, "torque_crosstalk"), named(simple, 0, JUMP)))
    one, two = Search(made).candidates(Search(made).model())
    assert one.term.name == "torque_crosstalk"
    assert made.threshold(1) < two.gain < 0.1 * one.gain
    assert two.simplicity < one.simplicity
    assert [t.name for t in Search(made).run(1)] == ["torque_crosstalk"]


def test_a_composite_enters_as_its_parts():
    """Coulomb and viscous friction of one joint are offered together, and named one by one."""
    case = Case([(CoulombFriction(1), [0.5]), (ViscousFriction(1), [0.4])], tuple(KINDS))
    made = problem(case.evaluator.residual(), tuple(case.banks))
    made = replace(made, bounds=case.rows.bounds, interval=case.rows.interval)
    both = [b for b in case.banks if "+" in b.name and b.place == 1]
    assert len(both) == 1
    found = Search(made).run(10)
    assert {(t.name, t.place) for t in found} == {("coulomb_friction", 1), ("viscous_friction", 1)}
    assert all(len(t.effects) == len(t.columns) == 1 for t in found)


def test_the_misfit_of_a_large_one_is_not_named():
    """A law that fits to a few hundredths leaves more than the noise, but not another effect."""
    x = ar_noise(2, 1, ROWS, pole=0.9, seed=1)
    law = 60 * x[:1]
    y = random(N, ROWS, seed=2)
    y[1] += law[0, 0] + 0.01 * 60 * x[1, 0]
    misfit = named(x[1:], 1, "torque_offset")
    alone = y.clone()
    alone[1] -= law[0, 0]
    assert [t.name for t in searched(alone, misfit)[0]] == ["torque_offset"]
    assert [t.name for t in searched(y, misfit, named(law, 1, JUMP))[0]] == [JUMP]


def test_what_others_make_superfluous_leaves():
    """The sum of two columns comes first; with both in the model it explains nothing."""
    x = ar_noise(2, 1, ROWS, pole=0.9, seed=1)
    total = (x[:1] + x[1:]) + 0.5 * ar_noise(1, 1, ROWS, pole=0.9, seed=5)
    y = random(N, ROWS, seed=2)
    y[0] += 2.0 * x[0, 0] + 2.0 * x[1, 0]
    banks = (
        named(total, 0, "cogging"),
        named(x[:1], 0, "viscous_friction"),
        named(x[1:], 0, "torque_offset"),
    )
    made = problem(y, banks)
    first = max(Search(made).candidates(Search(made).model()), key=lambda c: c.score)
    assert first.term.name == "cogging"
    assert {t.name for t in Search(made).run(10)} == {"viscous_friction", "torque_offset"}


def test_nothing_is_learnt_from_rows_that_do_not_count():
    x = ar_noise(1, 1, ROWS, pole=0.9, seed=1)
    y = random(N, ROWS, seed=2)
    y[1] += 3 * x[0, 0]
    keep = torch.ones(N, ROWS, dtype=torch.bool)
    keep[1, ::2] = False
    made = problem(y * keep, (named(x, 1, "cogging"),))
    made = replace(made, keep=keep, count=int(keep.sum()))
    wild = replace(made, banks=(named(torch.where(keep[1], x, 1e6 * x), 1, "cogging"),))
    one, two = (Search(p).run(3) for p in (made, wild))
    assert len(one) == len(two) == 1
    assert torch.equal(one[0].columns, two[0].columns)
    assert float(one[0].columns[:, ~keep[1]].abs().max()) == 0


def test_looks_make_it_harder():
    made = problem(random(N, ROWS, seed=0), tuple(crowd(0)))
    fewer = replace(made, banks=made.banks[:1])
    assert made.looks == 60.0
    assert made.threshold(2) > made.threshold(1) > fewer.threshold(1)
    assert made.p_value(made.threshold(1), 1) == pytest.approx(made.alpha)
    assert made.p_value(0.0, 1) == 1.0


def test_keys_tell_places_and_effects_apart():
    x = random(1, 1, ROWS, seed=0)
    keys = [term_of(named(x, j, name)).key for j in range(2) for name in (JUMP, "torque_offset")]
    assert len(set(keys)) == 4
