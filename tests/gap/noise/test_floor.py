"""The noise floor and the whitener against noise whose size and spectrum are known."""

from dataclasses import replace

import pytest
import torch
from torchid.gap.flexible import predict_out_of_fold
from torchid.gap.floor import Floor, noise_floor
from torchid.gap.passages import Passage, Rows
from torchid.gap.repeats import Repeats, find_repeats
from torchid.gap.whitener import fit_whitener

from tests.gap.motions import motion_at, noises, passage_of, times
from torchid.typing import Samples, Tensor

CUTOFF, REPORT = 8.0, 20.0
COLOURS = [None, 5.0, 1.0]


def runs(seed: int = 0, count: int = 2, same: bool = True) -> list[Passage]:
    """One reference run several times, or several references."""
    out = []
    for k in range(count):
        m = motion_at(times(), seed if same else 10 * seed + k)
        m = m._replace(t=m.t + 30 * k, torque=20 * m.q.sin() + m.ddq)
        out.append(passage_of(m, name=f"run{k}"))
    return out


def rows_of(passages: list[Passage]) -> tuple[Rows, Rows]:
    return Rows(passages, CUTOFF), Rows(passages, REPORT)


def size(rows: Rows, signals: list[Samples]) -> Tensor:
    return rows.apply([x.T for x in signals]).square().mean(-1).sqrt()


def with_torque(passages: list[Passage], residual: list[Samples]) -> list[Passage]:
    return [replace(p, tau=p.motion.torque + r) for p, r in zip(passages, residual, strict=True)]


def ar(coefficients: tuple[float, ...], n: int, count: int, seed: int) -> Tensor:
    """x_t = -sum a_k x_(t-k) + e_t, (n, count), its beginning left out."""
    g = torch.Generator().manual_seed(seed)
    e = torch.randn(count + 500, n, generator=g, dtype=torch.float64)
    x = torch.zeros_like(e)
    for t in range(len(coefficients), len(x)):
        x[t] = e[t] - sum(a * x[t - k] for k, a in enumerate(coefficients, 1))
    return x[500:].T.contiguous()


AR = {"white": (), "slow": (-0.95,), "resonance": (-1.2, 0.8), "four": (-1.0, 0.5, -0.3, 0.2)}


@pytest.mark.parametrize("name", AR)
def test_the_whitener_whitens_an_autoregression(name):
    """On rows it was not fitted to; Ljung and Box's statistic is chi^2 with ten degrees of freedom,
    and the variance is one."""
    bounds = (slice(0, 1500), slice(1500, 4000))
    whitener = fit_whitener(ar(AR[name], 6, 4000, seed=0), bounds)
    white = whitener.apply_all(ar(AR[name], 6, 4000, seed=1))
    count = white.shape[-1]
    rho = [(white[:, k:] * white[:, :-k]).mean(-1) / white.square().mean(-1) for k in range(1, 11)]
    box = count**2 * sum(r**2 / (count - k) for k, r in enumerate(rho, 1))
    # Six joints: mean 10 with standard error 1.8, more by estimation on as many rows.
    assert float(box.mean()) < 20
    assert torch.allclose(white.square().mean(-1), torch.ones(6), atol=0.09)


def test_the_whitener_finds_the_coefficients():
    whitener = fit_whitener(ar(AR["four"], 3, 20_000, seed=0), (slice(0, 20_000),), order=4)
    assert torch.allclose(
        whitener.predictors[:, 4], torch.tensor(AR["four"]).expand(3, -1), atol=0.03
    )
    assert torch.allclose(whitener.std[:, 4], torch.ones(3), atol=0.02)


def test_a_trajectory_starts_as_its_covariance_says():
    """The whole map is the inverse Cholesky factor of the process's Toeplitz covariance, and
    trajectories are whitened on their own."""
    a, count = 0.9, 12
    whitener = fit_whitener(ar((-a,), 1, 50_000, seed=0), (slice(0, 50_000),), order=2)
    whitener = whitener.on((slice(0, count), slice(count, 2 * count)))
    matrix = whitener.apply(torch.eye(2 * count), 0).T
    index = torch.arange(count)
    covariance = a ** (index[:, None] - index).abs() / (1 - a * a)
    expected = torch.linalg.inv(torch.linalg.cholesky(covariance))
    assert torch.allclose(matrix[:count, :count], expected, atol=0.06)
    assert torch.allclose(matrix[count:, count:], matrix[:count, :count])
    assert float(matrix[count:, :count].abs().max()) == 0


def test_a_batch_of_columns_is_whitened_column_by_column():
    x = ar(AR["resonance"], 2, 300, seed=0)
    bounds = (slice(0, 3), slice(3, 200), slice(200, 300))
    whitener = fit_whitener(x, bounds)
    batch = torch.stack([x, 2 * x, x.flip(-1)]).unsqueeze(0)
    assert torch.allclose(whitener.apply_all(batch)[0, 1], 2 * whitener.apply_all(x))
    assert torch.allclose(whitener.apply(batch[0, 2, 1], 1), whitener.apply_all(x.flip(-1))[1])


@pytest.mark.parametrize("count", [30, 60])
def test_few_rows_make_a_stable_whitener_near_white(count):
    x = ar((), 5, count, seed=3)
    whitener = fit_whitener(x, (slice(0, count),))
    for a in whitener.predictors[:, -1]:
        companion = torch.zeros(len(a), len(a)).diagonal_scatter(torch.ones(len(a) - 1), -1)
        companion[0] = -a
        assert float(torch.linalg.eigvals(companion).abs().max()) < 1
    other = whitener.apply_all(ar((), 5, count, seed=4))
    assert 0.6 < float(other.square().mean()) < 1.8


def from_repeats(
    passages: list[Passage], residual: list[Samples]
) -> tuple[Floor, Repeats, tuple[Rows, Rows]]:
    repeats = find_repeats(passages)
    rows = rows_of(passages)
    found = noise_floor(with_torque(passages, residual), residual, *rows, repeats=repeats)
    return found, repeats, rows


@pytest.mark.parametrize("hz", COLOURS)
@pytest.mark.parametrize("gap", [0.0, 5.0])
def test_repeats_tell_the_noise_and_not_what_repeats(hz, gap):
    """Within 10 % of the truth on each of three joints and in both bands, on average within 5 %;
    an effect five times as large as the noise changes nothing."""
    ratios = []
    for seed in range(4):
        passages = runs(seed, count=3)
        z = noises(passages, seed, hz)
        residual = [x + gap * torch.tanh(4 * p.motion.dq) for x, p in zip(z, passages, strict=True)]
        found, repeats, (rows, report) = from_repeats(passages, residual)
        assert len(repeats) == 2
        assert found.report.source == "repeats"
        assert found.report.notes == ()
        shown = (found.report.low * found.report.high).sqrt()
        ratios += [found.rms / size(rows, z), shown / size(report, z)]
    ratio = torch.stack(ratios)
    assert float((ratio - 1).abs().mean()) < 0.05
    assert float((ratio - 1).abs().max()) < (0.15 if hz == 1.0 else 0.1)


@pytest.mark.parametrize("hz", COLOURS)
def test_the_whitener_from_repeats_whitens_the_residuals_noise(hz):
    """Rows are filtered, so nothing is left near half their rate; below, the spectrum of the
    whitened rows is flat, and one in size."""
    passages = runs(1, count=6)
    z = noises(passages, 1, hz)
    found, _, (rows, _) = from_repeats(passages, z)
    white = found.whitener.apply_all(rows.apply([x.T for x in z]))
    power = torch.stack(
        [torch.fft.rfft(white[:, b]).abs().square() / (b.stop - b.start) for b in rows.bounds]
    ).mean((0, 1))
    frequency = torch.linspace(0, 0.5 / rows.interval, len(power))
    for low in range(7):
        band = (frequency >= low) & (frequency < low + 1)
        assert float(power[band].mean()) == pytest.approx(1.0, abs=0.25)
    assert float(white.square().mean()) == pytest.approx(1.0, abs=0.08)


def test_what_happens_once_does_not_raise_the_floor():
    """A push in one of two runs: joint 2 is said not to repeat, with the time of the push."""
    passages = runs(2)
    z = noises(passages, 2, 5.0)
    pushed = [x.clone() for x in z]
    t = times()
    pushed[1][:, 1] += 12 * torch.exp(-(((t - 11.0) / 0.5) ** 2))
    found, _, (rows, _) = from_repeats(passages, pushed)
    assert torch.allclose(found.rms / size(rows, z), torch.ones(3), atol=0.25)
    (note,) = found.report.notes
    assert "non-repeatable effect on joint 2" in note
    first, last = (float(x) for x in note.split("worst at ")[1].split(" s (")[0].split(" to "))
    assert first - 1 <= 11.0 <= last + 1


def test_a_load_in_one_run_only_is_no_noise():
    """Everywhere in the second run, so no block stands out; but the motion predicts it. (From 20 s
    the predictor is not sure on every motion: on this one it is.)"""
    passages = runs(4)
    z = noises(passages, 4)
    load = 8 * passages[1].motion.q[:, :1].cos() * torch.tensor([0.0, 1.0, 0.0])
    found, _, (rows, report) = from_repeats(passages, [z[0], z[1] + load])
    with_load = size(rows, [load / 2**0.5])[1]
    truth = size(rows, z)
    assert float(found.low[1]) <= 1.05 * float(truth[1])
    assert float(found.rms[1]) < 0.5 * float(with_load)
    assert float(found.report.low[1]) <= 1.05 * float(size(report, z)[1])
    assert torch.allclose((found.rms / truth)[[0, 2]], torch.ones(2), atol=0.1)
    (note,) = found.report.notes
    assert "non-repeatable effect on joint 2" in note
    assert "function of the motion" in note


def test_what_the_flexible_predictor_leaves_limits_the_repeats():
    """Two runs that share next to nothing but their positions: a predictor that knows the residual
    says that the noise is smaller."""
    passages = runs(3)
    z = noises(passages, 3)
    wild = [x + 5 * y for x, y in zip(z, noises(passages, 4, 1.0), strict=True)]
    rows, report = rows_of(passages)
    r = rows.apply([x.T for x in wild])
    known = replace(
        predict_out_of_fold(passages, rows, r),
        prediction=r - rows.apply([x.T for x in z]),
        r2=torch.full((3,), 0.9),
    )
    found = noise_floor(
        with_torque(passages, wild), wild, rows, report, known, find_repeats(passages)
    )
    assert torch.allclose(found.high, size(rows, z))
    assert len(found.report.notes) == 3


@pytest.mark.parametrize("hz", COLOURS)
@pytest.mark.parametrize("gap", [0.0, 2.0])
def test_the_bracket_holds_the_noise(hz, gap):
    """Without repeats, with nothing unmodelled and with a smooth function of the motion. The lower
    end is the white level, far below coloured noise; the upper end is of the noise's order."""
    for seed in (0, 1):
        passages = runs(seed, count=3, same=False)
        z = noises(passages, seed, hz)
        residual = [
            x + gap * (torch.tanh(p.motion.dq) + p.motion.q.cos())
            for x, p in zip(z, passages, strict=True)
        ]
        rows, report = rows_of(passages)
        flexible = predict_out_of_fold(passages, rows, rows.apply([x.T for x in residual]))
        found = noise_floor(with_torque(passages, residual), residual, rows, report, flexible)
        assert found.report.source == "bracket"
        for low, high, r in (
            (found.low, found.high, rows),
            (found.report.low, found.report.high, report),
        ):
            truth = size(r, z)
            assert bool((low <= 1.02 * truth).all())
            assert bool((high >= 0.97 * truth).all())
            assert bool((low >= (0.85 if hz is None else 0.04) * truth).all())
        if gap == 0:
            assert bool((found.high <= 1.03 * size(rows, z)).all())
        else:
            assert float((found.high / size(rows, residual)).mean()) < 0.9


def test_a_floor_needs_something_to_go_by():
    passages = runs()
    with pytest.raises(ValueError, match="repeats"):
        noise_floor(passages, [p.tau for p in passages], *rows_of(passages))
