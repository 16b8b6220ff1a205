"""Which region each chain of a kind of violation samples: which links are relaxed, and how far."""

from dataclasses import replace

import numpy as np
import torch

from torchid.extraction.equal_torque.space import EqualTorqueSpace, Limits
from torchid.typing import Tensor

SLIGHTEST = 0.02
"""Relaxation of the first chain of a kind; the last has 1, those between a geometric sequence."""
FIRMEST = 0.5
"""Degree that the most firmly feasible chain asks for, if there are such sets."""


def relaxed_limits(
    walk: EqualTorqueSpace, relaxed: frozenset[str], chains: int, generator: np.random.Generator
) -> Limits | None:
    """Limits of the chains of a kind, from slightly to grossly relaxed; None if the conditions
    leave the kind nothing to violate."""
    limits = walk.limits(chains)
    if not relaxed:
        return _tightened(walk, limits)
    # What leaves a kind nothing to violate.
    wider = torch.isfinite(walk.conditions.com_box) & (walk.widest != walk.conditions.com_box)
    possible = {
        "com": bool(wider.any()),
        "total_mass": bool(torch.isfinite(walk.conditions.total_mass).any()),
        "shape": bool(torch.isfinite(walk.conditions.round_radius).any()),
    }
    if not all(possible.get(kind, True) for kind in relaxed):
        return None
    for kind in sorted(relaxed):
        level = torch.linspace(0.0, 1.0, chains, dtype=walk.x.dtype)
        if len(relaxed) > 1:
            level = level[torch.from_numpy(generator.permutation(chains))]
        # Random links (chains, n), any number of them from 1 to n, all numbers equally often.
        order = generator.permuted(np.tile(np.arange(walk.n), (chains, 1)), axis=1)
        count = generator.permutation(np.arange(chains) % walk.n) + 1
        links = torch.from_numpy(order < count[:, None])
        limits = _relaxed(kind, walk, limits, level, links, generator)
    return limits


def _tightened(walk: EqualTorqueSpace, limits: Limits) -> Limits:
    """Feasible with a degree of at least: nothing in half of the chains, then growing from chain to
    chain. Chains that ask for more than there is have an empty region."""
    k = limits.sign.shape[0]
    level = torch.linspace(-1.0, 1.0, k, dtype=walk.x.dtype)
    firm = _between(level.new_tensor(SLIGHTEST), level.new_tensor(FIRMEST), level).flatten()
    firm = torch.where(level > 0, firm, 0.0)
    by = firm.unsqueeze(-1)
    low, high = limits.com.unbind(-1)
    side = by.unsqueeze(-1) * (high - low) / 2
    half = (limits.total[:, 1:] - limits.total[:, :1]) / 2
    inner = torch.where(torch.isfinite(half), by * half, 0.0)
    return replace(
        limits,
        firm=firm,
        com=torch.stack([low + side, high - side], -1),
        radius=limits.radius * (1 - by),
        total=limits.total + torch.cat([inner, -inner], -1),
    )


def _between(slight: Tensor, gross: Tensor, level: Tensor) -> Tensor:
    """Geometrically from slight (n,) at level 0 to gross (n,) at 1, for each level: (K, n)."""
    power = level.reshape(-1, *[1] * slight.ndim)
    return gross * (slight / gross) ** (1 - power)


def _relaxed(
    kind: str,
    walk: EqualTorqueSpace,
    limits: Limits,
    level: Tensor,
    links: Tensor,
    generator: np.random.Generator,
) -> Limits:
    """The limits (K regions) without those of one kind, for levels (K,) and links (K, n)."""
    k, n = links.shape
    chain = torch.arange(k)
    share = _between(level.new_tensor(SLIGHTEST), level.new_tensor(1.0), level).reshape(-1, 1)
    if kind == "inertia":
        # Second moments from slightly below zero to where only |J| limits them.
        gross = torch.maximum(3 * walk.inertia.amax(-1), walk.scale)
        depth = _between(SLIGHTEST * walk.scale, gross, level)
        return replace(limits, second=torch.where(links, -depth, 0.0))
    if kind == "com":
        # Boxes on the way from the conditions' to the outer ones, and one coordinate of each chain
        # beyond one of its faces: otherwise few draws would violate anything.
        reach = (walk.widest - limits.com[0]).abs()
        faces = (reach.flatten() > 0).nonzero().flatten()
        face = faces[torch.from_numpy(generator.permutation(np.arange(k) % len(faces)))]
        link, side = face // 6, face % 2
        links = links | torch.nn.functional.one_hot(link, n).bool()
        com = limits.com + (share * links).reshape(k, n, 1, 1) * (walk.widest - limits.com)
        beyond = com.flatten(1)
        beyond[chain, face + 1 - 2 * side] = limits.com[0].flatten()[face]
        return replace(limits, com=beyond.reshape_as(com))
    if kind == "mass":
        # Negative masses: of one link in every other chain, of several in the rest.
        one = torch.nn.functional.one_hot(chain // 2 % n, n).bool()
        negative = torch.where((chain % 2 == 0).unsqueeze(-1), one, links)
        deepest = _between(SLIGHTEST * walk.mass_scale.expand(n), walk.heaviest, level)
        low = torch.where(negative, 0.0, limits.mass[..., 0])
        high = torch.where(negative, deepest, limits.mass[..., 1])
        sign = torch.where(negative, -1.0, 1.0).to(low)
        return replace(limits, sign=sign, mass=torch.stack([low, high], -1))
    if kind == "total_mass":
        # Above the interval, and below it in every other chain.
        low, high = limits.total.unbind(-1)
        part = share.flatten()
        above = torch.stack([high, high + part * (walk.heaviest.sum() - high).clamp(min=0.0)], -1)
        below = torch.stack([low * (1 - part), low], -1)
        down = ((chain % 2 == 1) & (low > 0)) | ~torch.isfinite(high)
        return replace(limits, total=torch.where(down.unsqueeze(-1), below, above))
    # Radii of the shapes up to twice themselves and the reach of the boxes.
    grown = limits.radius + share * (limits.radius + walk.widest.abs().amax(-1).norm(dim=-1))
    return replace(limits, radius=torch.where(links, grown, limits.radius))
