"""Write a result's dynamics in another format, reload them, and compare before they are kept."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

from torchid.errors import TorchidError
from torchid.export.checks import Comparison
from torchid.export.dynamics import (
    Dynamics,
    effect_text,
    folded_robot,
    nearest_representative,
    random_states,
)
from torchid.export.nearest import nearest_bodies
from torchid.export.record import ExportRecord, Places
from torchid.export.releases import has_field, lacking
from torchid.export.results import Exportable, dynamics_of
from torchid.export.servo_mjcf import ANCHOR, JOINTS, said_in_mjcf, unsaid_parameters
from torchid.export.set_points import followed
from torchid.export.write_actuator import Package, write_actuator
from torchid.export.write_bam import SAID, write_bam
from torchid.export.write_plain import write_c, write_yaml
from torchid.export.write_xml import write_xml
from torchid.feasibility.plausibility import LEAD, by_percent
from torchid.feasibility.record import Check, check_sets
from torchid.feasibility.sets import nominal_set
from torchid.files import require_name
from torchid.inputs import RobotLike, as_robot
from torchid.position.model import ServoArm
from torchid.results.record import Result
from torchid.robot.config_files import is_urdf
from torchid.robot.mjcf import mjcf_servos
from torchid.robot.model import Robot, joint_list
from torchid.robot.origin import of_own_file
from torchid.simulators.joint_dynamics import Target
from torchid.simulators.servo import AS_EFFORT

Format = Literal["urdf", "mjcf", "yaml", "c", "isaaclab", "mjlab", "bam"]
SUFFIXES = {"urdf": ".urdf", "mjcf": ".xml", "yaml": ".yaml", "c": ".c", "bam": "_bam.json"}
SUFFIXES |= {to: f"_actuator_{to}.py" for to in get_args(Package)}
_SET_POINTS = (
    "set points of servos are joints of the file (torchid_set_point_*): commands are its first "
    "controls, and where a simulation begins, set points are where the joints are; `plain` leaves "
    "them out"
)


@dataclass(frozen=True, eq=False)
class Export(Result):
    """What was written.

    Attributes:
        dynamics: the result.
        format: of the files.
        files: what was written, the main file first.
        original: the file that was edited a copy of; None for a new one.
        check: feasibility of the physical parameters; None where none are written.
        comparisons: of what was reloaded with the result's model.
        in_file, beside, left_out: effects that the format knows, that are in the sidecar (of an
            actuator: that the simulator's own fields say), and that are nowhere, in words.
        notes: sentences for the user.
    """

    dynamics: Dynamics
    format: Format
    files: tuple[Path, ...]
    original: Path | None
    check: Check | None
    comparisons: tuple[Comparison, ...]
    in_file: tuple[str, ...]
    beside: tuple[str, ...]
    left_out: tuple[str, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Export({self.format}, {', '.join(map(str, self.files))})"

    @cached_property
    def record(self) -> ExportRecord:
        """As the JSON has it."""
        return export_record(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What must not be overlooked."""
        said = list(self.dynamics.warnings) + list(self.notes)
        if self.check is not None and not bool(self.check.feasibility.feasible[0]):
            reasons = ", ".join(self.check.feasibility.reasons(0))
            said.append(f"infeasible, and written all the same: {reasons}")
        # Links that are bodies, but of no material: one sentence for all of them.
        findings = () if self.check is None else self.check.findings[0]
        dense = [f for f in findings if f.what == "density" and f.value > f.threshold == LEAD]
        if dense:
            links = ", ".join(str(f.link) for f in dense)
            most = max(f.value for f in dense)
            said.append(
                f"not plausible, though not forbidden: the inertia of link {links} is that of a "
                f"body denser than lead (up to {most:.2g} kg/m^3); `torchid check` says more"
            )
        said += [f"LEFT OUT of the {self.format} file: {words}" for words in self.left_out]
        return tuple(said)


def edited_of(robot: Robot, to: str) -> Robot | None:
    """The robot whose file is copied and edited: the nominal one, if its file is of the format."""
    own = Path(robot.source).suffix.lower()
    return robot if SUFFIXES[to] == (".urdf" if is_urdf(robot.source) else own) else None


def export_dynamics(
    result: Exportable,
    to: Format,
    folder: Path | str,
    name: str | None = None,
    *,
    nominal: RobotLike,
    original: RobotLike | None = None,
    geometry: str | None = None,
    force: bool = False,
    seed: int = 0,
    keep: Sequence[Path] = (),
    plain: bool = False,
) -> Export:
    """Write dynamics to `folder`, once what was written has been reloaded and compared.

    Args:
        result: what to write: an identification, one set of parameters, a robot, or what the
            functions of `torchid.export.results` read from files.
        to: format. All but c and actuators need
            physical parameters: of base parameters those nearest to the robot's own that have
            exactly them, or, where no bodies do, the nearest bodies that nearly do. isaaclab and
            mjlab are actuator classes that add the effects at run time, bam the servos' models of
            better-actuator-models.
        folder: made if need be.
        name: of the file, without suffix; the robot's own by default.
        nominal: the robot that the result belongs to, with its own parameters.
        original: for urdf and mjcf: the robot whose file a copy is edited of, the nominal
            one by default, or the file that its yaml was made from. If that is of another format,
            a new one is written.
        geometry: group of bounds, or `none`, of the check (see `check_sets`).
        force: write infeasible parameters, too.
        seed: of the states of the comparison.
        keep: files that are never overwritten, beside those of the robot and the original.
        plain: leave set points of servos out of an MJCF, which are joints there.

    Raises:
        TorchidError: infeasible parameters that are not forced, frames that are not the original's,
            what the format has no place for, or a file that does not reproduce the result's torque.
            Nothing is left then, and files that were there before stay.

    >>> from tempfile import TemporaryDirectory
    >>> from torchid import load_robot
    >>> robot = load_robot("3r")
    >>> with TemporaryDirectory() as folder:
    ...     done = export_dynamics(robot, "urdf", folder, nominal=robot)
    >>> [file.name for file in done.files], all(c.difference < 1e-9 for c in done.comparisons)
    (['3r.urdf'], True)
    """
    nominal = as_robot(nominal)
    original = None if original is None else as_robot(original)
    nominal.require_fixed_base("an export")
    dynamics, folder = dynamics_of(result, nominal), Path(folder)
    # What was refitted has been fitted with set points, or without.
    if dynamics.arm is not None and dynamics.late is None and to == "mjcf" and not plain:
        dynamics = replace(dynamics, set_points=True)
    name = stem_of(nominal) if name is None else name
    require_name(name)
    path = folder / f"{name}{SUFFIXES[to]}"
    own = nominal if original is None else original
    model, lost = of_own_file(own, SUFFIXES[to])
    sources = [*keep, Path(nominal.source), Path(model.source)]
    if path.resolve() in [source.resolve() for source in sources]:
        raise TorchidError(
            f"the export would take the place of the original '{path}'.",
            hint="another `name=...`, or another folder",
        )
    xml = to in get_args(Target)
    edited = edited_of(model, to) if xml else None
    ratios = ratios_to_file(
        dynamics.arm, edited if to == "mjcf" else None, refitted=dynamics.late is not None
    )
    found, written = None, dynamics.robot
    # C and actuators hold no bodies of base parameters.
    if to not in (*get_args(Package), "bam") and (dynamics.base is None or to != "c"):
        dynamics, written, found = _bodies(dynamics, nominal, geometry, force)
    folder.mkdir(parents=True, exist_ok=True)
    motion = random_states(dynamics.robot, seed)
    if to == "yaml":
        draft, comparisons = write_yaml(dynamics, written, path, motion)
    elif to == "c":
        draft, comparisons = write_c(dynamics, path, motion)
    elif to == "isaaclab" or to == "mjlab":
        draft, comparisons = write_actuator(dynamics, to, folder, name, motion)
    elif to == "bam":
        draft, comparisons = write_bam(dynamics.arm, folder, name)
    else:
        titled = replace(dynamics, title="; ".join((dynamics.title, *_of_servos(dynamics, to))))
        draft, comparisons = write_xml(titled, written, path, edited, motion, to, ratios)
    in_file, beside, left_out = (
        tuple(effect_text(effect, values, dynamics.robot) for effect, values in pairs)
        for pairs in (draft.in_file, draft.beside, draft.left_out)
    )
    return Export(
        dynamics=dynamics,
        format=to,
        files=tuple(folder / file for file, data in draft.files.items() if data is not None),
        original=None if edited is None else Path(edited.source),
        check=found,
        comparisons=comparisons,
        in_file=in_file,
        beside=beside,
        left_out=left_out,
        notes=(
            *_of_servos(dynamics, to),
            *_of_ratios(ratios),
            *_of_weight(dynamics, to),
            *(lost if xml else ()),
            *draft.notes,
        ),
    )


def _bodies(
    dynamics: Dynamics, nominal: Robot, geometry: str | None, force: bool
) -> tuple[Dynamics, Robot, Check]:
    """Dynamics with the physical parameters that are written, and their check: of base parameters
    those nearest to the robot's own, or, where no bodies have these, the nearest bodies.

    Raises:
        TorchidError: they are infeasible, and not forced.
    """
    written = dynamics.robot
    if dynamics.base is not None:
        written = nearest_representative(nominal, dynamics.base)
    found = check_sets(written, nominal_set(written), geometry=geometry)
    if not force and dynamics.base is not None and not bool(found.feasibility.feasible[0]):
        dynamics = nearest_bodies(dynamics, nominal, geometry)
        written = dynamics.robot
        found = check_sets(written, nominal_set(written), geometry=geometry)
    if not force:
        require_feasible(dynamics, found)
        # Boxes are of links alone; with what they carry they are bodies all the same.
        whole = folded_robot(written)
        if whole is not written:
            require_feasible(dynamics, check_sets(whole, nominal_set(whole), geometry="none"))
    return dynamics, written, found


def _of_servos(dynamics: Dynamics, to: Format) -> tuple[str, ...]:
    """What of servos that were not refitted a format does not say, and what set points ask for."""
    if dynamics.arm is None:
        return ()
    servos = dynamics.arm.servos
    words = (_SET_POINTS,) * (dynamics.set_points and bool(followed(servos).any()))
    kept = {"bam": SAID, **dict.fromkeys(get_args(Package), AS_EFFORT)}
    said = servos.keeping(kept.get(to, JOINTS))
    if to == "mjcf":
        said = said_in_mjcf(servos, set_points=dynamics.set_points)
    unsaid = unsaid_parameters(servos, said)
    if to == "mjcf" and not has_field("pid"):
        lost = [x for x in ("integral", "speed") if x in unsaid]
        words += (f"{lacking('pid')}, so {' and '.join(lost)} of servos is left out",) * bool(lost)
    if dynamics.late is not None or not unsaid:
        return words
    hint = ""
    if to == "mjcf":
        hint = "; torchid.simulators.servo makes them at run time, and `log=...` refits the others"
    elif to not in kept:
        hint = '; `to="mjcf"` says gains, delays, clips and stops, too'
    return (f"of the servos {', '.join(unsaid)} are not in it{hint}", *words)


def _of_ratios(ratios: Mapping[int, float]) -> tuple[str, ...]:
    """Which gains are numbers though the log tells a ratio, and no gain of the file is its unit."""
    numbers = [j for j, ratio in ratios.items() if math.isnan(ratio)]
    words = (
        f"the gain of {joint_list(numbers)} is known as a ratio alone, and a number because MuJoCo "
        "needs one: positions were run on the log with it, forces may be off by a factor; " + ANCHOR
    )
    return (words,) * bool(numbers)


def _of_weight(dynamics: Dynamics, to: Format) -> tuple[str, ...]:
    """What a format does not say of gravity that servos do not feel."""
    if dynamics.robot.compensated is None or to in ("mjcf", "yaml"):
        return ()
    return ("gravity compensation (gravcomp) is not in it",)


def ratios_to_file(
    arm: ServoArm | None, file: Robot | None, *, refitted: bool = False
) -> dict[int, float]:
    """Of joints (from 0) whose torques nothing anchors, kp over that of the actuators in the MJCF
    that is edited; NaN where it has none, of servos that were refitted to a log and have been run.

    Raises:
        TorchidError: there is none to which a gain would be a ratio.
    """
    if arm is None or not arm.unanchored:
        return {}
    own = [] if file is None else mjcf_servos(Path(file.source), file.joint_names)
    lost = [j for j in arm.unanchored if not own or "kp" not in own[j]]
    if lost and not refitted:
        raise TorchidError(
            f"the gain of {joint_list(lost)} is known as a ratio alone, so it is not exported.",
            got="no load and no known gain anchors the torques of the servo, friction and armature",
            expected="an MJCF (`robot=...`) with position actuators, to whose gain it is a ratio; "
            'or a diagnosis with `servo="kp=12"`, or the type of servos, of which one tells others',
            hint=ANCHOR,
        )
    kp = arm.servos.of("kp").tolist()
    return {j: math.nan if j in lost else kp[j] / own[j]["kp"] for j in arm.unanchored}


def stem_of(robot: Robot) -> str:
    """The robot's name as that of a file."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in robot.name)


def require_feasible(dynamics: Dynamics, found: Check) -> None:
    """Raise TorchidError where the parameters are infeasible: why, and what to do."""
    reasons = found.feasibility.reasons(0)
    if not reasons:
        return
    if dynamics.kind == "base parameters":
        hint = (
            "the bodies nearest to the robot's own keep not all conditions: `torchid extract` with "
            "other bounds may; C needs none"
        )
    else:
        hint = (
            "`torchid check ... --nearest FILE` writes the feasible set nearest in torque; "
            '`geometry="none"` asks for physics alone; `force=True` writes it as it is'
        )
    raise TorchidError(
        f"{dynamics.title}: infeasible, so not exported.",
        got="; ".join(reason_text(found, reason) for reason in reasons),
        expected="a set that a real arm can have",
        hint=hint,
    )


def reason_text(found: Check, reason: str) -> str:
    """A label with its evidence: `inertia_3 (triangle inequality broken, by 4 %)`."""
    kind, _, place = reason.rpartition("_")
    parameters = found.sets.parameters
    if kind == "inertia":
        link = int(place) - 1
        values = found.eigenvalues[0, link].tolist()
        if found.feasibility.inertia_violation(0, link) == "eigenvalue":
            return f"{reason} (not positive definite: {values[0]:.3g} kg m^2)"
        return f"{reason} (breaks the triangle inequality{by_percent(values)})"
    if kind == "mass":
        return f"{reason} ({float(parameters.mass[0, int(place) - 1]):.3g} kg)"
    if kind == "com":
        link, axis = int(place[:-1]) - 1, "xyz".index(place[-1])
        low, high = found.conditions.com_box[link, axis].tolist()
        at = float(parameters.com[0, link, axis])
        return f"{reason} ({at:.3g} m, outside {low:.3g} to {high:.3g})"
    return reason


def export_record(done: Export) -> ExportRecord:
    """An export as its JSON has it."""
    check = done.check
    return ExportRecord(
        robot=done.dynamics.robot.name,
        what=done.dynamics.kind,
        result=done.dynamics.title,
        format=done.format,
        files=tuple(map(str, done.files)),
        original=None if done.original is None else str(done.original),
        feasible=None if check is None else bool(check.feasibility.feasible[0]),
        reasons=() if check is None else check.feasibility.reasons(0),
        checks=done.comparisons,
        effects=Places.of(done),
        warnings=done.warnings,
    )
