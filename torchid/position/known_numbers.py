"""The numbers of a file's servos, held against each other by a log.

Motions tell torques as shares of the gain. What turns these into N m is known beforehand: the
gain itself, other numbers of the file, and the links' masses, each with a width. A number x of
which the log tells the share r says that kp is x / r, the masses say it by weight and inertia, and
a limit in which no servo at rest stands says what kp is at most. Where all are right they agree.
Their errors have heavy tails, for a placeholder is no number at all: kp is where most of them are
(the mode of Cauchy's errors), and a gain that is far from there is the one that is wrong.
"""

import math

import torch

from torchid.effects.servo import INDEX, PARAMETERS
from torchid.position.data import NO_STEP, STILL, PositionData
from torchid.position.judge import Equations
from torchid.results.words import digits, joints_words
from torchid.simulation.servo import Servos
from torchid.statistics.criteria import SHEET_STD
from torchid.typing import Bool, Float, Tensor

WIDTHS = {"damping": 1.0, "coulomb": 1.0, "armature": 1.0}
"""Standard deviations of logarithms of what files have of friction and rotors [1]: one joint's is
seldom another's."""

APART = 3.0
"""Factor between a gain and what all else says of it, from which it is wrong [1]: by as much units
of one type never differ."""

REST_S = 0.3
"""Time for which commands and a joint have stood where it is at rest [s]."""


def contradicted(data: PositionData, servos: Servos, plain: Equations) -> Float[Tensor, " n"]:
    """Gains (n,) [N m/rad] that all other known numbers say, where the file's contradicts them; nan
    where it does not, or where nothing else is known.

    Args:
        data: motions.
        servos: of the file.
        plain: equations of plain servos.
    """
    gain = servos.of("kp")
    out = torch.full_like(gain, torch.nan)
    said = [_said(data, servos, plain, j) for j in range(servos.n)]
    for value in gain.unique().tolist():
        # One number on several joints is one type of servo, and one number.
        alike = ((gain == value) & ~data.still).nonzero().flatten().tolist()
        own = math.log(value), SHEET_STD, True
        every = [own, *(number for j in alike for number in said[j])]
        where = torch.tensor([x for x, _, _ in every])
        apart = ((where - x if low else (where - x).clamp(min=0), std) for x, std, low in every)
        cost = torch.stack([(away / std).square().log1p() for away, std in apart]).sum(0)
        best = float(where[cost.argmin()])
        if abs(best - math.log(value)) > math.log(APART):
            out[alike] = math.exp(best)
    return out


def doubt_of(
    file: Servos, gains: Float[Tensor, " n"], found: Float[Tensor, " n"], open_: Bool[Tensor, " n"]
) -> str:
    """What speaks against the gains of a file, in a sentence; empty where nothing does.

    Args:
        file: its servos.
        gains: (n,) of `contradicted`.
        found: (n,) gains of the answer [N m/rad].
        open_: joints of which the answer does not tell the gain.
    """
    said, out = file.of("kp"), list[str]()
    for value in said.unique().tolist():
        alike = said == value
        if bool((doubted := alike & gains.isfinite()).any()):
            where = joints_words(doubted.nonzero().flatten().tolist())
            out.append(
                f"The file's gain of {digits(value)} N m/rad ({where}) contradicts its masses, "
                "friction, rotors and limits of torque beside this log: they say some "
                f"{float(gains[doubted][0]):.1g}. So it is sought."
            )
        own = found[alike & ~open_]
        if len(own) > 1 and float(own.max() / own.min()) > APART:
            out.append(
                f"The servos whose gain the file has as {digits(value)} N m/rad come out with "
                f"{digits(float(own.min()))} to {digits(float(own.max()))}: units of one type are "
                "not so far apart, so loads or masses of these joints are not what the file has."
            )
    return " ".join(out)


def _said(
    data: PositionData, servos: Servos, plain: Equations, joint: int
) -> list[tuple[float, float, bool]]:
    """Logarithms of kp that known numbers of a joint say, their standard deviations, and whether
    kp may not be less either."""
    shares = torch.ones_like(data.still)
    std, alone = (plain.deviations(x)[joint] for x in (None, shares))
    gain, out = plain.servos.of("kp")[joint], []
    if data.weighed:
        spread = math.hypot(float(std[plain.names.index("kp")]), float(data.torque_std[joint]))
        out.append((math.log(gain), spread, True))
    for name, width in WIDTHS.items():
        share = float(plain.servos.of(name)[joint] / gain)
        known = float(servos.of(name)[joint])
        if known > 0 and share > 0:
            unsure = float(alone[plain.names.index(name)])
            if PARAMETERS[INDEX[name]].kind != "log":
                unsure /= share
            out.append((math.log(known / share), math.hypot(width, unsure), True))
    away = at_rest(data)[:, joint]
    clip = float(servos.of("clip")[joint])
    if math.isfinite(clip) and bool(away.any()):
        off = (data.tracks.u - data.q)[away, joint].abs().quantile(0.99)
        out.append((math.log(clip / max(float(off), 1e-9)), SHEET_STD, False))
    return out


def at_rest(data: PositionData) -> Bool[Tensor, "T n"]:
    """Rows at which a joint and its command have stood for a while."""
    rate = torch.zeros_like(data.q)
    rate[1:] = data.tracks.u.diff(dim=0).abs()
    rate[data.tracks.first] = 1.0
    moves = ((rate > NO_STEP) | (data.dq.abs() > STILL)).double().T
    rows = max(1, round(REST_S / data.tracks.dt))
    before = torch.nn.functional.pad(moves, (rows, 0), value=1.0)
    return (torch.nn.functional.max_pool1d(before, rows + 1, 1) < 0.5).T
