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

A joint with elasticity or play becomes two masses: MuJoCo's joint is the link, and the motor, whose
inertia was the joint's armature, is a state of the gear (`gears`). What a controller reads, late as
delays and lags make it and on the motor's side of a gear, is `sensed()`.
"""

import ctypes
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import torch

from torchid.effects.backlash import Backlash
from torchid.effects.base import Motion
from torchid.effects.phase import JointElasticity
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import plant_of
from torchid.simulation.loads import Loads, changes_measurement
from torchid.simulation.open_loop import runs, true_torque
from torchid.simulators.gears import Gears
from torchid.typing import Float, Tensor

SHARP = (0.999, 0.999, 0.001)
"""solimpfriction of every joint: by MuJoCo's own a light joint has its friction only at speeds that
it hardly reaches."""


class Effects:
    """The effects of a robot, attached to simulations of its file.

    Attributes:
        ignored: names of effects that nothing is done about: those in sensors that are no affine
            map of the torque, no delay and no gear, and those of the bodies and poses of the arm,
            which belong into the file.
        across: (n, n) torque of the effects per acceleration of other joints, which no field of a
            joint holds [kg m^2].

    Args:
        robot: as read from the file with its sidecar: its bodies are the file's.
        simulations: (MjModel, MjData) of each; every one needs a model of its own, whose damping,
            friction and springs are overwritten.

    Raises:
        TorchidError: a model without one of the robot's joints, or one model twice; an explicit
            integrator, which meets nothing implicitly.
    """

    def __init__(self, robot: Robot, simulations: Sequence[tuple[Any, Any]]):
        self._mujoco = import_module("mujoco")
        if len({id(model) for model, _ in simulations}) < len(simulations):
            raise TorchidError(
                "simulations share a model, and each changes its friction at every step.",
                hint="copy.copy(model) for each of them",
            )
        if any(
            int(m.opt.integrator) == self._mujoco.mjtIntegrator.mjINT_RK4 for m, _ in simulations
        ):
            raise TorchidError(
                "RK4 takes damping explicitly, and stiff effects would explode.",
                got="integrator RK4",
                available=["Euler", "implicit", "implicitfast"],
            )
        self.simulations = tuple(simulations)
        self._rows, self._places = rows, places = self._joints(robot)
        models, datas = zip(*self.simulations, strict=True)
        # What is read and written at every step.
        self._state = [
            _Together([getattr(d, name) for d in datas], at)
            for name, at in (("qpos", places), ("qvel", rows), ("qacc", rows))
        ]
        self._acting = [
            _Together([getattr(d, name) for d in datas], rows)
            for name in ("qfrc_smooth", "qfrc_bias", "qfrc_constraint")
        ]
        fields = (models, "dof_damping"), (models, "dof_frictionloss"), (datas, "qfrc_applied")
        self._written = [_Together([getattr(x, name) for x in of], rows) for of, name in fields]
        pairs = nominal_effects(robot)
        late = [(e, v) for e, v in pairs if e.logs_late]
        geared = [(e, v) for e, v in pairs if isinstance(e, JointElasticity | Backlash)]
        pairs = [(e, v) for e, v in pairs if (e, v) not in (*late, *geared)]
        self.ignored = tuple(dict.fromkeys(e.name for e, v in pairs if not runs(robot, e, v)))
        pairs = [(e, v) for e, v in pairs if e.name not in self.ignored]
        # By how much each joint's torque, and all velocities, are read late [s].
        self._torque_late = torch.zeros(robot.n, dtype=torch.float64)
        self._speed_late = 0.0
        for effect, values in late:
            if effect.logs_late == "torque":
                self._torque_late[list(effect.joints)] += values[0]
            else:
                self._speed_late += values[0]
        self._latest = max(self._speed_late, float(self._torque_late.max()))
        zero = torch.zeros(len(simulations), robot.n, dtype=torch.float64)
        # True torque of a command in the units in which torque was logged: gains undone.
        sensed = [pair for pair in pairs if changes_measurement(pair[0])]
        self._sensed = bool(sensed)
        self._gain, self._offset = true_torque(robot, sensed)
        own = [pair for pair in pairs if not changes_measurement(pair[0])]
        bare = replace(robot, effects=())
        self._plant = plant_of(bare, [own] * len(simulations), zero)
        # Rotors are armature; what couples joints' accelerations has no field and is applied. The
        # rotors of gears that give way are motors, not their links'.
        inertia = self._plant.effects.inertia[0]
        self.across = inertia - torch.diag(inertia.diagonal())
        armature = inertia.diagonal().clone()
        self._gears = Gears.of(geared, armature)
        if self._gears is not None:
            armature[self._gears.joints] = 0.0
        self._beside = inertia - torch.diag(armature)
        self._coupled = bool(self._beside.any())
        self.restart()
        for model, _ in self.simulations:
            model.jnt_stiffness[model.dof_jntid[self._rows]] = 0.0
            model.dof_dampingpoly[self._rows] = 0.0
            model.dof_armature[self._rows] = armature.numpy()
            model.dof_solimp[self._rows, :3] = SHARP

    def place(self, simulation: int, q: Float[Tensor, " n"], dq: Float[Tensor, " n"]) -> None:
        """Set the joints of one simulation [rad, rad/s; m, m/s]; `restart` after the last one."""
        _, data = self.simulations[simulation]
        data.qpos[self._places], data.qvel[self._rows] = q.numpy(), dq.numpy()

    def restart(self) -> None:
        """States of the effects as at the beginning: after the simulations were set elsewhere."""
        now = self.motion()
        self._carried: Float[Tensor, "B n"] | None = None
        t = now.require("t", "a start")
        self._memory = self._plant.start(*now.state, t=t).memory
        if self._gears is not None:
            posture = self._plant.arms.at(now.q)
            self._gears.start(now.q, now.dq, posture.torque(now.dq), posture.mass_matrix())
        # What the sensors will read, from the oldest that any of them still does.
        seen = self._motors(now)
        self._seen = deque([(t, torch.zeros_like(now.q), seen.dq)])

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
        q, dq, ddq = (torch.from_numpy(x.read()) for x in self._state)
        t = np.array([data.time for _, data in self.simulations])
        return Motion(q, dq, ddq, t=torch.from_numpy(t))

    def _transmitted(self, ddq: Float[Tensor, "B n"]) -> Float[Tensor, "B n"]:
        """Torque that the joints transmitted in the last step: mass matrix times acceleration and
        the bias forces of that instant, as the sum of what MuJoCo let act; rotors that are no
        armature are beside it."""
        moved = torch.from_numpy(np.sum([x.read() for x in self._acting], 0))
        return moved + ddq @ self._beside if self._coupled else moved

    @torch.no_grad()
    def loads(self, motion: Motion, dt: float = 0.0) -> Loads:
        """Torque of the effects that resists a motion, apart from rotors, which are `armature`.

        Args:
            motion: q, dq, ddq (B, n) and t (B,). What is transmitted, which friction may grow with,
                is its torque where it has one, else the arm's at this acceleration.
            dt: time since the states of the memory [s].
        """
        at = motion._replace(ddq=torch.zeros_like(motion.ddq))
        if self._plant.effects.needs_torque and motion.torque is None:
            posture = self._plant.arms.at(motion.q)
            mass = posture.mass_matrix() + self._plant.effects.inertia
            moved = (mass @ motion.ddq.unsqueeze(-1)).squeeze(-1)
            at = at._replace(torque=posture.torque(motion.dq) + moved)
        return self._plant.effects.at(at, dt, self._memory)

    def true_torque(self, torque: Float[Tensor, "B n"]) -> Float[Tensor, "B n"]:
        """What acts on the joints where this would be logged: gains and offsets of the sensors
        undone."""
        return torque @ self._gain.T + self._offset if self._sensed else torque

    def _motors(self, now: Motion) -> Motion:
        """The motion where the encoders are: on the motors' side of gears."""
        if self._gears is None:
            return now
        q, dq = now.q.clone(), now.dq.clone()
        q[:, self._gears.joints], dq[:, self._gears.joints] = self._gears.angle, self._gears.rate
        return now._replace(q=q, dq=dq)

    def sensed(self) -> Motion:
        """What the log would hold now: q and dq (B, n) of the encoders, t (B,), and the torque
        (B, n) that `step` was last given; late by the delays of torque and velocity, between steps
        by interpolation, and as at the beginning before it."""
        now = self._motors(self.motion())
        t = now.require("t", "the sensors")
        torque = torch.stack(
            [self._then(t - float(d), 1)[:, j] for j, d in enumerate(self._torque_late)], -1
        )
        dq = self._then(t - self._speed_late, 2) if self._speed_late else now.dq
        return now._replace(dq=dq, torque=torque)

    def _then(self, t: Float[Tensor, " B"], what: int) -> Float[Tensor, "B n"]:
        """Torque (1) or speed (2) at an earlier time."""
        times = [entry[0] for entry in self._seen]
        k = len(times) - 1
        while k > 0 and bool((times[k] > t + 1e-12).any()):
            k -= 1
        first, second = self._seen[k], self._seen[min(k + 1, len(times) - 1)]
        span = (second[0] - first[0]).clamp(min=1e-12)
        share = ((t - first[0]) / span).clamp(0, 1).unsqueeze(-1)
        return torch.lerp(first[what], second[what], share)

    @torch.no_grad()
    def step(self, torque: Float[Tensor, "B n"]) -> None:
        """One mj_step of every simulation with these torques (B, n) of the drives [N m; N], in the
        units of the log; `ctrl` and other forces act as they do without effects."""
        now = self.motion()
        h = float(self.simulations[0][0].opt.timestep)
        loads = self.loads(now._replace(torque=self._carried), h / 2)
        drives = self.true_torque(torque)
        # A falling friction curve is met explicitly: negative damping has no implicit step.
        slope = loads.slope.clamp(min=0)
        applied = drives - loads.smooth + slope * now.dq
        if self._coupled:
            applied = applied - now.ddq @ self.across
        law = None
        if self._gears is not None:
            # In the place of the drives' torque what the gears transmit.
            law = self._gears.law(now.q, now.dq, drives, h)
            applied[:, self._gears.joints] += law.force - law.torque
            slope[:, self._gears.joints] += law.damping
        for written, values in zip(self._written, (slope, loads.dry, applied), strict=True):
            written.write(values.numpy())
        step = self._mujoco.mj_step
        for model, data in self.simulations:
            step(model, data)
        after = self.motion()
        t = after.require("t", "a step")
        if self._plant.effects.needs_torque:
            self._carried = self._transmitted(after.ddq)
        if self._memory:
            middle = after._replace(dq=(now.dq + after.dq) / 2, t=now.t)
            self._memory = self._plant.effects.advance(middle, h, self._memory)
        if self._gears is not None and law is not None:
            self._gears.advance(law, after.dq, h)
        # The oldest entries that no sensor reads any more go.
        oldest = float(t.min()) - self._latest - h
        self._seen.append((t, torque, self._motors(after).dq))
        while len(self._seen) > 2 and float(self._seen[1][0].max()) < oldest:
            self._seen.popleft()


class _Together:
    """Elements of one array in each of many simulations, read and written as one (B, n), by their
    addresses: without a call for each simulation.

    Args:
        arrays: of MuJoCo, which stay where they are as long as the simulations live.
        at: elements.
    """

    def __init__(self, arrays: Sequence[Any], at: Sequence[int]):
        self._arrays = arrays  # kept alive
        start = np.array([x.ctypes.data for x in arrays])
        first = int(start.min())
        count = (int(start.max()) - first) // 8 + len(arrays[0])
        # All memory between them, of which nothing but these elements is ever touched.
        self._memory = np.ctypeslib.as_array((ctypes.c_double * count).from_address(first))
        self._index = (start[:, None] - first) // 8 + np.array(at)

    def read(self) -> np.ndarray:
        """A copy of the elements (B, n)."""
        return self._memory[self._index]

    def write(self, values: np.ndarray) -> None:
        """Set the elements (B, n)."""
        self._memory[self._index] = values
