"""Ordinary, weighted, robust and bounded least squares against dense references."""

from dataclasses import replace
from functools import lru_cache

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from tests.identification.test_rows import a_log, collected, layout_of
from tests.marks import quick_first
from torchid.design.motion import Measurement, measurements
from torchid.errors import IdentificationError
from torchid.identification import least_squares
from torchid.identification.least_squares import (
    HUBER,
    MAD_TO_SIGMA,
    fit,
    solve,
    undetermined_columns,
)
from torchid.identification.rows import RowSource
from torchid.robot.library import load_robot

ROBOT = load_robot("3r_friction")
LAYOUT = layout_of(ROBOT)
METHODS = [("ols", "diagonal"), ("wls", "diagonal"), ("wls", "full"), ("huber", "diagonal"),
           ("huber", "full")]  # fmt: skip


@lru_cache
def clean() -> tuple[Measurement, ...]:
    return tuple(measurements(a_log(ROBOT, rates=(50.0, 100.0), durations=(20.0, 12.0)), None))


@lru_cache
def truth() -> torch.Tensor:
    return fit(RowSource(clean(), LAYOUT), method="ols").x


def noisy(noise: torch.Tensor, offset: torch.Tensor | None = None) -> RowSource:
    """Noise (I, n) on the torque of the clean log, and other coefficients if `offset` says so."""
    a = collected(RowSource(clean(), LAYOUT))[0]
    extra = noise if offset is None else noise + a @ offset
    edges = [0, *torch.tensor([m.samples for m in clean()]).cumsum(0).tolist()]
    parts = zip(clean(), edges, edges[1:], strict=False)
    return RowSource([replace(m, tau=m.tau + extra[i:j]) for m, i, j in parts], LAYOUT)


def gaussian(seed: int = 0, covariance: torch.Tensor | None = None) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    samples = sum(m.samples for m in clean())
    white = torch.randn(samples, ROBOT.n, generator=generator, dtype=torch.float64)
    return white if covariance is None else white @ torch.linalg.cholesky(covariance).T


COVARIANCE = torch.tensor(
    [[0.25, 0.08, 0.0], [0.08, 0.04, 0.005], [0.0, 0.005, 0.0025]], dtype=torch.float64
)


def with_outliers(seed: int = 1) -> torch.Tensor:
    noise = gaussian(seed) * torch.tensor([0.05, 0.02, 0.01], dtype=torch.float64)
    generator = torch.Generator().manual_seed(seed)
    hit = torch.rand(noise.shape, generator=generator, dtype=torch.float64) < 0.05
    return torch.where(hit, noise.abs() * 60 + 1.0, noise)


def dense_solution(a: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
    return torch.linalg.lstsq(a.flatten(0, 1), tau.flatten()).solution


def reference(source: RowSource, method: str, covariance: str) -> torch.Tensor:
    """The textbook's iteration on dense rows."""
    a, tau, _, _ = collected(source)
    x = dense_solution(a, tau)
    huber = torch.ones_like(tau)
    for _ in range(0 if method == "ols" else 200):
        r = tau - a @ x
        w = torch.eye(ROBOT.n, dtype=torch.float64)
        if covariance == "full":
            weighted = r * huber / huber.norm(dim=0)
            s = weighted.T @ weighted
            w = torch.linalg.cholesky(torch.linalg.inv(s)).T
        white = r @ w.T
        scale = (
            MAD_TO_SIGMA * white.abs().median(0).values
            if method == "huber"
            else white.square().mean(0).sqrt()
        )
        w = w / scale.unsqueeze(-1)
        size = (r @ w.T).abs()
        huber = (HUBER / size).clamp(max=1).sqrt() if method == "huber" else huber
        rows = torch.einsum("ij,mjb->mib", w, a) * huber.unsqueeze(-1)
        x = dense_solution(rows, (tau @ w.T) * huber)
    return x


def distance(fitted: torch.Tensor, expected: torch.Tensor) -> float:
    return float((fitted - expected).abs().max() / expected.abs().max())


@pytest.fixture
def to_the_end(monkeypatch):
    monkeypatch.setattr(least_squares, "_CONVERGED", 1e-9)
    monkeypatch.setattr(least_squares, "_MAX_ITERATIONS", 200)


@pytest.mark.parametrize(("method", "covariance"), METHODS)
@pytest.mark.parametrize("noise", quick_first(["correlated", "outliers"], 1))
def test_each_method_is_its_dense_reference(to_the_end, method, covariance, noise):
    made = with_outliers() if noise == "outliers" else gaussian(0, COVARIANCE)
    source = noisy(made)
    found = fit(source, method=method, covariance=covariance)
    assert distance(found.x, reference(source, method, covariance)) < 1e-6
    assert bool(found.free.all())
    assert not bool(found.bounded.any() or found.undetermined.any())


@pytest.mark.parametrize(("method", "covariance"), METHODS)
def test_a_fit_describes_itself(method, covariance):
    source = noisy(with_outliers())
    found = fit(source, method=method, covariance=covariance)
    a, tau, _, _ = collected(source)
    assert torch.allclose(found.residual, tau - a @ found.x, atol=1e-10)
    rows = torch.einsum("ij,mjb->mib", found.whitening, torch.cat([a, tau[..., None]], -1))
    rows = (rows * found.robust[..., None]).flatten(0, 1)
    assert distance(found.factor.T @ found.factor, rows.T @ rows) < 1e-9
    flat = a.flatten(0, 1)
    assert found.condition_number == pytest.approx(float(torch.linalg.cond(flat)), rel=1e-6)
    scaled = float(torch.linalg.cond(flat / flat.norm(dim=0)))
    assert found.scaled_condition_number == pytest.approx(scaled, rel=1e-6)
    assert bool((found.whitening.tril(-1) == 0).all())
    assert (found.iterations == 0) == (method == "ols")


@pytest.mark.parametrize(("method", "covariance"), METHODS)
def test_iteration_stops_where_it_no_longer_matters(to_the_end, monkeypatch, method, covariance):
    """Within a tenth of a standard deviation of white noise in any direction."""
    source = noisy(with_outliers())
    last = fit(source, method=method, covariance=covariance)
    monkeypatch.undo()
    early = fit(source, method=method, covariance=covariance)
    step = last.factor[:-1, :-1] @ (last.x - early.x)
    assert float(step.norm()) < 0.1


@pytest.mark.parametrize("covariance", ["diagonal", "full"])
def test_weights_are_those_of_the_known_noise(covariance):
    found = fit(noisy(gaussian(2, COVARIANCE)), method="wls", covariance=covariance)
    got = torch.linalg.inv(found.whitening.T @ found.whitening)
    expected = COVARIANCE if covariance == "full" else torch.diag(COVARIANCE.diagonal())
    assert torch.allclose(got, expected, atol=0.06 * float(COVARIANCE.max()))
    a, tau, _, _ = collected(noisy(gaussian(2, COVARIANCE)))
    precision = torch.linalg.inv(expected)
    gram = torch.einsum("mia,ij,mjb->ab", a, precision, a)
    x = torch.linalg.solve(gram, torch.einsum("mia,ij,mj->a", a, precision, tau))
    std = torch.linalg.inv(gram).diagonal().sqrt()
    assert float(((found.x - x) / std).abs().max()) < 0.3


def test_outliers_are_resisted():
    source = noisy(with_outliers())
    errors = {m: (fit(source, method=m).x - truth()).abs() for m in ("ols", "wls", "huber")}
    assert float(errors["huber"].norm()) < 0.2 * float(errors["ols"].norm())
    found = fit(source, method="huber")
    std = torch.linalg.inv(found.factor[:-1, :-1].T @ found.factor[:-1, :-1]).diagonal().sqrt()
    # One-sided outliers move Huber's estimate too, but by no more than a few standard deviations;
    # the torque offsets carry most of it.
    others = torch.tensor([not LAYOUT.base.names[k].startswith("F0") for k in LAYOUT.order])
    assert float((errors["huber"] / std)[others].max()) < 6


@pytest.mark.parametrize(("method", "covariance"), METHODS)
def test_exact_data_give_the_coefficients(method, covariance):
    """Weights of residuals that are rounding."""
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(LAYOUT.size, generator=generator, dtype=torch.float64)
    parts = [replace(m, tau=torch.zeros_like(m.tau)) for m in clean()]
    a = [collected(RowSource([m], LAYOUT))[0] for m in parts]
    exact = [replace(m, tau=rows @ x) for m, rows in zip(parts, a, strict=True)]
    found = fit(RowSource(exact, LAYOUT), method=method, covariance=covariance)
    assert float((found.x - x).abs().max()) < 1e-10


def negative_friction() -> torch.Tensor:
    """Adds what makes Fv1, Fc2 and Ia3 negative."""
    names = [LAYOUT.base.names[k] for k in LAYOUT.order]
    offset = torch.zeros(len(names), dtype=torch.float64)
    for name in ("Fv1", "Fc2", "Ia3"):
        offset[names.index(name)] = -1.0
    return offset


def signs() -> torch.Tensor:
    return torch.tensor([LAYOUT.base.names[k][:2] in ("Fv", "Fc", "Ia") for k in LAYOUT.order])


@pytest.mark.parametrize("method", ["ols", "wls"])
def test_bounds_are_those_of_dense_bounded_least_squares(method):
    source = noisy(gaussian(3, COVARIANCE), negative_friction())
    found = fit(source, method=method, non_negative=signs())
    a, tau, _, _ = collected(source)
    w = found.whitening.diagonal()
    dense = (a * w[:, None]).flatten(0, 1).numpy()
    lower = torch.where(signs(), 0.0, -torch.inf).numpy()
    expected = lsq_linear(dense, (tau * w).flatten().numpy(), (lower, float("inf")), method="bvls")
    assert distance(found.x, torch.from_numpy(expected.x)) < 1e-8
    bounded = {LAYOUT.base.names[LAYOUT.order[j]] for j in found.bounded.nonzero().flatten()}
    assert {"Fv1", "Fc2", "Ia3"} <= bounded
    assert bool((found.x[found.bounded] == 0).all())
    assert torch.equal(found.free, ~found.bounded)


@st.composite
def bounded_problems(draw):
    b = draw(st.integers(1, 12))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 10_000)))
    rows = torch.randn(b + 5, b + 1, generator=generator, dtype=torch.float64)
    mixing = torch.randn(b, generator=generator, dtype=torch.float64)
    rows[:, :b] += 0.7 * rows[:, :1] * mixing  # correlated columns
    rows[:, :b] *= 10 ** (4 * torch.rand(b, generator=generator, dtype=torch.float64) - 2)
    mask = st.lists(st.booleans(), min_size=b, max_size=b).map(torch.tensor)
    return torch.linalg.qr(rows, mode="r").R, draw(mask), draw(mask)


@given(bounded_problems())
@settings(max_examples=120, derandomize=True)
def test_solutions_satisfy_the_karush_kuhn_tucker_conditions(problem):
    r, non_negative, held = problem
    x, bounded = solve(r, non_negative, held)
    a, y = r[:, :-1], r[:, -1]
    gradient = a.T @ (a @ x - y) / a.norm(dim=0) / y.norm()
    free = ~(held | bounded)
    assert bool((x[held | bounded] == 0).all())
    assert bool((x[non_negative] >= 0).all())
    assert bool((bounded <= (non_negative & ~held)).all())
    assert float(gradient[free].abs().max() if bool(free.any()) else 0) < 1e-9
    assert float(gradient[bounded].min() if bool(bounded.any()) else 0) > -1e-9


def still_joint(joint: int) -> RowSource:
    """The joint stands at an angle throughout."""
    log = a_log(ROBOT, rates=(50.0,))
    signals = {k: log.signals[k].clone() for k in ("q", "dq", "ddq")}
    signals["q"][:, joint] = 0.4
    signals["dq"][:, joint] = signals["ddq"][:, joint] = 0.0
    return RowSource(measurements(log.replace(**signals), None), LAYOUT)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_joint_that_never_moves(joint):
    found = fit(still_joint(joint), non_negative=signs())
    names = {LAYOUT.base.names[LAYOUT.order[j]] for j in found.undetermined.nonzero().flatten()}
    number = joint + 1
    assert {f"Fv{number}", f"Fc{number}"} <= names
    assert not {f"{c}{j}" for c in ("Fv", "Fc") for j in (1, 2, 3) if j != number} & names
    assert bool(torch.isfinite(found.x).all())
    assert bool((found.x[found.undetermined] == 0).all())
    a = collected(still_joint(joint))[0].flatten(0, 1)
    assert int((~found.undetermined).sum()) == int(
        torch.linalg.matrix_rank(a / a.norm(dim=0).clamp(min=1e-300), rtol=1e-9)
    )


def test_undetermined_columns_leave_out_those_held():
    generator = torch.Generator().manual_seed(0)
    a = torch.randn(20, 5, generator=generator, dtype=torch.float64)
    a[:, 2] = a[:, 0] + a[:, 1]
    a[:, 3] = 0.0
    r = torch.linalg.qr(a, mode="r").R
    none = torch.zeros(4, dtype=torch.bool)
    assert undetermined_columns(r, none).tolist() == [False, False, True, True]
    first = torch.tensor([True, False, False, False])
    assert undetermined_columns(r, first).tolist() == [False, False, False, True]


@pytest.mark.parametrize("method", ["wls", "huber"])
def test_a_joint_without_residual_is_no_trouble_for_the_covariance(method):
    """No torque and no rows to fit: a level of zero, a singular covariance."""
    parts = [
        replace(m, tau=m.tau * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)) for m in clean()
    ]
    noise = [m.tau + torch.sin(40 * m.t).unsqueeze(-1) * m.tau for m in parts]
    source = RowSource(
        [replace(m, tau=tau) for m, tau in zip(parts, noise, strict=True)], LAYOUT, moving_only=True
    )
    for covariance in ("diagonal", "full"):
        found = fit(source, method=method, covariance=covariance)
        assert bool(torch.isfinite(found.x).all())
        assert bool(torch.isfinite(found.whitening).all())


def test_columns_left_out():
    out = torch.zeros(LAYOUT.size, dtype=torch.bool)
    out[[2, 5]] = True
    found = fit(noisy(gaussian(4, COVARIANCE)), method="ols", left_out=out)
    a, tau, _, _ = collected(noisy(gaussian(4, COVARIANCE)))
    expected = torch.zeros(LAYOUT.size, dtype=torch.float64)
    expected[~out] = dense_solution(a[..., ~out], tau)
    assert distance(found.x, expected) < 1e-9
    assert torch.equal(found.free, ~out)
    assert not bool(found.undetermined.any())


def test_moving_rows_only_are_fitted():
    source = noisy(gaussian(5, COVARIANCE))
    moving = RowSource(source.measured, LAYOUT, moving_only=True)
    found = fit(moving, method="ols")
    a, tau, keep, _ = collected(moving)
    assert distance(found.x, torch.linalg.lstsq(a[keep], tau[keep]).solution) < 1e-9
    assert torch.equal(found.kept, keep)


@pytest.mark.parametrize("method", ["ols", "wls", "huber"])
def test_no_row_is_left(method):
    log = a_log(ROBOT, rates=(50.0,))
    nothing = torch.zeros_like(log.q)
    still = log.replace(q=nothing + 0.2, dq=nothing, ddq=nothing)
    source = RowSource(measurements(still, None), LAYOUT, moving_only=True)
    with pytest.raises(IdentificationError, match="no row is left"):
        fit(source, method=method)
