"""One basis for the base parameters of several identifications.

Two identifications of one arm may group its parameters differently: another effect among the
columns, a model whose gravity lies along an axis, a rank that was decided otherwise. What both
determine are combinations w' pi of the whole parameter vector that lie in the row space of both
groupings, base = G pi. Each row of the common basis is such a w; with G's independent columns the
identity, its value is w_I' base, w_I being w's entries at the independent parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.compare.reading import Identified
from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

SAME = 1e-2
"""Relative distance of a combination from a row space below which it lies in it: kinematics that
differ by a calibration of millimetres still compare."""

POSITION, GRAVITY = 5e-3, 0.05
"""Differences of recorded kinematics [m; and of rotation matrices] and gravity [m/s^2] that count
as none."""


@dataclass(frozen=True, eq=False)
class Common:
    """Estimates of the same D combinations by m results.

    Attributes:
        names, units: (D,) of the combinations, readable.
        rigid: (D,) those of the rigid body.
        values, std: (m, D); 0 where not estimated.
        covariance, correlation: (m, D, D), as Identified's.
        estimated: (m, D).
        held: (m, D) held at zero by the fit.
        determined: (m, D) the result's structure has it; not the same as estimated.
        notes: sentences for the user.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rigid: Bool[Tensor, " D"]
    values: Float[Tensor, "m D"]
    covariance: Float[Tensor, "m D D"]
    correlation: Float[Tensor, "m D D"]
    estimated: Bool[Tensor, "m D"]
    held: Bool[Tensor, "m D"]
    determined: Bool[Tensor, "m D"]
    notes: tuple[str, ...]

    @property
    def std(self) -> Float[Tensor, "m D"]:
        """Standard deviations."""
        return self.covariance.diagonal(dim1=-2, dim2=-1).clamp(min=0).sqrt()


def common_basis(results: Sequence[Identified]) -> Common:
    """The results' estimates in one basis: the rigid body's of the result with the fewest, and
    every result's own effects.

    Raises:
        TorchidError: results of arms with different kinematics.
    """
    first = results[0]
    for other in results[1:]:
        if other.n != first.n:
            raise TorchidError(
                "the results are of arms with different numbers of joints.",
                got=f"{first.label}: {first.n}, {other.label}: {other.n}",
            )
    refuse_other_kinematics([(r.label, r.record.model) for r in results])
    union = list(dict.fromkeys(name for r in results for name in r.base.parameter_names))
    wide = _groupings(results, union)
    # Combinations to compare: the rigid body's of the poorest result, and all effects' own.
    poorest = min(range(len(results)), key=lambda k: results[k].base.n_rigid)
    picked = [(poorest, b) for b in range(results[poorest].base.n_rigid)]
    others: list[tuple[int, int]] = []
    for k, result in enumerate(results):
        for b in range(result.base.n_rigid, len(result.base)):
            if not any(torch.allclose(wide[k][b], wide[i][c], atol=SAME) for i, c in others):
                others.append((k, b))
    rows = torch.stack([wide[k][b] for k, b in picked + others])
    bases = [(results[k].base, b) for k, b in picked + others]
    rigid = torch.tensor([b < base.n_rigid for base, b in bases])
    names, units = (tuple(getattr(base, n)[b] for base, b in bases) for n in ("names", "units"))
    parts = [_in_basis(r, g, rows, union) for r, g in zip(results, wide, strict=True)]
    values, covariance, correlation, estimated, held, determined = (
        torch.stack(x) for x in zip(*parts, strict=True)
    )
    notes = []
    kinds = [tuple(dict.fromkeys(e.name for e in r.effects)) for r in results]
    every = dict.fromkeys(name for own in kinds for name in own)
    for result, own in zip(results, kinds, strict=True):
        missing = [name for name in every if name not in own]
        if missing:
            notes.append(
                f"{result.label} was fitted without {', '.join(missing)}: what they explain may "
                "have gone into its other parameters"
            )
    seen: dict[str, str] = {}
    for result in results:
        for name in result.record.fit.trajectories:
            if name in seen and seen[name] != result.label:
                notes.append(
                    f"{seen[name]} and {result.label} were both fitted on a trajectory called "
                    f"'{name}': if it is the same one, their errors are common and agreement "
                    "says little"
                )
            seen.setdefault(name, result.label)
    cutoffs = ["none" if r.record.cutoff is None else f"{r.record.cutoff:g} Hz" for r in results]
    if len({r.record.cutoff for r in results}) > 1:
        text = ", ".join(cutoffs)
        notes.append(f"cut-offs differ ({text}): part of a difference may come from the filter")
    found = determined[:, rigid]
    if not bool(found.all()):
        bad = [results[k].label for k in range(len(results)) if not bool(found[k].all())]
        k = int((~found.all(0)).nonzero()[0, 0])
        raise TorchidError(
            "the results are of arms with different kinematics, or of one arm described in "
            "different frames: their base parameters are different quantities.",
            got=f"{', '.join(bad)} has no combination {names[k]}",
            hint="identify all logs with the same robot file",
        )
    return Common(
        names, units, rigid, values, covariance, correlation, estimated, held, determined,
        tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def refuse_other_kinematics(robots: Sequence[tuple[str, Robot | None]]) -> None:
    """Raise if kinematics, as far as they are known, differ."""
    known = [(label, robot) for label, robot in robots if robot is not None]
    for label, two in known[1:]:
        one, said = known[0][1], []
        if one.joint_types != two.joint_types:
            kinds = ("".join(t.value for t in r.joint_types) for r in (one, two))
            said.append("joints " + " and ".join(kinds))
        else:
            for what, a, b in (("before", one.before, two.before), ("after", one.after, two.after)):
                apart = (a - b).abs().amax((1, 2))
                if float(apart.max()) > POSITION:
                    k = int(apart.argmax())
                    said.append(f"the pose {what} joint {k + 1} differs by {float(apart[k]):.3g}")
        if float((one.gravity - two.gravity).abs().max()) > GRAVITY:
            said.append(f"gravity {one.gravity.tolist()} and {two.gravity.tolist()}")
        if said:
            raise TorchidError(
                "the results are of arms with different kinematics: their parameters are "
                "different quantities.",
                got=f"{known[0][0]} and {label}: {said[0]}",
                hint="identify all logs with the same robot file",
            )


def _groupings(results: Sequence[Identified], union: Sequence[str]) -> list[Tensor]:
    """Each result's grouping (B, U) of all parameters. It also holds effects the result did not
    have but whose columns are combinations of its own: what was fitted without Ia1 determines
    J1zz + Ia1 all the same."""
    out = []
    for result in results:
        own = torch.zeros(len(result.base), len(union), dtype=torch.float64)
        own[:, [union.index(name) for name in result.base.parameter_names]] = result.base.grouping
        out.append(own)
    for source in results:
        base = source.base
        made_of = [base.parameter_names[k] for k in base.independent]
        for name in base.absorbed_effects():
            column = base.grouping[:, base.parameter_names.index(name)]
            parts = column.nonzero().flatten().tolist()
            for other, grouping in zip(results, out, strict=True):
                names = other.base.parameter_names
                if name in names or any(made_of[k] not in names for k in parts):
                    continue
                index = [union.index(made_of[k]) for k in parts]
                grouping[:, union.index(name)] = grouping[:, index] @ column[parts]
    return out


def _in_basis(
    result: Identified, wide: Float[Tensor, "B U"], rows: Float[Tensor, "D U"], union: Sequence[str]
) -> tuple[Tensor, ...]:
    """Values, covariance, correlation, and masks of one result in the common basis."""
    names = result.base.parameter_names
    turn = rows[:, [union.index(names[k]) for k in result.base.independent]]
    size = torch.linalg.vector_norm(rows, dim=1)
    within = torch.linalg.vector_norm(turn @ wide - rows, dim=1) <= SAME * size
    used = turn.abs() > SAME * size.unsqueeze(1)
    held = within & (used & result.held).any(1) & ~(used & ~result.held).any(1)
    estimated = within & ~held & ~(used & ~(result.estimated | result.held)).any(1)
    covariance = turn @ result.covariance @ turn.T
    std = result.covariance.diagonal().clamp(min=0).sqrt()
    white = turn @ (result.correlation * std * std.unsqueeze(1)) @ turn.T
    scale = white.diagonal().clamp(min=1e-300).sqrt()
    apart = estimated.unsqueeze(1) & estimated
    eye = torch.eye(len(rows), dtype=white.dtype)
    correlation = torch.where(apart, white / scale / scale.unsqueeze(1), eye)
    values = turn @ result.values * within
    return values, covariance * apart, correlation, estimated, held, within
