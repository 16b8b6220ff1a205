"""Where the log-Cholesky runs may go, and starts strictly inside."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from torchid.errors import TorchidError
from torchid.extraction.problem import Problem
from torchid.feasibility.conditions import Conditions, physics_only
from torchid.robot.inertia import second_moment
from torchid.typing import Bool, Float, Tensor

_ROOM = 1e-3
"""Share of an interval by which a run starts away from its ends."""
_BISECTIONS = 30


@dataclass(frozen=True, eq=False)
class Room:
    """Where runs may go.

    Attributes:
        box: (D, 2) of p, the boxes of the centres of mass narrowed by the conditions'.
        conditions: shapes and total mass.
        anchor: (D,) a point well inside.
    """

    box: Tensor
    conditions: Conditions
    anchor: Tensor


def room_of(problem: Problem, with_conditions: bool) -> Room:
    """The room that bounds and conditions leave, with a point well inside.

    Raises:
        TorchidError: they leave none.
    """
    n = problem.n
    asked = problem.conditions.to("cpu") if with_conditions else physics_only(n)
    box = problem.box.cpu().double().clone()
    own = asked.com_box.reshape(-1, 2)
    box[:n, 0] = box[:n, 0].clamp(min=0.0)
    box[n : 4 * n, 0] = torch.maximum(box[n : 4 * n, 0], own[:, 0])
    box[n : 4 * n, 1] = torch.minimum(box[n : 4 * n, 1], own[:, 1])
    shut = (box[:, 0] >= box[:, 1]).nonzero().flatten().tolist()
    names = [f"com_{(k - n) // 3 + 1}{'xyz'[(k - n) % 3]}" for k in shut if n <= k < 4 * n]
    names += [f"mass_{k + 1}" for k in shut if k < n]
    anchor = box.mean(-1)
    low, high = torch.maximum(asked.total_mass[0], box[:n, 0].sum()), asked.total_mass[1]
    high = torch.minimum(high, box[:n, 1].sum())
    if not low < high:
        names.append("total_mass")
    else:
        share = ((low + high) / 2 - box[:n, 0].sum()) / (box[:n, 1] - box[:n, 0]).sum()
        anchor[:n] = box[:n, 0] + share * (box[:n, 1] - box[:n, 0])
    com = anchor[n : 4 * n].reshape(n, 3)
    near = torch.clamp(asked.round_centre, *_inner(box[n : 4 * n]).reshape(n, 3, 2).unbind(-1))
    out = ~_in_shape(asked, com)
    com = torch.where(out.unsqueeze(-1), near, com)
    names += [f"shape_{i + 1}" for i in (~_in_shape(asked, com)).nonzero().flatten().tolist()]
    # Inertias as near a sphere's as the bounds allow.
    low, high = _inner(box[4 * n : 10 * n].reshape(n, 6, 2)).unbind(-1)
    inertia = torch.clamp(torch.zeros_like(low), low, high)
    diagonal = [0, 3, 5]
    middle = (low[:, diagonal].amax(-1) + high[:, diagonal].amin(-1)) / 2
    inertia[:, diagonal] = torch.clamp(middle.unsqueeze(-1), low[:, diagonal], high[:, diagonal])
    names += [f"inertia_{i + 1}" for i in (~_is_body(inertia)).nonzero().flatten().tolist()]
    if names:
        raise TorchidError(
            "conditions and bounds leave no room between them.",
            got=", ".join(names),
            hint="the certificate says which exclude each other; or leave the conditions out",
        )
    anchor[n : 4 * n] = com.flatten()
    anchor[4 * n : 10 * n] = inertia.flatten()
    return Room(box, asked, anchor)


def _inner(box: Tensor) -> Tensor:
    """The box without a rim."""
    rim = _ROOM * (box[..., 1] - box[..., 0])
    return torch.stack([box[..., 0] + rim, box[..., 1] - rim], -1)


def _in_shape(asked: Conditions, com: Float[Tensor, "*batch n 3"]) -> Bool[Tensor, "*batch n"]:
    away = ((com - asked.round_centre) * asked.round_axes).norm(dim=-1)
    return away < (1 - _ROOM) * asked.round_radius


def _is_body(inertia: Float[Tensor, "*batch 6"]) -> Bool[Tensor, "*batch"]:
    """Whether second moments are positive definite, not nearly singular."""
    values = torch.linalg.eigvalsh(second_moment(inertia))
    return values[..., 0] > 1e-3 * _ROOM * values[..., 2].abs()


def moved_inside(problem: Problem, room: Room, p: Float[Tensor, "K D"]) -> Float[Tensor, "K D"]:
    """p moved towards the anchor until it is inside: masses, each centre of mass and each inertia
    by as much as they need, which is possible as their conditions are convex."""
    n, asked = problem.n, room.conditions
    box = _inner(room.box)
    p = torch.clamp(p, box[:, 0], box[:, 1])
    mass, com, inertia, rest = problem.split(p)
    mass0, com0, inertia0, _ = problem.split(room.anchor.expand_as(p))
    low, high = asked.total_mass
    rim = _ROOM * (high - low) if bool(torch.isfinite(high - low)) else 0.0

    def light(m: Tensor) -> Tensor:
        total = m.sum(-1)
        return (total > low + rim) & (total < high - rim)

    limits = box[4 * n : 10 * n].reshape(n, 6, 2)
    values, vectors = torch.linalg.eigh(second_moment(inertia))
    values = torch.maximum(values, _ROOM * values[..., 2:].clamp(min=1e-12))
    s = vectors @ torch.diag_embed(values) @ vectors.mT
    trace = s.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    i, j = torch.triu_indices(3, 3)
    body = (trace * torch.eye(3, dtype=s.dtype) - s)[..., i, j]

    def consistent(x: Tensor) -> Tensor:
        within = ((x >= limits[..., 0]) & (x <= limits[..., 1])).all(-1)
        return within & _is_body(x)

    mass = _towards(mass, mass0, light)
    com = _towards(com, com0, lambda c: _in_shape(asked, c)).flatten(-2)
    return torch.cat([mass, com, _towards(body, inertia0, consistent).flatten(-2), rest], -1)


def _towards(point: Tensor, anchor: Tensor, good: Callable[[Tensor], Tensor]) -> Tensor:
    """The first good point on the way from `point` to `anchor`, by bisection on the last axis."""
    bad, fine = torch.zeros_like(point[..., :1]), torch.ones_like(point[..., :1])
    at_once = good(point).unsqueeze(-1)
    for _ in range(_BISECTIONS):
        middle = (bad + fine) / 2
        ok = good(point + middle * (anchor - point)).unsqueeze(-1)
        bad, fine = torch.where(ok, bad, middle), torch.where(ok, middle, fine)
    return torch.where(at_once, point, point + fine * (anchor - point))
