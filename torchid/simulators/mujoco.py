"""Every effect of a robot in MuJoCo: what its file has no field for is added as it runs.

    robot = torchid.load_robot("arm_effects.xml")        # with the sidecar that lies beside it
    model = mujoco.MjModel.from_xml_path("arm_effects.xml")
    data = mujoco.MjData(model)
    effects = Effects(robot, [(model, data)])
    effects.step(torque)                                 # in the place of mj_step

At every step the joints' loads are taken apart as torchid's own simulation takes them (`Loads`): a
smooth torque with its slope over the speed, and dry friction. The slope becomes the joint's
`damping` and the dry friction its `frictionloss`, so that MuJoCo's own integrator and solver meet
both implicitly, however stiff they are; the rest is applied. States of bristles, of temperature and
the like are kept here. Several models, one a simulation, are stepped together, with one evaluation
of the effects for all of them.
"""

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import torch

from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import MissingExtraError, TorchidError
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import plant_of
from torchid.simulation.loads import Loads, changes_measurement
from torchid.simulation.open_loop import runs, true_torque
from torchid.typing import Float, Tensor

SHARP = (0.999, 0.999, 0.001)
"""solimpfriction of every joint: by MuJoCo's own a light joint has its friction only at speeds that
it hardly reaches."""


class Effects:
    """The effects of a robot, attached to simulations of its file.

    Attributes:
        ignored: names of effects that nothing is done about: those in sensors that are no affine
            map of the torque (delays, lags, play), and those of the bodies and poses of the arm,
            which belong into the file.
        across: (n, n) torque of the effects per acceleration of other joints, which no field of a
            joint holds [kg m^2].

    Args:
        robot: as read from the file with its sidecar: its bodies are the file's.
        simulations: (MjModel, MjData) of each; every one needs a model of its own, whose damping,
            friction and springs are overwritten.

    Raises:
        MissingExtraError: MuJoCo is not installed.
        TorchidError: a model without one of the robot's joints, or one model twice.
    """

    def __init__(self, robot: Robot, simulations: Sequence[tuple[Any, Any]]):
        try:
            self._mujoco = import_module("mujoco")
        except ImportError as error:
            raise MissingExtraError("mujoco", "mjcf", "Running effects in MuJoCo") from error
        if len({id(model) for model, _ in simulations}) < len(simulations):
            raise TorchidError(
                "simulations share a model, and each changes its friction at every step.",
                hint="copy.copy(model) for each of them",
            )
        self.simulations = tuple(simulations)
        self._rows, self._places = self._joints(robot)
        pairs = nominal_effects(robot)
        self.ignored = tuple(dict.fromkeys(e.name for e, v in pairs if not runs(robot, e, v)))
        pairs = [(e, v) for e, v in pairs if e.name not in self.ignored]
        zero = torch.zeros(len(simulations), robot.n, dtype=torch.float64)
        # True torque of a command in the units in which torque was logged: gains undone.
        sensed = [pair for pair in pairs if changes_measurement(pair[0])]
        self._gain, self._offset = true_torque(robot, sensed)
        own = [pair for pair in pairs if not changes_measurement(pair[0])]
        bare = replace(robot, effects=())
        self._plant = plant_of(bare, [own] * len(simulations), zero)
        self.restart()
        # Rotors are armature; what couples joints' accelerations has no field and is applied.
        inertia = self._plant.effects.inertia[0]
        self.across = inertia - torch.diag(inertia.diagonal())
        for model, _ in self.simulations:
            model.jnt_stiffness[[int(model.dof_jntid[row]) for row in self._rows]] = 0.0
            model.dof_armature[self._rows] = inertia.diagonal().numpy()
            model.dof_solimp[self._rows, :3] = SHARP

    def place(self, simulation: int, q: Float[Tensor, " n"], dq: Float[Tensor, " n"]) -> None:
        """Set the joints of one simulation [rad, rad/s; m, m/s]; `restart` after the last one."""
        _, data = self.simulations[simulation]
        data.qpos[self._places], data.qvel[self._rows] = q.numpy(), dq.numpy()

    def restart(self) -> None:
        """States of the effects as at the beginning: after the simulations were set elsewhere."""
        now = self.motion()
        t = now.require("t", "a start")
        self._memory = self._plant.start(*now.state, t=t).memory

    def _joints(self, robot: Robot) -> tuple[list[int], list[int]]:
        """Where the robot's joints are among velocities and positions."""
        model, kind = self.simulations[0][0], int(self._mujoco.mjtObj.mjOBJ_JOINT)
        ids = [int(self._mujoco.mj_name2id(model, kind, name)) for name in robot.joint_names]
        missing = [n for n, k in zip(robot.joint_names, ids, strict=True) if k < 0]
        if missing:
            raise TorchidError(
                "the model has not all of the robot's joints.",
                got=", ".join(missing),
                available=[model.joint(k).name for k in range(model.njnt)],
            )
        return [int(model.jnt_dofadr[k]) for k in ids], [int(model.jnt_qposadr[k]) for k in ids]

    def motion(self) -> Motion:
        """Where the simulations are: q, dq and the last ddq (B, n), t (B,)."""
        datas = [data for _, data in self.simulations]
        q = torch.from_numpy(np.stack([data.qpos[self._places] for data in datas]))
        dq = torch.from_numpy(np.stack([data.qvel[self._rows] for data in datas]))
        ddq = torch.from_numpy(np.stack([data.qacc[self._rows] for data in datas]))
        return Motion(q, dq, ddq, t=torch.tensor([data.time for data in datas]).double())

    @torch.no_grad()
    def loads(self, motion: Motion, dt: float = 0.0) -> Loads:
        """Torque of the effects that resists a motion, apart from rotors, which are `armature`.

        Args:
            motion: q, dq, ddq (B, n) and t (B,). What is transmitted, which friction may grow with,
                is the arm's torque at this acceleration.
            dt: time since the states of the memory [s].
        """
        at = motion._replace(ddq=torch.zeros_like(motion.ddq))
        if self._plant.effects.needs_torque:
            posture = self._plant.arms.at(motion.q)
            mass = posture.mass_matrix() + self._plant.effects.inertia
            moved = (mass @ motion.ddq.unsqueeze(-1)).squeeze(-1)
            at = at._replace(torque=posture.torque(motion.dq) + moved)
        return self._plant.effects.at(at, dt, self._memory)

    def true_torque(self, torque: Float[Tensor, "B n"]) -> Float[Tensor, "B n"]:
        """What acts on the joints where this would be logged: gains and offsets of the sensors
        undone."""
        return torque @ self._gain.T + self._offset

    @torch.no_grad()
    def step(self, torque: Float[Tensor, "B n"]) -> None:
        """One mj_step of every simulation with these torques (B, n) of the drives [N m; N], in the
        units of the log; `ctrl` and other forces act as they do without effects."""
        now = self.motion()
        h = float(self.simulations[0][0].opt.timestep)
        loads, applied = self.loads(now, h / 2), self.true_torque(torque)
        # A falling friction curve is met explicitly: negative damping has no implicit step.
        slope = loads.slope.clamp(min=0)
        applied = applied - loads.smooth + slope * now.dq - now.ddq @ self.across
        parts = (x.numpy() for x in (slope, loads.dry, applied))
        for (model, data), damping, dry, force in zip(self.simulations, *parts, strict=True):
            model.dof_damping[self._rows] = damping
            model.dof_frictionloss[self._rows] = dry
            data.qfrc_applied[self._rows] = force
            self._mujoco.mj_step(model, data)
        after = self.motion()
        middle = after._replace(dq=(now.dq + after.dq) / 2, t=now.t)
        self._memory = self._plant.effects.advance(middle, h, self._memory)
