"""A robot with its effects as a torch module: torque cause by cause, along motions of any batch.

    torque = rigid body + effects on it + effects on the torque of both

Everything is evaluated by what identification, diagnosis and simulation use, and no other way.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.nn import Module, Parameter, ParameterDict

from torchid.dynamics import forward, newton_euler
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.names import PLACES
from torchid.effects.registry import carrying, nominal_effects
from torchid.errors import TorchidError
from torchid.inputs import RobotLike, as_robot
from torchid.results.record import face
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot, free_name
from torchid.tensors import as_tensor, joint_signals, require_count
from torchid.typing import Float, JointMatrix, Joints, Numbers, Tensor

if TYPE_CHECKING:
    from torchid.results.record import Record

Times = Float[Tensor, "..."] | np.ndarray | Sequence[float] | None
State = Float[Tensor, "..."] | None

RIGID = "rigid body"
"""The first of the causes of a torque."""


class ArmModel(Module):
    """The torque of a robot with all its effects, differentiable, on any device and in any dtype.

    Inertial parameters and the effects' coefficients are the module's parameters, in float64. They
    are frozen: `requires_grad_()` makes them trainable.

    Some effects look at other instants: hysteresis at the way so far, a delay or a gear that gives
    way at the torque before and after. The last axis but one of a motion is then time. Hysteresis
    begins at rest, unless a `state` is given.

    Attributes:
        nominal: the rigid body alone, as a robot without effects.
        pi: (L, 10) its inertial parameters.
        values: coefficients of each effect, by the names of `parts`.

    Args:
        robot: with inertial parameters; its name or file will do.
        posterior: a diagnosis' record, of which `sample` draws; the robot's own knowledge if None.

    Raises:
        RobotError: no inertial parameters, or effects that do not exist.

    >>> import torch, torchid
    >>> model = torchid.load_model("3r_friction")
    >>> q = torch.tensor([0.1, -0.4, 0.7])
    >>> parts = model.parts(q, q, q)
    >>> list(parts)[:2], torch.allclose(sum(parts.values()), model.torque(q, q, q))
    (['rigid body', 'viscous_friction 1'], True)
    """

    def __init__(self, robot: RobotLike, posterior: "Record | None" = None):
        super().__init__()
        robot = as_robot(robot)
        pi = robot.require_parameters("a model of its torque").pi
        self.pi = Parameter(pi.clone(), requires_grad=False)
        # The robot's parameters are the module's: what trains or moves these changes them, too.
        bare = replace(robot, effects=(), knowledge=None)
        self.nominal = replace(bare, parameters=InertialParameters(self.pi))
        taken: set[str] = set()
        pairs = [(free_name(_cause(e), taken), e, v) for e, v in nominal_effects(robot)]
        self._kinds = {name: effect for name, effect, _ in pairs}
        values = [(name, torch.tensor(v, dtype=torch.float64)) for name, _, v in pairs]
        # Of pairs, for of a dictionary it would sort the names.
        self.values = ParameterDict(
            [(name, Parameter(v, requires_grad=False)) for name, v in values]
        )
        self._posterior = robot if posterior is None else posterior

    def __repr__(self) -> str:
        return f"ArmModel('{self.nominal.name}', {len(self._kinds)} effects)"

    @property
    def effects(self) -> tuple[dict[str, Any], ...]:
        """The effects with their present values, as a robot's yaml has them; joints from 1."""
        return tuple(e.record(self.values[name].tolist()) for name, e in self._kinds.items())

    @property
    def robot(self) -> Robot:
        """The robot with the present parameters and effects, e.g. for `write_robot`."""
        parameters = InertialParameters(self.pi.detach().clone().cpu())
        return replace(self.nominal, parameters=parameters, effects=self.effects)

    def torque(
        self,
        q: Numbers,
        dq: Numbers,
        ddq: Numbers,
        t: Times = None,
        *,
        state: State = None,
    ) -> Joints:
        """Torque that the motion takes, as the arm's sensors measure it.

        Args:
            q, dq, ddq: (*batch, T, n) [rad, rad/s, rad/s^2; m for prismatic joints]; without
                effects that look at other instants any leading shape.
            t: (T,) or (*batch, T) since the arm was switched on or the log began, evenly spaced
                [s]; where an effect needs it.
            state: (*batch, M) at the first instant, of the M effects with a memory (see `state`).

        Returns:
            (*batch, T, n) [N m; N for prismatic joints].

        Raises:
            TorchidError: signals of other joints, or effects that need times or other instants.
        """
        return _sum(self.parts(q, dq, ddq, t, state=state))

    forward = torque

    def parts(
        self,
        q: Numbers,
        dq: Numbers,
        ddq: Numbers,
        t: Times = None,
        *,
        state: State = None,
    ) -> dict[str, Joints]:
        """The torque by cause, which adds up to `torque`: `rigid body`, then each effect by its
        name and joint (`viscous_friction 2`). Arguments and errors are those of `torque`."""
        motion = self._motion(q, dq, ddq, t)
        states = self._states(motion, state)
        loaded_arm = carrying(
            self.nominal, [(e, self.values[name]) for name, e in self._kinds.items()]
        )
        out = {RIGID: newton_euler.inverse_dynamics(self.nominal, *motion.state)}
        for loaded in (False, True):
            here = motion._replace(torque=_sum(out)) if loaded else motion
            out |= {
                name: _torque(
                    effect,
                    here,
                    self.values[name],
                    self.nominal if effect.inertial else loaded_arm,
                    states.get(name),
                )
                for name, effect in self._kinds.items()
                if ("torque" in effect.needs) is loaded
            }
        return {name: out[name] for name in (RIGID, *self._kinds)}

    def state(self, q: Numbers, state: State = None) -> Float[Tensor, "..."]:
        """State at the last instant of a motion of the M effects with a memory, in the order of
        `effects`: the deflection of the bristles, -1 to 1. A motion that goes on from there begins
        with this instant.

        Args:
            q: (*batch, T, n) [rad; m].
            state: at its first instant; bristles at rest if None.

        Returns:
            (*batch, M).

        Raises:
            TorchidError: positions of other joints, or of one instant alone.
        """
        (q,) = joint_signals(self.nominal.n, q=q)
        motion = Motion(q, q, q)
        before = self._states(motion, q.new_zeros(1) if state is None else state)
        after = [
            effect.after(motion, before[name])
            for name, effect in self._kinds.items()
            if isinstance(effect, JointEffect) and effect.memory
        ]
        return torch.stack(after, -1) if after else q.new_zeros(*q.shape[:-2], 0)

    def forward_dynamics(
        self,
        q: Numbers,
        dq: Numbers,
        tau: Numbers,
        t: Times = None,
        *,
        state: State = None,
    ) -> Joints:
        """Accelerations that a torque gives: the inverse of `torque`, by Newton's method.

        A joint at rest has no dry friction here, in either direction; `torchid.simulate` holds it.

        Args:
            q, dq, tau: (*batch, T, n) [rad, rad/s, N m; m and N for prismatic joints].
            t, state: as of `torque`.

        Returns:
            (*batch, T, n) [rad/s^2; m/s^2 for prismatic joints].

        Raises:
            TorchidError: effects whose torque depends on accelerations at other instants, or a
                torque that no acceleration gives; and as `torque`.
        """
        if around := self._named(lambda e: e.over_time and not _memory(e)):
            raise TorchidError(
                "accelerations do not follow from a torque that depends on other instants, too.",
                got=", ".join(around),
                hint="`rigid=True` of `forward_dynamics`, or a robot without these effects",
            )
        q, dq, tau = joint_signals(self.nominal.n, q=q, dq=dq, tau=tau)
        given = [x.double() for x in torch.broadcast_tensors(q, dq, tau)]

        def missed(ddq: Tensor) -> Tensor:
            return self.torque(given[0], given[1], ddq, t, state=state) - given[2]

        with torch.no_grad():
            found = forward.forward_dynamics(self.nominal, *given)
            found, slopes = _solved(missed, found, given[2], [*self._kinds])
        # One step more carries the gradients of the implicit function.
        step = torch.linalg.solve(slopes, missed(found).unsqueeze(-1)).squeeze(-1)
        return (found - step).to(q)

    def sample(self, k: int, seed: int = 0) -> list["ArmModel"]:
        """Models drawn from what the diagnosis, or the file, leaves open (`torchid.randomise`).

        Args:
            k: how many.
            seed: of the draws.

        Raises:
            TorchidError: neither says how sure it is, or k is no such number.
        """
        require_count(k, "models")
        wide = face("randomise")(self._posterior, draws=max(2, k), seed=seed)
        return [ArmModel(wide.one(i)).to(self.pi.device) for i in range(k)]

    def _named(self, which: Callable[[Effect], bool]) -> list[str]:
        """Names of some of the effects."""
        return [name for name, effect in self._kinds.items() if which(effect)]

    def _motion(self, q: Numbers, dq: Numbers, ddq: Numbers, t: Times) -> Motion:
        """The signals as a motion that all effects can do with."""
        signals = joint_signals(self.nominal.n, q=q, dq=dq, ddq=ddq)
        # The rigid body alone broadcasts by itself, with fewer operations.
        motion = Motion(*(torch.broadcast_tensors(*signals) if self._kinds else signals))
        timed = self._named(lambda e: "t" in e.needs)
        if t is None and timed:
            raise TorchidError(
                "the torque of some effects depends on time, and no times are given.",
                got=", ".join(timed),
                expected="`t=...`, seconds since the arm was switched on or the log began",
            )
        shape = motion.q.shape
        instants = shape[-2] if len(shape) > 1 else 0
        # Bristles stand somewhere at one instant, too.
        around = self._named(lambda e: e.over_time and instants < (1 if _memory(e) else 2))
        if around:
            raise TorchidError(
                "the torque of some effects depends on other instants, and one alone is given.",
                got=f"{', '.join(around)}; q of shape {tuple(shape)}",
                expected="signals (*batch, T, n)",
            )
        if t is None:
            return motion
        return motion._replace(t=_expanded(as_tensor(t, "t"), motion.q, shape[:-1], "t"))

    def _states(self, motion: Motion, state: State) -> dict[str, Tensor]:
        """State (*batch) of each effect with a memory, by its name; empty if None."""
        names = self._named(_memory)
        if state is None or not names:
            return {}
        each = _expanded(state, motion.q, (*motion.q.shape[:-2], len(names)), "the state")
        return dict(zip(names, each.unbind(-1), strict=True))


def _expanded(x: Tensor, like: Tensor, shape: tuple[int, ...], what: str) -> Tensor:
    """A tensor as one of a shape, or a TorchidError that says what does not fit."""
    try:
        return x.to(like).expand(shape)
    except RuntimeError as error:
        raise TorchidError(
            f"{what} does not fit the motion and its effects.",
            got=f"shape {tuple(x.shape)}",
            expected=f"{tuple(shape)}, or its last axis",
        ) from error


def inverse_dynamics(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    ddq: Numbers,
    parameters: InertialParameters | None = None,
    *,
    t: Times = None,
    rigid: bool = False,
) -> Joints:
    """Joint torques of the rigid body, tau = M(q) ddq + S(q, dq) dq + g(q) (eq. 2.15), and of all
    the robot's effects.

    `torchid.load_model` evaluates many motions without reading the robot again, and says which
    cause takes which part of the torque.

    Args:
        robot: kinematics, gravity and effects.
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints]; arrays and lists too,
            in float64. Of tensors the widest dtype counts.
        parameters: (..., L, 10), leading axes broadcast against those of q; the robot's nominal
            ones if None.
        t: (T,) or (..., T) times of q's last axis but one [s], where an effect needs them.
        rigid: leave the effects out.

    Returns:
        (..., n) [N m; N for prismatic joints], positive along the axis.

    Raises:
        RobotError: no parameters given and none in the robot.
        TorchidError: not numbers of all joints; effects that need times, other instants, or one
            set of parameters.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r_friction")
    >>> q = torch.zeros(3, dtype=torch.float64)
    >>> whole, body = (inverse_dynamics(robot, q, q + 0.5, q, rigid=r) for r in (False, True))
    >>> [round(x, 6) for x in (whole - body).tolist()]  # Fv dq + Fc + F0
    [0.17095, 0.09505, 0.13405]
    """
    robot = as_robot(robot)
    if rigid or not robot.effects:
        return newton_euler.inverse_dynamics(robot, q, dq, ddq, parameters)
    return _module(robot, parameters).torque(q, dq, ddq, t)


def forward_dynamics(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    tau: Numbers,
    parameters: InertialParameters | None = None,
    *,
    t: Times = None,
    rigid: bool = False,
) -> Joints:
    """Joint accelerations that a torque gives: the inverse of `inverse_dynamics`, from
    M(q) ddq = tau - S(q, dq) dq - g(q) - effects (eq. 2.15).

    Args:
        robot: kinematics, gravity and effects.
        q, dq: (..., n) [rad, rad/s; m, m/s for prismatic joints]; arrays and lists too, in float64.
        tau: (..., n) [N m; N for prismatic joints], positive along the axis.
        parameters: (..., L, 10), leading axes broadcast against those of q; the robot's nominal
            ones if None.
        t: as of `inverse_dynamics`.
        rigid: leave the effects out.

    Returns:
        (..., n) [rad/s^2; m/s^2 for prismatic joints].

    Raises:
        RobotError: no parameters given and none in the robot.
        TorchidError: not numbers of all joints; effects whose torque depends on other instants, or
            a torque that no acceleration gives.

    >>> import torchid
    >>> robot = torchid.load_robot("3r_friction")
    >>> q, dq, ddq = [0.1, -0.4, 0.7], [1.0, 0.0, -2.0], [3.0, -1.0, 2.0]
    >>> tau = torchid.inverse_dynamics(robot, q, dq, ddq)
    >>> [round(x, 9) for x in forward_dynamics(robot, q, dq, tau).tolist()]
    [3.0, -1.0, 2.0]
    """
    robot = as_robot(robot)
    if rigid or not robot.effects:
        return forward.forward_dynamics(robot, q, dq, tau, parameters)
    return _module(robot, parameters).forward_dynamics(q, dq, tau, t)


def _module(robot: Robot, parameters: InertialParameters | None) -> ArmModel:
    """The model of a robot with these parameters, or its own; gradients go to what is given."""
    if parameters is not None:
        robot = robot.with_parameters(parameters)
    own = robot.require_parameters("a model of its torque")
    if own.pi.ndim > 2:
        raise TorchidError(
            f"the effects of '{robot.name}' are of one set of inertial parameters.",
            got=f"{tuple(own.pi.shape)}",
            expected=f"({robot.n_links}, 10)",
            hint="`rigid=True` leaves the effects out",
        )
    model = ArmModel(robot)
    model.nominal = replace(model.nominal, parameters=own)
    return model


def _cause(effect: Effect) -> str:
    """`torque_crosstalk 2 from 4`: an effect by name and joints, from 1."""
    places = [str(getattr(effect, p) + 1) for p in PLACES if hasattr(effect, p)]
    return " ".join([effect.name, *([" from ".join(places)] if places else [])])


def _memory(effect: Effect) -> bool:
    return isinstance(effect, JointEffect) and effect.memory


def _sum(parts: dict[str, Joints]) -> Joints:
    first, *others = parts.values()
    for one in others:
        first = first + one
    return first


def _torque(
    effect: Effect, motion: Motion, values: Tensor, robot: Robot, state: Tensor | None
) -> Joints:
    """Torque (*batch, T, n) of an effect along motions of any batch."""
    if isinstance(effect, JointEffect):
        columns = effect.columns(motion) if state is None else effect.columns_from(motion, state)
        own = columns @ values.to(columns)
        return torch.nn.functional.pad(
            own.unsqueeze(-1), (effect.joint, motion.q.shape[-1] - 1 - effect.joint)
        )
    shape = motion.q.shape
    # Those that look at other instants take one trajectory at a time, the others any instants.
    axes = 2 if effect.over_time else 1
    flat = (None if x is None else x.reshape(-1, *x.shape[len(shape) - axes :]) for x in motion)
    if axes == 1:
        return effect.all_torques(Motion(*flat), values, robot).reshape(shape)  # type: ignore[arg-type]
    signals = {
        name: x.unbind() for name, x in zip(Motion._fields, flat, strict=True) if x is not None
    }
    each = [
        effect.all_torques(Motion(**dict(zip(signals, one, strict=True))), values, robot)
        for one in zip(*signals.values(), strict=True)
    ]
    return torch.stack(each).reshape(shape) if each else torch.zeros_like(motion.q)


def _solved(
    missed: Callable[[Tensor], Tensor], start: Tensor, size: Tensor, effects: Sequence[str]
) -> tuple[Joints, JointMatrix]:
    """Accelerations at which no torque is missed, and the derivative of that.

    Args:
        missed: torque (..., n) that accelerations (..., n) are off by.
        start: where to begin.
        size: (..., n) of the torque.
        effects: to be named where there is no solution.
    """
    n, found = start.shape[-1], start
    # Of the finite difference in acceleration, in which torque is linear but for kinks [rad/s^2;
    # m/s^2]
    acceleration_step = 1e-3
    units = acceleration_step * torch.eye(n).to(start).view(n, *(1,) * (start.ndim - 1), n)
    # 30: Newton steps at most
    for _ in range(30):
        error = missed(found)
        slopes = ((missed(found + units) - error) / acceleration_step).movedim(0, -1)
        # 1e-9: torque that accelerations may miss, relative to the largest, where they are found
        if bool((error.abs() <= 1e-9 * (1 + size.abs())).all()):
            # 1e8: condition of torque per acceleration from which on the one does not tell the
            # other
            if bool((torch.linalg.cond(slopes) < 1e8).all()):
                return found, slopes
            break
        found = found - torch.linalg.solve_ex(slopes, error.unsqueeze(-1))[0].squeeze(-1)
    raise TorchidError(
        "no acceleration gives this torque with the model's effects, or many do.",
        got=", ".join(effects),
        hint="a sensor that clips hides what the torque is",
    )
