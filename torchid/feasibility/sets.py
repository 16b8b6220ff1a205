"""Sets of physical parameters, and the file they are kept in (schema torchid.parameter_sets/1)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from torchid.effects.base import JointEffect
from torchid.effects.registry import Valued, column_kind, effect_from_record, nominal_columns
from torchid.errors import TorchidError
from torchid.json_data import read_json
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.library import named_record
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

SCHEMA = "torchid.parameter_sets/1"
_FILE = '{"sets": [{"id", "mass", "com", "inertia_about_com", ...}, ...]}'


@dataclass(frozen=True, eq=False)
class ParameterSets:
    """K candidate sets of physical parameters of one robot.

    Attributes:
        ids: (K,) what to call each.
        parameters: inertial parameters, pi (K, n, 10) in the link frames.
        effects: linear effects whose coefficients belong to the sets.
        coefficients: (K, E) the effects' coefficients, in the effects' order [see each effect].

    >>> import torchid
    >>> sets = nominal_set(torchid.load_robot("3r_friction"))
    >>> len(sets), sets.vector.shape, sets.coefficient_names()[:2]
    (1, torch.Size([1, 39]), ('Fv1', 'Fv2'))
    """

    ids: tuple[str, ...]
    parameters: InertialParameters
    effects: tuple[JointEffect, ...]
    coefficients: Float[Tensor, "K E"]

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        links, count = self.parameters.pi.shape[-2], self.coefficients.shape[-1]
        return f"ParameterSets({len(self)} of {links} links and {count} coefficients of effects)"

    @property
    def vector(self) -> Float[Tensor, "K P"]:
        """All parameters in the order the base parameters' grouping takes them: the paper's
        stacking (eq. 2.5), then the effects' coefficients (eq. 2.7)."""
        return torch.cat([self.parameters.to_paper_order(), self.coefficients], -1)

    @property
    def search_vector(self) -> Float[Tensor, "K D"]:
        """All parameters in the order of `Bounds.box`: masses, centres of mass, barycentric
        inertias, coefficients."""
        own = self.parameters
        parts = [own.mass, own.com.flatten(-2), own.inertia_about_com.flatten(-2)]
        return torch.cat([*parts, self.coefficients], -1)

    def coefficient_names(self) -> tuple[str, ...]:
        """Names of the coefficients with their joints' numbers, e.g. Fv6."""
        return tuple(name for effect in self.effects for name in effect.coefficient_names())

    def coefficient_reasons(self) -> tuple[str, ...]:
        """The same as reasons are written, e.g. Fv_6, F0_1."""
        return coefficient_reasons(self.effects)

    def part(self, rows: Sequence[int]) -> "ParameterSets":
        """Some of the sets, in the order asked for."""
        index = list(rows)
        return ParameterSets(
            tuple(self.ids[k] for k in index),
            InertialParameters(self.parameters.pi[index]),
            self.effects,
            self.coefficients[index],
        )

    def to_robot(self, robot: Robot, k: int) -> Robot:
        """The robot with set k as its nominal parameters."""
        return robot.with_parameters(InertialParameters(self.parameters.pi[k].clone()))


def coefficient_reasons(effects: Sequence[JointEffect]) -> tuple[str, ...]:
    """Names of the effects' coefficients as reasons are written: Fv_6, not Fv6."""
    return tuple(f"{c.name}_{e.joint + 1}" for e in effects for c in e.coefficients)


def nominal_set(robot: Robot) -> ParameterSets:
    """The robot's nominal parameters and effects as one set, named after the robot.

    Raises:
        RobotError: the robot has no inertial parameters, or an effect that is not known.
    """
    pi = robot.require_parameters("a check").pi.double()
    pairs = nominal_columns(robot)
    values = [value for _, own in pairs for value in own]
    return ParameterSets(
        (robot.name,),
        InertialParameters(pi.unsqueeze(0)),
        tuple(effect for effect, _ in pairs),
        torch.tensor([values], dtype=pi.dtype).reshape(1, len(values)),
    )


def joined(parts: Sequence[ParameterSets]) -> ParameterSets:
    """Several batches of sets with the same effects as one."""
    return ParameterSets(
        tuple(i for part in parts for i in part.ids),
        InertialParameters(torch.cat([part.parameters.pi for part in parts])),
        parts[0].effects,
        torch.cat([part.coefficients for part in parts]),
    )


def to_record(sets: ParameterSets, robot: Robot, others: Sequence[Valued] = ()) -> dict[str, Any]:
    """JSON-ready data, lossless: masses, first moments and inertias about the link frames.

    Args:
        sets: of one robot.
        robot: that they belong to.
        others: effects that hold beside every set, which has no columns for them.
    """
    entries = []
    for k, name in enumerate(sets.ids):
        pi, values = sets.parameters.pi[k], iter(sets.coefficients[k].tolist())
        effects = [
            {
                "effect": effect.name,
                "joint": effect.joint + 1,
                **{c.name: next(values) for c in effect.coefficients},
            }
            for effect in sets.effects
        ]
        entries.append(
            {
                "id": name,
                "mass": pi[:, 0].tolist(),
                "first_moment": pi[:, 1:4].tolist(),
                "inertia_about_link_frame": pi[:, 4:].tolist(),
                "effects": effects,
            }
        )
    beside = [dict(effect.record(values)) for effect, values in others]
    more = {"other_effects": beside} if beside else {}
    return {"schema": SCHEMA, **named_record(robot), "sets": entries, **more}


def read_sets(path: str | Path, robot: Robot) -> ParameterSets:
    """Read a file of sets (JSON, `sets: [...]`) for a robot.

    Each set has `mass` [n]; `com` or `first_moment` [n x 3]; `inertia_about_com` or
    `inertia_about_link_frame` [n x 6: xx xy xz yy yz zz]; and, optionally, `effects` as in a
    robot's yaml. All sets must list the same effects.

    Args:
        path: the file, e.g. the sets.json of an extraction.
        robot: that they belong to.

    Returns:
        K sets, in the order of the file.

    Raises:
        TorchidError: not such a file, a wrong number of links, values that are not finite numbers.

    >>> import json, torchid
    >>> from tempfile import TemporaryDirectory
    >>> robot = torchid.load_robot("3r")
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "sets.json"
    ...     _ = file.write_text(json.dumps(to_record(nominal_set(robot), robot)))
    ...     read_sets(file, robot).ids
    ('3r',)
    """
    path = Path(path)
    data = read_json(path, _FILE)
    entries = data.get("sets")
    if not isinstance(entries, list) or not entries:
        raise TorchidError(f"'{path}' holds no parameter sets.", got=list(data), expected=_FILE)
    parts = [_read_set(entry, k, robot, str(path)) for k, entry in enumerate(entries, start=1)]
    for part in parts[1:]:
        if part.effects != parts[0].effects:
            raise TorchidError(
                f"'{path}': all sets must have the same effects.",
                got=list(part.coefficient_names()),
                expected=list(parts[0].coefficient_names()),
            )
    ids = [part.ids[0] for part in parts]
    if len(set(ids)) != len(ids):
        raise TorchidError(f"'{path}': two sets have the same id.", got=ids)
    return joined(parts)


def read_all_sets(files: Sequence[Path], robot: Robot) -> ParameterSets:
    """The sets of several files; the files' names go before the ids where two have the same id.

    Raises:
        TorchidError: a file that cannot be read, or that has other effects than the first.
    """
    parts = [read_sets(file, robot) for file in files]
    for file, part in zip(files, parts, strict=True):
        if part.effects != parts[0].effects:
            raise TorchidError(
                f"'{file}' has other effects than '{files[0]}'.",
                got=list(part.coefficient_names()),
                expected=list(parts[0].coefficient_names()),
            )
    every = [name for part in parts for name in part.ids]
    if len(set(every)) < len(every):
        parts = [
            replace(part, ids=tuple(f"{file.stem}:{name}" for name in part.ids))
            for file, part in zip(files, parts, strict=True)
        ]
    return joined(parts)


def read_other_effects(path: Path, robot: Robot) -> tuple[Valued, ...]:
    """The effects that a file of sets lists beside them (`other_effects`).

    Raises:
        TorchidError: not a list of effects as in a robot's yaml.
    """
    entries = read_json(path, _FILE).get("other_effects", [])
    if not isinstance(entries, list) or not all(isinstance(e, Mapping) for e in entries):
        raise TorchidError(f"'{path}': other_effects is not a list of effects.", got=entries)
    return tuple(effect_from_record(entry, robot) for entry in entries)


def other_robot(path: Path, robot: Robot) -> str | None:
    """A sentence if the file says that its sets belong to a robot of another name."""
    name = read_json(path, _FILE).get("robot")
    if name is None or name == robot.name:
        return None
    return f"'{path}' says that its sets belong to '{name}'; the robot here is '{robot.name}'"


def _read_set(entry: Any, k: int, robot: Robot, source: str) -> ParameterSets:
    where = f"'{source}': set {k}"
    if not isinstance(entry, Mapping):
        raise TorchidError(f"{where} is not a mapping.", got=type(entry).__name__)
    mass = _numbers(entry, "mass", (robot.n,), where)
    com_key = _one_of(entry, ("com", "first_moment"), where)
    inertia_key = _one_of(entry, ("inertia_about_com", "inertia_about_link_frame"), where)
    place = _numbers(entry, com_key, (robot.n, 3), where)
    inertia = _numbers(entry, inertia_key, (robot.n, 6), where)
    moment = place if com_key == "first_moment" else mass.unsqueeze(-1) * place
    pi = torch.cat([mass.unsqueeze(-1), moment, inertia], -1)
    if inertia_key == "inertia_about_com":
        com = InertialParameters(pi).com if com_key == "first_moment" else place
        pi[:, 4:] += parallel_axis(mass, com)
    effects, values = _read_effects(entry.get("effects"), robot, where)
    ids, parameters = (str(entry.get("id", k)),), InertialParameters(pi.unsqueeze(0))
    return ParameterSets(ids, parameters, effects, values.reshape(1, -1))


def _one_of(entry: Mapping[str, Any], keys: tuple[str, str], where: str) -> str:
    given = [key for key in keys if key in entry]
    if len(given) != 1:
        raise TorchidError(
            f"{where} needs one of {' and '.join(keys)}.", got=given or "neither", available=keys
        )
    return given[0]


def _numbers(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Tensor:
    try:
        values = torch.tensor(entry[key], dtype=torch.float64)
    except KeyError as error:
        raise TorchidError(f"{where} has no '{key}'.", available=list(entry)) from error
    except (TypeError, ValueError, OverflowError) as error:
        raise TorchidError(f"{where}: {key} is not a table of numbers.", got=entry[key]) from error
    if tuple(values.shape) != shape:
        raise TorchidError(
            f"{where}: {key} has the wrong size.",
            got=tuple(values.shape),
            expected=f"{shape} for this robot's {shape[0]} links",
        )
    if not torch.isfinite(values).all():
        raise TorchidError(f"{where}: {key} is not all finite.", got=entry[key])
    return values


def _read_effects(data: Any, robot: Robot, where: str) -> tuple[tuple[JointEffect, ...], Tensor]:
    data = [] if data is None else data
    if not isinstance(data, list):
        raise TorchidError(f"{where}: effects must be a list.", got=type(data).__name__)
    effects: list[JointEffect] = []
    values: list[float] = []
    for record in data:
        if not isinstance(record, Mapping) or "effect" not in record:
            raise TorchidError(
                f"{where}: an effect needs the key 'effect'.",
                got=record,
                expected="{effect: viscous_friction, joint: 1, Fv: 0.07}",
            )
        kind = column_kind(str(record["effect"]))
        joint = record.get("joint")
        if not isinstance(joint, int) or not 1 <= joint <= robot.n:
            raise TorchidError(
                f"{where}: {kind.name} is on a joint that does not exist.",
                got=joint,
                available=list(range(1, robot.n + 1)),
            )
        if kind(joint - 1) in effects:
            raise TorchidError(f"{where}: {kind.name} of joint {joint} is listed twice.")
        effects.append(kind(joint - 1))
        values += [float(_numbers(record, c.name, (), where)) for c in kind.coefficients]
    return tuple(effects), torch.tensor(values, dtype=torch.float64)
