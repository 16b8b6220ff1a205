"""A family of sets with equal torque, its errors, and what statistics want to know of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.extraction.equal_torque.sample import FEASIBLE, EqualTorqueSets, equal_torque_sets
from torchid.extraction.equal_torque.space import equal_torque_space
from torchid.feasibility.margins import LINK_CONDITIONS, Feasibility, feasibility
from torchid.robot.inertia import InertialParameters
from torchid.study.equal_torque.force_reach import force_squares
from torchid.study.equal_torque.setting import Setting
from torchid.study.equal_torque.statistics import Samples
from torchid.typing import Float, Tensor
from torchid.wrenches.classes import class_of, ordered_classes
from torchid.wrenches.compare import Comparison, compare
from torchid.wrenches.deviation import WrenchErrors, wrench_errors

_REPORTS_PAIR = ("CoM only", "inertia only")
_CONDITION_KINDS = {
    "mass": "mass",
    "eigenvalue": "inertia",
    "triangle": "inertia",
    "shape": "shape",
}


@dataclass(frozen=True, eq=False)
class Drawn:
    """A family of sets with equal torque, and its errors against the reference.

    Attributes:
        setting: where it is from.
        family: the sets.
        checked: their feasibility.
        errors: of their wrenches.
        squares: (n, D, D) see `force_squares`.
        z: (K, D) the sets' coordinates in the null space.
    """

    setting: Setting
    family: EqualTorqueSets
    checked: Feasibility
    errors: WrenchErrors
    squares: Float[Tensor, "n D D"]
    z: Float[Tensor, "K D"]

    @property
    def carried(self) -> Float[Tensor, "K n"]:
        """(K, n) difference of the mass that each joint carries [kg]."""
        sets, reference = self.family.sets.parameters, self.setting.reference.parameters
        return (sets.mass - reference.mass).flip(-1).cumsum(-1).flip(-1)

    def samples(self) -> Samples:
        """For the statistics."""
        return Samples(
            kind=np.array(self.family.kind),
            error=self.errors.force_rms.amax(-1).numpy(),
            degree=self.degree.numpy(),
            carried=self.carried.abs().amax(-1).numpy(),
            coordinates=self.checked.violated[..., 3:6].sum((1, 2)).numpy(),
            tightest=self.tightest(),
            cluster=self.family.cluster.numpy(),
        )

    def distances(self) -> np.ndarray:
        """(F, K) force error of each set if feasible set f is the truth: by joint from z'G z."""
        feasible = [k for k, own in enumerate(self.family.kind) if own == FEASIBLE]
        largest = self.z.new_zeros(len(feasible), len(self.z))
        for square in self.squares:
            values, vectors = torch.linalg.eigh(square)
            y = self.z @ (vectors * values.clamp(min=0.0).sqrt())
            largest = torch.maximum(largest, torch.cdist(y[feasible], y))
        return largest.numpy()

    def compared(self, resamples: int, seed: int, errors: WrenchErrors | None = None) -> Comparison:
        """By class and degree; each class against the feasible, and CoM against inertia."""
        reasons = [self.checked.reasons(k) for k in range(len(self.z))]
        present = ordered_classes(class_of(r) for r in reasons)
        pairs = [(name, present[0]) for name in present[1:]]
        pairs += [_REPORTS_PAIR] if set(_REPORTS_PAIR) <= set(present) else []
        return compare(
            (errors or self.errors).force_rms.amax(-1),
            reasons,
            self.degree,
            cluster=self.family.cluster,
            pairs=pairs,
            resamples=resamples,
            seed=seed,
        )

    @property
    def degree(self) -> Float[Tensor, " K"]:
        """(K,) smallest degree of the conditions on the links and on the total mass: coefficients
        of effects are the same in all sets."""
        return self._degrees().amin(-1)

    def tightest(self) -> np.ndarray:
        """(K,) kind of the condition with the smallest degree."""
        names = [_CONDITION_KINDS.get(c, "com") for c in LINK_CONDITIONS]
        names = [*names * self.checked.degrees.shape[1], "total_mass"]
        return np.array(names)[self._degrees().argmin(-1).numpy()]

    def _degrees(self) -> Float[Tensor, "K C"]:
        links = self.checked.degrees.flatten(1)
        return torch.cat([links, self.checked.total_mass_degree.unsqueeze(-1)], -1)


def draw(
    setting: Setting, motion: Motion, kinds: Sequence[str], per_kind: int, chains: int, seed: int
) -> Drawn:
    """Draw the sets of each kind and compare their wrenches with the reference's.

    Raises:
        TorchidError: there is no other feasible set, so nothing to compare with.
    """
    reference = setting.reference
    family = equal_torque_sets(
        setting.robot,
        setting.base,
        reference,
        setting.conditions,
        setting.outer,
        kinds=kinds,
        per_kind=per_kind,
        seed=seed,
        chains=chains,
    )
    if family.kind.count(FEASIBLE) < 2:
        raise TorchidError(
            "no feasible sets with the reference's torque were found beside it.",
            got=f"bounds '{setting.geometry}' and '{setting.outer.name}'",
            hint="wider boxes, or a reference with a larger margin",
        )
    space = equal_torque_space(reference, setting.base, setting.conditions, setting.outer)
    own = InertialParameters(reference.parameters.pi[0])
    rigid = family.sets.parameters
    return Drawn(
        setting=setting,
        family=family,
        checked=feasibility(family.sets, setting.conditions),
        errors=wrench_errors(setting.robot, *motion.state, rigid, own),
        squares=force_squares(setting.robot, motion, space.directions),
        z=(rigid.to_paper_order() - space.x) @ space.directions,
    )
