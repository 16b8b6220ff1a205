"""Repeats of a motion in a log as it is, for a first look at it."""

from dataclasses import dataclass

import torch

from torchid.design.motion import measurements
from torchid.design.segments import segments_of
from torchid.errors import LogError
from torchid.gap.data.repeats import find_repeats
from torchid.log.model import Log
from torchid.log.sampling import resample, sampling_rate

_BAND = 10.0  # in which motions are compared [Hz]


@dataclass(frozen=True)
class Repeat:
    """Two stretches of the same motion; equal names for two periods of one trajectory.

    Attributes:
        first, second: trajectories.
        start_first, start_second: where the stretches begin in them [s].
        duration: [s].
    """

    first: str
    second: str
    start_first: float
    start_second: float
    duration: float


def repeated_motion(log: Log) -> tuple[Repeat, ...]:
    """Motions that the arm made more than once; none where the log is too short or too slow.

    Args:
        log: with or without torque; it must have passed `check_log`.
    """
    still = torch.zeros_like(log.q)
    try:
        even = resample(log.replace(tau=still))
        band = min(_BAND, 0.2 * min(sampling_rate(even)))
        segments = segments_of(measurements(even, band), band)
    except LogError:
        return ()
    found = []
    for pair in find_repeats(segments).pairs:
        one, two = segments[pair.a], segments[pair.b]
        found.append(
            Repeat(
                one.name,
                two.name,
                pair.rows_a.start / one.rate,
                pair.rows_b.start / two.rate,
                (pair.rows_a.stop - pair.rows_a.start) / one.rate,
            )
        )
    return tuple(found)
