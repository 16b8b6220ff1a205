"""What a diagnosed robot becomes in a file that cannot say all of its effects.

Nothing is left out of the model: bodies and what the file knows of each joint are fitted anew to
the torque of the log. An effect without a field is then kept by the others as far as they can, and
by how far follows from the fit itself: its torque is given to the fit as if it were all there is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.design.columns import Columns, Model
from torchid.effects.base import Effect
from torchid.effects.friction import TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import PowerLawFriction, StribeckFriction
from torchid.effects.registry import Valued, nominal_effects
from torchid.effects.spring import JointSpring
from torchid.export.dynamics import folded_robot, records
from torchid.export.record import Kept
from torchid.extraction.entropic import (
    SPREAD,
    NearBodies,
    Quadratic,
    nearest_bodies,
    response,
    room_of,
)
from torchid.feasibility.margins import inertia_eigenvalues
from torchid.gap.data import Data
from torchid.identification.knowledge import known_coefficients
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.knowledge import Knowledge
from torchid.robot.model import Robot
from torchid.simulation.loads import changes_measurement
from torchid.simulation.open_loop import runs, undone
from torchid.simulators.joint_dynamics import CURVES, Target, attributes_in, kinds_in
from torchid.statistics.robust import huber_weights
from torchid.typing import Bool, Float, Tensor

WORDS = {"friction": "frictionloss"} | dict.fromkeys(CURVES.values(), "damping")
"""How the files call what `JointDynamics` calls otherwise; a URDF says friction, too."""

WORTH = 0.02
"""Share of the error that springs must take away to be in the file (a body's weight is one, too),
and so must curves of damping."""

_SPEEDS = 2.0 ** torch.arange(-6.0, 6.25, 0.25, dtype=torch.float64)
"""In units of a joint's fastest in the log: where its damper may not drive it."""
_BETWEEN = 1 / math.cosh(math.log(2.0) / 8)
"""b0 + b1 s + b2 s^2 is nowhere negative between these, if _BETWEEN (b0 + b2 s^2) + b1 s is at none
of them: its least, at s = sqrt(b0 / b2), is within a factor 2^(1/8) of one."""

_CURVED = (PowerLawFriction, StribeckFriction)
"""Friction that is a curve of the joint's speed."""

PRICE = 0.05
"""Share of the error that bodies a person believes may cost before it is said."""

MUCH = 0.1
"""Share of the error that other bodies must take away for those to be let go."""

NOTHING = 1e-3
"""Share of its joint's torque below which a field is left at zero."""


@dataclass(frozen=True, eq=False)
class Projection:
    """A robot that a file can say.

    Attributes:
        robot: nominal kinematics with the fitted bodies, and effects that the file has fields for.
        to: format of the file.
        kept: of every effect of the diagnosis without a field.
        believable: whether masses and centres are near the nominal ones (`room_of`).
        price: error of the fit relative to that of any parameters whatever, minus 1.
        believable_price: the same of the fit whose bodies are believable.
        at_bounds: masses and centres that stand at the ends of what is believable.
    """

    robot: Robot
    to: Target
    kept: tuple[Kept, ...]
    believable: bool
    price: float
    believable_price: float
    at_bounds: tuple[str, ...] = ()

    def odd_links(self, nominal: InertialParameters) -> list[int]:
        """Links with a principal inertia more than `SPREAD` times as large, or as small, as the
        nominal one."""
        inertias = inertia_eigenvalues(self.robot.require_parameters("a correction"))
        ratio = inertias / inertia_eigenvalues(nominal).clamp(min=1e-12)
        return ((ratio > SPREAD) | (ratio < 1 / SPREAD)).any(1).nonzero().flatten().tolist()


class Projector:
    """The fit of a file's fields to a log.

    Args:
        nominal: the robot as given.
        full: the diagnosed one, whose columns and noise count.
        data: of the log.
        to: format of the file.
    """

    def __init__(self, nominal: Robot, full: Robot, data: Data, to: Target):
        self.nominal, self.full, self.to, self.data = nominal, full, to, data
        model = Model.of(full)
        self.columns = Columns(model, data.samples)
        left = self.columns.gap * data.keep
        # Each joint in units of what the full model leaves; rows far out count as their limit.
        rms = (left.square().sum(1) / data.keep.sum(1).clamp(min=1)).sqrt().unsqueeze(1)
        torque = data.samples.of([s.tau.T for s in data.segments])
        rms = rms.clamp(min=1e-6 * float(torque.square().mean().sqrt()))
        self.weight = huber_weights(left) * data.keep / rms
        self.torque = torque
        self.room = room_of(nominal)
        # A joint whose torque says nothing keeps what the nominal robot has there.
        silent = set(data.silent)
        heard = [j for j in range(nominal.n) if j not in silent]
        # Springs and curves are where they are found only.
        every: list[Effect] = [kind(j) for kind in kinds_in(to) for j in heard]
        self.fields = [f for f in every if not isinstance(f, JointSpring | PowerLawFriction)]
        self.given = [
            (effect, values)
            for effect, values in nominal_effects(nominal)
            if effect.joints
            and silent.issuperset(effect.joints)
            and attributes_in(to, effect, values) is not None
        ]
        self._settle(model.effects)

    def _settle(self, effects: Sequence[Valued]) -> None:
        """Which springs and curves the file has, and whether and how near its bodies are
        believable."""
        beyond: list[list[Effect]] = []
        if self.to == "mjcf":
            constant = (JointSpring.name, TorqueOffset.name)
            at = {j for e, _ in effects if e.name in constant for j in e.joints}
            curved = {e.joint for e, _ in effects if isinstance(e, _CURVED)} - {*self.data.silent}
            curves = [PowerLawFriction(j, a) for j in sorted(curved) for a in CURVES]
            beyond = [[JointSpring(j) for j in sorted(at)], [*curves]]
        every = torch.ones(len(self.data.samples), dtype=torch.bool)
        bodies = self.room
        without = self._quadratic(self.fields, every)
        found = nearest_bodies(without, bodies)
        for more in filter(None, beyond):
            before, self.fields = self.fields, [*self.fields, *more]
            beside = self._quadratic(self.fields, every)
            other = nearest_bodies(beside, bodies)
            if other.least < (1 - WORTH) * found.least:
                without, found = beside, other
            else:
                self.fields = before
        # The least that any parameters leave, bodies or not.
        free = torch.linalg.lstsq(without.h, without.b, driver="gelsd").solution
        least = max(without.error(free), 1e-3 * without.square**0.5)
        self.believable_price = max(0.0, found.error / least - 1)
        self.believable = self.believable_price <= PRICE
        if not self.believable:
            other = nearest_bodies(without, bodies.bodies_alone)
            self.believable = other.error > (1 - MUCH) * found.error
            if not self.believable:
                self.room, found = bodies.bodies_alone, other
        self.price = max(0.0, found.error / least - 1)
        self.found, self.quadratic = found, without

    def _matrix(
        self, fields: Sequence[Effect], columns: Columns | None = None
    ) -> Float[Tensor, "K n N"]:
        """Columns of the bodies and of the fields, at the diagnosed model if at no other."""
        own = [(columns or self.columns).on_all_joints(field) for field in fields]
        return torch.cat([self.columns.regressor.flatten(0, 1), *own])

    def _quadratic(
        self,
        fields: Sequence[Effect],
        fitted: Bool[Tensor, " N"],
        torque: Float[Tensor, "n N"] | None = None,
        columns: Columns | None = None,
    ) -> Quadratic:
        """Squared error of the measured torque, or of another one; columns as in `_matrix`."""
        weight = self.weight * fitted
        y = ((self.torque if torque is None else torque) * weight).flatten()
        a = (self._matrix(fields, columns) * weight).flatten(1)
        return Quadratic(a @ a.T, a @ y, float(y @ y), self._signs(fields))

    def _signs(self, fields: Sequence[Effect]) -> Float[Tensor, "C E"]:
        """Sums of the fields' coefficients that are not negative: a file's spring pulls back, and
        its damper resists at every speed."""
        own = [(f, c) for f in fields for c in f.coefficients]
        one = torch.eye(len(own), dtype=torch.float64)
        row = {f: one[k] for k, (f, _) in enumerate(own)}
        alone = [c.non_negative or (c.name == "k" and f in self.fields) for f, c in own]
        rows = [one[torch.tensor(alone).bool()]]
        for j in range(self.nominal.n):
            powers = [ViscousFriction(j), *(PowerLawFriction(j, a) for a in CURVES)]
            if set(powers).issubset(row):
                s = _SPEEDS * max(float(m.dq[:, j].abs().max()) for m in self.columns.motions)
                damper = torch.stack([row[f] for f in powers])
                at = torch.stack([_BETWEEN * s**0, s, _BETWEEN * s**2], 1)
                rows += [at @ damper, damper[-1:]]
        return torch.cat(rows)

    def projection(self) -> Projection:
        """The fit to all samples."""
        return Projection(
            self._robot(self.fields, self.found),
            self.to,
            self._kept(),
            self.believable,
            self.price,
            self.believable_price,
            self.room.touched(self.found.pi),
        )

    def without(self, fitted: Bool[Tensor, " N"]) -> Robot:
        """The same fit to some samples only."""
        torque = self._quadratic(self.fields, fitted)
        strength = self.found.strength
        return self._robot(self.fields, nearest_bodies(torque, self.room, strength=strength))

    def with_effects(self, fitted: Bool[Tensor, " N"]) -> Robot:
        """A fit to some samples of the fields together with the effects that a simulation adds to
        the file at run time, and those in the torque sensors as they were diagnosed."""
        others, sensed = [], []
        for effect, values in nominal_effects(self.full):
            if effect.inertial or not runs(self.full, effect, values):
                continue
            if changes_measurement(effect):
                sensed.append((effect, values))
            elif isinstance(effect, PowerLawFriction) or not self._has_field(effect, values):
                others.append(effect)
        # A spring of the diagnosis stands in the place of the file's, and its friction in that of
        # curves.
        at = {e.joints for e in others if isinstance(e, JointSpring)}
        straight = [f for f in self.fields if not isinstance(f, PowerLawFriction)]
        own = [f for f in straight if not isinstance(f, JointSpring) or f.joints not in at]
        fields = [*own, *dict.fromkeys(others)]
        true = undone(self.full, sensed, self.torque.T.unsqueeze(0))[0][0].T
        torque, strength = self._quadratic(fields, fitted, true), self.found.strength
        robot = self._robot(fields, nearest_bodies(torque, self.room, strength=strength))
        # Loads of these bodies are others than those of the diagnosed ones.
        loads = self.columns.at(Model.of(robot))
        torque = self._quadratic(fields, fitted, true, loads)
        robot = self._robot(fields, nearest_bodies(torque, self.room, strength=strength))
        return replace(robot, effects=(*robot.effects, *records(sensed)))

    def _has_field(self, effect: Effect, values: Sequence[float]) -> bool:
        """Whether the file says this effect as it is."""
        own = [*self.fields, *(given for given, _ in self.given)]
        known = attributes_in(self.to, effect, values) is not None
        return known and any(f.identity == effect.identity for f in own)

    def _word(self, field: Effect) -> str:
        """How the file calls what a field of it is."""
        said = attributes_in(self.to, field, [1.0] * len(field.coefficients))
        name = next(iter(said or ()))
        return WORDS.get(name, name)

    def _robot(self, fields: Sequence[Effect], found: NearBodies) -> Robot:
        """Nominal kinematics, fitted bodies, and fields that carry anything."""
        sizes = (self.torque * self.data.keep).square().sum(1).sqrt()
        pairs: list[Valued] = []
        values = iter(found.coefficients.tolist())
        for field in fields:
            own = [next(values) for _ in field.coefficients]
            torque = self.columns.torque(field, own) * self.data.keep
            if bool((torque.square().sum(1).sqrt() > NOTHING * sizes).any()):
                pairs.append((field, own))
        robot = self.nominal.with_parameters(InertialParameters(found.pi))
        robot = replace(robot, effects=records([*pairs, *self.given]))
        return replace(robot, knowledge=self._knowledge(robot, pairs))

    def _knowledge(self, robot: Robot, pairs: Sequence[Valued]) -> Knowledge | None:
        """How sure the file is: as sure as the diagnosed robot, and off by as much as its values
        had to leave that one's."""
        known = self.full.knowledge
        if known is None:
            return None
        # Of a curve another power may have the same name.
        straight = [pair for pair in pairs if not isinstance(pair[0], PowerLawFriction)]
        own, there = (known_coefficients(some) for some in (straight, nominal_effects(self.full)))
        names = [name for name in own if name in known.coefficients and name in there]
        whole = folded_robot(self.full)
        pi = [r.require_parameters("a correction").pi.double() for r in (robot, whole)]
        moved = torch.tensor([own[name] - there[name] for name in names], dtype=torch.float64)
        return known.over(names).shifted(torch.cat([(pi[0] - pi[1]).flatten(), moved]))

    def _kept(self) -> tuple[Kept, ...]:
        """Of every effect without a field, what the fit makes of its torque alone."""
        # Equal effects of several joints are one: a gain of all currents.
        alike: dict[tuple[object, ...], list[Valued]] = {}
        for effect, values in nominal_effects(self.full):
            if not effect.inertial and not self._has_field(effect, values):
                key = (effect.name, tuple(values), effect.shape_values)
                alike.setdefault(key, []).append((effect, values))
        matrix, bodies = self._matrix(self.fields), PARAMETERS_PER_LINK * self.nominal.n_links
        weighted = (matrix * self.weight).flatten(1)
        # Coefficients of each field of the file.
        groups: dict[tuple[str, int], list[int]] = {}
        for k, f in enumerate([field for field in self.fields for _ in field.coefficients]):
            groups.setdefault((self._word(f), f.joints[0]), []).append(k)
        counts = self.data.keep.sum(1).clamp(min=1)
        out = []
        for pairs in alike.values():
            torque = torch.stack([self.columns.torque(*pair) for pair in pairs]).sum(0)
            z = (torque * self.weight).flatten()
            x = response(self.quadratic, self.room, self.found, weighted @ z)
            made, lost = (
                float(((one * self.data.keep).square().sum(1) / counts).sum().sqrt())
                for one in (torque, torque - torch.tensordot(x, matrix, 1))
            )
            lost = min(lost, made)  # what the fit makes for others is not of this effect
            share = 1 - lost / max(made, 1e-300)
            # The field that carries most of what is kept; all bodies are one.
            most = float((x[:bodies] @ weighted[:bodies]).norm())
            joints = tuple(sorted({j for effect, _ in pairs for j in effect.joints}))
            carrier: tuple[str, int | None, float | None] = ("bodies", None, None)
            for (word, j), own in groups.items():
                at = [bodies + k for k in own]
                if (size := float((x[at] @ weighted[at]).norm())) > most:
                    most, carrier = size, (word, j, float(self.found.coefficients[own[0]]))
            out.append(Kept(pairs[0][0].name, joints, share, *carrier, made, lost))
        return tuple(sorted(out, key=lambda one: one.share))
