"""How much of a residual torque could be predicted at all: boosted trees, out of fold.

What a flexible predictor leaves on data it was not trained on is an upper bound of the noise; what
it can still predict after the accepted effects is a gap without a name. It sees motion and the
model's torque only, never a measured torque, whose noise would predict itself.

Rows are dependent over the residual's autocorrelation time, so folds are made of contiguous blocks
of several such times, with rows one such time away from a block under test left out of its training
(Roberts et al. 2017, blocked cross-validation). Predictions are shrunk by a factor that the other
folds' predictions determine: trees that found nothing predict nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import stdtrit
from threadpoolctl import threadpool_limits

from torchid.design.motion import MOVING
from torchid.design.segments import Samples
from torchid.effects.base import Motion
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import FEWEST_BLOCKS, block_length, block_numbers, block_sums
from torchid.statistics.resampling import tails
from torchid.typing import Bool, Float, Int, Tensor

FOLDS = 5
LONGEST_TRAINING = 4000
"""Rows that one fit is trained on at most."""

LAGS = (0.05, 0.15)
"""History that is looked at [s]."""


@dataclass(frozen=True)
class OutOfFold:
    """What the residual is predicted to be by a predictor trained elsewhere.

    Attributes:
        prediction: (n, N) [N m; N].
        r2: (n,) share of the residual's sum of squares (about zero) that is predicted; may be < 0.
        interval: (n, 2) 95 % interval of it, from the spread between blocks.
    """

    prediction: Float[Tensor, "n N"]
    r2: Float[Tensor, " n"]
    interval: Float[Tensor, "n 2"]

    def left(self, residual: Float[Tensor, "n N"]) -> Float[Tensor, "n N"]:
        """The residual less what is predicted, where the prediction helps at all."""
        return residual - self.prediction * (self.r2 > 0).to(residual).unsqueeze(-1)


def predict_out_of_fold(
    motions: Sequence[Motion],
    samples: Samples,
    residual: Float[Tensor, "n N"],
    seed: int = 0,
    joints: Sequence[int] | None = None,
) -> OutOfFold:
    """Predict the residual torque of each joint from motion and model torque.

    Args:
        motions: of the segments, with the model's torque.
        samples: of these segments.
        residual: samples of measured less model torque.
        seed: of the trees' binning; the result is a function of it.
        joints: from 0, whose residual to predict; all if None. Others are predicted to be zero.
    """
    # Every joint's trees see the motion of all joints, and time.
    signals = [torch.cat([m.q, m.dq, m.ddq], -1).T for m in motions]
    shared = torch.cat([samples.of(signals), samples.t.unsqueeze(0)])
    predictions, scores = torch.zeros_like(residual), residual.new_zeros(len(residual), 3)
    # Trees this small are faster on one thread than on several, and never compete with torch's.
    with threadpool_limits(limits=1, user_api="openmp"):
        for j in range(len(residual)) if joints is None else joints:
            r = residual[j]
            features = torch.cat([_own_features(motions, samples, j), shared]).T.cpu().numpy()
            # Blocks of several correlation times, and the gap of one between what is trained on
            # and what is predicted.
            time = max(float(integrated_time(r, samples.bounds)), 0.25 / samples.interval)
            length = max(4, block_length(len(r), time))
            gap = max(1, round(min(time, length)))
            block = block_numbers(samples.bounds, length)
            predicted = _shrunk(_joint(features, r, samples.bounds, block, gap, seed), r, block)
            predictions[j], scores[j] = predicted, scores.new_tensor(_score(r, predicted, block))
    return OutOfFold(predictions, scores[:, 0], scores[:, 1:])


def _own_features(motions: Sequence[Motion], samples: Samples, joint: int) -> Float[Tensor, "F N"]:
    """Direction, model torque, their and the velocity's history, and the way since reversal."""
    signals, instants = [], []
    for m in motions:
        # What the joint does now, and did shortly before.
        torque = m.require("torque", "the flexible predictor")[:, joint]
        sign, dq = m.sign[:, joint].to(torque), m.dq[:, joint]
        # Values some samples ago; at the beginning the first one.
        past = [
            torch.cat([x[:1].expand(round(lag * samples.rate)), x])[: len(x)]
            for lag in LAGS
            for x in (dq, torque)
        ]
        signals.append(torch.stack([sign, torque, *past]))
        instants.append(torch.stack(_since_reversal(m, joint, samples.rate), -1))
    return torch.cat([samples.of(signals), samples.pick(instants).T])


def _since_reversal(m: Motion, joint: int, rate: float) -> tuple[Tensor, Tensor]:
    """Time [s] and displacement since the joint last turned, or since the beginning."""
    q, dq = m.q[:, joint], m.dq[:, joint]
    index = torch.arange(len(q))
    # The direction holds while the joint rests.
    last = torch.cummax(torch.where(dq.abs() > MOVING, index, 0), 0).values
    direction = torch.sign(dq)[last]
    turned = torch.nn.functional.pad(direction.diff() != 0, (1, 0))
    since = torch.cummax(torch.where(turned, index, 0), 0).values
    return (index - since).to(q) / rate, q - q[since]


def _joint(
    features: np.ndarray,
    r: Float[Tensor, " N"],
    bounds: tuple[slice, ...],
    block: Int[Tensor, " N"],
    gap: int,
    seed: int,
) -> Float[Tensor, " N"]:
    """Prediction of each fold by trees grown on the others; zero where nothing is left to train."""
    # Loading scikit-learn takes a second, which logs without torque do not need.
    from sklearn.ensemble import HistGradientBoostingRegressor

    out = torch.zeros_like(r)
    target = r.cpu().numpy()
    for fold in range(FOLDS):
        test = block % FOLDS == fold
        # Trained on what is not tested nor correlated with it, thinned evenly where that is much.
        usable = torch.nonzero(~_widened(test, bounds, gap)).flatten()
        train = usable[:: math.ceil(len(usable) / LONGEST_TRAINING) or 1].numpy()
        if not bool(test.any()) or len(train) < 4 * FEWEST_BLOCKS:
            continue
        trees = HistGradientBoostingRegressor(
            max_iter=60, max_leaf_nodes=8, max_bins=64, early_stopping=False, random_state=seed
        ).fit(features[train], target[train])
        out[test] = torch.from_numpy(trees.predict(features[test.numpy()])).to(r)
    return out


def _widened(mask: Bool[Tensor, " N"], bounds: tuple[slice, ...], gap: int) -> Bool[Tensor, " N"]:
    """The mask and what lies within `gap` rows of it in the same trajectory."""
    out = mask.clone()
    for b in bounds:
        wide = torch.nn.functional.max_pool1d(mask[b].double()[None], 2 * gap + 1, 1, gap)
        out[b] = wide[0] > 0
    return out


def _shrunk(
    predicted: Float[Tensor, " N"], r: Float[Tensor, " N"], block: Int[Tensor, " N"]
) -> Float[Tensor, " N"]:
    """Each fold's prediction times the factor, between 0 and 1, that suits the other folds."""
    out = torch.zeros_like(predicted)
    for fold in range(FOLDS):
        others = block % FOLDS != fold
        # Least squares of the others' residual on their own prediction.
        energy = predicted[others].square().sum()
        factor = (predicted[others] @ r[others] / energy.clamp(min=1e-300)).clamp(0, 1)
        out[~others] = factor * predicted[~others]
    return out


def _score(
    r: Float[Tensor, " N"], predicted: Float[Tensor, " N"], block: Int[Tensor, " N"]
) -> tuple[float, float, float]:
    """R^2 and its interval, from what each block gains."""
    total = float(r @ r)
    if total == 0:
        return 0.0, 0.0, 0.0
    # What each block gains by the prediction, as a share of the residual's squares.
    gains = block_sums(r.square() - (r - predicted).square(), block) / total
    count = len(gains)
    if count < 3:
        return float(gains.sum()), -math.inf, 1.0
    spread = float(gains.std()) * math.sqrt(count)
    # Student's interval of the sum over blocks.
    half = float(stdtrit(count - 1, tails()[1])) * spread
    r2 = float(gains.sum())
    return r2, r2 - half, r2 + half
