"""What other errors of a model do to the coefficients of its causes.

Blocks of a log show the spread of what differs between them. What the model's other bodies are
wrong by is the same function of the state in all of them, and as far as it lies along a cause's
columns it is in the coefficient, and not in what is left. So what is left is held against errors of
bodies, all of one width, and the variance that errors of this width give the coefficients joins
that between blocks of what they do not explain (Kennedy and O'Hagan 2001, Bayesian calibration of
computer models, where the discrepancy is a Gaussian process).
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import logsumexp

from torchid.design.bodies import links_near, usual_bodies
from torchid.design.columns import Columns
from torchid.statistics.criteria import BODY_STD
from torchid.typing import Float, Tensor

WIDTHS = np.geomspace(1e-3, 1.0, 61)
"""Standard deviations of bodies, relative to `BODY_STD`, that are averaged over: a model that gives
three digits is wrong by no less."""


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Of a fit.

    Attributes:
        covariance: (P, P) that it gives the coefficients.
        torque: (R,) of what the fit leaves what it explains.
    """

    covariance: Float[Tensor, "P P"]
    torque: Float[Tensor, " R"]

    @classmethod
    def of(
        cls,
        columns: Float[Tensor, "P R"],
        left: Float[Tensor, " R"],
        functions: Float[Tensor, "F R"],
        inverse: Float[Tensor, "P P"],
    ) -> "Discrepancy":
        """Of functions of the state whose width follows from what is left.

        Args:
            columns, left: of a fit, and what it leaves, in units of what an independent sample
                leaves.
            functions: each of one standard deviation at most, weighted likewise.
            inverse: of the fit's normal matrix, with what was known beforehand.
        """
        if not len(functions):
            return cls(torch.zeros_like(inverse), torch.zeros_like(left))
        moved = inverse @ (columns @ functions.T)
        beside = functions - moved.T @ columns
        values, axes = torch.linalg.eigh(beside @ beside.T)
        pull = axes.T @ (beside @ left)
        variance, noise = _widths(values, pull, float(left.square().sum()))
        shrunk = pull * variance / (noise + variance * values.clamp(min=0))
        return cls(variance * moved @ moved.T, (axes @ shrunk) @ beside)


def _widths(
    values: Float[Tensor, " F"], pull: Float[Tensor, " F"], size: float
) -> tuple[float, float]:
    """Variances of the functions and of the noise: means over the likelihood of what is left, the
    noise profiled out; each order of magnitude of the functions' standard deviation is as likely
    beforehand as any other.

    Args:
        values, pull: eigenvalues of the functions' normal matrix, and along its axes what they see.
        size: sum of squares that is left, the number of samples that are independent.
    """
    seen, squares, ratio = values.clamp(min=0).numpy(), pull.square().numpy(), WIDTHS[:, None] ** 2
    explained = (ratio * squares / (1 + ratio * seen)).sum(1)
    noise = np.maximum(1 - explained / max(size, 1.0), 1e-9)
    likelihood = -0.5 * np.log1p(ratio * seen).sum(1) - 0.5 * size * np.log(noise)
    weight = np.exp(likelihood - logsumexp(likelihood))
    return float(weight @ (WIDTHS**2 * noise)), float(weight @ noise)


def body_errors(columns: Columns, known: Collection[int]) -> Float[Tensor, "F n N"]:
    """Torque of errors of bodies, of as much as a model's are wrong by at most: ten directions of
    each link; none of a model whose links are no bodies.

    Args:
        columns: at the model.
        known: links whose error is a cause.
    """
    pi, rows = columns.model.robot.require_parameters("a diagnosis").pi.double(), columns.regressor
    near = enumerate(links_near(pi, usual_bodies(pi), BODY_STD) or ())
    # x'Mx of a body's error is that of L'x, whose numbers are of size one.
    roots = {k: torch.linalg.inv(torch.linalg.cholesky(b.metric[0])) for k, b in near}
    each = [torch.tensordot(root, rows[k], 1) for k, root in roots.items() if k not in known]
    return torch.cat([rows[0, :0], *each])
