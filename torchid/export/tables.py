"""A result as a table (csv): base parameters and effects, or physical parameters in both
conventions."""

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence

import torch

from torchid.digits import number
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.export.dynamics import Dynamics
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.typing import Tensor

COLUMNS = ("parameter", "value", "std", "unit", "meaning")
_ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
Row = tuple[str, str, str, str, str]


def table(dynamics: Dynamics) -> str:
    """The text of the csv; a standard deviation that is not known is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    values = dynamics.base
    if values is None:
        writer.writerows(_physical_rows(dynamics.robot))
        return out.getvalue()
    base, std = values.base, [0.0] * len(values.base)
    if values.covariance is not None:
        std = values.covariance.diagonal().clamp(min=0).sqrt().tolist()
    for k, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        kind = "base parameter" if k < base.n_rigid else "coefficient of an effect"
        meaning = kind if values.known[k] else f"{kind}, not determined by the log"
        deviation = number(std[k]) if std[k] > 0 else ""
        writer.writerow((name, number(values.values[k]), deviation, unit, meaning))
    return out.getvalue()


def _physical_rows(robot: Robot) -> Iterator[Row]:
    p = robot.require_parameters("an export")
    kinds = (
        ("m{}", ("",), p.mass.unsqueeze(-1), "kg", "mass of {}"),
        ("c{}", "xyz", p.com, "m", "centre of mass of {}, in its frame"),
        ("I{}", _ENTRIES, p.inertia_about_com, "kg m^2", "inertia of {} about its centre of mass"),
        ("m{0}c{0}", "xyz", p.first_moment, "kg m", "first moment of {}"),
        (
            "J{}",
            _ENTRIES,
            p.inertia_about_link_frame,
            "kg m^2",
            "inertia of {} about its frame's origin",
        ),
    )
    for i, link in enumerate(robot.link_names):
        for stem, tails, numbers, unit, meaning in kinds:
            for tail, value in zip(tails, numbers[i].tolist(), strict=True):
                yield stem.format(i + 1) + tail, number(value), "", unit, meaning.format(link)
    seen: Counter[str] = Counter()
    for effect, values in nominal_effects(robot):
        place = "".join(f"[{j + 1}]" for j in effect.joints)
        seen[effect.name + place] += 1
        if seen[effect.name + place] > 1:  # two springs on one joint, say
            place += f"#{seen[effect.name + place]}"
        kinds_of_joint = {robot.joint_types[j] for j in effect.joints}
        for c, value in zip(effect.coefficients, values, strict=True):
            unit = c.unit_for(kinds_of_joint == {JointType.PRISMATIC})
            yield f"{effect.name}{place}.{c.name}", number(value), "", unit, c.meaning
        for s, value in zip(effect.shapes, effect.shape_values, strict=True):
            yield f"{effect.name}{place}.{s.name}", number(value), "", s.unit, s.meaning


def read_values(text: str) -> dict[str, float]:
    """Values by name.

    Raises:
        TorchidError: a name twice.
    """
    rows = list(csv.reader(io.StringIO(text)))[1:]
    out = {row[0]: float(row[1]) for row in rows}
    if len(out) != len(rows):
        raise TorchidError("two parameters of the table have the same name.")
    return out


def physical(values: dict[str, float], n: int) -> tuple[InertialParameters, InertialParameters]:
    """The parameters of a table from its first moments and inertias about the link frames, and
    from its centres of mass and inertias about them."""

    def of(pattern: str, tails: Sequence[str]) -> Tensor:
        rows = [[values[pattern.format(i=i) + tail] for tail in tails] for i in range(1, n + 1)]
        return torch.tensor(rows, dtype=torch.float64)

    mass = of("m{i}", ("",))
    origin = torch.cat([mass, of("m{i}c{i}", "xyz"), of("J{i}", _ENTRIES)], -1)
    own = InertialParameters.from_com(mass[:, 0], of("c{i}", "xyz"), of("I{i}", _ENTRIES))
    return InertialParameters(origin), own
