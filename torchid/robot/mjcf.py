"""Read MJCF through MuJoCo's own compiler: defaults, includes and geometry inertias are its work.

The compiled model is float64. What MuJoCo has beyond rigid bodies, linear damping and springs,
dry friction and armature on joints of one freedom is told in `warnings`.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchid.errors import LARGEST, MissingExtraError, RobotError
from torchid.robot.assemble import assemble
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import JointType, Robot, free_name
from torchid.robot.placement import pose, quaternion
from torchid.robot.tree import Base, Choice, Following, Interval, Tree, TreeJoint, choose
from torchid.robot.xml_numbers import parse_xml

_OLDEST = (3, 15)
_NO_GRAVITY = (0.0, 0.0, 0.0)
_UNNAMED = "MuJoCo Model"
_READ = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "jnt_pos",
    "jnt_axis", "jnt_stiffness", "qpos0", "qpos_spring", "dof_damping", "dof_frictionloss",
    "dof_armature", "site_pos", "site_quat",
)  # fmt: skip
"""Arrays of a compiled model that a robot is made of."""


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
        MissingExtraError: MuJoCo is not installed.
        RobotError: MuJoCo is too old or cannot compile the file, a ball joint is part of the
            robot, a loop of bodies is closed, nothing moves, an unknown link or joint.
    """
    path = Path(path)
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtraError("mujoco", "mjcf", "Reading MJCF") from error
    version = tuple(int(part) for part in mujoco.__version__.split(".")[:2])
    if version < _OLDEST:
        raise RobotError(
            "this MuJoCo is too old to read a robot exactly.",
            got=mujoco.__version__,
            expected=f">= {_OLDEST[0]}.{_OLDEST[1]}",
            hint="pip install 'torchid[mjcf]'",
        )
    found = compiled(mujoco, path)
    model = found.model
    for name in _READ:
        if not (abs(getattr(model, name)) < LARGEST).all():
            raise RobotError(f"{path}: not all finite: {name}, as MuJoCo compiles it.")
    read = _Reader(mujoco, model)
    choice = Choice(tip, root, dict(lock or {}), base)
    links, joints = read.links_and_joints(choice.tip)
    off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    shares = {read.bodies[k]: float(c) for k, c in enumerate(model.body_gravcomp) if c}
    tree = Tree(links, tuple(joints), str(path), shares)
    # The first string of the name buffer.
    name = bytes(model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    read.refuse_loops(tree, choice)
    return assemble(
        tree,
        choice,
        name=path.stem if name in ("", _UNNAMED) else name,
        gravity=_NO_GRAVITY if off else model.opt.gravity.tolist(),
        path=path,
        warnings=[*found.warnings, *read.warnings(bool(off))],
    )


@dataclass(frozen=True)
class Compiled:
    """What MuJoCo makes of an MJCF.

    Attributes:
        model: the compiled model.
        warnings: MuJoCo's own, and what had to be left out.
        shapeless: ids of the bodies of which a mesh is absent, and whether it collides.
    """

    model: Any
    warnings: tuple[str, ...]
    shapeless: Mapping[int, bool] = field(default_factory=dict)


def compiled(mujoco: Any, path: Path) -> Compiled:
    """MuJoCo's model of an MJCF.

    Meshes, height fields, skins and textures whose files are absent are left out, with a warning.

    Raises:
        RobotError: no MJCF, MuJoCo cannot compile it, or a moving body's mass or inertia would
            come from an absent mesh.
    """
    root = parse_xml(path)
    if root.tag != "mujoco":
        hint = "this is a URDF: give it the suffix .urdf" if root.tag == "robot" else None
        raise RobotError(f"{path}: not MJCF.", got=f"<{root.tag}>", expected="<mujoco>", hint=hint)
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)  # else it writes a file into the working directory
    try:
        return Compiled(mujoco.MjModel.from_xml_path(str(path)), tuple(said))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        text = " ".join(str(error).split())
        # MuJoCo's wording for a mesh, texture or include that is not there.
        missing = any(words in text.lower() for words in ("opening file", "not found", "no file"))
        found = _without_absent(mujoco, path) if missing else None
        if found is not None:
            return found
        raise RobotError(
            f"{path}: MuJoCo cannot compile it: {text}",
            hint="the files it names (meshes, includes) must lie where it says: masses and "
            "inertias may come from them"
            if missing
            else None,
        ) from error


def _without_absent(mujoco: Any, path: Path) -> Compiled | None:
    """The model without what absent files would give it; None where something else is wrong with
    it, or a moving body's inertia would come from one."""
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, RuntimeError, mujoco.FatalError):
        return None

    def absent(parts: Iterable[Any], folder: str) -> list[Any]:
        places = ("", folder)
        return [
            part
            for part in parts
            if part.file and not any((path.parent / p / part.file).is_file() for p in places)
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
    try:
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError):
        return None
    shapeless: dict[int, bool] = {}
    for body, collides in bodies:
        shapeless[body.id] = shapeless.get(body.id, False) or collides
    said = ("its mesh files are absent: the robot has masses, and no such shapes",)
    return Compiled(model, said * bool(shaped), shapeless)


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


class _Reader:
    """Links and joints of a compiled model, and what it holds that a Robot does not."""

    def __init__(self, mujoco: Any, model: Any):
        self.mujoco, self.model = mujoco, model
        kinds = mujoco.mjtObj
        self.bodies = self._names(kinds.mjOBJ_BODY, model.nbody, "body")
        self.joints = self._names(kinds.mjOBJ_JOINT, model.njnt, "joint")
        # Equalities (from 0) that make a joint follow another, and how.
        self.mimics = dict(self._mimics())

    def _names(self, kind: Any, count: int, word: str) -> list[str]:
        """Names of a kind of object; those without one get word_<id>, distinct from the others."""
        given = [self.mujoco.mj_id2name(self.model, int(kind), i) or "" for i in range(count)]
        taken = set(given)
        return [name or free_name(f"{word}_{i}", taken) for i, name in enumerate(given)]

    def links_and_joints(self, tip: str | None) -> tuple[dict[str, Tensor | None], list[TreeJoint]]:
        """Links with their parameters (10,) or None, and joints in the order of qpos; a site that
        is named as the tip is a massless link fixed to its body."""
        model = self.model
        links: dict[str, Tensor | None] = {self.bodies[0]: None}
        joints: list[TreeJoint] = []
        for body in range(1, model.nbody):
            links[self.bodies[body]] = _inertial(model, body)
            steps = self._steps(body)
            joints.extend(steps)
            for step in steps[:-1]:
                links[step.child] = torch.zeros(10, dtype=torch.float64)
        site = -1
        if tip is not None and tip not in links:
            site = self.mujoco.mj_name2id(model, int(self.mujoco.mjtObj.mjOBJ_SITE), tip)
        if tip is not None and site >= 0:
            links[tip] = None
            body, placed = int(model.site_bodyid[site]), given_pose(model, "site", site)
            joints.append(TreeJoint(f"{tip} (fixed)", self.bodies[body], tip, origin=placed))
        return links, joints

    def warnings(self, without_gravity: bool) -> list[str]:
        """What the model holds and a Robot does not."""
        model, said = self.model, []
        for joint, name in enumerate(self.joints):
            dof = int(model.jnt_dofadr[joint])
            if _any(getattr(model, "dof_dampingpoly", ()), dof) or _any(
                getattr(model, "jnt_stiffnesspoly", ()), joint
            ):
                said.append(
                    f"joint '{name}' has nonlinear damping or stiffness: it is not modelled"
                )
        active = [k for k in range(model.neq) if model.eq_active0[k]]
        rest = len(active) - len(self.mimics)
        others = {
            f"{rest} equality constraint(s) are not modelled": rest,
            f"{model.ntendon} tendon(s) are not modelled": model.ntendon,
            "gravity compensation of bodies (gravcomp) counts where commands are replayed; torques "
            "of a log hold gravity, unless --torque without-gravity says that they hold none": (
                model.body_gravcomp.any()
            ),
            "forces of the surrounding fluid (density, viscosity) are not modelled": (
                model.opt.density or model.opt.viscosity
            ),
            "the model turns gravity off: gravity is zero": without_gravity,
        }
        return said + [sentence for sentence, holds in others.items() if holds]

    def _mimics(self) -> Iterator[tuple[int, tuple[int, Following]]]:
        """Equality constraints in which joint 1 is a linear function of joint 2."""
        model, taken = self.model, set()
        for k in range(model.neq):
            first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            c0, ratio, *higher = model.eq_data[k][:5].tolist()
            if (
                not model.eq_active0[k]
                or int(model.eq_type[k]) != int(self.mujoco.mjtEq.mjEQ_JOINT)
                or second < 0
                or any(higher)
                or not ratio
                or first in taken
            ):
                continue
            taken.add(first)
            # q1 - q1_0 = c0 + ratio (q2 - q2_0)
            own, other = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second))
            way = Following(self.joints[second], ratio, c0 + own - ratio * other)
            yield k, (first, way)

    def refuse_loops(self, tree: Tree, choice: Choice) -> None:
        """Raise RobotError where an equality constraint holds two bodies together that move against
        each other."""
        model, kinds = self.model, self.mujoco.mjtEq
        bodies = (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD))
        part = choose(tree, choice)
        place = {name: k for k, group in enumerate(part.groups) for name in group.poses}
        for k in range(model.neq):
            if not model.eq_active0[k] or int(model.eq_type[k]) not in bodies:
                continue
            ids = [model.eq_obj1id[k], model.eq_obj2id[k]]
            if int(model.eq_objtype[k]) == int(self.mujoco.mjtObj.mjOBJ_SITE):
                ids = [model.site_bodyid[s] for s in ids]
            pair = [self.bodies[int(body)] for body in ids]
            if place.get(pair[0], 0) != place.get(pair[1], 0):
                raise RobotError(
                    f"{tree.source}: bodies '{pair[0]}' and '{pair[1]}' are held together by an "
                    "equality constraint, which closes a loop.",
                    expected="a tree of bodies; joints that follow others in proportion",
                    hint="lock the joints of the loop (`lock=...`), or choose a part "
                    "without it (`tip=...`, `root=...`)",
                )

    def _steps(self, body: int) -> list[TreeJoint]:
        """The joints from a body's parent to the body; one fixed joint where it has none."""
        model = self.model
        name, parent = self.bodies[body], self.bodies[int(model.body_parentid[body])]
        placed = given_pose(model, "body", body)
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        if count == 0:
            return [TreeJoint(f"{name} (fixed)", parent, name, origin=placed)]
        steps = []
        for joint in range(first, first + count):
            last = joint == first + count - 1
            below = name if last else f"{name}/{self.joints[joint]}"
            steps.append(self._movable(joint, parent, below, placed))
            # The next joint of the body starts where this one has taken the body frame.
            parent, placed = below, pose()
        return steps

    def _movable(self, joint: int, parent: str, below: str, placed: Tensor) -> TreeJoint:
        model, name = self.model, self.joints[joint]
        kinds = self.mujoco.mjtJoint
        kind = int(model.jnt_type[joint])
        motions = {
            int(kinds.mjJNT_HINGE): JointType.REVOLUTE,
            int(kinds.mjJNT_SLIDE): JointType.PRISMATIC,
        }
        if kind not in motions:
            word = "free" if kind == int(kinds.mjJNT_FREE) else "ball"
            refused = f"joint '{name}' is a {word} joint; only hinge and slide joints are known"
            free = word == "free"
            return TreeJoint(name, parent, below, origin=placed, refused=refused, floating=free)
        followed = dict(self.mimics.values())
        anchor = torch.tensor(model.jnt_pos[joint].tolist(), dtype=torch.float64)
        dof = int(model.jnt_dofadr[joint])
        limited = bool(model.jnt_limited[joint])
        return TreeJoint(
            name,
            parent,
            below,
            motions[kind],
            placed @ pose(None, anchor),
            torch.tensor(model.jnt_axis[joint].tolist(), dtype=torch.float64),
            zero=float(model.qpos0[int(model.jnt_qposadr[joint])]),
            child_pose=pose(None, -anchor),
            position=_interval(model.jnt_range[joint]) if limited else None,
            torque=_torque_limit(self.mujoco, model, joint),
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            stiffness=float(model.jnt_stiffness[joint]),
            rest=float(model.qpos_spring[int(model.jnt_qposadr[joint])]),
            mimic=followed.get(joint),
        )


def given_pose(model: Any, kind: str, index: int) -> Tensor:
    """(4, 4) pose of a body, site or geom in the frame that the model gives it in."""
    turn, place = getattr(model, f"{kind}_quat")[index], getattr(model, f"{kind}_pos")[index]
    return pose(quaternion(turn), place.tolist())


def _inertial(model: Any, body: int) -> Tensor | None:
    """(10,) parameters in the body frame, or None for a body without mass."""
    mass = torch.tensor(model.body_mass[body], dtype=torch.float64)
    if mass == 0:
        return None
    xx, yy, zz = model.body_inertia[body].tolist()
    principal = torch.tensor([xx, 0.0, 0.0, yy, 0.0, zz], dtype=torch.float64)
    own = InertialParameters.from_com(mass, torch.zeros(3, dtype=torch.float64), principal)
    return move(own.pi, pose(quaternion(model.body_iquat[body]), model.body_ipos[body].tolist()))


def _interval(values: Iterable[float]) -> Interval:
    low, high = sorted(float(v) for v in values)
    return low, high


def _torque_limit(mujoco: Any, model: Any, joint: int) -> Interval | None:
    """The joint's own range, or that of the only actuator on it; None where neither is known."""
    if model.jnt_actfrclimited[joint]:
        return _interval(model.jnt_actfrcrange[joint])
    on_joint = [
        a
        for a in range(model.nu)
        if int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        and int(model.actuator_trnid[a, 0]) == joint
    ]
    if len(on_joint) != 1 or not model.actuator_forcelimited[on_joint[0]]:
        return None
    return _interval(model.actuator_forcerange[on_joint[0]] * model.actuator_gear[on_joint[0], 0])


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
    import mujoco  # the robot was read with it

    model = compiled(mujoco, path).model
    kinds, found = mujoco.mjtTrn, dict[int, list[dict[str, float]]]()
    for a in range(model.nu):
        joint, gear = int(model.actuator_trnid[a, 0]), float(model.actuator_gear[a, 0])
        if int(model.actuator_trntype[a]) == int(kinds.mjTRN_TENDON):
            first, count = int(model.tendon_adr[joint]), int(model.tendon_num[joint])
            if count != 1 or int(model.wrap_type[first]) != int(mujoco.mjtWrap.mjWRAP_JOINT):
                continue
            joint, gear = int(model.wrap_objid[first]), gear * float(model.wrap_prm[first])
        elif int(model.actuator_trntype[a]) != int(kinds.mjTRN_JOINT):
            continue
        found.setdefault(joint, []).append(_servo(mujoco, model, a, joint, gear))
    ids = [mujoco.mj_name2id(model, int(mujoco.mjtObj.mjOBJ_JOINT), name) for name in joints]
    return [found[k][0] if len(found.get(k, ())) == 1 else {} for k in ids]


def _servo(mujoco: Any, model: Any, actuator: int, joint: int, gear: float) -> dict[str, float]:
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
        limits.append(abs(model.actuator_forcerange[actuator]).max() * abs(gear))
    if model.jnt_actfrclimited[joint]:
        limits.append(abs(model.jnt_actfrcrange[joint]).max())
    if limits:
        values["clip"] = min(limits)
    if int(model.actuator_dyntype[actuator]) != int(mujoco.mjtDyn.mjDYN_NONE):
        values["lag"] = model.actuator_dynprm[actuator, 0]
    return {name: float(value) for name, value in values.items()}


def _any(table: Any, row: int) -> bool:
    """Whether a row of a table has an entry that is not zero; newer MuJoCo has more tables."""
    return len(table) > row and bool(table[row].any())
