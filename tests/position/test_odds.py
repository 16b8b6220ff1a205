"""How sure an effect of a servo is."""

import pytest
import torch

from torchid.position.odds import alike_rises, effect_sure
from torchid.results.agreement import MotionScale
from torchid.results.replication import replication_of
from torchid.statistics.bagging import Draws


def again(*factors, std=0.05):
    return replication_of([MotionScale(f"m{k}", 0.0, 10.0, f, std) for k, f in enumerate(factors)])


def sure(without, with_it, least=0.1, numbers=1, replication=None, rows=100.0):
    """Of losses that all windows share alike."""
    each = torch.full((20,), 1 / 20, dtype=torch.float64)
    draws = Draws.of(torch.arange(20))
    losses = without * each, with_it * each
    return effect_sure(
        *losses, least, numbers, replication, rows=rows * each, draws=draws, looks=60
    )


def test_an_effect_that_explains_the_error_is_sure():
    assert sure(10.0, 0.1) > 0.99


def test_one_that_explains_nothing_is_not():
    assert sure(1.0, 0.99) < 0.1


def test_what_stays_unexplained_bounds_it():
    found = [sure(10.0, left, rows=1e4) for left in (0.5, 2.0, 5.0, 8.0)]
    assert found == sorted(found, reverse=True)
    assert found[-1] < 0.75


@pytest.mark.parametrize("factors", [(1.0, 1.02, 0.97, 1.01), (1.9, 0.2, 1.5, 0.4)])
def test_motions_that_want_another_factor_make_it_less_sure(factors):
    found = sure(10.0, 1.0, replication=again(*factors))
    assert (found > 0.9) == (factors[0] == 1.0)
    assert (found < 0.5) == (factors[0] != 1.0)


def test_more_numbers_need_more():
    assert sure(1.3, 1.0, numbers=4) < sure(1.3, 1.0, numbers=1)


def test_motions_that_can_hardly_tell_say_nothing():
    telling = again(1.0, 1.02, 0.97, 1.01)
    wild = [MotionScale("far", 0.0, 10.0, -4e5, 3e5), MotionScale("near", 0.0, 10.0, 12.0, 4.0)]
    more = replication_of([*telling.motions, *wild])
    assert sure(10.0, 1.0, replication=more) == pytest.approx(sure(10.0, 1.0, replication=telling))


def test_joints_that_agree_on_a_size_make_it_surer():
    alike = alike_rises(torch.tensor([40.1, 39.6, 40.3, 39.9]), torch.full((4,), 0.4))
    apart = alike_rises(torch.tensor([40.1, 15.0, 90.0, 39.9]), torch.full((4,), 0.4))
    unknown = alike_rises(torch.tensor([40.1, 15.0, 90.0, 39.9]), torch.full((4,), 400.0))
    assert bool((alike > 2).all())
    # They may be servos of several types: at most half of the odds go.
    assert bool(((apart < 0.5) & (apart > -1.4)).all())
    assert float(apart.min()) < -1.3
    assert bool((unknown.abs() < 0.02).all())
    assert alike_rises(torch.tensor([40.1]), torch.tensor([0.4])).tolist() == [0.0]


def test_a_law_and_a_stand_in_are_told_apart_by_their_joints():
    """Sizes of a law are drawn with the spread of one type, those of stand-ins with another's."""
    g = torch.Generator().manual_seed(5)
    std = torch.full((6,), 0.05, dtype=torch.float64)

    def mean_rise(spread: float) -> float:
        draws = 1 + spread * torch.randn(200, 6, generator=g, dtype=torch.float64)
        return float(torch.stack([alike_rises(x.clamp(min=0.05), std) for x in draws]).mean())

    assert mean_rise(0.05) > 1.0 > 0.0 > mean_rise(0.6)


def test_what_one_window_alone_says_is_less_sure_than_what_all_say():
    """The same fall of the loss, of all windows alike or of a single one."""
    one = torch.ones(20, dtype=torch.float64)
    alone = one.clone()
    alone[3] = 21.0
    draws, rows = Draws.of(torch.arange(20)), torch.full((20,), 20.0, dtype=torch.float64)
    every, single = (
        effect_sure(without, one, 0.0, 1, rows=rows, draws=draws, looks=60)
        for without in (2 * one, alone)
    )
    assert every > single + 0.1
