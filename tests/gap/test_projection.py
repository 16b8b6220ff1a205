"""Gains of banks against explicit least squares with and without the columns."""

import pytest
import torch

from tests.gap.problems import PLAIN, POSITIVE, bank, explicit_gain, random
from torchid.effects.base import Coefficient
from torchid.gap.projection import VISIBLE, Projector, Scanner
from torchid.typing import Tensor

N, ROWS = 3, 80


def keep(seed: int | None = None) -> Tensor:
    if seed is None:
        return torch.ones(N, ROWS, dtype=torch.bool)
    return random(N, ROWS, seed=seed) > -1.0


def target(mask: Tensor, seed: int = 0) -> Tensor:
    return 3 * random(N, ROWS, seed=seed) * mask


def full(columns: Tensor, place: int | None) -> Tensor:
    """Rows of all joints, by hand."""
    if place is None:
        return columns
    out = torch.zeros(len(columns), N, ROWS, dtype=torch.float64)
    out[:, place] = columns
    return out.reshape(len(columns), -1)


def width(place: int | None) -> int:
    return N * ROWS if place is None else ROWS


@pytest.mark.parametrize("masked", [None, 7])
@pytest.mark.parametrize("in_model", [(), (0,), (None,), (1, None, 2)])
@pytest.mark.parametrize("place", [1, None])
def test_gains_are_differences_of_least_squares(place, in_model, masked):
    mask = keep(masked)
    y = target(mask)
    model = Projector(y)
    held = torch.zeros(0, N * ROWS, dtype=torch.float64)
    for k, where in enumerate(in_model):
        columns = full(random(2, width(where), seed=20 + k), where) * mask.flatten()
        held = torch.cat([held, columns])
        own = columns.reshape(2, N, ROWS)[:, where] if where is not None else columns
        model.add(own, where)
    tried = random(4, 3, width(place), seed=50)
    found = Scanner(bank(tried, place), mask).gains(model)
    for k in range(4):
        x = full(tried[k], place) * mask.flatten()
        assert float(found.gain[k]) == pytest.approx(explicit_gain(x, y.flatten(), held), rel=1e-8)
        both = torch.cat([held, x])
        solution = torch.linalg.lstsq(both.T, y.reshape(-1, 1)).solution[-3:, 0]
        assert torch.allclose(found.values[k], solution, rtol=1e-6, atol=1e-9)
    assert found.df.tolist() == [3] * 4
    assert model.loss == pytest.approx(
        float(y.square().sum()) - (explicit_gain(held, y.flatten()) if len(held) else 0.0)
    )


def test_the_residual_is_orthogonal_to_the_model():
    model = Projector(target(keep()))
    for k in range(4):
        model.add(random(3, ROWS, seed=k) * 10.0**k, k % N)
    eye = torch.eye(len(model.q))
    assert torch.allclose(model.q @ model.q.T, eye, atol=1e-12)
    assert float((model.q @ model.r.flatten()).abs().max()) < 1e-10


def test_a_kept_projection_is_a_new_one():
    """As the model grows, and when it becomes another one that begins as the last did."""
    mask, y = keep(3), target(keep(3))
    kept = Scanner(bank(random(5, 2, ROWS, seed=1), 0), mask)
    model = Projector(y)
    kept.gains(model)
    for k in range(3):
        branch = model.copy()
        for other in (model, branch):
            other.add(random(2, ROWS, seed=10 + k + 5 * (other is branch)) * mask[0], 0)
            fresh = Scanner(kept.bank, mask).gains(other)
            again = kept.gains(other)
            assert torch.allclose(again.gain, fresh.gain, rtol=1e-9)
            assert torch.allclose(again.values, fresh.values, rtol=1e-7)
    empty = kept.gains(Projector(y))
    assert torch.allclose(empty.gain, Scanner(kept.bank, mask).gains(Projector(y)).gain)


def test_a_copy_does_not_change_with_the_original():
    one = Projector(target(keep()))
    two = one.copy()
    loss = two.loss
    one.add(random(2, ROWS, seed=0), 1)
    assert two.loss == loss
    assert len(two.q) == 0


@pytest.mark.parametrize(("sign", "allowed"), [(1.0, True), (-1.0, False)])
def test_signs_that_physics_forbids_gain_nothing(sign, allowed):
    mask = keep()
    x = random(1, 1, ROWS, seed=2)
    y = torch.zeros(N, ROWS, dtype=torch.float64)
    y[1] = sign * 2 * x[0, 0]
    signed = Scanner(bank(x, 1, coefficient=POSITIVE), mask).gains(Projector(y))
    free = Scanner(bank(x, 1, coefficient=PLAIN), mask).gains(Projector(y))
    assert float(free.gain) == pytest.approx(float(y.square().sum()))
    assert float(signed.gain) == (pytest.approx(float(free.gain)) if allowed else 0.0)


@pytest.mark.parametrize(("second", "allowed"), [(0.0, True), (-1.5, True), (-6.0, False)])
def test_a_sign_counts_beyond_the_noise_of_its_coefficient(second, allowed):
    """The first column explains all; the second one's coefficient is so many standard deviations
    from zero."""
    mask, x = keep(), random(1, 2, ROWS, seed=2)
    x = x / x.norm(dim=-1, keepdim=True)
    std = torch.linalg.inv(x[0] @ x[0].T)[1, 1].sqrt()
    y = torch.zeros(N, ROWS, dtype=torch.float64)
    y[1] = 100 * x[0, 0] + second * std * x[0, 1]
    found = Scanner(bank(x, 1, coefficient=POSITIVE), mask).gains(Projector(y))
    assert float(found.gain) == (pytest.approx(float(y.square().sum())) if allowed else 0.0)


@pytest.mark.parametrize(("size", "allowed"), [(0.9, True), (-0.9, True), (1.1, False)])
def test_coefficients_beyond_their_largest_gain_nothing(size, allowed):
    limited = Coefficient("c", "", False, "a share", 1.0)
    x = 50 * random(1, 1, ROWS, seed=2)
    y = torch.zeros(N, ROWS, dtype=torch.float64)
    y[0] = size * x[0, 0]
    found = Scanner(bank(x, 0, coefficient=limited), keep()).gains(Projector(y))
    assert (float(found.gain) > 0) == allowed


def test_columns_below_noise_at_their_largest_are_not_seen():
    """Whatever the residual: the coefficient would have to be implausibly large."""
    small = Coefficient("c", "", False, "a small share", 1e-3)
    x = torch.stack([random(1, ROWS, seed=2), 1e4 * random(1, ROWS, seed=3)])
    found = Scanner(bank(x, 0, coefficient=small), keep()).gains(Projector(target(keep())))
    assert found.df.tolist() == [0, 1]
    assert float(found.gain[0]) == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sign_is_not_judged_where_it_is_not_determined(sign):
    """Two coefficients on one column: only their sum, or difference, is known. The least ones that
    explain it may be negative where others that do are not."""
    mask = keep()
    one = random(ROWS, seed=1)
    y = torch.zeros(N, ROWS, dtype=torch.float64)
    y[0] = one
    found = Scanner(bank(torch.stack([one, sign * one])[None], 0, coefficient=POSITIVE), mask)
    gains = found.gains(Projector(y))
    assert float(gains.gain) == pytest.approx(float(one @ one))
    assert gains.df.tolist() == [1]


@pytest.mark.parametrize(("outside", "seen"), [(0.25, False), (4.0, True)])
def test_columns_that_the_model_almost_holds_are_not_seen(outside, seen):
    """`outside` times the share of the square that must be outside."""
    mask, held = keep(), random(1, ROWS, seed=1)
    other = random(1, ROWS, seed=2)
    other = other - (other @ held.T) / (held @ held.T) * held
    share = outside * VISIBLE
    x = (1 - share) ** 0.5 * held / held.norm() + share**0.5 * other / other.norm()
    y = target(mask)
    model = Projector(y)
    model.add(held, 2)
    found = Scanner(bank(100 * x[None], 2), mask).gains(model)
    assert (int(found.df) == 1) == seen
    assert (float(found.gain) > 0) == seen
    before = len(model.q)
    model.add(x, 2)
    assert (len(model.q) > before) == seen


def test_columns_join_twice_as_once():
    model = Projector(target(keep()))
    x = random(3, ROWS, seed=1)
    model.add(x, 0)
    loss = model.loss
    model.add(2 * x, 0)
    model.add(torch.zeros(2, ROWS), 1)
    assert len(model.q) == 3
    assert model.loss == pytest.approx(loss, rel=1e-14)
