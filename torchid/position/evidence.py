"""How sure an effect of a servo is: by the criterion of causes of torques (`gap.causes.evidence`),
about the motion that is simulated.

Without an effect a joint leaves L0 in windows of 2 s, with it L1. The evidence for it is

    n/2 log((L0 + F) / (L1 + F)) - 1/2 x'P x - 1/2 log|I + P^-1/2 G P^-1/2| - price

with x what its numbers are beside what was expected, P the inverse covariance of that, and G what
the log tells of them beside the joint's others. F is what is known beforehand to be none of a
servo's: what repeats leave, or an encoder's count and a share of the distance between command and
position. n are the rows over the time for which the noise is alike: what is left as it shows
itself, what is known beforehand for a second. That noise is louder where an effect acts takes no
rows away here, unlike of torques: an effect that acts in few windows leaves its loudest errors
there while it is missing, and its size would be held against it.

A probability is a mean over logs that might have been, windows drawn again; what the answer leaves
on motions that were left out bounds it.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from torchid.effects.servo import INDEX, PARAMETERS, ServoEffect
from torchid.position.effects import EFFECTS
from torchid.position.fit import TOGETHER_S, errors_of_one, loss, prior_deviations, searched
from torchid.position.judge import Equations, alike_rows
from torchid.position.servo_model import Motions
from torchid.simulation.servo import Servos
from torchid.statistics.bagging import Draws
from torchid.statistics.evidence import most_sure, price_of, probabilities_of
from torchid.typing import Float, Tensor


def samples_of(
    motions: Motions,
    floor: Float[Tensor, " n"],
    left: Float[Tensor, " n"],
    alike: Float[Tensor, " n"],
) -> Float[Tensor, " n"]:
    """Rows (n,) that count where both kinds of noise are.

    Args:
        motions: whose windows are counted.
        floor: losses that are known beforehand to be none of a servo's [rad^2].
        left: losses that the better explanation leaves [rad^2].
        alike: rows, one after the other, in which these are as good as one [1].
    """
    together = TOGETHER_S / motions.data.tracks.dt
    times = (left * alike + floor * together) / (left + floor).clamp(min=1e-300)
    return motions.windows.rows / times.clamp(min=1.0)


def price_beside(motions: Motions) -> float:
    """What looking for a cause on all joints that move costs [nats]."""
    return price_of(len(EFFECTS) * int((~motions.data.still).sum()))


@dataclass(frozen=True, eq=False)
class LeastFall:
    """Fall of losses from which a cause is likelier than none, where servos explain the rest.

    Attributes:
        left: (n,) losses that these leave [rad^2].
        floor: (n,) of them that are known beforehand to be none of a servo's [rad^2].
        samples: (n,) that count.
        price: of a cause [nats].
    """

    left: Float[Tensor, " n"]
    floor: Float[Tensor, " n"]
    samples: Float[Tensor, " n"]
    price: float

    @classmethod
    def beside(cls, motions: Motions, servos: Servos) -> "LeastFall":
        """Where these servos are the better explanation."""
        residual, windows = errors_of_one(motions.data, servos, motions.windows), motions.windows
        left, floor = loss(residual[..., None], windows)[:, 0], motions.slight
        samples = samples_of(motions, floor, left, alike_rows(residual, windows))
        return cls(left, floor, samples.clamp(min=2.0), price_beside(motions))

    def told(self, losses: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Nats by which the log is less likely with servos that leave these losses [rad^2]."""
        return 0.5 * self.samples * ((losses + self.floor) / (self.left + self.floor)).log()

    def paid(self, numbers: int, at: int | slice | list[int]) -> float:
        """What numbers of a cause on some joints cost, as much as samples tell of them [nats]."""
        return 0.5 * numbers * math.log(float(self.samples[at].sum()))

    def of(
        self, numbers: float | Float[Tensor, " n"], fewer: float | Float[Tensor, " n"] = 0.0
    ) -> Float[Tensor, " n"]:
        """Of a cause with so many numbers, in the place of so many causes of one [rad^2]: each
        costs as much as samples tell of it."""
        paid = (1 - fewer) * self.price + 0.5 * (numbers - fewer) * self.samples.log()
        return (self.left + self.floor) * (2 * paid / self.samples).expm1()

    def risen(
        self, motions: Motions, losses: Float[Tensor, "W n"], causes: Float[Tensor, " n"]
    ) -> Float[Tensor, "W n"]:
        """Losses of windows that tell as much against them as if they paid for causes, too."""
        paid = causes * (self.price + 0.5 * self.samples.log())
        share = motions.windows.length * motions.windows.weight / motions.windows.rows
        floor = share[:, None] * self.floor
        return (losses + floor) * (2 * paid / self.samples).exp() - floor


@dataclass(frozen=True, eq=False)
class Evidence:
    """What effects of servos are held against.

    Attributes:
        motions: windows, as a search looks at them.
        known: the answer.
        noise: (n,) RMS errors that are known beforehand to be none of a servo's [rad].
        left: (n,) mean squared errors of motions left out that have no cause [rad^2].
        whole: their share of the arm's.
    """

    motions: Motions
    known: Equations
    noise: Float[Tensor, " n"]
    left: Float[Tensor, " n"]
    whole: float

    def sure(
        self,
        effect: ServoEffect,
        joint: int | None,
        without: Float[Tensor, "W n"],
        with_it: Float[Tensor, "W n"],
        numbers: int,
        joints: int = 1,
    ) -> float:
        """Probability of an effect, or of the set with what does as well in its place.

        Args:
            effect: which.
            joint: where, from 0; None of what all feel.
            without, with_it: losses of windows [rad^2].
            numbers: that it has.
            joints: that have it, as one cause of them all.
        """
        windows = self.motions.windows
        at = slice(None) if joint is None else slice(joint, joint + 1)
        before, after, floor, alike, rest = (
            x[..., at].double()
            for x in (without, with_it, self.noise.square(), self.known.alike, self.left)
        )
        rows = windows.length * windows.weight
        floor, left = floor * rows.sum(), after.sum(0)
        samples = samples_of(self.motions, floor, left, alike)
        draws = Draws.of(torch.arange(len(rows)))
        if effect.family == "world":
            # What acts at the ends of the travel alone is in each log that is drawn.
            gain = (before - after).sum(1)
            # 0.1: of the most that a window gains, from which it acts there
            draws = draws.parting(gain >= torch.minimum(0.1 * gain.max(), gain.max()))
        share = draws.sums(rows[None])[:, 0] / rows.sum()
        drawn = [draws.sums(x.T) + floor * share[:, None] for x in (before, after)]
        told = (drawn[0].clamp(min=1e-300) / drawn[1].clamp(min=1e-300)).log()
        ratio = (0.5 * samples * share[:, None] * told).sum(1)
        paid = price_beside(self.motions) / joints
        paid += self.cost(effect, joint, float(samples.sum()), numbers)
        # A log of half the windows has half of the price, too.
        weight = draws.times.sum(1) / draws.times.shape[1]
        rises = np.stack([np.zeros(len(share)), -(ratio - weight * paid).numpy()])
        fall = (before.sum(0) - left) / rows.sum()
        each = 0.5 * samples * ((before.sum(0) + floor) / (left + floor)).log()
        tells, takes, leaves = (x.clamp(min=0).numpy() for x in (each, fall, rest))
        bound = most_sure(tells, takes, leaves, self.whole)
        return min(probabilities_of(rises)[0], bound)

    def cost(self, effect: ServoEffect, joint: int | None, samples: float, numbers: int) -> float:
        """Of an effect's numbers: how far they are from what was expected, and how much better the
        log knows them than that [nats]."""
        known = self.known
        mask = known.mask[0 if joint is None else joint]
        own = mask & torch.tensor([name in effect.parameters for name in known.names])
        if joint is None or not bool(own.any()):  # a plane's or a load's: to the root of the rows
            return 0.5 * numbers * math.log(max(samples, 2.0))
        spread = prior_deviations(known.names)
        gram = known.gram[:, joint].sum(0) / known.noise[joint].clamp(min=1e-300)
        told = torch.eye(len(spread), dtype=gram.dtype) + spread[:, None] * gram * spread
        whole, others = (float(torch.logdet(told[on][:, on])) for on in (mask, mask & ~own))
        at = [INDEX[name] for name in known.names]
        neutral = torch.tensor([PARAMETERS[k].neutral for k in at], dtype=gram.dtype)
        logs = torch.tensor([PARAMETERS[k].kind == "log" for k in at])
        away = (searched(known.servos)[joint, at] - neutral) / spread
        # Where a limit is, or how large a gain, nothing was expected beforehand.
        away = torch.where(logs | ~neutral.isfinite(), 0.0, away)[own]
        return 0.5 * (whole - others + float(away.square().sum()))
