"""Identification of robots with branches: parameters come back, and shorter ways give the same."""

import pytest
import torch

import torchid
from tests.trees import random_tree
from torchid.identification import statistics
from torchid.identification.base_parameters import nominal_values
from torchid.identification.least_squares import whitened_rows
from torchid.identification.tuning import LONGEST, MANY, shortened

TREE = random_tree([-1, 0, 1, 0, 3, -1, 5], "RRRRPRR", 4, {6: 5})


@pytest.fixture(scope="module")
def log() -> torchid.Log:
    """Two motions of sums of sines, with 1 % noise and viscous friction on every joint."""
    draw, n = torch.Generator().manual_seed(2), TREE.n
    t, parts = torch.arange(2400, dtype=torch.float64) / 200, []
    for _ in range(2):
        omega, phase, size = torch.rand(3, n, 4, generator=draw, dtype=torch.float64)
        omega = 6 * omega + 0.5
        angle = omega * t[:, None, None] + 6 * phase
        q = (0.3 * size * angle.sin()).sum(-1)
        dq = (0.3 * size * omega * angle.cos()).sum(-1)
        ddq = -(0.3 * size * omega**2 * angle.sin()).sum(-1)
        parts.append(torch.stack([q, dq, ddq]))
    q, dq, ddq = torch.cat(parts, 1)
    tau = torchid.inverse_dynamics(TREE, q, dq, ddq) + 0.4 * dq
    tau += 0.01 * tau.std(0) * torch.randn(tau.shape, generator=draw, dtype=torch.float64)
    number = torch.arange(2).repeat_interleave(len(t))
    return torchid.Log(t.repeat(2), q, dq=dq, tau=tau, trajectory=number)


def found(log: torchid.Log):
    settings = torchid.Settings(effects=("viscous_friction",), held_out_fraction=0.0)
    return torchid.identify(TREE, log, settings=settings)


@pytest.mark.slow
def test_base_parameters_and_friction_come_back(log):
    result = found(log)
    expected = nominal_values(TREE, result.base)
    expected[result.base.n_rigid :] = 0.4
    off = (result.values - expected) / result.covariance.diagonal().sqrt()
    assert float(off.square().mean().sqrt()) < 2.0
    friction = result.values[[k for k, n in enumerate(result.base.names) if n.startswith("Fv")]]
    assert len(friction) == TREE.n
    torch.testing.assert_close(friction, torch.full_like(friction, 0.4), rtol=0.1, atol=0.02)


@pytest.mark.nightly
def test_a_joints_own_columns_give_the_covariance_of_all(log, monkeypatch):
    short = found(log)

    def every_column(source, piece, kept, fit, free, inverse):
        for rows in whitened_rows(source, piece, kept, fit.whitening):
            yield rows[:, -1] - rows[:, :-1] @ fit.x, rows[:, free] @ inverse

    monkeypatch.setattr(statistics, "_in_coordinates", every_column)
    whole = found(log)
    torch.testing.assert_close(short.covariance, whole.covariance, rtol=1e-6, atol=1e-12)


def test_many_joints_choose_by_less_of_the_log():
    samples = LONGEST // 2
    t = torch.arange(samples, dtype=torch.float64) / 500
    for n, kept in ((MANY, samples), (3 * MANY, round(LONGEST / 9))):
        log = torchid.Log(t, torch.zeros(samples, n))
        assert shortened(log).samples == kept
