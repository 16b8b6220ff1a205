"""The corrected model in Python: a torch module of whatever a diagnosis answered or wrote."""

from dataclasses import replace
from pathlib import Path

import torch
from torch.nn import Module, Parameter

from torchid.effects.instants import interval
from torchid.effects.model import ArmModel, Times
from torchid.errors import TorchidError
from torchid.export.randomise_positions import randomise_positions
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.inputs import LogLike, RobotLike
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import ServoArm
from torchid.position.record import PositionRecord
from torchid.position.replay import Replay, replay
from torchid.results.files import load
from torchid.simulation.servo import Servos
from torchid.simulators.servo import ServoTorque
from torchid.tensors import as_tensor, joint_signals, require_count
from torchid.typing import Joints, Numbers


class ServoModel(Module):
    """Position servos of an arm: their torque and their motion, of a file or answer with servos.

    The servos' numbers are the module's parameter, in float64. They are frozen: `requires_grad_()`
    makes them trainable.

    Args:
        arm: a robot with servos.
        posterior: the record of a diagnosis of positions, of which `sample` draws.

    >>> import numpy as np, torchid
    >>> model = torchid.load_model(torchid.ServoArm.of("3r", kp=260.0, damping=22.0))
    >>> t = 0.02 * np.arange(50)
    >>> u = np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    >>> model.torque(0.9 * u, 0 * u, u, t)[-1].round().tolist()  # kp (u - q)
    [22.0, 24.0, 5.0]
    """

    def __init__(self, arm: ServoArm, posterior: PositionRecord | None = None):
        super().__init__()
        self._arm, self._posterior = arm, posterior
        self.joint = Parameter(arm.servos.joint.clone(), requires_grad=False)

    def __repr__(self) -> str:
        return f"ServoModel('{self._arm.robot.name}')"

    @property
    def arm(self) -> ServoArm:
        """The arm with the present servos, e.g. to `write`."""
        servos = replace(self._arm.servos, joint=self.joint.detach().clone().cpu())
        return replace(self._arm, servos=servos)

    def torque(
        self,
        q: Numbers,
        dq: Numbers,
        command: Numbers | None = None,
        t: Times = None,
    ) -> Joints:
        """Torque of the servos at the joints, their friction taken off: what moves links and
        rotors. End stops and a plane are no part of a servo, `replay` has them.

        Dry friction is a straight line at speeds below `RESTING`; an integrating servo begins
        where it bears the arm at rest.

        Args:
            q, dq: (*batch, T, n) in the unit of the logs [rad, rad/s].
            command: (*batch, T, n) that came with them, from the beginning on.
            t: (T,) evenly spaced [s].

        Returns:
            (*batch, T, n) [N m; N].

        Raises:
            TorchidError: no commands or times, or signals of other joints.
        """
        arm = self._arm
        if command is None or t is None:
            raise TorchidError(
                "the torque of a servo follows from what it was commanded until then.",
                got="no times" if command is not None else "positions and velocities alone",
                expected="`torque(q, dq, command, t)`, commands (*batch, T, n) and times (T,)",
                hint="`replay` moves the arm by its commands",
            )
        signals = joint_signals(arm.robot.n, command=command, q=q, dq=dq)
        goal, at, speed = (x * arm.scale.to(x) for x in torch.broadcast_tensors(*signals))
        times = as_tensor(t, "t").to(at)
        if at.ndim < 2 or times.shape != at.shape[-2:-1] or len(times) < 2:
            raise TorchidError(
                "times do not fit the motion.",
                got=f"t of shape {tuple(times.shape)}, q of {tuple(at.shape)}",
                expected="q, dq, command (*batch, T, n), t (T,) with T of 2 or more",
            )
        flat = [x.reshape(-1, *x.shape[-2:]).unbind(1) for x in (goal, at, speed)]
        drives = ServoTorque(
            arm.robot, replace(arm.servos, joint=self.joint), environments=len(flat[0][0]),
            device=at.device, dtype=at.dtype, dt=interval(times), fields=True,
        )  # fmt: skip
        each = [drives.torque(*instant) for instant in zip(*flat, strict=True)]
        return torch.stack(each, 1).reshape(at.shape)

    forward = torque

    def replay(self, logs: LogLike, *, windows: float | None = None) -> Replay:
        """Where the arm would have gone with the commands of logs: `torchid.replay`."""
        return replay(self.arm, logs, windows=windows)

    def sample(self, k: int, seed: int = 0) -> list["ServoModel"]:
        """Models drawn from what the diagnosis leaves open (`torchid.randomise`).

        Args:
            k: how many.
            seed: of the draws.

        Raises:
            TorchidError: it is of a file, which says standard deviations alone, or k is no such
                number.
        """
        require_count(k, "models")
        if self._posterior is None:
            raise TorchidError(
                f"the model of '{self._arm.robot.name}' does not say how sure it is.",
                got="servos with a standard deviation each, or none",
                expected="the diagnosis that found them: `load_model(found)`",
            )
        drawn = randomise_positions(self._posterior, 0.95, self._arm.robot, max(2, k), seed).draws
        assert isinstance(drawn, Servos)
        servos = (replace(self._arm.servos, joint=joint) for joint in drawn.joint[:k])
        return [ServoModel(replace(self._arm, servos=one)) for one in servos]


def load_model(
    model: RobotLike | ServoArm | TorqueDiagnosis | PositionDiagnosis | GapRecord,
) -> ArmModel | ServoModel:
    """A corrected model as a torch module, to compute with, differentiate and train.

    Args:
        model: a file that `torchid gap --save-model` wrote, or any robot's; the JSON of a
            diagnosis; a diagnosis, its `corrected`, or a Robot.

    Returns:
        An `ArmModel` with `torque`, `parts`, `forward_dynamics`, `sample`; of servos a `ServoModel`
        with `torque`, `replay`, `sample`.

    Raises:
        RobotError: no such robot, or one without inertial parameters.
        TorchidError: the JSON of a diagnosis of positions, which does not hold its servos' model.

    >>> import torch, torchid
    >>> model = torchid.load_model("3r_friction")
    >>> q = torch.linspace(-1, 1, 50)[:, None] * torch.tensor([1.0, 0.5, -0.7])
    >>> model.torque(q, torch.ones_like(q), torch.zeros_like(q)).shape
    torch.Size([50, 3])
    """
    if isinstance(model, str | Path):
        if Path(model).suffix.lower() == ".json":
            return load_model(load(model))  # type: ignore[arg-type]
        arm = ServoArm.of_file(model)
        return ArmModel(model) if arm is None else ServoModel(arm)
    if isinstance(model, ServoArm):
        return ServoModel(model)
    if isinstance(model, PositionDiagnosis):
        return ServoModel(model.corrected, model.record)
    if isinstance(model, TorqueDiagnosis):
        return ArmModel(model.corrected, model.record)
    if isinstance(model, GapRecord):
        return ArmModel(model.corrected, model)
    if isinstance(model, PositionRecord):
        raise TorchidError(
            f"the result of '{model.robot}' does not hold the corrected model.",
            hint="the .yaml of `torchid gap --save-model`",
        )
    return ArmModel(model)
