"""Compliance of joints whose link has an encoder of its own, from how far it lags the motor's.

    q_motor - q_link = c tau + d + e q + f sin q + g cos q

c is the compliance and tau the model's torque of the joint (Spong 1987); d is the encoders' common
zero, e a scale and f, g an eccentricity of one of them. It is a measurement of its own, to which
what the torques say is added.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.gram import VISIBLE, least_squares
from torchid.statistics.autocorrelation import integrated_time
from torchid.typing import Float, Tensor


@dataclass(frozen=True)
class Compliance:
    """Compliance of one joint, as encoders of motor and link tell it.

    Attributes:
        value, std: [rad/(N m); m/N], the noise as slow as what is left.
        rms: of the lag without the encoders' errors [rad; m].
        explained: share by which the compliance lowers it.
    """

    value: float
    std: float
    rms: float
    explained: float

    size = math.inf
    """It is no torque, which could be too small."""

    @property
    def sentence(self) -> str:
        """What it says of the compliance, as a sentence."""
        return (
            f"the encoders of motor and link tell {self.value:.3g} ± {self.std:.2g}, which lowers "
            f"a lag of {1e3 * self.rms:.2g} mrad (mm) by {100 * self.explained:.0f} %"
        )


def compliance(
    lag: Float[Tensor, " N"],
    load: Float[Tensor, " N"],
    q: Float[Tensor, " N"],
    bounds: Sequence[slice],
) -> Compliance | None:
    """The compliance of one joint, from samples of its lag [rad; m], model torque [N m; N] and
    position [rad; m]; None where the torque cannot be told from the encoders' errors, or the
    encoders agree exactly.

    Args:
        lag, load, q: (N,) low-passed alike.
        bounds: samples of each trajectory.
    """
    # The encoders' own errors are taken out of lag and torque (Frisch and Waugh 1933).
    own = torch.stack([torch.ones_like(q), q - q.mean(), torch.sin(q), torch.cos(q)])
    y, x = (s - least_squares(own, s) @ own for s in (lag, load))
    square = float(x.square().sum())
    if not square > VISIBLE * float(load.square().sum()) or not bool(y.any()):
        return None
    # What is left is as slow as it is; noise hides a slow torque (Newey and West 1987).
    value = float(x @ y) / square
    left = y - value * x
    time = float(integrated_time(left, bounds, centred=False, along=x))
    std = (float(left.square().mean()) * time / square) ** 0.5
    rms, after = (float(s.square().mean().sqrt()) for s in (y, left))
    return Compliance(value, std, rms, 1 - after / rms if rms > 0 else 0.0)
