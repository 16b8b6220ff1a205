"""Position servos at run time, for simulators whose own actuators are simpler.

Where the actuators follow a position, set-points are made for them:

    points = SetPoints(torchid.ServoArm.read("arm_corrected_effects.yaml").servos, dt=0.02)
    for command in policy:                      # every dt
        for ctrl in points.feed(command, 10):   # ten steps of the physics
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data)

Where they take an effort, all of a servo is made for them, batched over environments:

    arm = torchid.ServoArm.read("corrected.yaml")
    servos = ServoTorque(arm.robot, arm.servos, environments=4096, dt=0.005, steps=4)
    effort = servos.torque(command, joint_pos, joint_vel)   # every step of the physics

With `drawn_servos("so101_servo_draws.npz", arm.servos)`, of `export gap.json --randomise`, in the
place of `arm.servos` each environment has servos of its own.

A servo follows a set-point of limited acceleration and speed, not the command, and answers to the
set-point's rate: kp (x - q) + kd (dx - dq) = kp (x + kd / kp dx - q) - kd dq, of which the last is
in the simulator's file. Plain torch on any device; nothing of a simulator is imported.
"""

import math
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from torchid.dynamics.forward import bias_torque
from torchid.effects.servo import NAMES, PARAMETERS
from torchid.errors import TorchidError
from torchid.log.movement import RESTING
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import FASTEST, compensation, profile_step
from torchid.simulators.actuator import joints_named
from torchid.typing import Bool, Float, Int, Tensor

AT_RUN_TIME = ("kd", "acceleration", "speed")
"""Parameters of servos that set-points at run time make true."""
FIELDS = ("damping", "coulomb", "armature")
"""Parameters that simulators have fields of joints for."""
BY_LOAD = ("load_share", "stiction_share")
OF_ALL = (*BY_LOAD, "supply")
"""Parameters by which friction is by the load, and those whose torque is by all joints at once."""
NOT_AS_EFFORT = ("stop_low", "stop_high")
"""Parameters that an actuator does nothing about: limits are the joint's."""
AS_EFFORT = tuple(p.name for p in PARAMETERS if p.name not in NOT_AS_EFFORT)
"""Parameters that are true where all of a servo is made at run time."""


class SetPoints:
    """What servos make of commands that come every dt and hold until the next.

    Args:
        servos: of n joints: one set, or one of each environment.
        dt: from one command to the next [s].
        device, dtype: of the tensors.

    Raises:
        TorchidError: dt is no time.
    """

    def __init__(
        self,
        servos: Servos,
        dt: float,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float64,
    ):
        if not 0 < dt < float("inf"):
            raise TorchidError("commands come one after the other.", got=dt, expected="dt > 0 s")
        kp, kd, scale, a, top = (
            servos.of(name).to(device, dtype)
            for name in ("kp", "kd", "scale", "acceleration", "speed")
        )
        self.dt, self.repeated = dt, servos.repeated
        self.limited = a.isfinite() | top.isfinite()
        self._limits = a.clamp(max=FASTEST[0]), top.clamp(max=FASTEST[1])
        self._scale, self._ahead = scale, kd / kp.clamp(min=1e-30)
        self._lines = self.limited | (kd > 0)
        self._state: tuple[Tensor, Tensor, Tensor] | None = None

    @property
    def late(self) -> Float[Tensor, "*batch n"]:
        """(*batch, n) by how much the control is later than straight lines from one command to the
        next, in the mean [s]: a command that is held by half of dt; a line that ends where the
        command is, by all of it. A limited set-point knows no more than the last command anyway.
        """
        late = (self.dt + self.dt * self._lines.to(self._scale)) / 2
        return torch.where(self.limited, 0.0, late)

    def reset(self, environments: Int[Tensor, " K"] | Sequence[int] | slice | None = None) -> None:
        """Begin anew at the next command: in some environments, or in all."""
        if environments is None or self._state is None:
            self._state = None
            return
        self._state[2][environments] = math.nan

    def line(
        self, command: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch n"], Float[Tensor, "*batch n"], Bool[Tensor, "*batch n"]]:
        """Where set-points are now [rad; m], how far they go until the next command, and which
        begin anew.

        Args:
            command: [rad; m].
        """
        goal = command * self._scale
        if self._state is None:
            nothing = torch.full_like(goal, math.nan)
            self._state = goal, torch.zeros_like(goal), nothing
        x, v, last = self._state
        new = last.isnan()
        x, v, last = (
            torch.where(new, goal, x),
            torch.where(new, 0.0, v),
            torch.where(new, goal, last),
        )
        way, v = profile_step(goal - x, v, *self._limits, self.dt)
        after = torch.where(self.limited, x + way, goal)
        if self.repeated:
            same = (goal == last) & ~new
            after, v = torch.where(same, goal, after), torch.where(same, 0.0, v)
        self._state = after, v, goal
        return torch.where(self._lines, x, goal), torch.where(self._lines, after - x, 0.0), new

    def feed(self, command: npt.ArrayLike, steps: int) -> np.ndarray:
        """(steps, ..., n) what to control to in each step of the physics until the next command.

        Args:
            command: (..., n) [rad; m].
            steps: of the physics in dt.
        """
        x, way, _ = self.line(torch.as_tensor(np.asarray(command)).to(self._scale))
        along = (torch.arange(steps).to(x) / steps).reshape(-1, *(1,) * x.ndim)
        return ((x + along * way + self._ahead * way / self.dt) / self._scale).cpu().numpy()


class ServoTorque:
    """The torque of position servos, as that of an explicit actuator, batched over environments.

    Damping, dry friction and armature are left to the simulator's own fields, which it meets
    implicitly; `ignored` is left to nobody here. Friction by the load takes the robot's gravity and
    velocity torques in every step, on the CPU, and integral action where it begins: both need an
    actuator of all joints.

    Attributes:
        joints: of the robot, in the order of the given names.
        ignored: names of the servos' parameters that nothing is done about.

    Args:
        robot: whose joints the servos are of.
        servos: one set, or some of which each environment has one, in turn.
        names: of the actuator's joints, in its order; all of the robot's if None. A prefix that
            ends with a slash is passed over.
        environments: how many.
        device, dtype: of the tensors.
        dt: of a step of the physics [s].
        steps: of the physics from one command to the next.
        fields: whether to add damping and dry friction, too: a straight line below `resting`.
        resting: speed up to which friction grows in proportion [rad/s; m/s].

    Raises:
        TorchidError: a name that is no joint of the robot, or steps that take no time.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> servos = Servos.neutral(3, kp=20.0, clip=4.0)
    >>> drives = ServoTorque(robot, servos, environments=2, dt=0.002, steps=10)
    >>> drives.torque(torch.full((2, 3), 0.1), torch.zeros(2, 3), torch.zeros(2, 3))[0].tolist()
    [2.0, 2.0, 2.0]
    """

    def __init__(
        self,
        robot: Robot,
        servos: Servos,
        names: Sequence[str] | None = None,
        environments: int = 1,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        dt: float,
        steps: int = 1,
        fields: bool = False,
        resting: float = RESTING,
    ):
        if not (0 < dt < math.inf and steps >= 1):
            raise TorchidError(
                "there are steps from one command to the next.",
                got=f"dt={dt}, steps={steps}",
                expected="dt > 0 s, steps >= 1",
            )
        self.joints = joints_named(robot, names)
        every, joint = servos, servos.joint[..., self.joints, :]
        if joint.ndim > 2:
            joint = joint[torch.arange(environments) % len(joint)]
        plane = every.plane.new_zeros(*joint.shape[:-2], 5)
        servos = Servos(joint, plane, repeated=every.repeated)
        p = {x.name: servos.of(x.name).to(device, dtype) for x in PARAMETERS}
        neutral = {x.name: x.neutral for x in PARAMETERS}
        self._knows_load = sorted(self.joints) == list(range(robot.n))
        out_of_reach = NOT_AS_EFFORT if self._knows_load else (*OF_ALL, *NOT_AS_EFFORT)
        unmade = [name for name in out_of_reach if bool((p[name] != neutral[name]).any())]
        for name in () if self._knows_load else OF_ALL:
            p[name] = torch.full_like(p[name], neutral[name])
        self._loaded = any(bool((p[name] > 0).any()) for name in BY_LOAD)
        self.ignored = (*unmade, *["plane"] * bool((every.plane[..., 4] > 0).any()))
        self._p, self._dt, self._steps, self._fields = p, dt, steps, fields
        self._resting, self._robot = resting, robot
        self._points = SetPoints(servos, dt * steps, device, dtype)
        self._step = 0
        # A command that is held is late by itself.
        behind = (p["delay"] - self._points.late).clamp(min=0) / dt
        self._whole = behind.floor().long()
        self._part = behind - self._whole
        zero = torch.zeros(environments, len(self.joints), device=device, dtype=dtype)
        self._keep = torch.exp(-dt / p["lag"].clamp(min=1e-12))
        self._x, self._way, self._filtered, self._sum = zero, zero, zero, zero
        # What set-points and their rates were, for servos that hear of them late.
        self._past = zero.expand(2, int(self._whole.max()) + 2, *zero.shape).clone()

    def reset(self, environments: Int[Tensor, " K"] | Sequence[int] | slice | None = None) -> None:
        """Begin anew at the next command, in some environments or in all: as if it had stood for
        long."""
        self._points.reset(environments)
        if environments is None:
            self._step = 0

    def torque(
        self, command: Float[Tensor, "B J"], q: Float[Tensor, "B J"], dq: Float[Tensor, "B J"]
    ) -> Float[Tensor, "B J"]:
        """Torque of the servos in this step [N m; N].

        Args:
            command: positions, of which the first of `steps` counts [rad; m].
            q, dq: of the actuator's joints [rad, rad/s; m, m/s].
        """
        p, dt = self._p, self._dt
        q, dq = q.to(self._x), dq.to(self._x)
        new = None
        if self._step == 0:
            self._x, way, new = self._points.line(command.to(self._x))
            self._way = way / self._steps
            # A filter goes on from where it was; without one the set-point is what it knows.
            self._filtered = torch.where(new | (p["lag"] == 0), self._x, self._filtered)
        self._step = (self._step + 1) % self._steps
        # The filter's answer to a straight line, exactly.
        behind = p["lag"] / dt * self._way
        after = self._x + self._way
        filtered = after - behind + (self._filtered - self._x + behind) * self._keep
        now = torch.stack([self._filtered, (filtered - self._filtered) / dt])
        self._x, self._filtered = after, filtered
        self._past = torch.cat([now.unsqueeze(1), self._past[:, :-1]], 1)
        if new is not None and bool(new.any()):
            first = torch.stack([now[0], torch.zeros_like(now[0])]).unsqueeze(1)
            self._past = torch.where(new, first, self._past)
        rows = (self._whole + torch.zeros_like(q).long()).expand(2, 1, *q.shape)
        at, before = (self._past.gather(1, rows + k)[:, 0] for k in (0, 1))
        x, dx = torch.lerp(at, before, self._part)
        error = x - q
        if new is not None and bool(new.any()) and bool((p["integral"] > 0).any()):
            self._sum = torch.where(new, self._borne(error, q), self._sum)
        error = error - error.clamp(-p["dead_zone"], p["dead_zone"])
        inside = p["damping_share"] * p["damping"]
        motor = p["kp"] * error + p["kd"] * (dx - dq) - inside * dq + self._sum
        motor = motor.clamp(-p["clip"], p["clip"])
        motor = motor / (1 + motor.abs().sum(-1, keepdim=True) / p["supply"])
        # What the servo cannot give is not summed.
        self._sum = (self._sum + p["integral"] * dt * error).clamp(-p["clip"], p["clip"])
        load = self._load(q, dq) if self._loaded else torch.zeros_like(q)
        fading = torch.exp(-((dq.abs() / p["stribeck_speed"]) ** p["stribeck_exponent"]))
        dry = (p["stiction"] + p["stiction_share"] * (motor + load).abs()) * fading
        dry = dry + (p["motor_share"] * motor + p["load_share"] * load).abs()
        out = motor + p["offset"]
        if self._fields:
            dry, out = dry + p["coulomb"], out - (p["damping"] - inside) * dq
        return out - dry * (dq / self._resting).clamp(-1.0, 1.0)

    def _borne(self, error: Float[Tensor, "B J"], q: Float[Tensor, "B J"]) -> Float[Tensor, "B J"]:
        """What integral action has summed where the arm stands still, gravity's torque borne;
        nothing where the other joints are not known."""
        p = self._p
        if not self._knows_load:
            return torch.zeros_like(q)
        weight = self._load(q, torch.zeros_like(q))
        return torch.where(p["integral"] > 0, weight - p["offset"] - p["kp"] * error, 0.0)

    def _load(self, q: Float[Tensor, "B J"], dq: Float[Tensor, "B J"]) -> Float[Tensor, "B J"]:
        """Torque of the robot's bodies at a constant velocity, less what compensates gravity
        [N m; N]."""
        at = torch.zeros(2, len(q), self._robot.n, dtype=torch.float64)
        at[..., self.joints] = torch.stack([q, dq]).cpu().double()
        borne = bias_torque(self._robot, *at) - compensation(self._robot, at[0])
        return borne[:, self.joints].to(q)


def drawn_servos(path: str | Path, servos: Servos) -> Servos:
    """Servos (D, n, K) that `torchid export gap.json --randomise` drew, for `ServoTorque`.

    Args:
        path: NAME_servo_draws.npz.
        servos: that they are draws about.

    Raises:
        TorchidError: no such file, or draws of other joints or parameters.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            names, values = data["parameters"].tolist(), torch.from_numpy(data["values"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise TorchidError(f"'{path}' holds no draws of servos.", got=str(error)[:200]) from error
    if names != list(NAMES) or values.shape[1:] != servos.joint.shape[-2:]:
        raise TorchidError(
            f"'{path}' holds draws of other servos.",
            got=f"{values.shape[1]} joints, {len(names)} parameters",
            expected=f"{servos.n} joints, {len(NAMES)} parameters",
        )
    plane = servos.plane.expand(len(values), -1)
    return replace(servos, joint=values.double(), plane=plane)
