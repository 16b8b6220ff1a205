"""How well servos are known: by how much motions disagree, and by how much noise alone allows.

Per motion, the normal equations of every joint at the fitted servos tell where that motion pulls;
their spread is a jackknife with motions as blocks (see `statistics.jackknife`). What servos leave
is mostly misfit, which sits in the motion that tells a number, so each block counts as left out.
Of few motions, or one alone, that variance is hardly known: it is drawn towards the noise's, alike
for as long as its correlation says, times what is usual on the arm's other numbers (Smyth 2004).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from torchid.effects.servo import INDEX, PARAMETERS, TORQUES
from torchid.position.data import SMALL, PositionData
from torchid.position.fit import (
    VALLEYS,
    mean_square,
    moved,
    prior_deviations,
    prior_precision,
    searched,
    sensitivities,
    step_by,
    weights,
)
from torchid.results.agreement import MotionScale, Replication
from torchid.results.replication import replication_of
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Windows
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.criteria import TORQUE_MISFIT
from torchid.statistics.jackknife import jackknife, student_quantile
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float

USUAL = 2.0
"""Motions that what is usual on an arm counts as, beside a number's own [1]."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of every joint and motion, at one set of servos.

    Attributes:
        servos: where they hold.
        names: the K parameters.
        mask: (n, K) where each is free.
        gram: (m, n, K, K), pull: (m, n, K) of motions.
        square: (n,) mean square error [rad^2].
        rows: of the motions [1].
        alike: (n,) rows, one after the other, whose errors are as good as one [1].
        torque_std: (n,) of the scale of all torques of a joint, which the robot's masses have [1].
        away: (n, K) searched coordinates beside what was expected of them; 0 where nothing was.
        told: (n, K, K) covariances that are known already; None: as the equations tell.
    """

    servos: Servos
    names: tuple[str, ...]
    mask: Tensor
    gram: Tensor
    pull: Tensor
    square: Tensor
    rows: float
    alike: Tensor
    torque_std: Tensor
    away: Tensor
    told: Tensor | None = None

    @property
    def noise(self) -> Float[Tensor, " n"]:
        """Mean square error of rows as if each were independent [rad^2]."""
        return self.alike * self.square

    @property
    def prior(self) -> Float[Tensor, "n K"]:
        """Precision of what was expected."""
        return prior_precision(self.names, self.square, self.alike[:, None])

    def without(self, gone: Bool[Tensor, " m"]) -> Servos:
        """Servos as the other motions alone tell them: a step of Gauss-Newton, for which nothing is
        simulated. Limits of set-points, over which no slope leads, stay."""
        moves = self.mask & torch.tensor([name not in VALLEYS for name in self.names])
        both = moves[:, :, None] & moves[:, None]
        gram = self.gram[~gone].sum(0) + torch.diag_embed(self.prior)
        gram = torch.where(both, gram, torch.eye(len(self.names), dtype=gram.dtype))
        pull = torch.where(moves, self.pull[~gone].sum(0), 0.0)
        tried = searched(self.servos)
        step_by(tried, [INDEX[name] for name in self.names], gram, pull)
        return moved(self.servos, tried)

    def replication(
        self, name: str, joint: int, motions: Sequence[tuple[str, float]]
    ) -> Replication | None:
        """By which factor each motion wants a parameter of a joint, beside what the joint's others
        are in all motions together; None where fewer than two can tell.

        Args:
            name: of the parameter, one of `names` that is free on the joint.
            joint: counted from 0.
            motions: name and length [s] of each.
        """
        on, k = self.mask[joint], int(self.mask[joint, : self.names.index(name)].sum())
        grams, pulls = self.gram[:, joint][:, on][:, :, on], self.pull[:, joint, on]
        prior = self.prior[joint, on]
        # Along this direction the joint's other numbers make up for what they can: what is left is
        # this parameter's alone.
        unit = torch.eye(int(on.sum()), dtype=grams.dtype)[k]
        along = torch.linalg.solve(grams.sum(0) + prior.diag(), unit)
        # A step of a logarithm is a factor already; of all else it is a share of what was found.
        p = PARAMETERS[INDEX[name]]
        fitted = float(searched(self.servos)[joint, INDEX[name]]) - p.neutral
        size = 1.0 if p.kind == "log" else fitted
        # Motions disagree by what is usual on the arm before they disagree on a parameter.
        noise = float(self.noise[joint]) * self.beyond_noise
        scales = []
        for (motion, end), gram, pull in zip(motions, grams, pulls, strict=True):
            # How far the parameter must go in this motion until nothing pulls along it.
            held = float(along @ gram[k]) * size
            if held != 0:
                std = math.sqrt(noise * float(along @ gram @ along)) / abs(held)
                step = -float(along @ pull) / held
                scales.append(MotionScale(motion, 0.0, end, 1.0 + step, std))
        return replication_of(scales)

    def deviations(self, shares: Bool[Tensor, " n"] | None = None) -> Float[Tensor, "n K"]:
        """Half of the 95 % intervals (n, K) over that of a normal variable; of logarithms where
        parameters are searched so.

        Args:
            shares: joints of which torques are told as shares of kp.
        """
        return self.covariances(shares).diagonal(dim1=1, dim2=2).sqrt()

    def covariances(self, shares: Bool[Tensor, " n"] | None = None) -> Float[Tensor, "n K K"]:
        """Of what `deviations` tells, joint by joint; zeros of what is not free."""
        if self.told is not None:
            way = self.to_values(shares) @ torch.linalg.inv(self.to_values())
            return way @ self.told @ way.mT
        to = self.to_values(shares)
        return self._with_scale(self._spread(to), self.beyond_noise, to)

    def _with_scale(
        self, spread: "Spread", excess: float, to: Float[Tensor, "n K K"]
    ) -> Float[Tensor, "n K K"]:
        """How numbers vary together, as motions and noise say it, at the sizes that both say; with
        what torques are unsure by as a whole."""
        together = spread.by_noise + spread.by_motions
        unit = spread.deviations(excess) * self.mask
        unit = unit / together.diagonal(dim1=1, dim2=2).clamp(min=1e-300).sqrt()
        # With other masses all torques would be others, and what is left may be so in part.
        unsure = self.torque_std.hypot(self._misfit_of_torques())
        k = self.names.index("kp")  # where it is not free, the scale of torques is known
        scale = to[:, :, k] * (unsure * self.mask[:, k])[:, None] * self.mask
        out = together * unit[:, None] * unit[:, :, None]
        return out + scale[:, :, None] * scale[:, None]

    @cached_property
    def beyond_noise(self) -> float:
        """Times by which the arm's motions disagree on its numbers more than noise makes them, in
        squares; no less than 1. Few motions tell little of one number alone."""
        return self._spread(self.to_values()).excess

    def _misfit_of_torques(self) -> Float[Tensor, " n"]:
        """Change of the scale of all torques that a third of what is left would make, were it no
        noise: the joint's other numbers, and what was expected, make up for what they can."""
        k = self.names.index("kp")
        by_log = self.gram.sum(0)
        free = self.mask[:, :, None] & self.mask[:, None, :]
        gram = by_log + torch.diag_embed(self.prior)
        gram = torch.where(free, gram, torch.eye(len(self.names), dtype=gram.dtype))
        row = torch.linalg.inv(gram)[:, k] * self.mask
        answer = torch.einsum("nk,nkj,nj->n", row, by_log, row)
        return TORQUE_MISFIT * (self.square * self.rows * answer).sqrt()

    def _spread(self, to: Float[Tensor, "n K K"]) -> "Spread":
        """Of combinations of searched coordinates, joint by joint; zeros of what is not free."""
        parts = [torch.zeros_like(to) for _ in range(4)]
        freedom = self.noise.new_zeros(self.mask.shape)
        for j in self.mask.any(1).nonzero().flatten().tolist():
            on, noise = self.mask[j], self.noise[j].clamp(min=1e-300)
            gram, pull = self.gram[:, j][:, on][:, :, on], self.pull[:, j, on]
            prior, away = self.prior[j, on].diag(), self.away[j, on]
            of_joint = Spread.of(gram, pull, prior, noise, to[j][:, on], away)
            own = of_joint.by_noise, of_joint.by_motions, of_joint.by_log, of_joint.open
            for part, one in zip(parts, own, strict=True):
                part[j] = one
            freedom[j, on] = of_joint.freedom[on]
        by_noise, by_motions, by_log, left_open = parts
        return Spread(by_noise, by_motions, freedom, by_log, left_open)

    def expected(self) -> Float[Tensor, "n K K"]:
        """Second moments (n, K, K) of the truth about these values, of which something was expected
        before any motion was seen.

        With the log's precision H and P that of what was expected, noise and misfit make the part
        S^-1 H S^-1 of S^-1, S = H + P, and S^-1 P S^-1 is left of what was expected. Where these
        values are away from that, what the log leaves open may be there: S^-1 P away.
        """
        to = self.to_values()
        if self.told is None:
            spread = self._spread(to)
            by_log = replace(spread, by_noise=spread.by_log)
            return self._with_scale(by_log, by_log.excess, to) + spread.open
        # What makers or other joints tell is about these values.
        before, out = prior_deviations(self.names).diag().square(), torch.zeros_like(to)
        for j, (on, covariance) in enumerate(zip(self.mask, self.told, strict=True)):
            by_log, prior = covariance[on][:, on], (to[j] @ before @ to[j].T)[on][:, on]
            rest = by_log - by_log @ torch.linalg.solve(by_log + prior, by_log)
            out[j][on[:, None] & on] = ((rest + rest.T) / 2).flatten()
        return out

    def to_values(self, shares: Bool[Tensor, " n"] | None = None) -> Float[Tensor, "n K K"]:
        """Changes of parameters, logarithms of what is searched so, by searched coordinates, in
        which torques are shares of kp, and stay so on some joints."""
        size = len(self.names)
        out = torch.eye(size, dtype=self.gram.dtype).repeat(self.servos.n, 1, 1)
        gain, k = self.servos.of("kp"), self.names.index("kp")
        whole = torch.ones_like(gain, dtype=torch.bool) if shares is None else ~shares
        for row, name in enumerate(self.names):
            if name not in TORQUES or name == "kp":
                continue
            if PARAMETERS[INDEX[name]].kind == "log":
                out[:, row, k] = 1.0 * whole
            else:
                out[:, row, row] = torch.where(whole, gain, 1.0) / SMALL
                out[:, row, k] = self.servos.of(name) * whole
        return out


@dataclass(frozen=True, eq=False)
class Spread:
    """How numbers vary.

    Attributes:
        by_noise, by_motions: (*D, Q, Q) covariances by noise alone, and by how motions disagree.
        freedom: (*D, Q) degrees of the latter, none where one motion alone tells.
        by_log, open: (*D, Q, Q) parts of by_noise: what the log's noise makes, and what is left
            open of what was expected, with how far that is from these values.
    """

    by_noise: Float[Tensor, "*D Q Q"]
    by_motions: Float[Tensor, "*D Q Q"]
    freedom: Float[Tensor, "*D Q"]
    by_log: Float[Tensor, "*D Q Q"]
    open: Float[Tensor, "*D Q Q"]

    @classmethod
    def of(
        cls,
        grams: Float[Tensor, "m P P"],
        pulls: Float[Tensor, "m P"],
        prior: Float[Tensor, "P P"],
        noise: float | Tensor,
        to: Float[Tensor, "Q P"],
        away: Float[Tensor, " P"],
    ) -> "Spread":
        """Of combinations of P numbers.

        Args:
            grams, pulls: of the motions' normal equations.
            prior: precision of what was expected, in the same units.
            noise: mean square error of an independent row.
            to: the combinations.
            away: numbers beside what was expected.
        """
        # In units of the noise, where what was expected is told.
        grams, pulls, prior = grams / noise, (pulls - pulls.mean(0)) / noise, prior / noise
        by_blocks = jackknife(grams, pulls, variance=1.0, combinations=to, known=prior, power=1.0)
        total = grams.sum(0)
        root = to @ torch.linalg.inv(total + prior)
        shift = root @ prior @ away
        left_open = root @ prior @ root.T + shift[:, None] * shift
        freedom = torch.where(by_blocks.by_one_block, 0.0, by_blocks.freedom)
        return cls(root @ to.T, by_blocks.covariance, freedom, root @ total @ root.T, left_open)

    @property
    def _variances(self) -> tuple[Float[Tensor, "*D Q"], Float[Tensor, "*D Q"]]:
        noise, motions = self.by_noise, self.by_motions
        return noise.diagonal(dim1=-2, dim2=-1), motions.diagonal(dim1=-2, dim2=-1)

    @property
    def excess(self) -> float:
        """Times by which motions disagree more than noise makes them, in squares; no less than
        1."""
        noise, motions = self._variances
        ratio = (self.freedom * motions / noise.clamp(min=1e-300)).sum() / self.freedom.sum()
        return float(ratio.nan_to_num(1.0).clamp(min=1.0))

    def deviations(self, excess: float) -> Float[Tensor, "*D Q"]:
        """Half of the 95 % intervals over that of a normal variable: what motions say, drawn
        towards what is usual over noise, in squares, where they are few, and no less than noise
        makes it."""
        (noise, motions), sure = self._variances, USUAL + self.freedom
        variance = (USUAL * noise * excess + self.freedom * motions) / sure
        wide = student_quantile(0.95, sure.flatten()).view_as(sure) / HALF_95
        return torch.maximum(variance.sqrt() * wide, noise.clamp(min=0).sqrt())


def equations(
    data: PositionData,
    servos: Servos,
    free: Mapping[str, Tensor],
    windows: Windows,
    *,
    trusted: bool = True,
) -> Equations:
    """Normal equations by motion; Huber's weights bound what a rare event can do.

    Args:
        data: motions.
        servos, free: where, and what is free on which joints.
        windows: of the motions.
        trusted: whether the masses of the robot's file are what they are said to be.
    """
    names = tuple(free)
    s = sensitivities(data, servos, names, windows)
    w = weights(s.residual, windows)
    a = s.slope * w.sqrt()[..., None]
    b = s.residual * w.sqrt()
    motions = int(windows.motion.max()) + 1
    shape = (motions, data.robot.n)
    gram = torch.zeros(*shape, len(names), len(names), dtype=a.dtype)
    gram.index_add_(0, windows.motion, torch.einsum("lwnk,lwnj->wnkj", a, a))
    pull = torch.zeros(*shape, len(names), dtype=a.dtype)
    pull.index_add_(0, windows.motion, torch.einsum("lwnk,lwn->wnk", a, b))
    mask = torch.stack([free[name] for name in names], 1)
    alike, square = alike_rows(s.residual, windows), mean_square(s.residual, w, windows)
    unsure = torch.zeros_like(square) if trusted else data.torque_std
    away = _away(data, servos, names)
    return Equations(servos, names, mask, gram, pull, square, windows.rows, alike, unsure, away)


def _away(data: PositionData, servos: Servos, names: Sequence[str]) -> Float[Tensor, "n K"]:
    """Searched coordinates beside those of a small servo of the joints' strengths; 0 of limits,
    of which nothing is expected, and of what has no effect."""
    at = [INDEX[name] for name in names]
    usual = Servos.neutral(servos.n, **{PARAMETERS[k].name: PARAMETERS[k].start for k in at})
    expected = searched(usual)
    expected[:, INDEX["kp"]] += data.strength.log()
    away = (searched(servos) - expected)[:, at]
    limits = ~torch.tensor([math.isfinite(PARAMETERS[k].neutral) for k in at])
    return torch.where(limits | ~away.isfinite(), 0.0, away)


def alike_rows(residual: Float[Tensor, "L W n"], windows: Windows) -> Float[Tensor, " n"]:
    """Integrated autocorrelation times of what is left in windows, of mean zero [rows]."""
    ends = windows.length.cumsum(0).tolist()
    bounds = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
    inside = torch.arange(len(residual))[:, None] < windows.length
    return integrated_time(residual.transpose(0, 1)[inside.T].T, bounds, centred=False)


def closed_share(
    before: Float[Tensor, "*D n"], after: Float[Tensor, "*D n"], noise: Float[Tensor, " n"]
) -> Float[Tensor, "*D"]:
    """Share (*D,) of the errors beyond noise that is closed, of mean squares; errors are means of
    the joints' RMS."""
    rest, gap = ((x - noise).clamp(min=0).sqrt().mean(-1) for x in (after, before))
    return 1 - rest / gap


def value_interval(name: str, value: float, deviation: float) -> tuple[float, float]:
    """95 % interval of a parameter from the deviation of its searched coordinate."""
    kind = PARAMETERS[INDEX[name]].kind
    if kind == "log":
        factor = float(torch.tensor(HALF_95 * deviation).exp())
        return value / factor, value * factor
    low, high = value - HALF_95 * deviation, value + HALF_95 * deviation
    return (max(low, 0.0) if kind == "positive" else low), high
