"""Read MJCF through MuJoCo's own compiler: defaults, includes and geometry inertias are its work.

The compiled model is float64. What MuJoCo has beyond rigid bodies, damping, linear springs, dry
friction and armature on joints of one freedom is told in `warnings`.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.assemble import assemble
from torchid.robot.mjcf_files import require_end
from torchid.robot.model import Robot
from torchid.robot.placement import pose, quaternion
from torchid.robot.spec import (
    FAILURES,
    INSIDE,
    SERVO,
    SET_POINT,
    listening,
    name_parts,
    spec_tree,
)
from torchid.robot.tree import Base, Choice, Following, Tree, choose
from torchid.robot.xml_numbers import parse_xml

_NO_GRAVITY = (0.0, 0.0, 0.0)
_UNNAMED = "MuJoCo Model"


def read_mjcf(
    path: Path,
    *,
    tip: str | None = None,
    root: str | None = None,
    lock: Mapping[str, float] | None = None,
    base: Base = "fixed",
) -> Robot:
    """Read the robot of an MJCF file: the tree that the world carries, or a part of it.

    Link frames are MuJoCo's body frames. Bodies without joints are merged into the body that
    moves them. A body with several joints becomes a chain of massless links, named
    `body/joint`, that ends in the body. q is MuJoCo's qpos (`ref` is in the kinematics). Damping,
    frictionloss, armature and springs become `effects`; gravity is the model's option. An equality
    that makes a joint follow another in proportion makes it a mimic. A body with a free joint is
    taken as fixed, with a warning. What gravcomp takes of a body's weight, servos do not feel;
    actuatorgravcomp says only who makes that torque.

    Args:
        path: the file.
        tip: last body, or site, of a chain, which alone is read.
        root: body that is the base of what is read.
        lock: joints that are held, and where [rad or m].
        base: whether the base is held, or moves: one that floats in the file is then the base.

    Raises:
        RobotError: MuJoCo cannot compile the file, a ball joint is part of the
            robot, a loop of bodies is closed, nothing moves, an unknown link or joint.
    """
    path, choice = Path(path), Choice(tip, root, dict(lock or {}), base)
    read = compiled(path)
    spec, model = read.spec, read.model
    mimics = _mimics(spec, model)
    tree = spec_tree(spec, str(path), mimics, model, tip)
    shares = {b.name: float(model.body_gravcomp[b.id]) for b in spec.bodies}
    tree = replace(tree, compensated={name: c for name, c in shares.items() if c})
    off = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    _refuse_loops(spec, tree, choice)
    return assemble(
        tree,
        choice,
        name=path.stem if spec.modelname in ("", _UNNAMED) else spec.modelname,
        gravity=_NO_GRAVITY if off else model.opt.gravity.tolist(),
        path=path,
        warnings=[*read.warnings, *_not_modelled(spec, model, len(mimics), off)],
    )


@dataclass(frozen=True)
class Compiled:
    """What MuJoCo makes of an MJCF.

    Attributes:
        spec: the parsed file, in which all bodies and joints have names.
        model: compiled from it.
        warnings: MuJoCo's own, and what had to be left out.
        shapeless: ids of the bodies of which a mesh is absent, and whether it collides.
    """

    spec: Any
    model: Any
    warnings: tuple[str, ...]
    shapeless: Mapping[int, bool] = field(default_factory=dict)


def compiled(path: Path) -> Compiled:
    """MuJoCo's model of an MJCF.

    Meshes, height fields, skins and textures whose files are absent are left out, with a warning.

    Raises:
        RobotError: no MJCF, MuJoCo cannot compile it or would not end (`require_end`), or a
            moving body's mass or inertia would come from an absent mesh.
    """
    root = parse_xml(path)
    if root.tag != "mujoco":
        hint = "this is a URDF: give it the suffix .urdf" if root.tag == "robot" else None
        raise RobotError(f"{path}: not MJCF.", got=f"<{root.tag}>", expected="<mujoco>", hint=hint)
    require_end(path)
    said, spec, shaped = listening(), None, None
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        model = spec.compile()
    except FAILURES as error:
        text = " ".join(str(error).split())
        # MuJoCo's wording for a mesh, texture or include that is not there.
        missing = any(words in text.lower() for words in ("opening file", "not found", "no file"))
        model = None
        if missing and spec is not None:
            spec = mujoco.MjSpec.from_file(str(path))  # one that fails to compile is of no more use
            shaped = _without_absent(spec, path.parent)
            with suppress(*FAILURES):
                model = None if shaped is None else spec.compile()
        if model is None:
            raise RobotError(
                f"{path}: MuJoCo cannot compile it: {text}",
                hint="the files it names (meshes, includes) must lie where it says: masses and "
                "inertias may come from them"
                if missing
                else None,
            ) from error
    name_parts(spec)
    if shaped:
        said.append("its mesh files are absent: the robot has masses, and no such shapes")
    shapeless: dict[int, bool] = {}
    for body, collides in shaped or ():
        shapeless[body.id] = shapeless.get(body.id, False) or collides
    return Compiled(spec, model, tuple(said), shapeless)


def _without_absent(spec: Any, folder: Path) -> list[tuple[Any, bool]] | None:
    """Take what absent files would give out of the spec.

    Returns:
        For each shape whose mesh is absent its body and whether it collides; None where a moving
        body's inertia would come from one.
    """

    def absent(parts: Iterable[Any], beside: str) -> list[Any]:
        places = ("", beside)
        return [
            part
            for part in parts
            if part.file and not any((folder / p / part.file).is_file() for p in places)
        ]

    meshes = [*absent(spec.meshes, spec.meshdir), *absent(spec.hfields, spec.meshdir)]
    textures = absent(spec.textures, spec.texturedir)
    gone = {part.name or Path(part.file).stem for part in meshes}
    shaped = [g for g in spec.geoms if {g.meshname, g.hfieldname} & gone]
    if any(map(_gives_mass, shaped)):
        return None
    bodies = [(geom.parent, bool(geom.contype or geom.conaffinity)) for geom in shaped]
    for material in spec.materials:
        kept = [t for t in material.textures if t not in {texture.name for texture in textures}]
        material.textures = kept + [""] * (len(material.textures) - len(kept))
    for part in [*shaped, *meshes, *textures, *absent(spec.skins, spec.meshdir)]:
        spec.delete(part)
    return bodies


def _gives_mass(geom: Any) -> bool:
    """Whether the mass of a body that moves comes from a geom."""
    body, compiler = geom.parent, geom.compiler
    low, high = compiler.inertiagrouprange
    from_geoms = compiler.inertiafromgeom == 1 or (
        compiler.inertiafromgeom != 0 and not body.explicitinertial
    )
    moves = False
    while body is not None and not moves:
        moves, body = bool(body.joints), body.parent
    weighs = geom.mass != 0 and (geom.mass == geom.mass or geom.density != 0)
    return bool(moves and from_geoms and weighs and low <= geom.group <= high)


def _mimics(spec: Any, model: Any) -> dict[str, Following]:
    """By joint, equalities that make it a linear function of another."""
    out: dict[str, Following] = {}
    for equality in spec.equalities:
        c0, ratio, *higher = map(float, equality.data[:5])
        first, second = equality.name1, equality.name2
        if (
            not equality.active
            or equality.type != mujoco.mjtEq.mjEQ_JOINT
            or not second
            or any(higher)
            or not ratio
            or first in out
        ):
            continue
        # q1 - q1_0 = c0 + ratio (q2 - q2_0)
        own, other = (float(model.joint(name).qpos0[0]) for name in (first, second))
        out[first] = Following(second, ratio, c0 + own - ratio * other)
    return out


def _not_modelled(spec: Any, model: Any, mimics: int, without_gravity: bool) -> list[str]:
    """Sentences on what the model holds and a Robot does not."""
    rest = sum(bool(equality.active) for equality in spec.equalities) - mimics
    tendons = [t for t in spec.tendons if not t.name.startswith(SET_POINT)]
    others = {
        f"{rest} equality constraint(s) are not modelled": rest,
        f"{len(tendons)} tendon(s) are not modelled": tendons,
        "gravity compensation of bodies (gravcomp) counts where commands are replayed; torques "
        "of a log hold gravity, unless it is read as one without": (model.body_gravcomp.any()),
        "forces of the surrounding fluid (density, viscosity) are not modelled": (
            model.opt.density or model.opt.viscosity
        ),
        "the model turns gravity off: gravity is zero": without_gravity,
    }
    return [
        f"joint '{joint.name}' has nonlinear damping (commands are replayed with its linear part "
        "alone) or stiffness (it is not modelled)"
        for joint in spec.joints
        if np.any(np.ravel(joint.damping)[1:]) or np.any(np.ravel(joint.stiffness)[1:])
    ] + [sentence for sentence, holds in others.items() if holds]


def _refuse_loops(spec: Any, tree: Tree, choice: Choice) -> None:
    """Raise RobotError where an equality constraint holds two bodies together that move against
    each other."""
    part = choose(tree, choice)
    place = {name: k for k, group in enumerate(part.groups) for name in group.poses}
    for equality in spec.equalities:
        kinds = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
        if not equality.active or equality.type not in kinds:
            continue
        pair = [equality.name1, equality.name2 or spec.worldbody.name]
        if equality.objtype == mujoco.mjtObj.mjOBJ_SITE:
            pair = [spec.site(name).parent.name for name in pair]
        if place.get(pair[0], 0) != place.get(pair[1], 0):
            raise RobotError(
                f"{tree.source}: bodies '{pair[0]}' and '{pair[1]}' are held together by an "
                "equality constraint, which closes a loop.",
                expected="a tree of bodies; joints that follow others in proportion",
                hint="lock the joints of the loop (`lock=...`), or choose a part "
                "without it (`tip=...`, `root=...`)",
            )


def given_pose(model: Any, kind: str, index: int) -> Tensor:
    """(4, 4) pose of a body, site or geom in the frame that the model gives it in."""
    turn, place = getattr(model, f"{kind}_quat")[index], getattr(model, f"{kind}_pos")[index]
    return pose(quaternion(turn), place.tolist())


def mjcf_servos(path: Path, joints: Iterable[str]) -> list[dict[str, float]]:
    """Servos that an MJCF's actuators are, one a joint, by `torchid.simulation.servo`'s names;
    empty where a joint has no such actuator, or several.

    An actuator on a joint, or on a fixed tendon of one joint, has a length of g q with g its gear
    (times the tendon's coefficient), and pulls at the joint with g times its force, which is
    gain u + b0 + b1 g q + b2 g dq: a servo of kp = -b1 g^2 that goes where gain u / (-b1 g) is.

    Args:
        path: the file.
        joints: their names, in order.

    Raises:
        RobotError: MuJoCo cannot compile the file.
    """
    model, servos = compiled(path).model, dict[int, list[dict[str, float]]]()
    for a, joint, gear, has_set_point in driving(model):
        values = _servo(model, a, joint, gear)
        if has_set_point:
            servos[joint] = [_with_set_point(model, values, joint)]
        elif model.actuator(a).name == f"{SERVO}{model.joint(joint).name}{INSIDE}":
            # Damping of a servo whose other actuator is on its set point, before this one.
            within = -float(model.actuator_biasprm[a, 2])
            whole = within + servos[joint][0]["damping"]
            servos[joint][0] |= {"damping": whole, "damping_share": within / whole}
        else:
            servos.setdefault(joint, []).append(values)
    ids = [mujoco.mj_name2id(model, int(mujoco.mjtObj.mjOBJ_JOINT), name) for name in joints]
    return [servos[k][0] if len(servos.get(k, ())) == 1 else {} for k in ids]


def driving(model: Any) -> Iterator[tuple[int, int, float, bool]]:
    """Actuators that drive one joint each: which, the joint, the gear, and whether the joint
    follows a set point that is a joint, too."""
    kinds = mujoco.mjtTrn
    for a in range(model.nu):
        joint, gear = int(model.actuator_trnid[a, 0]), float(model.actuator_gear[a, 0])
        if int(model.actuator_trntype[a]) == int(kinds.mjTRN_TENDON):
            first, count = int(model.tendon_adr[joint]), int(model.tendon_num[joint])
            if count == 2 and model.tendon(joint).name.startswith(SET_POINT):
                yield a, int(model.wrap_objid[first]), gear, True
            elif count == 1 and int(model.wrap_type[first]) == int(mujoco.mjtWrap.mjWRAP_JOINT):
                share = float(model.wrap_prm[first])
                yield a, int(model.wrap_objid[first]), gear * share, False
        elif int(model.actuator_trntype[a]) == int(kinds.mjTRN_JOINT):
            yield a, joint, gear, False


def _servo(model: Any, actuator: int, joint: int, gear: float) -> dict[str, float]:
    """Values of one actuator's servo; empty where it follows no position."""
    gain, (b0, b1, b2) = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator][:3]
    kinds = int(model.actuator_gaintype[actuator]), int(model.actuator_biastype[actuator])
    affine = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_AFFINE)
    if kinds != affine or not b1 < 0 or not gear:
        return {}
    dof = int(model.jnt_dofadr[joint])
    own = -b2 * gear**2
    damping = own + model.dof_damping[dof]
    values = {
        "kp": -b1 * gear**2,
        "damping": damping,
        "armature": model.dof_armature[dof],
        "coulomb": model.dof_frictionloss[dof],
        "scale": -gain / (b1 * gear),
        "offset": b0 * gear,
    }
    if own > 0:  # what a limit of force holds is the actuator's alone
        values["damping_share"] = own / damping
    limits = []
    if model.actuator_forcelimited[actuator]:
        limits.append(model.actuator_forcerange[actuator] * gear)
    if model.jnt_actfrclimited[joint]:
        limits.append(model.jnt_actfrcrange[joint])
    if limits:
        # A constant torque is beside what a servo can, as far as its limits are about it.
        values["clip"] = min(abs(ends - values["offset"]).max() for ends in limits)
    if int(model.actuator_dyntype[actuator]) != int(mujoco.mjtDyn.mjDYN_NONE):
        values["lag"] = model.actuator_dynprm[actuator, 0]
    return {name: float(value) for name, value in values.items()}


def _with_set_point(model: Any, values: dict[str, float], joint: int) -> dict[str, float]:
    """Values of a servo that answers to the rate of its error, with what its set point has: the
    limit of acceleration, and the factor on the command."""
    name = f"{SET_POINT}{model.joint(joint).name}"
    point = model.joint(name)
    (drive,) = [
        a
        for a in range(model.nu)
        if int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        and int(model.actuator_trnid[a, 0]) == point.id
        and model.actuator_gainprm[a, 0]
    ]
    kd = values["damping"] - float(model.dof_damping[model.jnt_dofadr[joint]])
    values = values | {"kd": kd, "damping": values["damping"] - kd}
    values.pop("damping_share", None)
    inertia = float(model.body_inertia[point.bodyid[0], 0])
    scale = -model.actuator_gainprm[drive, 0] / model.actuator_biasprm[drive, 1]
    limit = float(model.jnt_actfrcrange[point.id, 1])
    return values | {"scale": float(scale), "acceleration": limit / inertia}
