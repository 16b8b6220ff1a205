"""How well servos are known: by how much motions disagree, and by how much noise alone allows.

Per motion, the normal equations of every joint at the fitted servos tell where that motion pulls;
their spread is a jackknife with motions as blocks (see `statistics.jackknife`). Of few motions, or
one alone, that variance is hardly known: it is drawn towards the noise's, alike for as long as its
correlation says, times what is usual on the arm's other numbers (Smyth 2004).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchid.position.data import SMALL, WINDOW_S, PositionData
from torchid.position.fit import (
    errors_of_one,
    huber,
    mean_square,
    prior_deviations,
    prior_precision,
    searched,
    sensitivities,
    weights,
)
from torchid.results.replication import MotionScale, Replication, replication_of
from torchid.simulation.servo import INDEX, PARAMETERS, TORQUES, Servos
from torchid.simulation.servo_loop import Windows
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.jackknife import jackknife, student_quantile
from torchid.statistics.proportion import HALF_95
from torchid.statistics.resampling import DRAWS, nested_weights, percentile_interval
from torchid.typing import Bool, Float, Int

FOLDS = 5
ALONG = 1 / 3
"""Share of what is left of a joint's error that may be as a change of its torques is [1]."""
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
        given: (n, K, K) covariances that are known already; None: as the equations tell.
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
    given: Tensor | None = None

    @property
    def noise(self) -> Float[Tensor, " n"]:
        """Mean square error of rows as if each were independent [rad^2]."""
        return self.alike * self.square

    @property
    def prior(self) -> Float[Tensor, "n K"]:
        """Precision of what was expected."""
        return prior_precision(self.names, self.square, self.alike[:, None])

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
        found = float(searched(self.servos)[joint, INDEX[name]]) - p.neutral
        size = 1.0 if p.kind == "log" else found
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
        if self.given is not None:
            way = self.to_values(shares) @ torch.linalg.inv(self.to_values())
            return way @ self.given @ way.mT
        to = self.to_values(shares)
        out, (white, spread, freedom) = torch.zeros_like(to), self._by_noise_and_motions(to)
        by_noise, by_motions = (x.diagonal(dim1=1, dim2=2) for x in (white, spread))
        std = deviations_of(by_noise, by_motions, freedom, self.beyond_noise) * self.mask
        for j in self.mask.any(1).nonzero().flatten().tolist():
            # How numbers vary together, as motions and noise say it, at those sizes.
            together = white[j] + spread[j]
            unit = std[j] / together.diagonal().clamp(min=1e-300).sqrt()
            out[j] = together * unit * unit[:, None]
        # With other masses all torques would be others, and what is left may be so in part.
        unsure = self.torque_std.hypot(self._misfit_of_torques())
        k = self.names.index("kp")  # where it is not free, the scale of torques is known
        scale = to[:, :, k] * (unsure * self.mask[:, k])[:, None] * self.mask
        return out + scale[:, :, None] * scale[:, None]

    @cached_property
    def beyond_noise(self) -> float:
        """Times by which the arm's motions disagree on its numbers more than noise makes them, in
        squares; no less than 1. Few motions tell little of one number alone."""
        white, spread, freedom = self._by_noise_and_motions(self.to_values())
        by_noise, by_motions = (x.diagonal(dim1=1, dim2=2) for x in (white, spread))
        return usual_excess(by_noise, by_motions, freedom)

    def _misfit_of_torques(self) -> Float[Tensor, " n"]:
        """Change of the scale of all torques that a third of what is left would make, were it no
        noise: the joint's other numbers make up for what they can."""
        k = self.names.index("kp")
        gram = self.gram.sum(0) + torch.diag_embed(self.prior)
        free = self.mask[:, :, None] & self.mask[:, None, :]
        gram = torch.where(free, gram, torch.eye(len(self.names), dtype=gram.dtype))
        return ALONG * (self.square * self.rows * torch.linalg.inv(gram)[:, k, k]).sqrt()

    def _by_noise_and_motions(self, to: Float[Tensor, "n K K"]) -> tuple[Tensor, Tensor, Tensor]:
        """Covariances (n, K, K) of combinations of the searched coordinates, by noise alone and by
        how motions disagree, and the latter's degrees of freedom (n, K)."""
        white, spread = torch.zeros_like(to), torch.zeros_like(to)
        freedom = self.noise.new_zeros(self.mask.shape)
        for j in self.mask.any(1).nonzero().flatten().tolist():
            on, noise = self.mask[j], self.noise[j].clamp(min=1e-300)
            white[j], spread[j], told = by_noise_and_motions(
                self.gram[:, j][:, on][:, :, on], self.pull[:, j, on], self.prior[j, on].diag(),
                noise, to[j][:, on],
            )  # fmt: skip
            freedom[j, on] = told[on]
        return white, spread, freedom

    def expected(self) -> Float[Tensor, "n K K"]:
        """The same of what is left open where values were expected near to these before any motion
        was seen: V - V (V + P)^-1 V, which is no wider than either."""
        to, before = self.to_values(), prior_deviations(self.names).diag().square()
        out = torch.zeros_like(to)
        for j, (on, found) in enumerate(zip(self.mask, self.covariances(), strict=True)):
            own, prior = found[on][:, on], (to[j] @ before @ to[j].T)[on][:, on]
            rest = own - own @ torch.linalg.solve(own + prior, own)
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


def by_noise_and_motions(
    grams: Float[Tensor, "m P P"],
    pulls: Float[Tensor, "m P"],
    prior: Float[Tensor, "P P"],
    noise: float | Tensor,
    to: Float[Tensor, "Q P"] | None = None,
) -> tuple[Float[Tensor, "Q Q"], Float[Tensor, "Q Q"], Float[Tensor, " Q"]]:
    """Covariances of combinations of P numbers by noise alone and by how m motions disagree, and
    the latter's degrees of freedom, none where one motion alone tells.

    Args:
        grams, pulls: of the motions' normal equations.
        prior: precision of what was expected, in the same units.
        noise: mean square error of an independent row.
        to: the combinations; the numbers themselves if None.
    """
    # In units of the noise, where what was expected is given.
    grams, pulls, prior = grams / noise, (pulls - pulls.mean(0)) / noise, prior / noise
    found = jackknife(grams, pulls, variance=1.0, combinations=to, known=prior)
    white = torch.linalg.inv(grams.sum(0) + prior)
    white = white if to is None else to @ white @ to.T
    return white, found.covariance, torch.where(found.by_one_block, 0.0, found.freedom)


def usual_excess(by_noise: Tensor, by_motions: Tensor, freedom: Tensor) -> float:
    """Times by which motions disagree more than noise makes them, in squares; no less than 1."""
    ratio = (freedom * by_motions / by_noise.clamp(min=1e-300)).sum() / freedom.sum()
    return float(ratio.nan_to_num(1.0).clamp(min=1.0))


def deviations_of(
    by_noise: Float[Tensor, "*D"],
    by_motions: Float[Tensor, "*D"],
    freedom: Float[Tensor, "*D"],
    excess: float,
) -> Float[Tensor, "*D"]:
    """Half of the 95 % intervals over that of a normal variable: what motions say, drawn towards
    what is usual where they are few, and no less than noise makes it.

    Args:
        by_noise, by_motions: variances.
        freedom: degrees of the latter.
        excess: what is usual over noise, in squares.
    """
    sure = USUAL + freedom
    variance = (USUAL * by_noise * excess + freedom * by_motions) / sure
    wide = student_quantile(0.95, sure.flatten()).view_as(sure) / HALF_95
    return torch.maximum(variance.sqrt() * wide, by_noise.clamp(min=0).sqrt())


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
    return Equations(servos, names, mask, gram, pull, square, windows.rows, alike, unsure)


def alike_rows(residual: Float[Tensor, "L W n"], windows: Windows) -> Float[Tensor, " n"]:
    """Integrated autocorrelation times of what is left in windows, of mean zero [rows]."""
    ends = windows.length.cumsum(0).tolist()
    bounds = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
    inside = torch.arange(len(residual))[:, None] < windows.length
    return integrated_time(residual.transpose(0, 1)[inside.T].T, bounds, centred=False)


def folds_of(motions: int, count: int = FOLDS) -> Int[Tensor, " m"]:
    """Which fold each motion is in: every fifth, so that like ones that were driven one after the
    other are apart."""
    return torch.arange(motions) % min(count, motions)


def window_losses(error: Float[Tensor, "L W n"], windows: Windows) -> Float[Tensor, "W n"]:
    """Huber's loss of every window and joint [rad^2], as many times as the window stands for."""
    return huber(error) * windows.weight[:, None]


def of_motions(losses: Float[Tensor, "W n"], windows: Windows) -> Float[Tensor, "m n"]:
    """Sums over the windows of every motion."""
    out = torch.zeros(int(windows.motion.max()) + 1, losses.shape[1], dtype=losses.dtype)
    return out.index_add_(0, windows.motion, losses)


def losses_of(data: PositionData, servos: Servos, windows: Windows) -> Float[Tensor, "W n"]:
    """Losses of windows [rad^2]."""
    return window_losses(errors_of_one(data, servos, windows), windows)


def mostly_better(gain: Float[Tensor, "m n"]) -> Bool[Tensor, " n"]:
    """(n,) whether most motions (m, n) gain of those that it matters to."""
    matters = gain.abs() > 0.02 * gain.abs().amax(0)
    better = ((gain > 0) & matters).sum(0)
    return (better > 0.7 * matters.sum(0)) & (gain.sum(0) > 0)


def closed_interval(
    data: PositionData,
    before: Float[Tensor, "T n"],
    after: Float[Tensor, "T n"],
    moves: Bool[Tensor, " n"],
    noise: Float[Tensor, " n"],
) -> tuple[float, float]:
    """95 % interval of the share of whole motions' errors that is closed, on other motions: motions
    are drawn again, and blocks of each; nan where too little is defined.

    Args:
        data: motions.
        before, after: errors of their rows.
        moves: (n,) joints that count.
        noise: (n,) their mean squares that no model closes.
    """
    blocks, owner = list[Tensor](), list[int]()
    size = max(1, round(WINDOW_S / data.tracks.dt))
    ends = zip(data.tracks.first.tolist(), data.tracks.last.tolist(), strict=True)
    for motion, (a, b) in enumerate(ends):
        squares = torch.stack([before, after])[:, a : b + 1, moves].square()
        # Of every block the sums of squares, and how many they are.
        for x in squares.split(size, 1):
            blocks.append(torch.stack([x.sum(1), torch.full_like(x[:, 0], x.shape[1])]))
            owner.append(motion)
    weights = torch.from_numpy(nested_weights(np.array(owner), DRAWS, np.random.default_rng(0)))
    total, count = torch.einsum("db,bkwj->kwdj", weights, torch.stack(blocks))
    before, after = total / count.clamp(min=1)
    return percentile_interval(closed_share(before, after, noise[moves]).numpy())


def closed_share(
    before: Float[Tensor, "*D n"], after: Float[Tensor, "*D n"], noise: Float[Tensor, " n"]
) -> Float[Tensor, "*D"]:
    """Share (*D,) of the errors beyond noise that is closed, of mean squares; errors are means of
    the joints' RMS."""
    left, gap = ((x - noise).clamp(min=0).sqrt().mean(-1) for x in (after, before))
    return 1 - left / gap


def each_window(servos: Mapping[int, Servos], owner: Tensor) -> Servos:
    """Servos of every window (W, 1, n, K), from those of the fold that it is in."""
    first = next(iter(servos.values()))
    joint = torch.stack([servos[k].joint for k in owner.tolist()])[:, None]
    plane = torch.stack([servos[k].plane for k in owner.tolist()])[:, None]
    return replace(first, joint=joint, plane=plane)


def value_interval(name: str, value: float, deviation: float) -> tuple[float, float]:
    """95 % interval of a parameter from the deviation of its searched coordinate."""
    kind = PARAMETERS[INDEX[name]].kind
    if kind == "log":
        factor = float(torch.tensor(HALF_95 * deviation).exp())
        return value / factor, value * factor
    low, high = value - HALF_95 * deviation, value + HALF_95 * deviation
    return (max(low, 0.0) if kind == "positive" else low), high
