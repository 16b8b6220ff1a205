"""Rows that are taken out of whitened rows, against a dense generalised least squares without them.

The reference knows the covariance of the autoregression as a matrix, strikes out the missing rows
and columns, and solves.
"""

import pytest
import torch

from tests.gap.problems import random
from torchid.gap.missing import WhiteRows
from torchid.gap.whitener import Whitener, fit_whitener
from torchid.typing import Tensor

COUNT = 150
BOUNDS = (slice(0, 60), slice(60, COUNT))
ORDER = 4


def whitener() -> Whitener:
    """Of two joints with differently coloured noise."""
    g = torch.Generator().manual_seed(0)
    e = torch.randn(2, 4000, generator=g, dtype=torch.float64)
    x = e.clone()
    for t in range(2, 4000):
        x[0, t] += 0.9 * x[0, t - 1]
        x[1, t] += 1.2 * x[1, t - 1] - 0.8 * x[1, t - 2]
    return fit_whitener(x, (slice(0, 4000),), order=ORDER).on(BOUNDS)


def covariance(white: Whitener, joint: int) -> Tensor:
    """Autocovariances of the process by the Yule-Walker equations; trajectories independent."""
    a, p = white.predictors[joint, -1], white.order
    # gamma_k + sum_m a_m gamma_|k-m| = s^2 [k = 0], k = 0..p
    matrix = torch.zeros(p + 1, p + 1, dtype=torch.float64)
    for k in range(p + 1):
        for m, weight in enumerate([1.0, *a.tolist()]):
            matrix[k, abs(k - m)] += weight
    right = torch.zeros(p + 1, dtype=torch.float64)
    right[0] = white.std[joint, -1] ** 2
    gamma = torch.linalg.solve(matrix, right).tolist()
    for _ in range(p + 1, COUNT):
        gamma.append(-sum(float(w) * gamma[-1 - m] for m, w in enumerate(a)))
    out = torch.zeros(COUNT, COUNT, dtype=torch.float64)
    for own in BOUNDS:
        index = torch.arange(own.stop - own.start)
        out[own, own] = torch.tensor(gamma)[(index[:, None] - index).abs()]
    return out


def missing(kind: str) -> Tensor:
    keep = torch.ones(COUNT, dtype=torch.bool)
    if kind == "starts and ends":
        keep[:3] = keep[57:63] = keep[-2:] = False
    elif kind == "single rows":
        keep[torch.tensor([5, 8, 20, 70, 71, 110])] = False
    elif kind == "a long stretch":
        keep[20:50] = False
    elif kind == "most":
        keep[random(COUNT, seed=9) > -0.5] = False
    elif kind == "a whole trajectory":
        keep[:60] = False
    return keep


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize(
    "kind",
    ["nothing", "starts and ends", "single rows", "a long stretch", "most", "a whole trajectory"],
)
def test_least_squares_is_the_generalised_one_on_the_rows_left(kind, joint):
    white, keep = whitener(), missing(kind)
    rows = WhiteRows(white, keep.expand(2, -1))
    x, y = random(3, COUNT, seed=1), random(COUNT, seed=2)
    wx, wy = rows(x, joint), rows(y.unsqueeze(0), joint)[0]
    found = torch.linalg.lstsq(wx.T, wy.unsqueeze(1)).solution[:, 0]
    left = float((wy - found @ wx).square().sum())

    inverse = torch.linalg.inv(covariance(white, joint)[keep][:, keep])
    kx, ky = x[:, keep], y[keep]
    expected = torch.linalg.solve(kx @ inverse @ kx.T, kx @ inverse @ ky)
    r = ky - expected @ kx
    assert torch.allclose(found, expected, rtol=1e-8)
    assert left == pytest.approx(float(r @ inverse @ r), rel=1e-8)


def test_what_missing_rows_hold_does_not_matter():
    white, keep = whitener(), missing("starts and ends")
    rows = WhiteRows(white, keep.expand(2, -1))
    y = random(COUNT, seed=2)
    other = torch.where(keep, y, 1e3 * random(COUNT, seed=3))
    for joint in (0, 1):
        assert torch.allclose(rows(y, joint), rows(other, joint), atol=1e-8)


def test_noise_keeps_one_unit_a_row_that_is_left():
    """The expected sum of squares is the number of rows left: the trace of the projection."""
    white, keep = whitener(), missing("single rows")
    rows = WhiteRows(white, torch.stack([keep, missing("most")]))
    for joint, own in enumerate((keep, missing("most"))):
        root = torch.linalg.cholesky(covariance(white, joint))
        assert float(rows(root.T, joint).square().sum()) == pytest.approx(int(own.sum()), rel=1e-8)


def test_the_rows_of_each_joint_are_its_own():
    white = whitener()
    keep = torch.stack([missing("a long stretch"), missing("nothing")])
    rows = WhiteRows(white, keep)
    x = random(2, 3, COUNT, seed=4)
    assert torch.allclose(rows(x, 1), white.apply(x, 1))
    assert not torch.allclose(rows(x, 0), white.apply(x, 0))
