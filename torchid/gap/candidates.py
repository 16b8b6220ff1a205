"""Columns of every effect on every joint, for whole grids of shapes, as rows of the least squares.

Columns are evaluated in the wide band, filtered and whitened like the torque.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor_chunks
from torchid.effects.base import Coefficient, Effect, JointEffect, ModelEffect, Motion
from torchid.effects.registry import KINDS, Valued, in_rounds, model_torque
from torchid.effects.transient import Contact
from torchid.gap.bank import Bank, Place
from torchid.gap.passages import Rows
from torchid.gap.prediction import predicted_torque, smoothed
from torchid.gap.windows import best_windows
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

AT_ONCE = 64
"""Signals filtered at a time: bounds the memory of a search over long logs."""

Whiten = Callable[[Tensor, int], Tensor]
"""Rows (..., N) of a joint to whitened rows."""


class Evaluator:
    """Evaluates columns along passages for the present model.

    Args:
        robot: with the parameters of the present model.
        effects: of the present model, with coefficients.
        rows: of the passages.
        whiten: see `Whiten`.
    """

    def __init__(self, robot: Robot, effects: Sequence[Valued], rows: Rows, whiten: Whiten):
        self.robot = robot
        self.rows = rows
        self.whiten = whiten
        self.effects = tuple(effects)
        self.given = self.effects
        first, _ = in_rounds(effects)
        loads = [model_torque(robot, first, p.motion) for p in rows.passages]
        self.motions = [
            p.motion._replace(torque=load) for p, load in zip(rows.passages, loads, strict=True)
        ]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def with_whitener(self, whiten: Whiten) -> "Evaluator":
        """The same model, rows scaled in another way."""
        other = Evaluator(self.robot, self.effects, self.rows, whiten)
        other.given = self.given
        return other

    def with_model(self, robot: Robot, effects: Sequence[Valued]) -> "Evaluator":
        """The same rows, another model."""
        other = Evaluator(robot, effects, self.rows, self.whiten)
        other.given = self.given
        if torch.equal(robot.gravity, self.robot.gravity) and robot.before is self.robot.before:
            other.__dict__["regressor"] = self.regressor  # it does not depend on parameters
        return other

    def residual(self) -> Float[Tensor, "n N"]:
        """Whitened rows of the measured torque minus the model's."""
        passages = self.rows.passages
        predicted = (predicted_torque(self.robot, self.effects, p, self.rows) for p in passages)
        return self.on_all([(p.tau - tau).T for p, tau in zip(passages, predicted, strict=True)])

    def on_joint(self, signals: Sequence[Tensor], joint: int) -> Float[Tensor, "*batch N"]:
        """Whitened rows (..., N) of signals (..., T_p) of a joint's torque, a few at a time."""
        flat = [x.reshape(-1, x.shape[-1]) for x in signals]
        parts = [
            self.whiten(self.rows.apply([x[k : k + AT_ONCE] for x in flat]), joint)
            for k in range(0, flat[0].shape[0], AT_ONCE)
        ]
        return torch.cat(parts).reshape(*signals[0].shape[:-1], -1)

    def on_all(self, signals: Sequence[Tensor]) -> Float[Tensor, "*batch n N"]:
        """Whitened rows (..., n, N) of signals (..., n, T_p), one row a joint's torque."""
        rows = [self.on_joint([x[..., j, :] for x in signals], j) for j in range(self.n)]
        return torch.stack(rows, -2)

    def columns(self, effect: Effect) -> tuple[Place, Float[Tensor, "C R"]]:
        """Whitened columns of one effect, and the rows they are in."""
        if isinstance(effect, JointEffect):
            shapes = torch.tensor([effect.shape_values], dtype=torch.float64)
            return effect.joint, self._joint_columns(type(effect), effect.joint, shapes)[0]
        signals = self._signals(effect)
        place = _place(effect, signals)
        if place is not None:
            return place, self.on_joint([x[:, place] for x in signals], place)
        return None, self.on_all(signals).flatten(1)

    def _signals(self, effect: Effect) -> list[Float[Tensor, "C n _"]]:
        """Columns of a model effect along every passage; in one call where time plays no part."""
        if effect.needs & {"t", "age"}:
            motions = self._smooth if effect.smooth else self.motions
            return [effect.torque_columns(m, self.robot).permute(2, 1, 0) for m in motions]
        together = effect.torque_columns(self._together, self.robot).permute(2, 1, 0)
        return list(together.split([len(m.q) for m in self.motions], -1))

    @cached_property
    def _smooth(self) -> list[Motion]:
        """Motion and torque low-passed like the rows: columns that differentiate the model's torque
        would otherwise be full of the encoder's noise, which the residual shares."""
        return [smoothed(m, self.rows) for m in self.motions]

    @cached_property
    def _together(self) -> Motion:
        """The motion of all passages in one piece."""
        parts = zip(*self.motions, strict=True)
        return Motion(*(None if x[0] is None else torch.cat(x) for x in parts))  # type: ignore[arg-type]

    @cached_property
    def rigid(self) -> Float[Tensor, "M n"]:
        """Torque of the rigid body along all passages."""
        return inverse_dynamics(self.robot, *self._together.state)

    @property
    def load(self) -> Float[Tensor, "M n"]:
        """Torque that effects see, along all passages."""
        return self._together.require("torque", "a comparison")

    def renewed(self, bank: Bank) -> Bank:
        """A bank's columns at this model."""
        effect = bank.members[0][0]
        if effect.shared and bank.place is None:
            return self.shared_bank(type(effect))  # type: ignore[arg-type]
        if isinstance(effect, JointEffect):
            return self.joint_bank(type(effect), effect.joint)
        columns = [self.columns(member[0])[1] for member in bank.members]
        return replace(bank, columns=torch.stack(columns))

    def _joint_columns(
        self, kind: type[JointEffect], joint: int, shapes: Float[Tensor, "S P"]
    ) -> Float[Tensor, "S C N"]:
        """Columns of a joint effect for a list of shapes."""
        own = slice(joint, joint + 1)
        parts = []
        step = max(1, AT_ONCE // len(kind.coefficients))
        for some in shapes.split(step) if len(kind.shapes) else [shapes[:1]]:
            given = [s.reshape(-1, 1, 1) for s in some.unbind(1)]
            signals = [kind.formula(_only(m, own), *given)[..., 0, :] for m in self.motions]
            signals = [x if given else x.unsqueeze(0) for x in signals]
            parts.append(self.on_joint([x.transpose(-1, -2) for x in signals], joint))
        return torch.cat(parts)

    def grid(self, kind: type[JointEffect], joint: int) -> Float[Tensor, "S P"]:
        """Values of the shape parameters tried at first, one combination a row."""
        return kind.grid(self.motions, joint, self.rows.cutoff)

    def joint_bank(
        self, kind: type[JointEffect], joint: int, shapes: Float[Tensor, "S P"] | None = None
    ) -> Bank:
        """All shapes of a joint effect on a joint: of the grid, or the given ones."""
        if shapes is None:
            shapes = self.grid(kind, joint)
        names = [s.name for s in kind.shapes]
        members = tuple(
            (kind(joint, **dict(zip(names, row, strict=True))),) for row in shapes.tolist()
        )
        looks = RIPPLE_LOOKS if kind.name == "cogging" else float(max(1, len(members)))
        return Bank(
            kind.name,
            joint,
            members,
            self._joint_columns(kind, joint, shapes),
            kind.coefficients,
            looks,
            EXTRA.get(kind.name, 0.0),
            self.known(members[0][0]) if members else (),
        )

    def known(self, effect: Effect) -> tuple[float, ...]:
        """Coefficients that the model has of an effect already; zeros where it has none."""
        total = [0.0] * len(effect.coefficients)
        for other, values in self.given:
            if other == effect:
                total = [a + b for a, b in zip(total, values, strict=True)]
        return tuple(total)

    def model_bank(self, kind: type[ModelEffect]) -> list[Bank]:
        """All instances of a model effect."""
        banks = []
        for effect in kind.candidates(self.robot):
            place, columns = self.columns(effect)
            members = ((effect,),)
            bank = Bank(kind.name, place, members, columns.unsqueeze(0), kind.coefficients, 1.0)
            banks.append(replace(bank, extra=EXTRA.get(kind.name, 0.0)))
        return banks

    def contact_bank(self, r: Float[Tensor, "n N"]) -> Bank:
        """Contacts in the windows in which a force at the tool explains most of a residual."""
        signals = self._signals(Contact())
        columns = self.on_all(signals).reshape(3, self.n, -1)
        t = self.rows.pick([m.require("t", "contact") for m in self.motions])
        windows = best_windows(columns, r, self.rows.bounds)
        half = 0.5 * self.rows.interval
        members = [Contact(float(t[a]) - half, float(t[b - 1]) + half) for a, b in windows]
        return self._contacts(members, signals)

    def _contacts(
        self, members: Sequence[Contact], signals: Sequence[Tensor] | None = None
    ) -> Bank:
        """Bank of given contacts; `signals`: columns of one that lasts all the time."""
        whole = self._signals(Contact()) if signals is None else signals
        columns = []
        for contact in members:
            gates = [contact.window(m.require("t", "contact")) for m in self.motions]
            pairs = zip(whole, gates, strict=True)
            columns.append(self.on_all([x * gate for x, gate in pairs]).flatten(1))
        return Bank(
            Contact.name,
            None,
            tuple((contact,) for contact in members),
            torch.stack(columns),
            Contact.coefficients,
            WINDOW_LOOKS,
            EXTRA[Contact.name],
        )

    def around(self, contact: Contact, level: int) -> Bank:
        """Contacts whose window begins and ends a little earlier or later, ever less so."""
        return self._contacts(contact.around(level, self.rows.interval))

    def shared_bank(
        self, kind: type[ModelEffect], members: Sequence[ModelEffect] | None = None
    ) -> Bank:
        """One coefficient for all joints of an effect that acts on one joint at a time."""
        effects = tuple(kind.candidates(self.robot) if members is None else members)
        signals = [self._signals(e) for e in effects]
        together = [torch.stack(parts).sum(0) for parts in zip(*signals, strict=True)]
        columns = self.on_all(together).flatten(1)
        return Bank(kind.name, None, (effects,), columns.unsqueeze(0), kind.coefficients, 1.0)

    @cached_property
    def regressor(self) -> Float[Tensor, "n 10 n N"]:
        """Whitened rows of the rigid body's regressor, link by link; zero where a joint does not
        feel a link."""
        n = self.n
        out = torch.zeros(n, PARAMETERS_PER_LINK, n, len(self.rows), dtype=torch.float64)
        chunks = [list(regressor_chunks(self.robot, *m.state)) for m in self.motions]
        for j in range(n):
            for link in range(j, n):
                own = [(link, k) for k in range(PARAMETERS_PER_LINK)]
                signals = [torch.cat([c.row(j, own) for c in part], -1) for part in chunks]
                out[link, :, j] = self.on_joint(signals, j)
        return out

    def rigid_bank(self, name: str, effects: tuple[Effect, ...], columns: Sequence[int]) -> Bank:
        """Bank of some of the 10 n rigid parameters (numbers link by link), entering together."""
        flat = self.regressor.reshape(-1, self.n * len(self.rows))
        return Bank(
            name,
            None,
            (effects,),
            flat[list(columns)].unsqueeze(0),
            effects[0].coefficients if effects else ANY * len(columns),
            1.0,
            EXTRA.get(name, 0.0),
        )

    def link_bank(self, effect: Effect, link: int) -> Bank:
        """An effect that is a change of one link's ten parameters."""
        first = link * PARAMETERS_PER_LINK
        numbers = range(first, first + PARAMETERS_PER_LINK)
        return self.rigid_bank(effect.name, (effect,), numbers)


ANY = (Coefficient("", "", False, "a base parameter"),)

EXTRA = {
    "link_inertia": 2.0,
    "all_base": 6.0,
    "cogging": 6.0,
    "torque_crosstalk": 1.0,
    "gear_coupling": 1.0,
    "kinematic_error": 1.0,
    "contact": 6.0,
}
"""Penalties beyond those of the columns, in whitened squared units."""

RIPPLE_LOOKS = 60.0
WINDOW_LOOKS = 300.0
"""Tests that a search over wave numbers, or over windows, counts for: neighbours are related."""


def _only(motion: Motion, own: slice) -> Motion:
    """Motion of one joint."""
    return Motion(
        motion.q[..., own],
        motion.dq[..., own],
        motion.ddq[..., own],
        None if motion.direction is None else motion.direction[..., own],
        motion.t,
        None if motion.torque is None else motion.torque[..., own],
        None if motion.age is None else motion.age[..., own],
        None if motion.sensed is None else motion.sensed[..., own],
    )


def _place(effect: Effect, signals: Sequence[Tensor]) -> Place:
    """The joint whose rows alone hold the columns, if there is one."""
    filled = torch.stack([x.abs().amax((0, 2)) for x in signals]).amax(0) > 0
    hit = filled.nonzero().flatten().tolist()
    return hit[0] if len(hit) == 1 else None


def all_banks(
    evaluator: Evaluator, names: Sequence[str], *, own_velocity: bool, age: bool
) -> Iterator[Bank]:
    """Banks of the named effects, place by place, where their columns can be evaluated."""
    missing = set() if own_velocity else {"velocity"}
    missing |= set() if age else {"age"}
    for name in names:
        kind = KINDS[name]
        if kind.needs & missing:
            continue
        if issubclass(kind, JointEffect):
            for joint in range(evaluator.n):
                if len(evaluator.grid(kind, joint)):  # none for ripple on a joint that never moves
                    yield evaluator.joint_bank(kind, joint)
        elif kind is not Contact:
            assert issubclass(kind, ModelEffect)
            yield from evaluator.model_bank(kind)
            if kind.shared:  # one cause explains them better than many
                yield evaluator.shared_bank(kind)
