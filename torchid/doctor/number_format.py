"""Whole numbers of registers, as drivers read them."""

import numpy as np

from torchid.doctor.case import Case
from torchid.doctor.check import Check, judged
from torchid.doctor.repair import PLACES, Signed
from torchid.log.columns import PREFIXES
from torchid.robot.model import joint_list

_SIGNS = {False: (2.0**7, 2.0**15, 2.0**31), True: (2.0**10, 2.0**15)}
"""First negative number as a complement of two (8, 16, 32 bits), and bits that are a sign (servos'
registers of load and speed)."""


def check_number_format(case: Case) -> Check:
    """Negative whole numbers that were read without their sign."""
    log, repairs = case.log, []
    for name, signal in log.signals.items():
        columns = [signal[:, k].numpy() for k in range(log.n)]
        read = next((r for x in columns if (r := _read_unsigned(x, name in PLACES))), None)
        if read is not None:
            zero, magnitude = read
            # A column may be negative throughout.
            joints = tuple(k for k, x in enumerate(columns) if x.max() >= zero)
            repairs.append(Signed(name, joints, zero, magnitude))
    if not repairs:
        return judged("number format", "fine", "no numbers were read without their sign")
    evidence = "; ".join(
        f"no {PREFIXES[r.signal]} is negative, and in {joint_list(r.joints)} many are "
        f"{r.zero:.10g} or more: "
        + ("a bit is the sign" if r.magnitude else "signed numbers read as unsigned")
        for r in repairs
    )
    joints = tuple(sorted({k for r in repairs for k in r.joints}))
    return judged("number format", "wrong", evidence, joints).mended_by(*repairs)


def _read_unsigned(x: np.ndarray, position: bool) -> tuple[float, bool] | None:
    """What stands for the first negative number of a column (T,), in its unit, and whether it is a
    bit for the sign; None where the numbers are what they seem to be."""
    if x.min() < 0.0:  # of most columns, before they are sorted
        return None
    levels = np.unique(x)
    if len(levels) < 2:
        return None
    unit = 1.0 if (levels == np.round(levels)).all() else float(np.diff(levels).min())
    # 1e-3: deviation from whole numbers of the smallest difference
    if np.abs(levels / unit - np.round(levels / unit)).max() > 1e-3:
        return None
    step = np.abs(np.diff(x)).max()
    # The complement of a position is a whole turn.
    for magnitude in (True,) if position else (False, True):
        for zero in (unit * z for z in _SIGNS[magnitude]):
            negative = x >= zero
            if x.max() < 2.0 * zero and 0 < negative.sum() < len(x):
                mended = np.where(negative, zero - x if magnitude else x - 2.0 * zero, x)
                # 0.5: share of a column's largest step that is left once its numbers have their
                # signs
                if np.abs(np.diff(mended)).max() < 0.5 * step:
                    return zero, magnitude
    return None
