"""Servos fitted to windows of logs: Gauss-Newton on simulated positions (multiple shooting).

One parameter is varied on all joints at once: what a joint's servo does to another joint's
position is small beside what it does to its own, and only the speed of convergence depends on it.
Every joint has its own damped step; of several dampings the best is kept by simulation.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.effects.servo import INDEX, PARAMETERS, TORQUES
from torchid.position.data import SMALL, PositionData
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import (
    Windows,
    profiles_of,
    rollout,
    set_points,
)
from torchid.typing import Bool, Float

LARGE = 0.03
"""Position error from which it counts less than its square [rad]."""
TOGETHER_S = 1.0
"""Time for which errors are taken to be alike while servos are sought [s]; how well they are known
then follows from what is left (`judge.alike_rows`)."""
DAMPINGS = (0.0, 1.0, 10.0, 100.0)
LONGEST = 0.7
"""Longest step of a logarithm [1]."""
NOISE = 0.003
"""Largest position error that a prior is weighed against [rad]: of two counts of a small servo."""
LEAST_ROTOR = 1e-5
"""Inertia of a rotor over the gain, at least: 5 per mille of a small servo's [s^2]."""
FINEST = 1e-6
"""Least one [rad], of the finest encoders: a joint at rest may have no error at all."""
HARDLY = 2e-3
"""Share of a joint's loss below which another iteration is not worth its time [1]."""
VALLEYS = ("acceleration", "speed", "lag")
"""Numbers of set-points: the loss of motions that chase their commands has many small valleys, over
which no slope leads."""
_PLANE_STEP = torch.tensor([3e-3, 3e-3, 3e-3, 2e-3, 1e2], dtype=torch.float64)


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Residuals of windows, and how they answer to parameters.

    Attributes:
        residual: (L, W, n) simulated minus measured [rad]; 0 after a window's end.
        slope: (L, W, n, K) by the searched coordinate of each of K parameters.
        plane: (L, W, n, 5) by the plane's numbers, or None.
    """

    residual: Tensor
    slope: Tensor
    plane: Tensor | None


def searched(servos: Servos) -> Tensor:
    """(..., n, K) coordinates in which a search steps: logarithms of what is positive, and torques
    as shares of kp. What motions without a load do not tell is then one coordinate alone."""
    out = absolute(servos)
    gain = servos.of("kp")
    for name in TORQUES:
        k = INDEX[name]
        if name == "kp":
            continue
        if PARAMETERS[k].kind == "log":
            out[..., k] -= gain.log()
        else:
            out[..., k] *= SMALL / gain
    return out


def absolute(servos: Servos) -> Tensor:
    """(..., n, K) values, logarithms of what is searched so."""
    out = servos.joint.clone()
    logs = [k for k, p in enumerate(PARAMETERS) if p.kind == "log"]
    out[..., logs] = out[..., logs].log()
    return out


def from_absolute(values: Tensor) -> Tensor:
    """(..., n, K) parameters: the inverse of `absolute`, none below zero that is positive."""
    joint = values.clone()
    for k, p in enumerate(PARAMETERS):
        if p.kind == "log":
            joint[..., k] = joint[..., k].exp()
        elif p.kind == "positive":
            joint[..., k] = joint[..., k].clamp(min=0)
    return joint


def moved(servos: Servos, coordinates: Tensor) -> Servos:
    """The servos at other coordinates (..., n, K)."""
    joint = from_absolute(coordinates)
    gain = joint[..., INDEX["kp"]]
    for k, p in enumerate(PARAMETERS):
        if p.name in TORQUES and p.name != "kp":
            joint[..., k] *= gain if p.kind == "log" else gain / SMALL
    # No motor is without a rotor, however little a log tells of it.
    k = INDEX["armature"]
    joint[..., k] = torch.maximum(joint[..., k], LEAST_ROTOR * gain)
    return replace(servos, joint=joint, plane=servos.plane.expand(*joint.shape[:-2], 5).clone())


def errors(data: PositionData, servos: Servos, windows: Windows) -> Float[Tensor, "L W n P"]:
    """Simulated minus measured positions [rad]; 0 after a window's end."""
    profiles, owner = profiles_of(servos).unique(dim=0, return_inverse=True)
    # Most steps of a fit leave the profiles as they are.
    known = data.set_points.get(servos.repeated)
    if known is None or known[0].shape != profiles.shape or not torch.equal(known[0], profiles):
        known = profiles, set_points(profiles, data.tracks, repeated=servos.repeated)
        data.set_points[servos.repeated] = known
    q = rollout(
        servos,
        data.body,
        data.tracks,
        windows,
        *data.start(windows),
        points=known[1],
        measured=data.q,
        owner=owner,
    )
    rows = windows.start + torch.arange(len(q))[:, None]
    measured = data.q[rows.clamp(max=len(data.q) - 1)][..., None]
    if data.beside is not None:
        measured = measured - data.beside(windows, searched(servos))
    return (q - measured).nan_to_num_(nan=0.0)


def errors_of_one(data: PositionData, servos: Servos, windows: Windows) -> Float[Tensor, "L W n"]:
    """Errors of one set of servos alone."""
    one = replace(servos, joint=servos.joint[None], plane=servos.plane[None])
    return errors(data, one, windows)[..., 0]


def loss(error: Tensor, windows: Windows) -> Tensor:
    """Huber's loss (n, P) of errors (L, W, n, P), as a sum of squares where they are small."""
    return (huber(error) * windows.weight[:, None, None]).sum(0)


def huber(error: Tensor) -> Tensor:
    """Huber's loss of windows: (W, ...) of errors (L, W, ...)."""
    a = error.abs() / LARGE
    return (torch.where(a < 1, a * a, 2 * a - 1) * LARGE**2).sum(0)


def sensitivities(
    data: PositionData,
    servos: Servos,
    names: tuple[str, ...],
    windows: Windows,
    *,
    plane: bool = False,
) -> Sensitivities:
    """Residuals of one set of servos, and their differences by every parameter of `names`."""
    here = searched(servos)
    sets, steps = [here], []
    for name in names:
        p = PARAMETERS[INDEX[name]]
        step = p.difference
        there = here.clone()
        there[:, INDEX[name]] += step
        sets.append(there)
        steps.append(step)
    count = len(sets) + (5 if plane else 0)
    sets += [here] * (count - len(sets))
    batch = moved(servos, torch.stack(sets))
    if plane:
        batch.plane[len(names) + 1 :] += torch.diag(_PLANE_STEP)
    error = errors(data, batch, windows)
    change = error[..., 1:] - error[..., :1]
    slope = change[..., : len(names)] / torch.tensor(steps, dtype=torch.float64)
    return Sensitivities(
        error[..., 0], slope, change[..., len(names) :] / _PLANE_STEP if plane else None
    )


def weights(residual: Tensor, windows: Windows) -> Tensor:
    """Huber's weights (L, W, n), times what each window stands for."""
    return LARGE / residual.abs().clamp(min=LARGE) * windows.weight[:, None]


def prior_precision(
    names: tuple[str, ...], square: Float[Tensor, " n"], rows: float | Tensor
) -> Float[Tensor, "n K"]:
    """Of the searched coordinates, in units of a squared position error.

    Args:
        names: of the K parameters.
        square: mean square error of each joint [rad^2], which a prior is weighed against.
        rows: one after the other, or (n, 1), whose errors are alike [1].
    """
    return rows * square.clamp(FINEST**2, NOISE**2)[:, None] / prior_deviations(names) ** 2


def prior_deviations(names: tuple[str, ...]) -> Float[Tensor, " K"]:
    """Standard deviations of searched coordinates that are expected before any motion is seen."""
    return torch.tensor([PARAMETERS[INDEX[name]].prior for name in names], dtype=torch.float64)


def mean_square(residual: Tensor, w: Tensor, windows: Windows) -> Float[Tensor, " n"]:
    """Of each joint [rad^2], with Huber's weights (L, W, n)."""
    return (residual.square() * w).sum((0, 1)) / windows.rows


@dataclass(frozen=True, eq=False)
class _Search:
    """What is free of servos, and what pulls it.

    Attributes:
        names: of K parameters.
        mask: (n, K) where they are free.
        begun: (n, K) coordinates that a prior pulls towards.
    """

    names: tuple[str, ...]
    mask: Bool[Tensor, "n K"]
    begun: Float[Tensor, "n K"]

    @classmethod
    def of(cls, servos: Servos, free: Mapping[str, Tensor]) -> "_Search":
        """From where these servos are."""
        names = tuple(name for name, joints in free.items() if bool(joints.any()))
        none = torch.zeros(servos.n, 0, dtype=torch.bool)
        mask = torch.stack([free[name] for name in names], 1) if names else none
        return cls(names, mask, searched(servos)[:, [INDEX[name] for name in names]])

    @property
    def at(self) -> list[int]:
        """Indices of the names."""
        return [INDEX[name] for name in self.names]

    def equations(
        self, s: Sensitivities, there: Float[Tensor, "n P"], data: PositionData, windows: Windows
    ) -> tuple[Tensor, Tensor, Tensor]:
        """(n, K, K) gram and (n, K) pull of residuals and a prior at coordinates, with Huber's
        weights, and the prior's precision."""
        w = weights(s.residual, windows)
        square = mean_square(s.residual, w, windows)
        precision = prior_precision(self.names, square, TOGETHER_S / data.tracks.dt)
        a = (s.slope * w.sqrt()[..., None]).flatten(0, 1).transpose(0, 1).contiguous()
        b = (s.residual * w.sqrt()).flatten(0, 1).T
        gram = a.mT @ a + torch.diag_embed(precision)
        away = (there[:, self.at] - self.begun).nan_to_num(nan=0.0)
        pull = (a.mT @ b[..., None])[..., 0] + precision * away
        # What is not free has a unit equation of its own, with the answer 0.
        both = self.mask[:, :, None] & self.mask[:, None, :]
        gram = torch.where(both, gram, torch.eye(len(self.names), dtype=gram.dtype))
        return gram, torch.where(self.mask, pull, 0.0), precision


def fit(
    data: PositionData,
    servos: Servos,
    free: Mapping[str, Tensor],
    windows: Windows,
    *,
    plane: bool = False,
    iterations: int = 8,
) -> Servos:
    """Servos that follow the log's windows best.

    Args:
        data: motions.
        servos: one set, where the search starts.
        free: parameters to search, each with the joints (n,) on which it is free.
        windows: of the motions.
        plane: whether to search the plane's numbers too.
        iterations: of Gauss-Newton, at most, every second one with the slopes of that before, which
            costs a fifth; they end where no joint's loss falls much.
    """
    search = _Search.of(servos, free)
    if not plane and not search.names:
        return servos
    damping, plane_damping = torch.full((servos.n,), 1e-3, dtype=torch.float64), 1e-2
    for turn in range(iterations):
        if fresh := turn % 2 == 0:
            s = sensitivities(data, servos, search.names, windows, plane=plane)
        else:
            s = replace(s, residual=errors_of_one(data, servos, windows))
        here = searched(servos)
        gram, pull, precision = search.equations(s, here, data, windows)
        tried = here.repeat(len(DAMPINGS) + 1, 1, 1)
        for there, factor in zip(tried[1:], DAMPINGS, strict=True):
            extra = (damping * factor)[:, None] * gram.diagonal(dim1=1, dim2=2)
            step_by(there, search.at, gram + torch.diag_embed(extra), pull)
        batch = moved(servos, tried)
        if plane and s.plane is not None:
            w = weights(s.residual, windows)
            batch.plane[1:] += _plane_steps(s.plane, s.residual, w, plane_damping)
            batch.plane[:, 4].clamp_(min=50.0)
        # The first set is where the residuals are.
        others = replace(batch, joint=batch.joint[1:], plane=batch.plane[1:])
        tries = s.residual[..., None], errors(data, others, windows)
        cost = torch.cat([loss(error, windows) for error in tries], 1)
        away = (tried[..., search.at] - search.begun).nan_to_num(nan=0.0)
        cost = cost + (precision * away**2).sum(-1).T
        best = cost.argmin(1)
        joint = batch.joint[best, torch.arange(servos.n)]
        better = int(cost.sum(0).argmin())
        servos = replace(servos, joint=joint, plane=batch.plane[better].clone())
        factors = torch.tensor([8.0, 0.1, *DAMPINGS[1:]], dtype=torch.float64)
        damping = (damping * factors[best]).clamp(1e-6, 1e3)
        gain = float((1 - cost.amin(1) / cost[:, 0].clamp(min=1e-300)).max())
        plane_damping = max(1e-6, plane_damping * float(factors[better]))
        if fresh and gain < HARDLY:
            break
    return servos


def giving_way(
    data: PositionData, servos: Servos, sets: Servos, free: Mapping[str, Tensor], windows: Windows
) -> tuple[Servos, Float[Tensor, "n Q"]]:
    """Sets of servos as they are, and after one and two steps of what is free, and their losses.

    Args:
        data: motions.
        servos: one set near all of them, whose slopes are taken.
        sets: P of them.
        free: parameters that step, each with the joints (n,) on which it is free.
        windows: of the motions.
    """
    search = _Search.of(servos, free)
    s = sensitivities(data, servos, search.names, windows)
    gram, _, precision = search.equations(s, searched(servos), data, windows)
    ways, left = [sets], [errors(data, sets, windows)]
    for _ in range(2):
        tried = searched(ways[-1])
        # Residuals times Huber's weights, against all slopes at once.
        bounded = left[-1].clamp(-LARGE, LARGE) * windows.weight[:, None, None]
        pulls = torch.einsum("lwnk,lwnp->pnk", s.slope, bounded)
        pulls += precision * (tried[..., search.at] - search.begun).nan_to_num(nan=0.0)
        for there, pull in zip(tried, torch.where(search.mask, pulls, 0.0), strict=True):
            step_by(there, search.at, gram, pull)
        ways.append(moved(ways[-1], tried))
        left.append(errors(data, ways[-1], windows))
    joint, plane = (torch.cat([getattr(way, x) for way in ways]) for x in ("joint", "plane"))
    return replace(sets, joint=joint, plane=plane), loss(torch.cat(left, -1), windows)


def step_by(there: Float[Tensor, "n P"], at: list[int], gram: Tensor, pull: Tensor) -> None:
    """Move some of the coordinates to where they are pulled, no farther than logarithms may go."""
    logs, positive = (
        torch.tensor([PARAMETERS[k].kind == kind for k in at], dtype=torch.bool)
        for kind in ("log", "positive")
    )
    step = bounded_step(gram, pull, there[:, at], positive)
    there[:, at] += torch.where(logs, step.clamp(-LONGEST, LONGEST), step)


def bounded_step(
    gram: Float[Tensor, "n K K"],
    pull: Float[Tensor, "n K"],
    here: Float[Tensor, "n K"],
    positive: Bool[Tensor, " K"],
) -> Float[Tensor, "n K"]:
    """Where all pulls end. What would leave its range goes to the end of it, the others to where
    they are best beside that: cut off afterwards, they would make up for a step not made."""
    step = -torch.linalg.solve(gram, pull)
    beyond = positive & (here + step < 0)
    if not bool(beyond.any()):
        return step
    to = torch.where(beyond, -here, 0.0)
    rest = pull + (gram @ to[..., None])[..., 0]
    within = ~beyond[:, :, None] & ~beyond[:, None, :]
    gram = torch.where(within, gram, torch.eye(gram.shape[-1], dtype=gram.dtype))
    return torch.where(beyond, to, -torch.linalg.solve(gram, rest))


def _plane_steps(slope: Tensor, residual: Tensor, w: Tensor, damping: float) -> Tensor:
    """(D, 5) steps of the plane's numbers at several dampings."""
    a = (slope * _PLANE_STEP * w.sqrt()[..., None]).flatten(0, 2)
    b = (residual * w.sqrt()).flatten()
    gram = a.T @ a + 1e-9 * torch.eye(5, dtype=a.dtype)
    pull = a.T @ b
    out = []
    for factor in DAMPINGS:
        extra = damping * factor * torch.diag(gram.diagonal())
        out.append(-torch.linalg.solve(gram + extra, pull).clamp(-4, 4) * _PLANE_STEP)
    return torch.stack(out)
