"""Exports to URDF and MJCF: an edited copy of the user's file, or a new one."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from torchid import __version__
from torchid.effects.base import Motion
from torchid.effects.registry import Valued, nominal_effects
from torchid.errors import TorchidError
from torchid.export.checks import Comparison, Draft, compared, require_agreement, staged_files
from torchid.export.dynamics import (
    Dynamics,
    effect_text,
    folded_robot,
    in_places_of,
    records,
    robot_torque,
)
from torchid.export.engines import check_mujoco, check_pinocchio
from torchid.export.mjcf import edited_mjcf, new_mjcf
from torchid.export.servo_mjcf import check_servos, write_servos
from torchid.export.urdf import edited_urdf, in_joint_frames, new_urdf
from torchid.export.xml_tree import XmlFile, set_head
from torchid.files import UNCONFIRMED
from torchid.robot.library import load_robot
from torchid.robot.model import STANDARD_GRAVITY, Robot
from torchid.robot.origin import same_places
from torchid.robot.sidecar import sidecar_path, sidecar_yaml
from torchid.robot.tree import Choice, choice_of
from torchid.simulators.joint_dynamics import JointDynamics, Target, split


def write_xml(
    dynamics: Dynamics,
    written: Robot,
    path: Path,
    original: Robot | None,
    motion: Motion,
    to: Target,
    ratios: Mapping[int, float] | None = None,
) -> tuple[Draft, tuple[Comparison, ...]]:
    """Write, reload with torchid, Pinocchio and MuJoCo, compare, and keep.

    Args:
        dynamics: the result, whose torque counts.
        written: physical parameters and effects to write.
        path: .urdf or .xml (MJCF).
        original: the robot whose file a copy is edited of.
        motion: states of the comparison.
        to: format.
        ratios: as in `write_servos`.
    """
    mjcf = path.suffix == ".xml"
    robot, file, joints, rest = xml_of(written, path, original, to)
    if original is not None:
        dynamics = replace(dynamics, robot=in_places_of(dynamics.robot, original))
    servos = dynamics.arm.servos if to == "mjcf" and dynamics.arm is not None else None
    if servos is not None:
        source = path.name if original is None else original.source
        write_servos(file, robot, servos, source, dynamics.late, ratios, dynamics.set_points)
    known = tuple(pair for pair in nominal_effects(robot) if pair not in rest)
    if original is None and not mjcf:
        rest = in_joint_frames(rest, robot)
    # A URDF has no gravity; its reader takes -9.81 along z.
    usual = mjcf or tuple(robot.gravity.tolist()) == STANDARD_GRAVITY
    gravity = None if usual else robot.gravity.tolist()
    # Knowledge is of parameters in the frames of the file that is edited.
    sure = None if original is None else written.knowledge
    beside = bool(rest) or gravity is not None or sure is not None
    side = sidecar_path(path)
    mark = "".join(f"{w} " for w in written.warnings if w.startswith(UNCONFIRMED))
    head = f"{mark}dynamics of {dynamics.title}; torchid {__version__}."
    if beside:
        head += f" What this format cannot say is in {side.name}, which torchid reads with it."
    set_head(file.root, "\n    ".join([head, *(effect_text(*pair, robot) for pair in rest)]))
    sidecar = sidecar_yaml(path.name, robot.joint_names, records(rest), gravity, sure)
    contents = {path.name: file.to_bytes(), side.name: sidecar.encode() if beside else None}
    draft = Draft(contents, known, rest, notes=_notes(robot, original))
    with staged_files(path.parent, draft.files) as files:
        main = files[path.name]
        torque = robot_torque(_read_back(main, path, original), motion)
        reader, what = f"torchid {__version__}", "torque with all effects"
        own = compared(reader, what, motion, dynamics.torque(motion), torque)
        engines = [check(main, robot, joints, motion) for check in (check_pinocchio, check_mujoco)]
        if servos is not None:
            engines.append(check_servos(main, robot, servos))
        return draft, require_agreement([own, *engines])


def xml_of(
    written: Robot, path: Path, original: Robot | None, to: Target
) -> tuple[Robot, XmlFile, tuple[JointDynamics, ...], tuple[Valued, ...]]:
    """The robot with its bodies put together and named as in the file, the file's content, the
    joints' attributes in it, and the effects that are not.

    Args:
        written: physical parameters and effects.
        path: .urdf or .xml (MJCF), for references to meshes.
        original: the robot whose file a copy is edited of.
        to: format.

    Raises:
        TorchidError: parameters that are not in the original's frames, or have no place in it.
    """
    mjcf, robot = path.suffix == ".xml", folded_robot(written)
    if original is not None:
        _require_same_frames(robot, original)
        robot = replace(
            in_places_of(robot, original),
            joint_names=original.joint_names,
            link_names=original.link_names,
        )
    joints, rest = split(robot, to)
    if original is None:
        file = new_mjcf(robot, joints) if mjcf else new_urdf(robot, joints)
    elif mjcf:
        turned = robot.gravity.tolist() != original.gravity.tolist()
        file = edited_mjcf(Path(original.source), robot, joints, turned, path.parent)
    else:
        file = edited_urdf(Path(original.source), choice_of(original), robot, joints, path.parent)
    return robot, file, joints, rest


def _read_back(staged_path: Path, path: Path, original: Robot | None) -> Robot:
    """The robot of the file, under its hidden name."""
    try:
        return load_robot(
            staged_path, **(Choice() if original is None else choice_of(original)).options
        )
    except TorchidError as error:
        raise TorchidError(
            "what was written cannot be read back, so nothing was kept.",
            got=str(error).replace(staged_path.name, path.name),
            hint="MuJoCo compiles no body that cannot exist; the formats urdf and yaml hold any"
            if path.suffix == ".xml"
            else None,
        ) from error


def _structure(robot: Robot) -> tuple[object, ...]:
    """What links and joints a robot has, but for names and places."""
    follows = [(mimic.link, mimic.coordinate, mimic.ratio, mimic.offset) for mimic in robot.mimics]
    return robot.n, robot.joint_types, robot.parents, follows


def _require_same_frames(robot: Robot, other: Robot) -> None:
    """Raise TorchidError where parameters are not in the frames of the original's links."""
    if _structure(robot) != _structure(other):
        raise TorchidError(
            f"the result is of another arm than '{other.source}'.",
            got=" ".join(robot.joint_types),
            expected=" ".join(other.joint_types),
            hint="choose the part with `tip=...`, `root=...` and `lock=...`",
        )
    apart = (~same_places(robot, other)).nonzero().flatten().tolist()
    if apart:
        raise TorchidError(
            f"the result has its link frames elsewhere than '{other.source}', so its parameters "
            "do not fit into it.",
            got=f"links {', '.join(str(i + 1) for i in apart)}",
            hint="identify with this file as the robot; without `robot=...` a new file is written",
        )


def _notes(robot: Robot, original: Robot | None) -> tuple[str, ...]:
    """What a reader of the file should know."""
    if original is None:
        lost = {
            "acceleration limits": robot.limits.acceleration is not None,
            "drive gains": robot.drive_gain is not None,
            "bounds": bool(robot.bounds),
        }
        said = [name for name, there in lost.items() if there]
        new = ("a new file of kinematics and dynamics, without shapes",)
        return (*new, f"not in it: {', '.join(said)}") if said else new
    return tuple(
        f"{warning}; their own inertials stay in the copy, and count twice if the log was recorded "
        "with them on the arm"
        for warning in original.warnings
        if "is not on the chain" in warning
    )
