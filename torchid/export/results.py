"""Reading what is exported: an identification, parameter sets, or a robot.

The JSON of `torchid identify` holds base parameters. Sets are those of sets.json, of the JSON of
`torchid extract`, or of `torchid check --nearest`; study.json's are in the sets.json beside it. A
robot is a built-in name or a file, such as `torchid gap --save-model` writes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.inertia import RotorInertia
from torchid.effects.registry import Valued, nominal_effects, nominal_others
from torchid.effects.spring import JointSpring
from torchid.errors import TorchidError
from torchid.export.dynamics import Dynamics, effect_text, of_base, records
from torchid.extraction.problem import FAR_TORQUE
from torchid.feasibility.record import check_sets
from torchid.feasibility.sets import (
    ParameterSets,
    read_other_effects,
    read_sets,
    read_sets_knowledge,
)
from torchid.gap.record import GapRecord
from torchid.gap.settings import GapSettings
from torchid.identification.result import Identification
from torchid.identification.values import identified_base, read_base
from torchid.json_data import read_json
from torchid.position.model import ServoArm
from torchid.position.record import PositionRecord
from torchid.results.files import read
from torchid.robot.config_files import names_robot
from torchid.robot.library import as_robot, load_both, load_robot, named_robot
from torchid.robot.model import Robot, RobotLike
from torchid.robot.tree import Choice
from torchid.typing import Float, Tensor

Exportable = Dynamics | Identification | ParameterSets | RobotLike
IDENTIFICATION = "torchid.identification/1"
CORRECTED = "corrected"
"""Where a diagnosis has the robot that it corrected."""

_KINDS = "the JSON of `torchid identify`, `extract` or `gap`, a file of parameter sets, or a robot"


@dataclass(frozen=True)
class Carried:
    """What the name or the file of an export stands for.

    Attributes:
        dynamics: that it carries.
        nominal: the robot that they are of.
        original: the robot whose file a copy is edited of.
        settings: of the diagnosis that it is; the defaults otherwise.
        diagnosed: whether it is a diagnosis.
    """

    dynamics: Dynamics
    nominal: Robot
    original: Robot
    settings: GapSettings = field(default_factory=GapSettings)
    diagnosed: bool = False


def carried(
    result: str, robot: str | None, choice: Choice, chosen: str | None, geometry: str | None
) -> Carried:
    """What is exported for a name on the command line.

    Args:
        result: a robot, or the file of a result.
        robot: that the result is of, where it is another than the one it records.
        choice: of its part.
        chosen: set of a file of several; see `set_dynamics`.
        geometry: bounds of the centres of mass that count when a set is chosen.

    Raises:
        TorchidError: neither a robot nor a result that carries dynamics.
    """
    if names_robot(result):
        nominal, original = load_both(result, robot, choice)
        servos = ServoArm.of_file(result)
        own = robot_dynamics(nominal) if servos is None else servo_dynamics(servos)
        return Carried(own, nominal, original)
    path = Path(result)
    data = load(path)
    if CORRECTED in data:
        found = diagnosis(path)
        assert isinstance(found, GapRecord)
        nominal = found.model if robot is None else load_robot(robot, **choice.options)
        title = f"the corrected robot of {path.name}"
        dynamics = replace(robot_dynamics(found.corrected), title=title)
        settings = GapSettings(cutoff=found.cutoff_hz, report_band=found.band_hz)
        return Carried(dynamics, nominal, nominal, settings, diagnosed=True)
    nominal = (
        named_robot(path, data, choice) if robot is None else load_robot(robot, **choice.options)
    )
    if "sets" in data:
        return Carried(set_dynamics(path, data, nominal, chosen, geometry), nominal, nominal)
    return Carried(base_dynamics(path, nominal), nominal, nominal)


def load(path: Path) -> Mapping[str, Any]:
    """The content of a JSON result.

    Raises:
        TorchidError: not readable, not JSON, or a result that carries no dynamics.
    """
    data = read_json(path, _KINDS)
    schema = data.get("schema")
    if not ("sets" in data or schema == IDENTIFICATION or CORRECTED in data):
        raise TorchidError(
            f"'{path}' carries no dynamics.", got=f"schema {schema}", expected=_KINDS
        )
    return data


def dynamics_of(result: Exportable, robot: Robot) -> Dynamics:
    """What is exported of a result in memory.

    Args:
        result: an identification, one set of parameters, a robot; dynamics stay as they are.
        robot: that it belongs to.

    Raises:
        TorchidError: several sets, or a robot without parameters.
    """
    if isinstance(result, Identification):
        return of_base(robot, identified_base(result))
    if isinstance(result, ParameterSets):
        return of_set(robot, result)
    return result if isinstance(result, Dynamics) else robot_dynamics(as_robot(result))


def base_dynamics(path: Path, robot: Robot) -> Dynamics:
    """The base parameters of an identification."""
    values = read_base(path, robot)
    return of_base(
        robot, values, f"the {len(values.base)} base parameters identified in {path.name}"
    )


def diagnosis(path: Path, *more: str) -> GapRecord | PositionRecord:
    """A diagnosis of torques with the robot that it corrected, or of `more` schemas.

    Raises:
        TorchidError: another file, or a fault in it, with its place.
    """
    found = read(path, ("torchid.gap/2", *more), "the JSON of `torchid gap`")
    assert isinstance(found, PositionRecord | GapRecord)
    return found


def any_diagnosis(path: Path) -> GapRecord | PositionRecord:
    """A diagnosis, of commands and positions as well; errors are those of `diagnosis`."""
    return diagnosis(path, "torchid.position_gap/1")


def set_dynamics(
    path: Path, data: Mapping[str, Any], robot: Robot, asked: str | None, geometry: str | None
) -> Dynamics:
    """One set of a file: the one asked for; else, of the feasible ones, the one of least loss, or
    of the largest degree where no losses are known. Where none is feasible, of all. The effects
    that the file lists beside its sets come with it.

    Raises:
        TorchidError: no such set, or a file without parameters.
    """
    # The parameters are in the result itself, or in the sets.json beside it.
    entries, file = data["sets"], path
    if not isinstance(entries, list) or not all(
        isinstance(entry, Mapping) and "mass" in entry for entry in entries
    ):
        file = path.parent / "sets.json"
        if not file.is_file() or file == path:
            raise TorchidError(
                f"'{path}' lists sets without their parameters, and there is no sets.json beside "
                "it.",
                hint="export the sets.json that the command wrote beside it",
            )
    sets = read_sets(file, robot)
    k, why = _chosen(path, data, sets, asked, robot, geometry)
    name = sets.ids[k]
    title = f"the set '{name}' of {path.name}{why}"
    found = of_set(robot, sets.part([k]), title, read_other_effects(file, robot))
    known = read_sets_knowledge(file, robot)
    if known is not None:
        found = replace(found, robot=replace(found.robot, knowledge=known))
    warnings = list(found.warnings)
    # An extraction says how far a set's torque is from the one that was asked for.
    errors, source = _beside(path, data, "torque_error_percent")
    percent = [0.0 if v is None else float(v) for v in errors.get(name) or ()]
    worst = max(percent, default=0.0)
    if worst > 100 * FAR_TORQUE:
        instead = "; `torchid extract --loss one-step` asks for the log's torque"
        warnings.append(
            f"the set's torque is up to {worst:.2g} % from the one asked for (joint "
            f"{percent.index(worst) + 1}){instead if source.get('loss') == 'two-step' else ''}"
        )
    if data.get("robot") not in (None, robot.name):
        warnings.append(
            f"the sets belong to '{data['robot']}', and the robot here is '{robot.name}'"
        )
    return replace(found, warnings=tuple(warnings))


def of_set(
    robot: Robot, one: ParameterSets, title: str | None = None, others: Sequence[Valued] = ()
) -> Dynamics:
    """A set of parameters to export.

    Args:
        robot: that it belongs to.
        one: one set, e.g. `sets.part([k])` of several.
        title: what it is, for people; by its name otherwise.
        others: effects beside it, which sets have no columns for.

    Raises:
        TorchidError: not one set.
    """
    if len(one) != 1:
        raise TorchidError("one set is exported.", got=f"{len(one)} sets", hint="sets.part([k])")
    coefficients = iter(one.coefficients[0].tolist())
    effects = [(e, [next(coefficients) for _ in e.coefficients]) for e in one.effects]
    return Dynamics(
        replace(one.to_robot(robot, 0), effects=records([*effects, *others])),
        "set",
        f"the set '{one.ids[0]}'" if title is None else title,
        warnings=tuple(
            f"an effect of the robot that is not part of the set is left out: "
            f"{effect_text(*pair, robot)}"
            for pair in nominal_others(robot)
            if pair not in others
        ),
    )


def robot_dynamics(robot: Robot) -> Dynamics:
    """A robot's own parameters and effects.

    Raises:
        RobotError: it has no parameters.
    """
    robot.require_parameters("an export")
    nominal_effects(robot)
    return Dynamics(robot, "robot", f"the parameters of {Path(robot.source).name or robot.name}")


def servo_dynamics(
    arm: ServoArm, late: Float[Tensor, " n"] | None = None, set_points: bool = False
) -> Dynamics:
    """A robot with its servos, whose damping, dry friction and armature are its joints', in the
    place of those that its file has: of these, servos are fitted beside springs alone.

    Args:
        arm: robot and servos.
        late: (n,) by how much commands are late by being held [s].
        set_points: as in `torchid.export.servo_mjcf.write_servos`.

    Raises:
        RobotError: it has no parameters.
    """
    own = robot_dynamics(arm.robot)
    values = {name: arm.servos.of(name) for name in ("damping", "coulomb", "armature")}
    values["damping"] = values["damping"] * (1 - arm.servos.of("damping_share"))
    kinds = {"damping": ViscousFriction, "coulomb": CoulombFriction, "armature": RotorInertia}
    pairs = [
        (kind(j), [value])
        for name, kind in kinds.items()
        for j, value in enumerate(values[name].tolist())
        if value > 0
    ]
    springs = [e for e in arm.robot.effects if e["effect"] == JointSpring.name]
    robot = replace(arm.robot, effects=(*springs, *records(pairs)))
    return replace(own, robot=robot, arm=arm, late=late, set_points=set_points)


def _beside(
    path: Path, data: Mapping[str, Any], key: str
) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """What a result says of each set under a key, by id, and the result: this one, or the
    extraction or study beside it."""
    for other in (path, path.parent / "extraction.json", path.parent / "study.json"):
        try:
            source = data if other == path else read_json(other, _KINDS)
            found = {str(e["id"]): e[key] for e in source["sets"] if key in e}
        except (TorchidError, KeyError, TypeError):
            continue
        if found:
            return found, source
    return {}, {}


def _chosen(
    path: Path,
    data: Mapping[str, Any],
    sets: ParameterSets,
    asked: str | None,
    robot: Robot,
    geometry: str | None,
) -> tuple[int, str]:
    """Number of the set to export, and why it is this one."""
    if asked is not None:
        if asked not in sets.ids:
            raise TorchidError("there is no such set.", got=asked, available=sets.ids)
        return sets.ids.index(asked), ""
    if len(sets) == 1:
        return 0, ""
    found = check_sets(robot, sets, geometry=geometry).feasibility
    feasible = found.feasible.nonzero().flatten().tolist()
    among = feasible or list(range(len(sets)))
    words = f"of {len(sets)} sets" if not feasible else f"of {len(feasible)} feasible sets"
    phi = _beside(path, data, "phi")[0]
    losses = {name: math.inf if v is None else float(v) for name, v in phi.items()}
    if set(sets.ids) <= set(losses):
        return min(among, key=lambda k: losses[sets.ids[k]]), f", the least loss {words}"
    return max(among, key=lambda k: float(found.degree[k])), f", the largest degree {words}"
