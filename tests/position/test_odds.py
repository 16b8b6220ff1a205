"""How sure an effect of a servo is."""

import pytest

from torchid.position.odds import effect_sure
from torchid.results.replication import MotionScale, replication_of


def again(*factors, std=0.05):
    return replication_of([MotionScale(f"m{k}", 0.0, 10.0, f, std) for k, f in enumerate(factors)])


def sure(without, with_it, least=0.1, numbers=1, replication=None, rows=100.0):
    return effect_sure(without, with_it, least, numbers, replication, rows=rows, looks=60)


def test_an_effect_that_explains_the_error_is_sure():
    assert sure(10.0, 0.1) > 0.99


def test_one_that_explains_nothing_is_not():
    assert sure(1.0, 0.99) < 0.01


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
