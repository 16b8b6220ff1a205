"""A file in the engine that will run it, on the motion of a log: the torque that the motion takes,
and where the arm goes when it is given the measured one.

Contacts, joint limits and actuators are turned off: a log of an arm in free motion asks nothing of
them. All else is as the file has it, dry friction as the engine's own constraint too.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.design.columns import Model
from torchid.design.segments import Samples, Segment
from torchid.effects.registry import nominal_effects
from torchid.errors import MissingExtraError, TorchidError
from torchid.export.engines import mujoco_model, mujoco_places, pinocchio_torque
from torchid.robot.model import Robot
from torchid.simulation.loads import changes_measurement
from torchid.simulation.open_loop import true_torque
from torchid.simulation.shooting import Windows
from torchid.typing import Float


def simulator(path: Path, robot: Robot) -> "InMujoco | InPinocchio":
    """The engine of a file: MuJoCo of an MJCF, Pinocchio of a URDF (MuJoCo where it is missing).

    Raises:
        MissingExtraError: it is not installed.
    """
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
        MissingExtraError: MuJoCo is not installed.
        TorchidError: it refuses the file, for a body off the chain for instance.
    """

    def __init__(self, path: Path, robot: Robot, *off: str):
        try:
            self.mujoco = import_module("mujoco")
        except ImportError as error:
            purpose = f"Checking a file of '{robot.name}' on the log"
            raise MissingExtraError("mujoco", "mjcf", purpose) from error
        self.name = f"MuJoCo {self.mujoco.__version__}"
        try:
            self.model = mujoco_model(self.mujoco, path)
        except (ValueError, RuntimeError, self.mujoco.FatalError) as error:
            raise _refused(self.name, robot, error) from error
        if path.suffix.lower() == ".urdf":
            self.model.opt.gravity[:] = robot.gravity.numpy()
        for name in off:
            self.model.opt.disableflags |= int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        self.rows, self.places = mujoco_places(self.mujoco, self.model, robot)

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
        MissingExtraError, TorchidError: as LoadedInMujoco.
    """

    def __init__(self, path: Path, robot: Robot):
        super().__init__(path, robot, "CONTACT", "LIMIT", "ACTUATION")

    def torque(self, segment: Segment, samples: Samples) -> Float[torch.Tensor, "T n"]:
        """mj_inverse along a segment."""
        data, out = self.mujoco.MjData(self.model), np.zeros((segment.length, segment.n))
        for k, (q, dq, ddq) in enumerate(
            zip(*(x.numpy() for x in segment.motion.state), strict=True)
        ):
            data.qpos[self.places], data.qvel[self.rows], data.qacc[self.rows] = q, dq, ddq
            self.mujoco.mj_inverse(self.model, data)
            out[k] = data.qfrc_inverse[self.rows]
        return torch.from_numpy(out)

    def positions(self, windows: Windows) -> Float[torch.Tensor, "B T n"]:
        """Where the joints are at the samples [rad; m], from the measured states with the measured
        torque, by the file's own integrator; nan from where the engine gives up."""
        mujoco, model, data = self.mujoco, self.model, self.mujoco.MjData(self.model)
        steps = self.fit_step(windows.dt)
        out = np.full(windows.q.shape, np.nan)
        for b in range(len(out)):
            mujoco.mj_resetData(model, data)
            q, tau = windows.q[b].numpy(), windows.tau[b].numpy()
            data.qpos[self.places], data.qvel[self.rows] = q[0], windows.dq0[b].numpy()
            out[b, 0] = q[0]
            for k in range(int(windows.steps[b].clamp(max=len(q) - 1))):
                with silent(mujoco):
                    for i in range(steps):
                        share = (i + 0.5) / steps
                        data.qfrc_applied[self.rows] = (1 - share) * tau[k] + share * tau[k + 1]
                        mujoco.mj_step(model, data)
                if data.warning.number.any():  # MuJoCo resets an arm that has run away
                    break
                out[b, k + 1] = data.qpos[self.places]
        return torch.from_numpy(out)


def _refused(reader: str, robot: Robot, error: Exception) -> TorchidError:
    return TorchidError(
        f"{reader} cannot load the corrected file of '{robot.name}', so it cannot be judged.",
        got=" ".join(str(error).split())[:300],
    )


@contextmanager
def silent(mujoco: Any) -> Iterator[None]:
    """An arm that runs away is part of the answer: MuJoCo neither prints it nor writes a file of
    it."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class InPinocchio:
    """A URDF in Pinocchio: rnea with the damping and friction that it read.

    Args:
        path: URDF.
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
        try:
            self.model = self.pin.buildModelFromUrdf(str(path))
        except Exception as error:  # its own exception types differ between versions
            raise _refused(self.name, robot, error) from error
        self.model.gravity.linear = robot.gravity.numpy()
        self.ids = [int(self.model.getJointId(name)) for name in robot.joint_names]
        dry = (
            self.model.friction
            if hasattr(self.model, "friction")
            else self.model.upperDryFrictionLimit
        )
        rows = [self.model.joints[k].idx_v for k in self.ids]
        self.damping, self.dry = (
            torch.tensor([float(x[row]) for row in rows], dtype=torch.float64)
            for x in (self.model.damping, dry)
        )

    def torque(self, segment: Segment, samples: Samples) -> Float[torch.Tensor, "T n"]:
        """rnea along a segment, and friction by its equations."""
        motion = segment.motion
        rigid = pinocchio_torque(self.pin, self.model, self.ids, motion)
        return rigid + self.damping * motion.dq + self.dry * motion.sign
