"""Which of many parameter sets are one and the same."""

import torch

from torchid.typing import Float, Int, Tensor


def alike(force: Float[Tensor, "K n"], group: Int[Tensor, " K"] | None = None) -> Int[Tensor, " K"]:
    """Which sets are one and the same (K,): those of a group whose forces agree to 0.1 %.

    Where a loss has one minimiser all runs of a search end there: one observation, not fifty.

    Args:
        force: (K, n) force errors [N].
        group: (K,) sets of different groups are never the same; one group if None.
    """
    digits = (force.clamp(min=1e-9).log() * 1e3).round().nan_to_num(0.0).long()
    own = torch.zeros_like(digits[:, 0]) if group is None else group
    return torch.unique(torch.cat([own.unsqueeze(-1), digits], -1), dim=0, return_inverse=True)[1]
