"""One basis for the base parameters of several identifications.

Two identifications of one arm may group its parameters differently: another effect among the
columns, a model whose gravity lies along an axis, a rank that was decided otherwise. What both
determine are combinations w' pi of the whole parameter vector that lie in the row space of both
groupings, base = G pi. Each row of the common basis is such a w; with G's independent columns the
identity, its value is w_I' base, w_I being w's entries at the independent parameters.
"""

from collections.abc import Mapping, Sequence

import torch

from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.least_squares import contaminated_columns
from torchid.identification.record import IdentificationRecord
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

POSITION, GRAVITY = 5e-3, 0.05
"""Differences of recorded kinematics [m; and of rotation matrices] and gravity [m/s^2] that count
as none."""


def common_basis(
    results: Mapping[str, IdentificationRecord],
) -> tuple[list[tuple[str, str]], Float[Tensor, "D m"], Float[Tensor, "D m"]]:
    """The results' estimates in one basis: the rigid body's of the result with the fewest, and
    every result's own effects.

    Args:
        results: by what to call them.

    Returns:
        Names and units of D combinations, values (D, m) and standard deviations (D, m) of the
        results; nan where not estimated. What a fit held at zero is 0 without standard deviation.

    Raises:
        TorchidError: results of arms with different kinematics, or one that contradicts itself.
    """
    bases = [r.base for r in results.values()]
    counts = {label: len(r.reversal) for label, r in results.items()}
    if len(set(counts.values())) > 1:
        raise TorchidError(
            "the results are of arms with different numbers of joints.",
            got=", ".join(f"{label}: {n}" for label, n in counts.items()),
        )
    union = list(dict.fromkeys(name for base in bases for name in base.parameter_names))
    wide = _groupings(bases, union)
    # Combinations to compare: the rigid body's of the poorest result, and all effects' own.
    poorest = min(range(len(bases)), key=lambda k: bases[k].n_rigid)
    rigid = bases[poorest].n_rigid
    picked = [(poorest, b) for b in range(rigid)]
    # Relative distance of a combination from a row space below which it lies in it: kinematics that
    # differ by a calibration of millimetres still compare
    same_combination = 1e-2
    for k, base in enumerate(bases):
        for b in range(base.n_rigid, len(base)):
            known = (wide[i][c] for i, c in picked[rigid:])
            if not any(torch.allclose(wide[k][b], other, atol=same_combination) for other in known):
                picked.append((k, b))
    rows = torch.stack([wide[k][b] for k, b in picked])
    values, std = [], []
    for (label, record), base, own in zip(results.items(), bases, wide, strict=True):
        turn = rows[:, [union.index(base.parameter_names[k]) for k in base.independent]]
        size = torch.linalg.vector_norm(rows, dim=1)
        within = torch.linalg.vector_norm(turn @ own - rows, dim=1) <= same_combination * size
        if not bool(within[:rigid].all()):
            k, b = picked[int((~within).nonzero()[0, 0])]
            raise TorchidError(
                "the results are of arms with different kinematics, or of one arm described in "
                "different frames: their base parameters are different quantities.",
                got=f"{label} has no combination {bases[k].names[b]}",
                hint="identify all logs with the same robot file",
            )
        used = turn.abs() > same_combination * size.unsqueeze(1)
        unknown = base.mask(record.undetermined)
        unknown |= contaminated_columns(record.factor[:, : len(base)], unknown)
        known = within & ~(used & unknown).any(1)
        estimated = known & (used & record.free).any(1)
        variance = ((turn @ record.covariance) * turn).sum(1).clamp(min=0)
        values.append(torch.where(known, turn @ record.values, torch.nan))
        std.append(torch.where(estimated, variance.sqrt(), torch.nan))
    named = [(bases[k].names[b], bases[k].units[b]) for k, b in picked]
    return named, torch.stack(values, 1), torch.stack(std, 1)


def refuse_other_kinematics(robots: Mapping[str, Robot | None]) -> None:
    """Raise if kinematics, as far as they are known, differ."""
    known = [(label, robot) for label, robot in robots.items() if robot is not None]
    for label, two in known[1:]:
        first, one = known[0]
        said, kinds = "", ["".join(t.value for t in r.joint_types) for r in (one, two)]
        if kinds[0] != kinds[1]:
            said = f"joints {kinds[0]} and {kinds[1]}"
        else:
            apart = torch.maximum((one.before - two.before).abs(), (one.after - two.after).abs())
            if float((most := apart.amax((1, 2))).max()) > POSITION:
                k = int(most.argmax())
                said = f"the pose of joint {k + 1} differs by {float(most[k]):.3g}"
            elif float((one.gravity - two.gravity).abs().max()) > GRAVITY:
                said = f"gravity {one.gravity.tolist()} and {two.gravity.tolist()}"
        if said:
            raise TorchidError(
                "the results are of arms with different kinematics: their parameters are "
                "different quantities.",
                got=f"{first} and {label}: {said}",
                hint="identify all logs with the same robot file",
            )


def _groupings(bases: Sequence[BaseParameters], union: Sequence[str]) -> list[Tensor]:
    """Each result's grouping (B, U) of all parameters. It also holds effects the result did not
    have but whose columns are combinations of its own: what was fitted without Ia1 determines
    J1zz + Ia1 all the same."""
    out = []
    for base in bases:
        own = torch.zeros(len(base), len(union), dtype=torch.float64)
        own[:, [union.index(name) for name in base.parameter_names]] = base.grouping
        out.append(own)
    for base in bases:
        made_of = [base.parameter_names[k] for k in base.independent]
        for name in base.absorbed_effects():
            column = base.grouping[:, base.parameter_names.index(name)]
            parts = column.nonzero().flatten().tolist()
            for other, grouping in zip(bases, out, strict=True):
                names = other.parameter_names
                if name in names or any(made_of[k] not in names for k in parts):
                    continue
                index = [union.index(made_of[k]) for k in parts]
                grouping[:, union.index(name)] = grouping[:, index] @ column[parts]
    return out
