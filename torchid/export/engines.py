"""Other programs that read an export: Pinocchio and MuJoCo, where they are installed.

Each is asked for what it knows: Pinocchio for the rigid body, MuJoCo for the rigid body with
armature, damping and springs. Dry friction is a constraint in MuJoCo, whose force depends on more
than the state; so its coefficients are compared, and constraints are turned off.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from msgspec import structs

from torchid.design.columns import Model
from torchid.design.segments import Samples, Segment
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import MissingExtraError, TorchidError
from torchid.export.checks import EXACT, Comparison, compared, missing, relative_difference
from torchid.robot.model import Robot
from torchid.simulation.loads import changes_measurement
from torchid.simulation.open_loop import true_torque
from torchid.simulation.shooting import Windows
from torchid.simulators.joint_dynamics import JointDynamics
from torchid.typing import Float, Joints

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
        engine = InPinocchio(path, robot)
    except MissingExtraError:
        return missing("Pinocchio", what, "not installed")
    except RefusedFileError as error:
        return missing(error.reader, what, f"cannot load the file: {error.got}")
    model, ids = engine.model, engine.ids
    if max(ids) >= model.njoints:
        return missing(engine.name, what, "does not have all of the joints")
    if not bool((robot.require_parameters("an export").mass > 0).all()):
        return missing(engine.name, what, "takes positive masses only")
    # No masses off the chain.
    aside = []
    for k in [k for k in range(1, model.njoints) if k not in ids]:
        if model.inertias[k].mass > 0 and model.parents[k] in ids:
            aside.append(f"what joint '{model.names[k]}' moves, off the chain")
        model.inertias[k] = engine.pin.Inertia.Zero()
    wrong = _wrong(joints, {name: engine.attribute(name) for name in names})
    model.armature = np.zeros(model.nv)
    expected = inverse_dynamics(robot, *motion.state)
    found = compared(engine.name, what, motion, expected, engine.rigid(motion))
    found = _with_note(found, wrong, aside)
    if mjcf and found.ok is False:
        return missing(engine.name, what, "reads the file otherwise than MuJoCo does")
    return found


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
        engine = LoadedInMujoco(path, robot)
    except RefusedFileError as error:
        return missing(error.reader, what, f"cannot load the file: {error.got}")
    note = _bare(engine.mujoco, engine.model, robot)
    loss = engine.model.dof_frictionloss
    wrong = _wrong(joints, {"friction": [loss[row] for row in engine.rows]})
    loss[:] = 0.0
    # What is expected: the rigid body with the attributes that MuJoCo knows, without dry friction.
    damping, quadratic, cubic, _, armature, stiffness, offset = torch.tensor(
        [astuple(joint) for joint in joints], dtype=torch.float64
    ).T
    speed = motion.dq.abs()
    resisting = (damping + quadratic * speed + cubic * speed**2) * motion.dq
    expected = inverse_dynamics(robot, *motion.state) + resisting + armature * motion.ddq
    expected = expected + stiffness * motion.q + offset
    return _with_note(
        compared(engine.name, what, motion, expected, engine.inverse(motion)), wrong, note
    )


def mujoco_model(mujoco: Any, path: Path) -> Any:
    """The compiled model of an MJCF or URDF. Of a URDF the shapes are left out, since MuJoCo looks
    for their meshes itself, and of an MJCF its meshes where one is missing."""
    urdf = path.suffix.lower() == ".urdf"
    with suppress(ValueError):
        if not urdf:
            return mujoco.MjModel.from_xml_path(str(path))
    spec = mujoco.MjSpec.from_file(str(path))
    for geom in [g for g in spec.geoms if urdf or g.type == mujoco.mjtGeom.mjGEOM_MESH]:
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec.compile()


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
        return structs.replace(found, difference=float("inf"), note=wrong)
    return structs.replace(found, note=f"left aside: {', '.join(aside)}" if aside else "")


class RefusedFileError(TorchidError):
    """An engine does not load a file.

    Attributes:
        reader: the engine, with its version.
    """

    def __init__(self, reader: str, robot: Robot, error: BaseException):
        self.reader = reader
        super().__init__(
            f"{reader} cannot load the corrected file of '{robot.name}', so it cannot be judged.",
            got=" ".join(str(error).split())[:300],
        )


def engine_of(path: Path, robot: Robot) -> "InMujoco | InPinocchio":
    """The engine of a file: MuJoCo of an MJCF, Pinocchio of a URDF, or MuJoCo without it."""
    if path.suffix.lower() == ".urdf":
        try:
            return InPinocchio(path, robot)
        except MissingExtraError:
            pass
    return InMujoco(path, robot)


@dataclass(frozen=True, eq=False)
class AtRunTime:
    """What the log would read of a simulation with effects: its torque, and the sensors' own
    effects on all of that.

    Attributes:
        model: without effects in the torque sensors.
        gain, offset: (n, n), (n,) of the true torque for a measured one.
    """

    model: Model
    gain: Float[torch.Tensor, "n n"]
    offset: Float[torch.Tensor, " n"]

    @staticmethod
    def of(robot: Robot) -> "AtRunTime":
        """That of a robot with all its effects."""
        pairs = nominal_effects(robot)
        sensed = [pair for pair in pairs if changes_measurement(pair[0])]
        others = tuple(pair for pair in pairs if pair not in sensed)
        gain, offset = true_torque(robot, sensed)
        return AtRunTime(Model(robot, others), gain, offset)

    def torque(self, segment: Segment, samples: Samples) -> Float[torch.Tensor, "T n"]:
        """Torque (T, n) [N m; N] along a segment."""
        true = self.model.torque(segment, samples) - self.offset
        return torch.linalg.solve(self.gain, true.T).T


class LoadedInMujoco:
    """A file in MuJoCo, parts of the engine turned off.

    Args:
        path: MJCF, or URDF.
        robot: whose joints are meant.
        off: of mujoco.mjtDisableBit, without its prefix.

    Raises:
        TorchidError: MuJoCo refuses the file, for a body off the chain for instance.
    """

    def __init__(self, path: Path, robot: Robot, *off: str):
        self.mujoco = import_module("mujoco")
        self.name = f"MuJoCo {self.mujoco.__version__}"
        try:
            self.model = mujoco_model(self.mujoco, path)
        except (ValueError, RuntimeError, self.mujoco.FatalError) as error:
            raise RefusedFileError(self.name, robot, error) from error
        if path.suffix.lower() == ".urdf":
            self.model.opt.gravity[:] = robot.gravity.numpy()
        for name in off:
            self.model.opt.disableflags |= int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        self.rows, self.places = mujoco_places(self.mujoco, self.model, robot)

    def inverse(self, motion: Motion) -> Joints:
        """mj_inverse at states (T, n)."""
        data, out = self.mujoco.MjData(self.model), np.zeros(tuple(motion.q.shape))
        for k, (q, dq, ddq) in enumerate(zip(*(x.numpy() for x in motion.state), strict=True)):
            data.qpos[self.places], data.qvel[self.rows], data.qacc[self.rows] = q, dq, ddq
            self.mujoco.mj_inverse(self.model, data)
            out[k] = data.qfrc_inverse[self.rows]
        return torch.from_numpy(out)

    def fit_step(self, dt: float) -> int:
        """Make the file's step fit samples that are dt [s] apart; returns how many it takes."""
        steps = max(1, math.ceil(dt / self.model.opt.timestep - 1e-9))
        self.model.opt.timestep = dt / steps
        return steps


class InMujoco(LoadedInMujoco):
    """A file in MuJoCo: MJCF or URDF.

    Args:
        path: the file.
        robot: whose joints are meant.

    Raises:
        TorchidError: as LoadedInMujoco.
    """

    def __init__(self, path: Path, robot: Robot):
        super().__init__(path, robot, "CONTACT", "LIMIT", "ACTUATION")

    def torque(self, segment: Segment, samples: Samples) -> Float[torch.Tensor, "T n"]:
        """mj_inverse along a segment."""
        return self.inverse(segment.motion)

    def positions(self, windows: Windows) -> Float[torch.Tensor, "B T n"]:
        """Where the joints are at the samples [rad; m], from the measured states with the measured
        torque, by the file's own integrator; nan from where the engine gives up."""
        mujoco, model, data = self.mujoco, self.model, self.mujoco.MjData(self.model)
        steps = self.fit_step(windows.dt)
        out = np.full(windows.q.shape, np.nan)
        for b in range(len(out)):
            mujoco.mj_resetData(model, data)
            q, tau = windows.q[b].numpy(), windows.tau[b].numpy()
            data.qpos[self.places], data.qvel[self.rows] = q[0], windows.dq[b, 0].numpy()
            out[b, 0] = q[0]
            for k in range(int(windows.steps[b].clamp(max=len(q) - 1))):
                with without_warnings(mujoco):
                    for i in range(steps):
                        share = (i + 0.5) / steps
                        data.qfrc_applied[self.rows] = (1 - share) * tau[k] + share * tau[k + 1]
                        mujoco.mj_step(model, data)
                if data.warning.number.any():  # MuJoCo resets an arm that has run away
                    break
                out[b, k + 1] = data.qpos[self.places]
        return torch.from_numpy(out)


@contextmanager
def without_warnings(mujoco: Any) -> Iterator[None]:
    """An arm that runs away is part of the answer: MuJoCo neither prints it nor writes a file of
    it."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class InPinocchio:
    """A URDF, or what it reads of an MJCF, in Pinocchio: rnea with the damping and friction that it
    read.

    Args:
        path: URDF or MJCF.
        robot: whose joints are meant.

    Raises:
        MissingExtraError: Pinocchio is not installed.
        TorchidError: it refuses the file.
    """

    def __init__(self, path: Path, robot: Robot):
        try:
            self.pin = import_module("pinocchio")
        except ImportError as error:
            purpose = f"Checking a file of '{robot.name}' on the log"
            raise MissingExtraError("pinocchio", "bench", purpose) from error
        self.name = f"Pinocchio {self.pin.__version__}"
        mjcf = path.suffix.lower() == ".xml"
        try:
            build = self.pin.buildModelFromMJCF if mjcf else self.pin.buildModelFromUrdf
            self.model = build(str(path))
        except Exception as error:  # its own exception types differ between versions
            raise RefusedFileError(self.name, robot, error) from error
        self.model.gravity.linear = robot.gravity.numpy()
        self.ids = [int(self.model.getJointId(name)) for name in robot.joint_names]

    def attribute(self, name: str) -> list[float]:
        """(n,) damping, armature or friction of the joints, as it read them."""
        older = name == "friction" and not hasattr(self.model, name)
        values = self.model.upperDryFrictionLimit if older else getattr(self.model, name)
        return [float(values[self.model.joints[k].idx_v]) for k in self.ids]

    def rigid(self, motion: Motion) -> Joints:
        """Torque (T, n) of rnea on these joints; the others stay where they are."""
        model = self.model
        data, neutral = model.createData(), self.pin.neutral(model)
        out = []
        for q, dq, ddq in zip(*(x.numpy() for x in motion.state), strict=True):
            position, rates, accelerations = neutral.copy(), np.zeros(model.nv), np.zeros(model.nv)
            for k, i in enumerate(self.ids):
                joint = model.joints[i]
                # A continuous joint has the cosine and sine of its angle.
                own = [q[k]] if joint.nq == 1 else [np.cos(q[k]), np.sin(q[k])]
                position[joint.idx_q : joint.idx_q + joint.nq] = own
                rates[joint.idx_v], accelerations[joint.idx_v] = dq[k], ddq[k]
            tau = self.pin.rnea(model, data, position, rates, accelerations)
            out.append([float(tau[model.joints[i].idx_v]) for i in self.ids])
        return torch.tensor(out, dtype=torch.float64)

    def torque(self, segment: Segment, samples: Samples) -> Float[torch.Tensor, "T n"]:
        """rnea along a segment, and friction by its equations."""
        motion = segment.motion
        damping, friction = torch.tensor(
            [self.attribute(name) for name in ("damping", "friction")], dtype=torch.float64
        )
        return self.rigid(motion) + damping * motion.dq + friction * motion.sign
