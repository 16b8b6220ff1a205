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
"""Of a log, and one of a trajectory at least: as few as a variance can be told from, as long as
they can be then, for it is what differs from one motion to another that is asked, not from one
instant to the next."""

MOTIONS = 1.75
"""Variance between motions over that between windows of one motion [1]: the median, over eleven
pairs of logs of five healthy arms, of what all of the library seemed to have changed by."""

FELT = 1e-6
"""Share of a torque's squares from which a log shows it [1]."""

ALONE = 1e-3
"""Share of a torque's squares beyond one window below which that window has all of it [1]."""


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

    def same(self, torque: np.ndarray, left: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Samples (n,) of which one tells as much of a torque of all logs as an independent one.

        Args:
            torque: (n, N) what is asked [N m; N].
            left: (n, N) what is left beside it [N m; N].
            times: (n,) the same as what is left and the torque are alike in time.
        """
        sums, squares = (
            np.concatenate([_sums(x, log) for log in self.logs], 1)
            for x in (torque * left, torque**2)
        )
        return _more(sums, squares, self._noise(left), times)

    def new(self, torque: np.ndarray, left: np.ndarray, times: np.ndarray) -> np.ndarray:
        """The same of a torque of the log that is asked alone: it stands against what differs
        within either log about its mean there, and so between the two.

        Args:
            torque: (n, N), on the earlier log what it would be there [N m; N].
            left, times: as above.
        """
        out, least = times, FELT * (torque**2).sum(1)
        for log in self.logs:
            sums, squares = _sums(torque * left, log), _sums(torque**2, log)
            more = _more(sums, squares, self._noise(left), times)
            shown = squares.sum(1) > least
            out = np.where(shown, np.maximum(out, more), out)
        # Where the earlier log, the last, does not show it, the two have nothing in common.
        return times + np.where(shown, MOTIONS * self.both, 1.0) * (out - times)

    def _noise(self, left: np.ndarray) -> np.ndarray:
        return (left**2).sum(1) / self.rows


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


def _more(
    sums: np.ndarray, squares: np.ndarray, noise: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Samples (n,) of which one tells as much as an independent one, no fewer than `times`.

    Args:
        sums, squares: (n, W) windows' sums of the product of torque and what is left, and of the
            torque's squares.
        noise: (n,) mean squares that are left.
        times: (n,) as long as these are alike.
    """
    whole = np.maximum(squares.sum(1, keepdims=True), 1e-300)
    share = squares / whole
    about = sums - share * sums.sum(1, keepdims=True)
    # Where one window has all of the torque nothing differs.
    room = 1 - (share**2).sum(1)
    ratio = (about**2).sum(1) / np.maximum(noise * whole[:, 0] * room, 1e-300)
    return np.where(room > ALONE, np.maximum(times, ratio), times)
