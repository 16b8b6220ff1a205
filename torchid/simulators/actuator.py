"""Effects as the torque of an explicit actuator, for simulators that step thousands of arms.

    effects = EffectTorque(robot, joint_names, environments, device)
    effort = pd_effort - effects.torque(joint_pos, joint_vel, dt, pd_effort)

Plain torch on any device; nothing of a simulator is imported. Rotor inertia, viscous and Coulomb
friction are left to the simulator's own armature, damping and friction, which it meets implicitly.
What an actuator adds is explicit: dry friction is a straight line at speeds below `resting`, and
slopes must stay below inertia / step. `torchid export ... --to isaaclab|mjlab` writes an actuator
class and its configuration with it.
"""

from collections.abc import Sequence

import torch

from torchid.effects.base import Effect, Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.log.movement import RESTING
from torchid.robot.model import Robot
from torchid.simulation.loads import BatchEffects, adds_torque
from torchid.typing import Float, Int, Tensor


def joints_named(robot: Robot, names: Sequence[str] | None) -> list[int]:
    """Joints (from 0) of a simulator's names, which may have the entity's before a slash; all of
    them if None.

    Raises:
        TorchidError: a name that is no joint of the robot.
    """
    own = [n.rpartition("/")[2] for n in (robot.joint_names if names is None else names)]
    if unknown := [n for n in own if n not in robot.joint_names]:
        raise TorchidError(
            "the robot has no such joint.",
            got=", ".join(unknown),
            available=list(robot.joint_names),
        )
    return [robot.joint_names.index(n) for n in own]


class EffectTorque:
    """What the effects of a robot resist its drives with, batched over environments.

    Attributes:
        joints: of the robot, in the order of the given names.
        ignored: names of effects that nothing is done about: of the sensors, of the bodies, of the
            arm's model, and of joints that are not among the given ones.

    Args:
        robot: with its effects, e.g. of `torchid gap --save-model` or a file with its sidecar.
        names: of the actuator's joints, in its order; all of the robot's if None. A prefix that
            ends with a slash is passed over.
        environments: how many.
        device, dtype: of the tensors.
        resting: speed up to which dry friction grows in proportion [rad/s; m/s]; 0 for its sign.
        fields: whether to add what the simulator has fields for, too.

    Raises:
        TorchidError: a name that is no joint of the robot.
    """

    def __init__(
        self,
        robot: Robot,
        names: Sequence[str] | None = None,
        environments: int = 1,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        resting: float = RESTING,
        fields: bool = False,
    ):
        self.joints = joints_named(robot, names)
        pairs = nominal_effects(robot)
        held = [(e, v) for e, v in pairs if fields or e.attributes(v) is None]
        used = [(e, v) for e, v in held if self._adds(e)]
        self.ignored = tuple(dict.fromkeys(e.name for e, v in held if (e, v) not in used))
        self._resting = resting
        # One arm's coefficients are broadcast over all environments.
        like = torch.zeros(1, robot.n, device=device, dtype=dtype)
        self._effects = BatchEffects([used], robot, like)
        self._zero = like.expand(environments, robot.n)
        self._t = torch.zeros(environments, device=device, dtype=dtype)
        self._states = self._effects.initial(Motion(self._zero, self._zero, self._zero))

    def _adds(self, effect: Effect) -> bool:
        """Whether an actuator of these joints can add its torque."""
        joints = {*effect.identity[1]}
        here = joints <= set(self.joints) and effect.needs <= {"t", "torque"}
        return here and adds_torque(effect)

    def reset(self, environments: Int[Tensor, " K"] | Sequence[int] | slice | None = None) -> None:
        """States as at the beginning, of some environments or of all."""
        at = slice(None) if environments is None else environments
        fresh = self._effects.initial(Motion(self._zero, self._zero, self._zero))
        self._t[at] = 0.0
        for state, new in zip(self._states, fresh, strict=True):
            if state is not None and new is not None:
                state[at] = new[at]

    @torch.no_grad()
    def torque(
        self,
        q: Float[Tensor, "B J"],
        dq: Float[Tensor, "B J"],
        dt: float,
        drive: Float[Tensor, "B J"] | None = None,
    ) -> Float[Tensor, "B J"]:
        """What resists the drives now, and a step of the states.

        Args:
            q, dq: of the actuator's joints [rad, rad/s; m, m/s].
            dt: since the last call [s].
            drive: torque of the drives [N m; N], which friction that grows with load follows; 0 if
                None.
        """
        load = self._zero if drive is None else self._all(drive)
        motion = Motion(self._all(q), self._all(dq), self._zero, t=self._t, torque=load)
        loads = self._effects.at(motion, dt, self._states)
        self._states = self._effects.advance(motion, dt, self._states)
        self._t += dt
        way = torch.sign(motion.dq)
        if self._resting > 0:
            way = (motion.dq / self._resting).clamp(-1.0, 1.0)
        return (loads.smooth + loads.dry * way)[:, self.joints]

    def _all(self, x: Float[Tensor, "B J"]) -> Float[Tensor, "B n"]:
        """Values of the actuator's joints among those of all joints."""
        out = self._zero.clone()
        out[:, self.joints] = x.to(out)
        return out
