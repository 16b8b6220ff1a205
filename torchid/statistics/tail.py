"""How likely a value is that is larger than any seen: from the tail of the others."""

import math

from torchid.typing import Float, Tensor

TAIL_SHARE = 0.2
"""Share of the values that are its tail."""

FEWEST = 20
"""Values of a tail from which its shape is estimated to a quarter."""


def tail_probability(values: Float[Tensor, " W"], x: float) -> float | None:
    """Probability of a value above x, where the tail of some values leads to: a generalised Pareto
    distribution by probability-weighted moments, no lighter than an exponential one.

    Source: Hosking and Wallis 1987, Parameter and quantile estimation for the generalized Pareto
    distribution, Technometrics 29(3), eq. 5.

    Args:
        values: of which none is above x by more than chance.
        x: the value.

    Returns:
        1 where x is not in the tail; None where too few values are to know how it goes on.
    """
    edge = float(values.quantile(1 - TAIL_SHARE))
    over = (values[values > edge] - edge).sort().values
    if x <= edge:
        return 1.0
    if len(over) < FEWEST:
        return None
    # Means of the exceedances, and of these times the share of larger ones.
    rank = 1 - (over.new_tensor(range(1, len(over) + 1)) - 0.35) / len(over)
    mean, weighted = float(over.mean()), float((rank * over).mean())
    shape = max(0.0, 2 - mean / max(mean - 2 * weighted, 1e-12 * mean))
    scale = mean * (1 - shape)
    if scale <= 0:  # its mean is not finite
        return TAIL_SHARE
    y = (x - edge) / scale
    return TAIL_SHARE * (math.exp(-y) if shape < 1e-6 else (1 + shape * y) ** (-1 / shape))
