"""Independent rigid-body dynamics of a torchid Robot: Pinocchio's and MuJoCo's.

Both models are built from the Robot object. A Pinocchio joint's frame is our moved joint frame: the
joint's placement is after_{i-1} before_i, its axis z, and the link's inertia sits at after_i.
MuJoCo's bodies have our link frames, joints an axis and an anchor in them.
"""

from functools import cached_property

import numpy as np
import pytest
import torch
from torch import Tensor

from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.model import JointType, Robot


class PinocchioOracle:
    """Pinocchio's algorithms, sample by sample. Joint frames: see the module."""

    def __init__(self, robot: Robot):
        self.pin = pytest.importorskip("pinocchio")
        self.robot = robot
        self.model = self.pin.Model()
        self.model.gravity.linear = robot.gravity.numpy()
        assert robot.parameters is not None
        before, after = robot.before.numpy(), robot.after.numpy()
        pi = robot.parameters.to_pinocchio_order().numpy()
        parent, link = 0, np.eye(4)
        for i, kind in enumerate(robot.joint_types):
            joint = (
                self.pin.JointModelRZ() if kind is JointType.REVOLUTE else self.pin.JointModelPZ()
            )
            parent = self.model.addJoint(
                parent, joint, self.pin.SE3(link @ before[i]), robot.joint_names[i]
            )
            body = self.pin.Inertia.FromDynamicParameters(pi[i])
            self.model.appendBodyToJoint(parent, body, self.pin.SE3(after[i]))
            link = after[i]
        self.data = self.model.createData()

    def inverse_dynamics(self, q: Tensor, dq: Tensor, ddq: Tensor) -> Tensor:
        return self._each(lambda *x: self.pin.rnea(self.model, self.data, *x), q, dq, ddq)

    def wrenches(self, q: Tensor, dq: Tensor, ddq: Tensor) -> Tensor:
        """data.f (..., n, 6): force, moment about the moved joint frame's origin, in its axes."""

        def one(*x: np.ndarray) -> np.ndarray:
            self.pin.rnea(self.model, self.data, *x)
            return np.stack([f.vector for f in list(self.data.f)[1:]])

        return self._each(one, q, dq, ddq)

    def tool_jacobian(self, q: Tensor) -> Tensor:
        """(..., 6, n): linear first, of the tool's origin, in axes of the base."""
        pin, world = self.pin, self.pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        at_tool = pin.SE3((self.robot.after[-1] @ self.robot.tool).numpy())
        tool = self.model.addFrame(
            pin.Frame("tool", self.robot.n, 0, at_tool, pin.FrameType.OP_FRAME)
        )
        data = self.model.createData()
        return self._each(lambda x: pin.computeFrameJacobian(self.model, data, x, tool, world), q)

    def mass_matrix(self, q: Tensor) -> Tensor:
        def one(x: np.ndarray) -> np.ndarray:
            upper = np.triu(self.pin.crba(self.model, self.data, x))
            return upper + np.triu(upper, 1).T

        return self._each(one, q)

    def gravity_torque(self, q: Tensor) -> Tensor:
        return self._each(lambda x: self.pin.computeGeneralizedGravity(self.model, self.data, x), q)

    def forward_dynamics(self, q: Tensor, dq: Tensor, tau: Tensor) -> Tensor:
        return self._each(lambda *x: self.pin.aba(self.model, self.data, *x), q, dq, tau)

    def coriolis_matrix(self, q: Tensor, dq: Tensor) -> Tensor:
        return self._each(
            lambda *x: self.pin.computeCoriolisMatrix(self.model, self.data, *x), q, dq
        )

    def _each(self, function, *signals: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
        flat = [np.ascontiguousarray(x.reshape(-1, self.robot.n).numpy()) for x in signals]
        # Pinocchio returns views of its data: copied before the next call.
        out = np.stack([np.array(function(*row)) for row in zip(*flat, strict=True)])
        return torch.from_numpy(out.reshape(*signals[0].shape[:-1], *out.shape[1:]))


class MujocoOracle:
    """MuJoCo's inverse and forward dynamics, sample by sample."""

    def __init__(self, robot: Robot):
        self.robot = robot
        self.mujoco = pytest.importorskip("mujoco")

    @cached_property
    def model(self):  # type: ignore[no-untyped-def]
        model = self.mujoco.MjModel.from_xml_string(mjcf(self.robot))
        # MuJoCo's compiler refuses inertias that no body has; its dynamics does not mind, and the
        # published parameters of the LWR are such.
        assert self.robot.parameters is not None
        for i in range(self.robot.n):
            values, _ = _principal(self.robot.parameters, i)
            model.body_inertia[i + 1] = values.numpy()
        return model

    @cached_property
    def data(self):  # type: ignore[no-untyped-def]
        return self.mujoco.MjData(self.model)

    def inverse_dynamics(self, q: Tensor, dq: Tensor, ddq: Tensor) -> Tensor:
        out = []
        for row in zip(q.numpy(), dq.numpy(), ddq.numpy(), strict=True):
            self.data.qpos[:], self.data.qvel[:], self.data.qacc[:] = row
            self.mujoco.mj_inverse(self.model, self.data)
            out.append(self.data.qfrc_inverse.copy())
        return torch.from_numpy(np.stack(out))

    def forward_dynamics(self, q: Tensor, dq: Tensor, tau: Tensor) -> Tensor:
        out = []
        for row in zip(q.numpy(), dq.numpy(), tau.numpy(), strict=True):
            self.data.qpos[:], self.data.qvel[:], self.data.qfrc_applied[:] = row
            self.mujoco.mj_forward(self.model, self.data)
            out.append(self.data.qacc.copy())
        return torch.from_numpy(np.stack(out))


def mjcf(robot: Robot) -> str:
    """The robot as MJCF, numbers with all digits; moments of inertia are put in after compiling.
    At q = 0, body i is at before_i after_i."""
    assert robot.parameters is not None
    opening, closing = "", ""
    for i, kind in enumerate(robot.joint_types):
        rest = robot.before[i] @ robot.after[i]
        axis = robot.after[i][2, :3]
        # The joint frame's origin in the link frame at q = 0.
        anchor = -robot.after[i][:3, :3].T @ robot.after[i][:3, 3]
        name = "hinge" if kind is JointType.REVOLUTE else "slide"
        opening += (
            f'<body pos="{_text(rest[:3, 3])}" quat="{_text(_quaternion(rest[:3, :3]))}">'
            f'<joint type="{name}" axis="{_text(axis)}" pos="{_text(anchor)}"/>'
            f"{_inertial(robot.parameters, i)}"
        )
        closing += "</body>"
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<option gravity="{_text(robot.gravity)}"><flag contact="disable" constraint="disable"/>'
        f"</option><worldbody>{opening}{closing}</worldbody></mujoco>"
    )


def _inertial(parameters: InertialParameters, i: int) -> str:
    _, axes = _principal(parameters, i)
    return (
        f'<inertial mass="{float(parameters.mass[i])!r}" pos="{_text(parameters.com[i])}" '
        f'quat="{_text(_quaternion(axes))}" diaginertia="1 1 1"/>'
    )


def _principal(parameters: InertialParameters, i: int) -> tuple[Tensor, Tensor]:
    """Principal moments (3,) of a link about its centre of mass, and their axes (3, 3)."""
    values, axes = torch.linalg.eigh(symmetric(parameters.inertia_about_com[i]))
    axes[:, 2] *= torch.linalg.det(axes)
    return values, axes


def _quaternion(rotation: Tensor) -> Tensor:
    """(w, x, y, z) of a rotation: the dominant eigenvector of the symmetric 4 x 4 form."""
    r = rotation
    w = torch.stack([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    form = torch.zeros(4, 4, dtype=r.dtype)
    trace = r.trace()
    form[0, 0] = trace
    form[0, 1:], form[1:, 0] = w, w
    form[1:, 1:] = r + r.T - trace * torch.eye(3, dtype=r.dtype)
    return torch.linalg.eigh(form).eigenvectors[:, -1]


def _text(values: Tensor) -> str:
    return " ".join(repr(v) for v in values.tolist())
