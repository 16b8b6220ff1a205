"""gamma(p): how much a set violates the conditions (eq. 2.30), as a sum of scaled violations.

Each condition h >= 0 adds max(0, -h) / s, with h the margins of `feasibility.margins` and a scale s
fixed by the bounds, so that a violation across the whole box counts about 1 whatever its unit:

- mass (2.22): s = largest size that the bounds allow the mass;
- smallest eigenvalue (2.24) and triangle inequality (2.26) of the barycentric inertia: s = largest
  size that the bounds allow the link's diagonal entries;
- box of the centre of mass (2.27): s = side of the search box; cylinder or sphere: its radius;
- coefficients of effects that physics forbids to be negative: s = their largest bound;
- total mass (2.31): s = length of its interval; of one open to one side, its end or 1 kg.

A sum of violations, not of their squares: it is an exact penalty, so from some xi on the minimiser
of phi + xi gamma has gamma = 0, not merely a small one.
"""

import math

import torch

from torchid.extraction.problem import Problem
from torchid.robot.inertia import symmetric
from torchid.typing import Float, Tensor


def gamma(
    problem: Problem, p: Float[Tensor, "*batch D"], *, exact: bool = True
) -> Float[Tensor, "*batch"]:
    """The sum of scaled violations (...).

    Args:
        problem: bounds and conditions.
        p: search vectors (..., D).
        exact: eigenvalues from LAPACK; otherwise in closed form, several times faster and good to
            some 1e-8 of the largest, which is what a search needs.
    """
    mass, com, inertia, coefficients = problem.split(p)
    bounds, c = problem.bounds, problem.conditions
    total = _short(mass, bounds.mass.abs().amax(-1).to(mass)).sum(-1)
    # Inertias.
    if exact:
        smallest, largest = torch.linalg.eigvalsh(symmetric(inertia))[..., [0, 2]].unbind(-1)
    else:
        smallest, largest = extreme_eigenvalues(inertia)
    half_trace = (inertia[..., 0] + inertia[..., 3] + inertia[..., 5]) / 2
    scale = bounds.inertia[:, [0, 3, 5]].abs().amax((-1, -2)).to(inertia)
    total = total + (_short(smallest, scale) + _short(half_trace - largest, scale)).sum(-1)
    # Centres of mass: boxes, then cylinders and spheres.
    box = c.com_box.to(com)
    side = (bounds.com[..., 1] - bounds.com[..., 0]).to(com)
    outside = _short(com - box[..., 0], side) + _short(box[..., 1] - com, side)
    of_com = outside.sum((-1, -2))
    if bool(torch.isfinite(c.round_radius).any()):
        radius = c.round_radius.to(com)
        away = ((com - c.round_centre.to(com)) * c.round_axes.to(com)).norm(dim=-1)
        beyond = (away - radius).clamp(min=0.0)
        of_com = of_com + torch.where(torch.isfinite(radius), beyond / radius, 0.0).sum(-1)
    total = total + of_com
    low, high = c.total_mass.tolist()
    ends = [abs(end) for end in (low, high) if math.isfinite(end)]
    if ends:
        length, sum_of_masses = high - low if len(ends) == 2 else ends[0] or 1.0, mass.sum(-1)
        below, above = (low - sum_of_masses).clamp(min=0.0), (sum_of_masses - high).clamp(min=0.0)
        total = total + (below + above) / length
    # Signs of the effects' coefficients.
    bounded = problem.non_negative.to(coefficients.device)
    largest_bound = problem.box[10 * problem.n :].abs().amax(-1).to(coefficients)
    return total + _short(coefficients[..., bounded], largest_bound[bounded]).sum(-1)


def _short(margin: Tensor, scale: Tensor) -> Tensor:
    return (-margin).clamp(min=0.0) / scale


def extreme_eigenvalues(inertia: Float[Tensor, "*batch 6"]) -> tuple[Tensor, Tensor]:
    """Smallest and largest eigenvalue (...) of symmetric 3x3 matrices (..., 6: xx xy xz yy yz zz).

    Closed form (Smith 1961): with A = m E + K, tr K = 0, the eigenvalues are m + 2 s cos of three
    angles a third of a turn apart.
    """
    xx, xy, xz, yy, yz, zz = inertia.unbind(-1)
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    off = xy * xy + xz * xz + yz * yz
    spread = ((a * a + b * b + c * c + 2 * off) / 6).sqrt()
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cube = 2 * spread**3
    ratio = (determinant / torch.where(cube > 0, cube, torch.ones_like(cube))).clamp(-1.0, 1.0)
    angle = torch.acos(ratio) / 3
    largest = mean + 2 * spread * torch.cos(angle)
    smallest = mean + 2 * spread * torch.cos(angle + 2 * math.pi / 3)
    return smallest, largest
