"""What a measured torque is worth: does it follow the motion, and is its scale known?

The torque of a joint that is measured at all can be predicted from its motion, by whatever rigid
body and friction fit best, much better than by its mean. Where they cannot do that on stretches
they were not fitted on, a log tells nothing about the joint's dynamics; a model that predicts
torque there has a gap that is none of its faults.
"""

import math

import torch

from torchid.design.columns import Columns
from torchid.design.gram import least_squares
from torchid.log.model import Log
from torchid.statistics.robust import robust_std
from torchid.typing import Bool, Float, Int, Tensor

DRIVE_GAIN = 0.05
"""How well torque constants times gear ratios are known [1]: two published sets of one arm differ
by 3 to 33 %, makers promise a few per cent."""


def without_signal(
    columns: Columns,
    torque: Float[Tensor, "n N"],
    gap: Float[Tensor, "n N"],
    keep: Bool[Tensor, "n N"],
    parts: Int[Tensor, " N"],
) -> Bool[Tensor, " n"]:
    """Joints (n,) whose measured torque no rigid body with friction predicts better than its own
    mean does, though a model predicts as much torque as is measured: in all, or on half of the
    stretches; what is fitted was not fitted on the stretch that is judged.

    Args:
        columns: at any model; the regressor depends on the kinematics alone.
        torque: measured, as samples.
        gap: what the model leaves of it.
        keep: samples that count.
        parts: (N,) stretch of every sample, from 1; 0 of those between stretches.
    """
    out = []
    # Eigenvalue of the products of columns of length one, relative to the largest, below which a
    # direction is not fitted: hardly excited, it would predict little and be wrong about it
    excited = 1e-4
    for joint, (y, error) in enumerate(zip(torque, gap, strict=True)):
        a = columns.laws(joint)
        # A push is no law: what is far off what fits the usual torques takes no part.
        telling = keep[joint] & ~_far(y - y.median(), keep[joint])
        telling &= ~_far(y - least_squares(a[:, telling], y[telling], excited) @ a, telling)
        # What the body, the model and the mean leave of each stretch; and of all together.
        rows = []
        for part in range(1, int(parts.max()) + 1):
            fitted, judged = telling & (parts > 0) & (parts != part), telling & (parts == part)
            if fitted.any() and judged.any():
                body = y[judged] - least_squares(a[:, fitted], y[fitted], excited) @ a[:, judged]
                given = error[judged] - error[fitted].mean()
                usual = y[judged] - y[fitted].mean()
                rows.append([float(x.square().sum()) for x in (body, given, usual)])
        sums = torch.tensor(rows).reshape(-1, 3)
        left = torch.cat([sums, sums.sum(0, keepdim=True)])
        # Twice as much: what the model predicts varies as much as what is measured, beside it.
        useless = (left[:, 0] >= left[:, 2]) & (left[:, 1] >= 2 * left[:, 2])
        most = 2 * int(useless[:-1].sum()) >= len(sums)
        out.append(len(sums) > 0 and (most or bool(useless[-1])))
    return torch.tensor(out)


def _far(x: Float[Tensor, " N"], keep: Bool[Tensor, " N"]) -> Bool[Tensor, " N"]:
    """Which of the samples that count are outside of what is usual."""
    if not keep.any():
        return torch.zeros_like(keep)
    # 4.0: robust standard deviations beyond which a torque, or what a fit leaves of it, is not a
    # usual one: of a normal variable one in sixteen thousand
    return x.abs() > 4.0 * robust_std(x[keep].unsqueeze(0)).nan_to_num(nan=math.inf)


def from_current(log: Log) -> bool:
    """Whether the log's torque is its current times one gain a joint."""
    if log.current is None or log.tau is None:
        return False
    tau, current = log.tau.double(), log.current.double()
    gain = (tau * current).sum(0) / current.square().sum(0).clamp(min=1e-300)
    return torch.allclose(tau, gain * current, rtol=1e-4, atol=1e-9)
