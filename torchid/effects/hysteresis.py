"""Friction before sliding: contacts deflect like bristles, so torque depends on the path."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion, Shape
from torchid.effects.scan import affine_scan
from torchid.typing import Float


@dataclass(frozen=True)
class PreslidingHysteresis(JointEffect):
    """Dahl's friction: after a reversal torque builds up over a displacement, not at once.

    The mean deflection z of the bristles, relative to the deflection at which they slide, follows
    dz = (dq - |dq| z) / length, so that |z| <= 1, and torque is Fh z. It depends on the path alone,
    not on speed: LuGre friction at speeds where its bristles' damping and Stribeck's decay do not
    show. Over displacements much larger than the length it is Coulomb friction.

    Over a step without a reversal the equation has an exact solution, so sampling adds no error but
    at reversals between samples. How the bristles stood at first is unknown: z starts at 0, which
    the first few lengths of travel forget.

    Attributes:
        length: displacement over which friction builds up to 1 - 1/e from rest [rad; m].
    """

    length: float = 0.05

    name = "presliding_hysteresis"
    usual = True
    family = "hysteresis"
    branch = "friction"
    detail = "builds up over a distance (presliding)"
    memory = True
    coefficients = (
        Coefficient("Fh", "N m", True, "friction that the bristles reach when they slide"),
    )
    shapes = (
        Shape(
            "length", "rad", 0.001, 1.0, (0.01, 0.02, 0.045, 0.1, 0.2, 0.4), "presliding distance"
        ),
    )
    gloss = "friction that builds up before the joint slides"
    meaning = (
        "Contacts in gear and bearings, and cables, deflect before they slide: a loop in the "
        "torque over position after each reversal."
    )
    equation = "Fh z with dz/dt = (dq - |dq| z)/length"
    signature = "a loop over position after each reversal"
    experiment = "make many small reversals, smaller than the bristle's length"
    remedy = (
        "Replace dry friction by a Dahl or LuGre model with stiffness Fh/length in the simulator."
    )
    source = (
        "Dahl 1968, A Solid Friction Model (TOR-0158); Canudas de Wit, Olsson, Astrom and "
        "Lischinsky 1995, A New Model for Control of Systems with Friction (IEEE TAC 40), eq. 1"
    )
    example = Example((1.0,), "position", {"length": 0.1})

    def __post_init__(self) -> None:
        if not self.length > 0:
            raise ValueError(f"the length must be positive, not {self.length}.")

    @property
    def becomes(self) -> str | None:
        """Coulomb friction, where torque builds up over less than a log usually resolves."""
        return "coulomb_friction" if self.length < 0.5 * self.shapes[0].grid[0] else None

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """z along the trajectory (..., T, n, 1), 0 at its first instant; shapes: length."""
        return cls._bristles(motion.q, motion.q.new_zeros(()), *shapes).unsqueeze(-1)

    def columns_from(
        self, motion: Motion, state: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch T 1"]:
        """Its column on its joint, from bristles that stand somewhere."""
        return self._own(motion, state)

    def after(self, motion: Motion, state: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """How the bristles stand at the last instant."""
        return self._own(motion, state)[..., -1, 0]

    def _own(self, motion: Motion, state: Tensor) -> Float[Tensor, "*batch T 1"]:
        """Deflection of its joint's bristles."""
        q = motion.q[..., self.joint, None]
        return self._bristles(q, state.unsqueeze(-1), q.new_tensor(self.length))

    @classmethod
    def initial(cls, motion: Motion, *shapes: Tensor) -> Tensor:
        """Bristles at rest, z = 0."""
        return torch.zeros_like(motion.q)

    @classmethod
    def advance(
        cls, motion: Motion, dt: float, state: Tensor | None, *shapes: Tensor
    ) -> tuple[Columns, Tensor | None]:
        """z after the displacement dq dt, which is exactly that of a semi-implicit integrator."""
        assert state is not None, "a state from `initial`"
        kept, gained = cls._step(motion.dq * dt, *shapes)
        z = kept * state + gained
        return z.unsqueeze(-1), z

    @classmethod
    def _bristles(
        cls, q: Float[Tensor, "*batch T k"], first: Tensor, *shapes: Tensor
    ) -> Float[Tensor, "..."]:
        """Deflections along positions, from those at the first instant: (..., k), or () for all."""
        kept, gained = cls._step(torch.diff(q, dim=-2, prepend=q[..., :1, :]), *shapes)
        return affine_scan(kept, gained, first)

    @classmethod
    def _step(cls, step: Tensor, *shapes: Tensor) -> tuple[Tensor, Tensor]:
        """Factors of z+ = kept z + gained over a displacement: z+ = s + (z - s) exp(-|step|/length)
        with the step's sign s."""
        (length,) = shapes
        exponent = -step.abs() / length
        return torch.exp(exponent), -torch.sign(step) * torch.expm1(exponent)


@dataclass(frozen=True)
class LoadHysteresis(PreslidingHysteresis):
    """Dahl's friction whose level grows with the joint's torque: geared joints, harmonic drives.

    As `presliding_hysteresis`, with mu |tau| in the place of Fh.
    """

    name = "load_hysteresis"
    needs = frozenset({"torque"})
    coefficients = (
        Coefficient("mu_h", "1", True, "friction per torque when the bristles slide", 0.5),
    )
    gloss = "a friction loop that widens with load"
    meaning = "Teeth under load deflect before they slide: a loop that is wider under more torque."
    equation = "mu_h |tau| z with dz/dt = (dq - |dq| z)/length"
    signature = "a loop over position after each reversal, in proportion to the torque"
    experiment = "make many small reversals under several payloads"
    remedy = "Scale a Dahl or LuGre model's friction with the joint's torque in the simulator."
    example = Example((0.05,), "position", {"length": 0.04})

    @property
    def becomes(self) -> str | None:
        """Load-dependent friction, where it builds up over less than a log usually resolves."""
        return "load_dependent_friction" if super().becomes else None

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """|torque of the model| z (..., T, n, 1); shapes: length."""
        return super().formula(motion, *shapes) * _load(motion)

    def columns_from(
        self, motion: Motion, state: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch T 1"]:
        """Its column on its joint, from bristles that stand somewhere."""
        return self._own(motion, state) * _load(motion)[..., self.joint, :]

    @classmethod
    def advance(
        cls, motion: Motion, dt: float, state: Tensor | None, *shapes: Tensor
    ) -> tuple[Columns, Tensor | None]:
        """Columns after the displacement dq dt."""
        columns, state = super().advance(motion, dt, state, *shapes)
        return columns * _load(motion), state


def _load(motion: Motion) -> Tensor:
    return motion.require("torque", LoadHysteresis.name).abs().unsqueeze(-1)
