"""Torque of models along every trajectory, each fitted without the part that it is shown on."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch

from torchid.design.segments import Samples, Segment, moving_instants
from torchid.gap.diagnosis import Trace
from torchid.gap.folds import Folds
from torchid.log.filtering import low_passed
from torchid.typing import Float, Tensor


@runtime_checkable
class Foretells(Protocol):
    """A model of an arm, or a file of it in a simulator."""

    def torque(self, segment: Segment, samples: Samples) -> Float[Tensor, "T n"]:
        """Torque that the motion of a segment takes [N m; N]."""


def traces(
    samples: Samples,
    folds: Folds | None,
    before: Sequence[Foretells],
    after: Sequence[Foretells],
    band: float,
    *,
    reach: Float[Tensor, " n"] | None = None,
) -> list[Trace]:
    """Torque before and after along every segment, each instant by the models of its own fold.

    Args:
        samples: of the segments.
        folds: None where all segments are held out from one pair of models.
        before, after: one model a fold, or one for all.
        band: low-pass of what is reported [Hz].
        reach: (n,) how near to a joint's reversal instants do not count for how far the gap closes
            [s]; None where all count.
    """
    out = []
    for k, segment in enumerate(samples.segments):
        owner = torch.zeros(segment.length, dtype=torch.long)
        valid = torch.zeros(segment.length, dtype=torch.bool)
        valid[samples.edge : segment.length - samples.edge] = True
        if folds is not None:
            own = samples.bounds[k]
            # Every instant belongs to the fold of the nearest sample; those at a border to none.
            index = (torch.arange(segment.length) - samples.edge) // samples.step
            index = index.clamp(0, own.stop - own.start - 1)
            owner = folds.fold[own][index]
            valid &= ~folds.border[own][index]
        torques = []
        for models in (before, after):
            # Each model's torque is computed once, and taken where its fold is.
            tau = torch.zeros_like(segment.tau)
            shared: dict[int, Tensor] = {}
            for f in owner.unique().tolist():
                model = models[f] if len(models) > 1 else models[0]
                if id(model) not in shared:
                    shared[id(model)] = model.torque(segment, samples)
                tau = torch.where((owner == f).unsqueeze(-1), shared[id(model)], tau)
            torques.append(low_passed(tau.T, segment.rate, band).T)
        out.append(
            Trace(
                segment.name,
                segment.rate,
                segment.motion,
                low_passed(segment.tau.T, segment.rate, band).T,
                torques[0],
                torques[1],
                valid,
                moving_instants(segment, reach),
                segment.stamp,
            )
        )
    return out
