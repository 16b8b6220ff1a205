"""A robot's MJCF, replayed by MuJoCo itself: with its integrator, its soft friction and limits, its
contacts, and whatever else no servo here has a number for.

Causes are found about that replay: what a servo's numbers change is told by our own kernel, which
is fast and has every effect, and where the file as given goes by MuJoCo,

    q(numbers) = kernel(numbers) - kernel(file) + MuJoCo(file).
"""

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchid.effects.servo import INDEX, NAMES
from torchid.position.fit import searched
from torchid.results.words import digits
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import MIDDLE, Tracks, Windows, jumps, rollout, windows_of
from torchid.typing import Float, Tensor

if TYPE_CHECKING:
    from torchid.position.data import PositionData

Commands = Callable[[int, np.ndarray], np.ndarray]
"""(K, n) of a motion, at times (K,) since its first row [s]."""
RAN_AWAY = 50.0
"""Position beyond which a simulation has left the arm [rad]."""
FORGOTTEN = 20.0
"""Time constants of a filter after which it no longer knows what was [1]."""
AGREES = 0.05
"""Error up to which the kernel agrees with MuJoCo [mrad], where a tenth of a count is no more."""
_FIELDS = {
    "contact": ("mjDSBL_CONTACT", "geom_contype"),
    "joint range": ("mjDSBL_LIMIT", "jnt_limited"),
    "frictionloss": ("mjDSBL_FRICTIONLOSS", "dof_frictionloss"),
}
"""What MuJoCo has otherwise than our kernel: how it is left out, and where a file has it."""
ROUNDING = 1e-6
"""Share of a step by which a row may come before it [1]."""


@dataclass(frozen=True, eq=False)
class FileInMujoco:
    """An MJCF of which every joint has a servo.

    Attributes:
        model: MuJoCo's.
        at: (n,) where each of the robot's joints is among all of them.
        driven, gears: (n,) by which actuator, and how many of its radians one of the joint's is.
    """

    model: Any
    at: list[int]
    driven: list[int]
    gears: list[float]

    @classmethod
    def of(cls, robot: Robot) -> "FileInMujoco | None":
        """The file that a robot was read from; None where that is no MJCF, has joints or actuators
        beside the robot's, or other bodies than the robot now has."""
        path = Path(robot.source)
        if path.suffix.lower() != ".xml" or not path.is_file():
            return None
        from torchid.robot.mjcf import compiled, driving, read_mjcf

        model, given = compiled(path).model, read_mjcf(path)
        alike = robot.joint_names == given.joint_names and torch.equal(robot.gravity, given.gravity)
        if not alike or robot.parameters is None or given.parameters is None:
            return None
        if not torch.equal(robot.parameters.pi, given.parameters.pi):
            return None
        joints = {joint: (actuator, gear) for actuator, joint, gear, _ in driving(model)}
        at = [int(model.joint(name).id) for name in robot.joint_names]
        if not robot.n == model.nv == model.nu == model.nq or sorted(joints) != sorted(at):
            return None
        return cls(model, at, [joints[k][0] for k in at], [joints[k][1] for k in at])

    @property
    def range(self) -> Float[np.ndarray, "2 nu"]:
        """Of commands, by actuator."""
        free = ~self.model.actuator_ctrllimited.astype(bool)
        ends = self.model.actuator_ctrlrange.T.copy()
        ends[:, free] = [[-np.inf], [np.inf]]
        return ends

    def taken(self, tracks: Tracks) -> Tracks:
        """Commands as far as actuators take them."""
        low, high = torch.from_numpy(self.range[:, self.driven])
        return replace(tracks, u=tracks.u.clamp(low, high))

    def having(self, file: Servos, servos: Servos) -> "FileInMujoco":
        """It with other numbers of its servos.

        Args:
            file: its servos as they are read from it.
            servos: others, of which delays are the commands'.
        """
        import mujoco

        model = copy(self.model)
        new, old = ({p: x.of(p).tolist() for p in NAMES} for x in (servos, file))
        for j, (joint, a) in enumerate(zip(self.at, self.driven, strict=True)):
            more = {p: new[p][j] - old[p][j] for p in NAMES}
            ratio = {
                p: new[p][j] / old[p][j] if old[p][j] else 1.0 for p in ("kp", "scale", "clip")
            }
            gear, inside = self.gears[j], old["damping_share"][j] * more["damping"]
            model.actuator_gainprm[a, 0] *= ratio["kp"] * ratio["scale"]
            model.actuator_biasprm[a, :3] *= 1.0, ratio["kp"], 1.0
            model.actuator_biasprm[a, :3] += more["offset"] / gear, 0.0, -inside / gear**2
            model.dof_damping[joint] += more["damping"] - inside
            model.dof_armature[joint] += more["armature"]
            model.dof_frictionloss[joint] += more["coulomb"]
            if math.isfinite(ratio["clip"]):
                model.actuator_forcerange[a] *= ratio["clip"]
                model.jnt_actfrcrange[joint] *= ratio["clip"]
            if model.actuator_actadr[a] >= 0:
                model.actuator_dynprm[a, 0] += more["lag"]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return replace(self, model=model)

    def rollout(
        self,
        commands: Commands,
        windows: Windows,
        dt: float,
        state: tuple[Float[Tensor, "W n"], Float[Tensor, "W n"]],
        first: Tensor,
    ) -> Float[Tensor, "L W n"] | None:
        """Positions at the rows of windows, NaN after their ends; None where the simulation breaks.

        Args:
            commands: of motions.
            windows: stretches of motions.
            dt: sampling interval [s].
            state: q and dq where windows begin [rad, rad/s].
            first: (m,) first row of each motion.
        """
        import mujoco

        h, n = float(self.model.opt.timestep), len(self.at)
        out = np.full((int(windows.length.max()), len(windows.start), n), np.nan)
        for w, (start, rows, motion) in enumerate(
            zip(*(x.tolist() for x in (windows.start, windows.length, windows.motion)), strict=True)
        ):
            begun = (start - int(first[motion])) * dt
            # Rows are in the step that begins at or before them.
            row_times = dt * np.arange(rows)
            step = np.floor(row_times / h + ROUNDING).astype(int)
            rest = row_times - step * h
            u = commands(motion, begun + h * np.arange(step[-1] + 1))
            data = mujoco.MjData(self.model)
            data.qpos[self.at], data.qvel[self.at] = (x[w].numpy() for x in state)
            if self.model.na:
                since = begun - FORGOTTEN * float(self.model.actuator_dynprm[:, 0].max())
                data.act[:] = self._filtered(commands(motion, np.arange(since, begun + h / 2, h)))
            row = 0
            for k, ctrl in enumerate(u):
                while row < rows and step[row] == k:
                    out[row, w] = data.qpos[self.at] + rest[row] * data.qvel[self.at]
                    row += 1
                data.ctrl[self.driven] = ctrl
                mujoco.mj_step(self.model, data)
            if not np.abs(out[:rows, w]).max() < RAN_AWAY or data.warning.number.any():
                return None
        return torch.from_numpy(out)

    def _filtered(self, before: Float[np.ndarray, "K n"]) -> np.ndarray:
        """The actuators' states after commands, the first of which has been there for long: they
        feel nothing of where the arm is."""
        import mujoco

        aside, model = mujoco.MjData(self.model), self.model
        aside.ctrl[self.driven] = before[0]
        has = model.actuator_actadr >= 0
        aside.act[model.actuator_actadr[has]] = aside.ctrl.clip(*self.range)[has]
        for ctrl in before[:-1]:
            aside.ctrl[self.driven] = ctrl
            mujoco.mj_step(model, aside)
        return aside.act


def late(servos: Servos, data: "PositionData") -> Servos:
    """Servos of a file, later by what commands are held by."""
    joint = servos.joint.clone()
    joint[:, INDEX["delay"]] += 0.5 * data.held
    return replace(servos, joint=joint)


def held(tracks: Tracks, parts: bool) -> Commands:
    """Commands that hold from their row to the next one, of motions or of parts of one."""
    u, first, last = (x.numpy() for x in (tracks.u, tracks.first, tracks.last))
    begin = np.zeros_like(first) if parts else first

    def at(motion: int, t: np.ndarray) -> np.ndarray:
        rows = first[motion] + np.floor(t / tracks.dt + ROUNDING).astype(int)
        return u[rows.clip(begin[motion], last[motion])]

    return at


def along_lines(tracks: Tracks, parts: bool) -> Commands:
    """Commands that go on between rows, but for those that jump; of motions or of parts of one."""
    u, first, last = (x.numpy() for x in (tracks.u, tracks.first, tracks.last))
    begin = np.zeros_like(first) if parts else first
    lone = jumps(tracks.u.T).T.numpy()
    when = np.full(len(u), MIDDLE) if tracks.jump_at is None else tracks.jump_at.numpy()

    def at(motion: int, t: np.ndarray) -> np.ndarray:
        place = (first[motion] + t / tracks.dt).clip(begin[motion], last[motion])
        row = np.floor(place).astype(int)
        part, after = (place - row)[:, None], np.minimum(row + 1, last[motion])
        part = np.where(lone[row], part >= when[row][:, None], part)
        return u[row] + part * (u[after] - u[row])

    return at


def later(commands: Commands, seconds: Sequence[float]) -> Commands:
    """Commands that come so much later (n,)."""

    def at(motion: int, t: np.ndarray) -> np.ndarray:
        columns = [commands(motion, t - late)[:, j] for j, late in enumerate(seconds)]
        return np.stack(columns, 1)

    return at


@dataclass(frozen=True, eq=False)
class Beside:
    """Where MuJoCo goes with a file beside where our kernel goes with its servos.

    What parts the two is not the same with other numbers: where these are known about, it is what
    it is there, and in proportion on the way there.

    Attributes:
        file: the MJCF.
        data: the motions as our kernel has them.
        servos: of the file, as late as the commands come.
        commands: of the motions.
        there: the same with other numbers.
    """

    file: FileInMujoco
    data: "PositionData"
    servos: Servos
    commands: Commands
    there: "Beside | None" = None
    _known: dict[tuple[int, int], Tensor] = field(default_factory=dict, repr=False)

    def about(self, servos: Servos) -> "Beside":
        """It, known with other numbers, too."""
        delays = (servos.of("delay") - self.servos.of("delay")).tolist()
        file, commands = self.file.having(self.servos, servos), later(self.commands, delays)
        return replace(self, there=Beside(file, self.data, servos, commands))

    def __call__(
        self, windows: Windows, servos: Float[Tensor, "*P n K"]
    ) -> Float[Tensor, "L W n #P"]:
        """MuJoCo's positions minus the kernel's at the rows of windows [rad]; 0 after their
        ends, and of a simulation that breaks.

        Args:
            windows: stretches of motions.
            servos: searched coordinates of sets, or of one a window.
        """
        apart = self.apart(windows)[..., None]
        if self.there is None:
            return apart
        here, there = (searched(x) for x in (self.servos, self.there.servos))
        way = (there - here).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
        gone = (servos - here).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
        share = (gone * way).sum((-2, -1)) / way.square().sum().clamp(min=1e-300)
        share = share.clamp(0, 1) if share.ndim < 2 else share.clamp(0, 1)[:, None]
        return apart + share * (self.there.apart(windows)[..., None] - apart)

    def unsure(self, windows: Windows) -> Float[Tensor, " n"]:
        """RMS error of what is taken to part MuJoCo from our kernel on the way to the other numbers
        [rad]: where it grows as a square, a line errs by a quarter of its change."""
        if self.there is None:
            return torch.zeros(self.servos.n, dtype=torch.float64)
        change = (self.there.apart(windows) - self.apart(windows)) * windows.weight[:, None].sqrt()
        return 0.25 * (change.square().sum((0, 1)) / windows.rows).sqrt()

    def apart(self, windows: Windows) -> Float[Tensor, "L W n"]:
        """The same with the file's own numbers."""
        keys = list(zip(windows.start.tolist(), windows.length.tolist(), strict=True))
        new = torch.tensor([k for k, key in enumerate(keys) if key not in self._known])
        if len(new):
            for k, apart in zip(new.tolist(), self._of(windows.some(new)).unbind(1), strict=True):
                self._known[keys[k]] = apart[: keys[k][1]]
        return torch.nn.utils.rnn.pad_sequence([self._known[key] for key in keys])

    def words(self) -> tuple[str, ...]:
        """Where our kernel goes elsewhere than MuJoCo with the file's own numbers, as one sentence;
        none where they agree."""
        whole, least = windows_of(self.data.tracks, None), 0.1 * self.data.count

        def rms(one: Beside) -> Tensor:
            apart = one.apart(whole).square().sum((0, 1)) / whole.rows
            return 1e3 * apart.sqrt()

        parted = rms(self)
        j = int(parted.argmax())
        if not float(parted[j]) > max(AGREES, 1e3 * float(least[j])):
            return ()
        model, shares = self.file.model, dict[str, float]()
        for name, (flag, has) in _FIELDS.items():
            if getattr(model, has).any():
                left = float(rms(self._without(flag, name))[j])
                shares[name] = math.sqrt(max(float(parted[j]) ** 2 - left**2, 0.0))
        rest = float(parted[j]) ** 2 - sum(x**2 for x in shares.values())
        shares["steps of the simulations"] = math.sqrt(max(rest, 0.0))
        parts = ", ".join(f"{name} {digits(x)}" for name, x in shares.items() if x > AGREES)
        return (
            f"With the file's numbers joint {j + 1} goes {digits(float(parted[j]))} mrad elsewhere "
            f"in MuJoCo than in torchid's own simulation ({parts}): MuJoCo's is what causes are "
            "held against.",
        )

    def _without(self, flag: str, name: str) -> "Beside":
        """It without one of MuJoCo's forces, which our kernel's servos lack, too."""
        import mujoco

        model, joint = copy(self.file.model), self.servos.joint.clone()
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, flag))
        if name == "frictionloss":
            joint[:, INDEX["coulomb"]] = 0.0
        file, servos = replace(self.file, model=model), replace(self.servos, joint=joint)
        return Beside(file, self.data, servos, self.commands)

    def _of(self, windows: Windows) -> Tensor:
        data, tracks = self.data, self.data.tracks
        state = data.start(windows)
        one = replace(self.servos, joint=self.servos.joint[None], plane=self.servos.plane[None])
        own = rollout(one, data.body, tracks, windows, *state, measured=data.q)[..., 0]
        far = self.file.rollout(self.commands, windows, tracks.dt, state, tracks.first)
        return torch.zeros_like(own) if far is None else (far - own).nan_to_num(nan=0.0)
