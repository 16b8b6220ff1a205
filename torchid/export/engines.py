"""Other programs that read an export: Pinocchio and MuJoCo, where they are installed.

Each is asked for what it knows: Pinocchio for the rigid body, MuJoCo for the rigid body with
armature, damping and springs. Dry friction is a constraint in MuJoCo, whose force depends on more
than the state; so its coefficients are compared, and constraints are turned off.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lxml import etree

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.export.checks import EXACT, Comparison, compared, missing, relative_difference
from torchid.export.xml_tree import local, read_xml
from torchid.robot.model import Robot
from torchid.simulators.joint_dynamics import JointDynamics
from torchid.typing import Joints

_RIGID = "rigid body"
Array = np.ndarray[Any, np.dtype[np.float64]]


def check_pinocchio(
    path: Path, robot: Robot, joints: Sequence[JointDynamics], motion: Motion
) -> Comparison:
    """Pinocchio's rnea, and the joint attributes that it read.

    Of MJCF it reads a part only, so there it can confirm a file and not refute it.

    Args:
        path: a URDF or MJCF.
        robot: as written.
        joints: attributes as written.
        motion: states.
    """
    mjcf = path.suffix.lower() == ".xml"
    names = ("damping", "armature") if mjcf else ("damping", "friction")
    what = f"{_RIGID}; {', '.join(names)}"
    try:
        pin = import_module("pinocchio")
    except ImportError:
        return missing("Pinocchio", what, "not installed")
    reader = f"Pinocchio {pin.__version__}"
    try:
        build = pin.buildModelFromMJCF if mjcf else pin.buildModelFromUrdf
        model = build(str(path))
    except Exception as error:  # its own exception types differ between versions
        return missing(reader, what, f"cannot load the file: {_line(error)}")
    ids = [int(model.getJointId(name)) for name in robot.joint_names]
    if max(ids) >= model.njoints:
        return missing(reader, what, "does not have all of the joints")
    if not bool((robot.require_parameters("an export").mass > 0).all()):
        return missing(reader, what, "takes positive masses only")
    # Gravity as the robot's, and no masses off the chain.
    model.gravity.linear = robot.gravity.numpy()
    aside = []
    for k in [k for k in range(1, model.njoints) if k not in ids]:
        if model.inertias[k].mass > 0 and model.parents[k] in ids:
            aside.append(f"what joint '{model.names[k]}' moves, off the chain")
        model.inertias[k] = pin.Inertia.Zero()
    dry = model.friction if hasattr(model, "friction") else model.upperDryFrictionLimit
    read = {"damping": model.damping, "armature": model.armature, "friction": dry}
    rows = [model.joints[k].idx_v for k in ids]
    wrong = _wrong(joints, {name: [read[name][row] for row in rows] for name in names})
    model.armature = np.zeros(model.nv)
    torque = pinocchio_torque(pin, model, ids, motion)
    found = compared(reader, what, motion, inverse_dynamics(robot, *motion.state), torque)
    found = _with_note(found, wrong, aside)
    if mjcf and not found.ok:
        return missing(reader, what, "reads the file otherwise than MuJoCo does")
    return found


def pinocchio_torque(pin: Any, model: Any, ids: Sequence[int], motion: Motion) -> Joints:
    """Torque (M, n) of Pinocchio's rnea on these joints; the others stay where they are."""
    data, neutral = model.createData(), pin.neutral(model)
    out = []
    for q, dq, ddq in zip(*(x.numpy() for x in motion.state), strict=True):
        position, rates, accelerations = neutral.copy(), np.zeros(model.nv), np.zeros(model.nv)
        for k, i in enumerate(ids):
            joint = model.joints[i]
            # A continuous joint has the cosine and sine of its angle.
            own = [q[k]] if joint.nq == 1 else [np.cos(q[k]), np.sin(q[k])]
            position[joint.idx_q : joint.idx_q + joint.nq] = own
            rates[joint.idx_v], accelerations[joint.idx_v] = dq[k], ddq[k]
        tau = pin.rnea(model, data, position, rates, accelerations)
        out.append([float(tau[model.joints[i].idx_v]) for i in ids])
    return torch.tensor(out, dtype=torch.float64)


def check_mujoco(
    path: Path, robot: Robot, joints: Sequence[JointDynamics], motion: Motion
) -> Comparison:
    """MuJoCo's mj_inverse on an MJCF or URDF, and the friction loss that it read.

    Args:
        path: the file. Of a URDF the shapes are left out: MuJoCo looks for their meshes itself.
        robot: as written.
        joints: attributes as written.
        motion: states.
    """
    what = f"{_RIGID}, armature, damping, spring; friction"
    try:
        mujoco = import_module("mujoco")
    except ImportError:
        return missing("MuJoCo", what, "not installed")
    reader = f"MuJoCo {mujoco.__version__}"
    urdf = path.suffix.lower() == ".urdf"
    try:
        model = mujoco_model(mujoco, path)
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        return missing(reader, what, f"cannot load the file: {_line(error)}")
    note = _bare(mujoco, model, robot)
    if urdf:
        model.opt.gravity[:] = robot.gravity.numpy()
    rows, places = mujoco_places(mujoco, model, robot)
    wrong = _wrong(joints, {"friction": [model.dof_frictionloss[row] for row in rows]})
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    torque = []
    for q, dq, ddq in zip(*(x.numpy() for x in motion.state), strict=True):
        data.qpos[places], data.qvel[rows], data.qacc[rows] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        torque.append(data.qfrc_inverse[rows].copy())
    # What is expected: the rigid body with the attributes that MuJoCo knows, without dry friction.
    damping, armature, stiffness, offset = torch.tensor(
        [[j.damping, j.armature, j.stiffness, j.offset] for j in joints], dtype=torch.float64
    ).T
    expected = inverse_dynamics(robot, *motion.state) + damping * motion.dq + armature * motion.ddq
    expected = expected + stiffness * motion.q + offset
    found = compared(reader, what, motion, expected, torch.from_numpy(np.stack(torque)))
    return _with_note(found, wrong, note)


def mujoco_model(mujoco: Any, path: Path) -> Any:
    """The compiled model of an MJCF or URDF. Of a URDF the shapes are left out: MuJoCo looks for
    their meshes itself."""
    if path.suffix.lower() != ".urdf":
        return mujoco.MjModel.from_xml_path(str(path))
    root = read_xml(path).root
    for node in [n for n in root.iter() if local(n) in ("visual", "collision")]:
        node.getparent().remove(node)
    return mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode"))


def mujoco_places(mujoco: Any, model: Any, robot: Robot) -> tuple[list[int], list[int]]:
    """Where the robot's joints are among the model's velocities, and among its positions."""
    ids = []
    for name in robot.joint_names:
        k = int(mujoco.mj_name2id(model, int(mujoco.mjtObj.mjOBJ_JOINT), name))
        # By its number where the file gives no name (joint_3).
        ids.append(k if k >= 0 else int(name.rstrip("_").rpartition("_")[2]))
    return [int(model.jnt_dofadr[k]) for k in ids], [int(model.jnt_qposadr[k]) for k in ids]


def _bare(mujoco: Any, model: Any, robot: Robot) -> list[str]:
    """Turn off what a Robot does not have: constraints, other masses, gravcomp, fluid, tendons."""
    flags = mujoco.mjtDisableBit
    model.opt.disableflags = int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_CONTACT)
    if not bool(robot.gravity.any()):
        model.opt.gravity[:] = 0.0
    said = []
    names = {b: model.body(b).name or f"body_{b}" for b in range(model.nbody)}
    others = [b for b in range(1, model.nbody) if names[b] not in robot.link_names]
    moved = {int(b) for b in model.jnt_bodyid}
    for b in others:
        if b in moved and model.body_mass[b] > 0:
            # Said where a moving link carries it; whatever else moves it is off the chain, too.
            carrier = int(model.body_parentid[b])
            while carrier > 0 and carrier not in moved:
                carrier = int(model.body_parentid[carrier])
            said += [f"body '{names[b]}' off the chain"] * (names[carrier] in robot.link_names)
        model.body_mass[b], model.body_inertia[b] = 0.0, 0.0
    if model.body_gravcomp.any():
        said.append("gravcomp")
        model.body_gravcomp[:] = 0.0
    if model.opt.density or model.opt.viscosity:
        said.append("fluid")
        model.opt.density = model.opt.viscosity = 0.0
    if model.ntendon and (model.tendon_stiffness.any() or model.tendon_damping.any()):
        said.append("tendons")
        model.tendon_stiffness[:] = model.tendon_damping[:] = 0.0
    return said


def _wrong(joints: Sequence[JointDynamics], read: Mapping[str, Sequence[float]]) -> str:
    """A sentence on the first attribute that was read otherwise than written; empty if none."""
    for name, values in read.items():
        written = [getattr(joint, name) for joint in joints]
        found, expected = torch.tensor([[float(v) for v in values], written], dtype=torch.float64)
        if relative_difference(found.unsqueeze(0), expected.unsqueeze(0)) > EXACT:
            return f"{name} read as {found.tolist()}, written as {written}"
    return ""


def _with_note(found: Comparison, wrong: str, aside: Sequence[str]) -> Comparison:
    """The comparison with what went wrong, which fails it, or what was left aside."""
    if wrong:
        return replace(found, difference=float("inf"), note=wrong)
    return replace(found, note=f"left aside: {', '.join(aside)}" if aside else "")


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300]
