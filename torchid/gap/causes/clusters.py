"""How much more windows of a log differ in what they say than independent samples would.

What is left on a real arm is no noise alone but misfit, a function of the state: where it is alike
with a candidate's torque its sum over a log is no zero, in another motion another one. Windows show
that. Of the sum of r d, r what is left and d what a candidate adds, the variance is that of the
windows' sums (cluster-robust: White 1980; Liang and Zeger 1986), and so many samples tell of d less
as it is larger than that of independent ones. So no term of the library is held against an exact
zero, but against what misfit makes of it by itself (a narrow slab in the place of a point, George
and McCulloch 1993).
"""

from collections.abc import Sequence

import numpy as np

from torchid.gap.causes.candidates import Library
from torchid.statistics.blocks import block_numbers

WINDOWS = 8
"""Of a log: as few as a variance can be told from, as long as they can be then, for it is what
differs from one motion to another that is asked, not from one instant to the next."""

FELT = 1e-6
"""Share of a torque's squares from which a log shows it [1]."""


class Clusters:
    """Windows of the log that is asked, and of an earlier one.

    Args:
        library: of the logs.
    """

    def __init__(self, library: Library):
        bounds = library.samples.bounds
        self.logs = [_windows(bounds, own) for own in (library.asked, ~library.asked) if own.any()]
        self.rows = library.rows
        asked = library.keep[:, library.asked].sum(1)
        # A mean over so much of another log differs from one over this log by both variances.
        self.both = 1 + asked / np.maximum(library.keep.sum(1) - asked, 1.0)

    def same(self, torque: np.ndarray, left: np.ndarray) -> np.ndarray:
        """By how much the variance (n,) of the sum of their products is that of independent
        samples, for a torque of all logs.

        Args:
            torque: (n, N) what is asked [N m; N].
            left: (n, N) what is left beside it [N m; N].
        """
        sums = np.concatenate([_sums(torque * left, log) for log in self.logs], 1)
        return _ratio(sums, (torque**2).sum(1), (left**2).sum(1) / self.rows)

    def new(self, torque: np.ndarray, left: np.ndarray) -> np.ndarray:
        """The same for a torque of the log that is asked alone: it stands against what differs
        within either log about its mean there.

        Args:
            torque: (n, N), on the earlier log what it would be there [N m; N].
            left: (n, N) what is left [N m; N].
        """
        out, least = np.zeros(len(left)), FELT * (torque**2).sum(1)
        for log in self.logs:
            own = slice(log[0], log[-1])
            squares = (torque[:, own] ** 2).sum(1)
            sums = _sums(torque * left, log)
            ratio = _ratio(sums - sums.mean(1, keepdims=True), squares, (left**2).sum(1) / self.rows)
            out = np.maximum(out, np.where(squares > least, ratio, 0.0))
        return out


def _windows(bounds: Sequence[slice], own: np.ndarray) -> np.ndarray:
    """First samples of the windows of a log (N,), and the one behind the last."""
    mine = [b for b in bounds if own[b].any()]
    start, stop = mine[0].start, mine[-1].stop
    parts = [slice(b.start - start, b.stop - start) for b in mine]
    number = block_numbers(parts, max(1, (stop - start) // WINDOWS)).numpy()
    return np.append(start + np.unique(number, return_index=True)[1], stop)


def _sums(x: np.ndarray, windows: np.ndarray) -> np.ndarray:
    """Sums (n, W) over windows of samples (n, N)."""
    return np.add.reduceat(x[:, windows[0] : windows[-1]], windows[:-1] - windows[0], axis=1)


def _ratio(sums: np.ndarray, squares: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Variance (n,) from windows' sums (n, W) about zero, over that of independent samples."""
    count = sums.shape[1]
    one = max(count - 1, 1) / count  # what is left has no sum with what was fitted to it
    return (sums**2).sum(1) / one / np.maximum(noise * squares, 1e-300)
