"""Sets of physical parameters, and the file they are kept in (schema torchid.parameter_sets/1)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import torch
from msgspec import UNSET, UnsetType

from torchid.effects.base import JointEffect
from torchid.effects.registry import Valued, column_kind, effect_from_record, nominal_columns
from torchid.errors import TorchidError
from torchid.inputs import RobotLike, as_robot
from torchid.results.files import contents, parsed
from torchid.results.record import FINITE, Col, Part, Result, RobotRecord, Rows, Values
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.knowledge import Knowledge, from_mapping, to_mapping
from torchid.robot.library import named_record
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

_FILE = '{"sets": [{"id", "mass", "com", "inertia_about_com", ...}, ...]}'


class _Candidates:
    """What K sets can do, made here or read back from their file."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def ids(self) -> tuple[str, ...]:
            """(K,) what to call each."""

        @property
        def parameters(self) -> InertialParameters:
            """Inertial parameters, pi (K, n, 10) in the link frames."""

        @property
        def effects(self) -> tuple[JointEffect, ...]:
            """Linear effects whose coefficients belong to the sets."""

        @property
        def coefficients(self) -> Float[Tensor, "K E"]:
            """(K, E) in the effects' order."""

    def __len__(self) -> int:
        return len(self.ids)

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
        """Names of coefficients as reasons are written, e.g. Fv_6, F0_1."""
        return coefficient_reasons(self.effects)

    def effect_records(self, k: int) -> tuple[Values, ...]:
        """The effects with set k's coefficients, as in a robot's yaml."""
        own = iter(self.coefficients[k].tolist())
        return tuple(dict(e.record([next(own) for _ in e.coefficients])) for e in self.effects)

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


@dataclass(frozen=True, eq=False)
class ParameterSets(_Candidates, Result):
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

    def __repr__(self) -> str:
        links, count = self.parameters.pi.shape[-2], self.coefficients.shape[-1]
        return f"ParameterSets({len(self)} of {links} links and {count} coefficients of effects)"

    @property
    def record(self) -> "SetsRecord":
        """As sets.json has it, without a robot's name."""
        return sets_record(self, None)


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


class SetEntry(Part, frozen=True, kw_only=True):
    """One set of a file: centres of mass or first moments, and inertias about the one point or the
    other.

    Attributes:
        id: what to call it.
        mass: (n,) [kg].
        com, first_moment: (n, 3) [m; kg m].
        inertia_about_com, inertia_about_link_frame: (n, 6) xx xy xz yy yz zz [kg m^2].
        effects: with their coefficients, as in a robot's yaml.
    """

    id: Annotated[str | int | float | None, Col("set", "g")] = None
    mass: Annotated[Float[Tensor, " n"], FINITE]
    com: Annotated[Float[Tensor, "n 3"], FINITE] | UnsetType = UNSET
    first_moment: Annotated[Float[Tensor, "n 3"], FINITE] | UnsetType = UNSET
    inertia_about_com: Annotated[Float[Tensor, "n 6"], FINITE] | UnsetType = UNSET
    inertia_about_link_frame: Annotated[Float[Tensor, "n 6"], FINITE] | UnsetType = UNSET
    effects: tuple[Values, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for keys in (("com", "first_moment"), ("inertia_about_com", "inertia_about_link_frame")):
            if sum(getattr(self, key) is not UNSET for key in keys) != 1:
                raise ValueError(f"a set needs one of {' and '.join(keys)}")

    @property
    def pi(self) -> Float[Tensor, "n 10"]:
        """Inertial parameters in the link frames."""
        mass = self.mass.unsqueeze(-1)
        moment = mass * self.com if isinstance(self.com, Tensor) else self.first_moment
        about_frame = isinstance(self.inertia_about_link_frame, Tensor)
        inertia = self.inertia_about_link_frame if about_frame else self.inertia_about_com
        assert isinstance(moment, Tensor)
        assert isinstance(inertia, Tensor)
        pi = torch.cat([mass, moment, inertia], -1)
        if not about_frame:
            com = self.com if isinstance(self.com, Tensor) else InertialParameters(pi).com
            pi[:, 4:] += parallel_axis(self.mass, com)
        return pi


class SetsFile(_Candidates, RobotRecord, frozen=True, kw_only=True):
    """A file that holds sets, by the names that `ParameterSets` has; asked one by one, each reads
    them anew.

    Attributes:
        sets: at least one.
    """

    if TYPE_CHECKING:

        @property
        def sets(self) -> Sequence[SetEntry]:
            """The parameter sets as the file has them."""

    def __len__(self) -> int:
        return len(self.sets)

    @property
    def candidates(self) -> ParameterSets:
        """The sets, ready to be computed with.

        Raises:
            TorchidError: no sets, or sets of different robots or effects.
        """
        n = len(self.sets[0].mass) if self.sets else 0
        return sets_of(self.sets, n, "the file")

    @property
    def ids(self) -> tuple[str, ...]:
        """(K,) what to call each."""
        return self.candidates.ids

    @property
    def parameters(self) -> InertialParameters:
        """Inertial parameters, pi (K, n, 10) in the link frames."""
        return self.candidates.parameters

    @property
    def effects(self) -> tuple[JointEffect, ...]:
        """Linear effects whose coefficients belong to the sets."""
        return self.candidates.effects

    @property
    def coefficients(self) -> Float[Tensor, "K E"]:
        """(K, E) in the effects' order."""
        return self.candidates.coefficients


class SetsRecord(SetsFile, frozen=True, kw_only=True, tag="torchid.parameter_sets/1"):
    """A file of sets.

    Attributes:
        sets: at least one.
        other_effects: that hold beside every set, which has no columns for them.
        knowledge: of the base parameters that the sets were extracted from, as a robot's yaml has
            it.
    """

    robot: str | None = None  # type: ignore[assignment]
    sets: tuple[SetEntry, ...]
    other_effects: tuple[Values, ...] | UnsetType = UNSET
    knowledge: dict[str, list[str]] | UnsetType = UNSET

    @property
    def named(self) -> dict[str, Any]:
        """The robot, as `named_record` names it."""
        keys = ("robot", "robot_source", "robot_tip", "robot_root", "robot_lock")
        return {key: value for key in keys if (value := getattr(self, key))}

    @property
    def table(self) -> Rows[SetEntry]:
        """The sets."""
        return Rows(self.sets)


class _Sets(Part, frozen=True, kw_only=True):
    """What any file of sets has, whatever else it holds."""

    robot: str | None = None
    sets: tuple[SetEntry, ...]
    other_effects: tuple[Values, ...] | UnsetType = UNSET
    knowledge: dict[str, list[str]] | UnsetType = UNSET


def sets_record(
    sets: ParameterSets,
    robot: Robot | None,
    others: Sequence[Valued] = (),
    knowledge: Knowledge | None = None,
) -> SetsRecord:
    """A file of sets, lossless: masses, first moments and inertias about the link frames.

    Args:
        sets: of one robot.
        robot: that they belong to, if it is to be named.
        others: effects that hold beside every set, which has no columns for them.
        knowledge: of the base parameters that the sets were extracted from.
    """
    beside = tuple(dict(effect.record(values)) for effect, values in others)
    return SetsRecord(
        **({} if robot is None else named_record(robot)),
        sets=tuple(
            SetEntry(
                id=name,
                mass=pi[:, 0],
                first_moment=pi[:, 1:4],
                inertia_about_link_frame=pi[:, 4:],
                effects=sets.effect_records(k),
            )
            for k, (name, pi) in enumerate(zip(sets.ids, sets.parameters.pi, strict=True))
        ),
        other_effects=beside or UNSET,
        knowledge=UNSET if knowledge is None else to_mapping(knowledge),
    )


def read_sets(path: str | Path, robot: RobotLike) -> ParameterSets:
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
    ...     nominal_set(robot).save(file)
    ...     read_sets(file, robot).ids
    ('3r',)
    """
    path = Path(path)
    return sets_of(_file(path).sets, as_robot(robot).n_links, f"'{path}'")


def sets_of(entries: Sequence["SetEntry"], n: int, source: str) -> ParameterSets:
    """The sets of a file, of a robot with n links; see `read_sets`.

    Args:
        entries: of the file.
        n: number of links.
        source: what the file is called in errors.
    """
    if not entries:
        raise TorchidError(f"{source} holds no parameter sets.", expected=_FILE)
    parts = []
    for k, entry in enumerate(entries, start=1):
        where = f"{source}: set {k}"
        if len(entry.mass) != n:
            raise TorchidError(
                f"{where} is of another robot.",
                got=f"{len(entry.mass)} links",
                expected=f"this robot's {n} links",
            )
        effects, values = _read_effects(entry.effects or (), n, where)
        name = k if entry.id is None else entry.id
        pi = InertialParameters(entry.pi.unsqueeze(0))
        parts.append(ParameterSets((str(name),), pi, effects, values.reshape(1, -1)))
    _require_same_effects(parts, [f"{source}: all sets must have the same effects."] * len(parts))
    ids = [part.ids[0] for part in parts]
    if len(set(ids)) != len(ids):
        raise TorchidError(f"{source}: two sets have the same id.", got=ids)
    return joined(parts)


def _require_same_effects(parts: Sequence[ParameterSets], words: Sequence[str]) -> None:
    """Raise TorchidError, in the words of the first part that has other effects than the first."""
    for part, said in zip(parts, words, strict=True):
        if part.effects != parts[0].effects:
            raise TorchidError(
                said,
                got=list(part.coefficient_names()),
                expected=list(parts[0].coefficient_names()),
            )


def read_all_sets(files: Sequence[Path], robot: Robot) -> ParameterSets:
    """The sets of several files; the files' names go before the ids where two have the same id.

    Raises:
        TorchidError: a file that cannot be read, or that has other effects than the first.
    """
    parts = [read_sets(file, robot) for file in files]
    _require_same_effects(parts, [f"'{f}' has other effects than '{files[0]}'." for f in files])
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
    return tuple(effect_from_record(entry, robot) for entry in _file(path).other_effects or ())


def read_sets_knowledge(path: Path, robot: Robot) -> Knowledge | None:
    """What a file of sets says of how sure the base parameters are that they were extracted from.

    Raises:
        RobotError: knowledge of another robot, or damaged.
    """
    knowledge = _file(path).knowledge
    return None if not knowledge else from_mapping(knowledge, robot.n_links, str(path))


def other_robot(path: Path, robot: Robot) -> str | None:
    """A sentence if the file says that its sets belong to a robot of another name."""
    name = _file(path).robot
    if name is None or name == robot.name:
        return None
    return f"'{path}' says that its sets belong to '{name}'; the robot here is '{robot.name}'"


def _file(path: Path) -> _Sets:
    """A file of sets, of an extraction too, whose entries say more."""
    return parsed(contents(path, _FILE), _Sets, path, "a file of parameter sets", _FILE)


def _read_effects(
    data: Sequence[Values], n: int, where: str
) -> tuple[tuple[JointEffect, ...], Tensor]:
    effects: list[JointEffect] = []
    values: list[float] = []
    for record in data:
        if "effect" not in record:
            raise TorchidError(
                f"{where}: an effect needs the key 'effect'.",
                got=record,
                expected="{effect: viscous_friction, joint: 1, Fv: 0.07}",
            )
        kind = column_kind(str(record["effect"]))
        joint = record.get("joint")
        if not isinstance(joint, int) or not 1 <= joint <= n:
            raise TorchidError(
                f"{where}: {kind.name} is on a joint that does not exist.",
                got=joint,
                available=list(range(1, n + 1)),
            )
        if kind(joint - 1) in effects:
            raise TorchidError(f"{where}: {kind.name} of joint {joint} is listed twice.")
        effects.append(kind(joint - 1))
        for c in kind.coefficients:
            value = record.get(c.name)
            if not isinstance(value, int | float):
                raise TorchidError(f"{where}: {kind.name} needs a number '{c.name}'.", got=value)
            values.append(float(value))
    return tuple(effects), torch.tensor(values, dtype=torch.float64)
