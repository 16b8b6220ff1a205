"""Exports without XML: the project's yaml, a table, C."""

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from torchid import __version__
from torchid.digits import number
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.export.c_code import c_file
from torchid.export.checks import Comparison, Draft, check_c, compared, kept, staged
from torchid.export.dynamics import Dynamics, records, robot_torque
from torchid.identification.model import model_torque
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import JointType, Robot
from torchid.robot.writer import robot_yaml
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


Written = tuple[Draft, tuple[Comparison, ...]]
READER = f"torchid {__version__}"


def write_yaml(dynamics: Dynamics, written: Robot, path: Path, motion: Motion) -> Written:
    """The robot's yaml, with its effects; read back and compared."""
    draft = Draft({path.name: robot_yaml(written).encode()}, tuple(nominal_effects(written)))
    with staged(path.parent, draft.files) as files:
        torque = robot_torque(load_robot(files[path.name]), motion)
        what = "torque with all effects"
        return draft, kept([compared(READER, what, motion, dynamics.torque(motion), torque)])


def write_table(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """A csv; its numbers are read back and compared."""
    robot, base = dynamics.robot, dynamics.base
    draft = Draft({path.name: table(dynamics).encode()}, tuple(nominal_effects(robot)))
    with staged(path.parent, draft.files) as files:
        values = read_values(files[path.name].read_text(encoding="utf-8"))
        if base is not None:
            read = torch.tensor([values[name] for name in base.base.names], dtype=torch.float64)
            torque = model_torque(robot, base.base, base.effects, read, motion)
            found = {"torque of the base parameters": torque}
        else:
            words = ("torque of m, m c, J (link frames)", "torque of m, c, I (centres of mass)")
            found = {
                what: robot_torque(robot.with_parameters(p), motion)
                for what, p in zip(words, physical(values, robot.n_links), strict=True)
            }
        expected = dynamics.torque(motion)
        return draft, kept(
            [compared(READER, what, motion, expected, torque) for what, torque in found.items()]
        )


def write_c(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """C source and header; compiled, run and compared, without the effects left out."""
    robot = dynamics.robot
    code = c_file(dynamics, path.stem)
    rest = tuple(pair for pair in nominal_effects(robot) if pair not in code.left_out)
    files = {path.name: code.source.encode(), f"{path.stem}.h": code.header.encode()}
    expected = robot_torque(replace(robot, effects=records(rest)), motion)
    with staged(path.parent, files):
        found = kept([check_c(code, path.stem, motion, expected)])
    return Draft(files, in_file=rest, left_out=code.left_out), found
