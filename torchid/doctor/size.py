"""Is torque in newton metres at the joint? Against nominal parameters, limits, or plain sense."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import torch
from msgspec.structs import replace
from scipy.optimize import nnls

from torchid.doctor.check import Check, Choice, Verdict, judged, with_choices, worded_check
from torchid.doctor.cone import reach_of, shares
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.repair import scaled
from torchid.dynamics.newton_euler import joint_wrenches
from torchid.log.model import Log
from torchid.robot.model import JointType
from torchid.statistics.criteria import CAD_SIZE, CLEAR_GAIN, ODD_SIZE, OTHER_UNIT, TOLD
from torchid.statistics.jackknife import fit_statistics

DENSITY = (0.03, 250.0)
"""Mass that the largest torque holds at arm's length, over the cube of the reach [kg/m^3]: 1 to 60
on arms from a desk to a foundry, a thousand times that in N mm."""
_GAINS = "(--gain K1,K2,.. or Log.with_torque) [N m/A]"
_CHECK_GAINS = f"drive gains for currents {_GAINS}; multiply motor torque by the gear ratio"
_SMALL_UNITS = {"torque unit mNm": 1e3, "torque unit Ncm": 100.0}
_UNITS = ((1e3, "N mm or mN m, or mA"), (1e-3, "kN m"), (100.0, "N cm"))


@dataclass(frozen=True)
class Slopes:
    """Measured torque over nominal, one a joint; friction, rotor and offset are free.

    Attributes:
        joints: from 0, those whose nominal torque varies enough to say.
        value, low, high: (J,) with 95 % intervals, blocks of time left out in turn.
    """

    joints: tuple[int, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def clear(self) -> np.ndarray:
        """(J,) whether they say anything."""
        return (self.value > 0) & (self.high - self.low < 0.6 * self.value)

    @property
    def overall(self) -> float | None:
        """The median of the clear ones."""
        return float(np.median(self.value[self.clear])) if self.clear.any() else None


def nominal_slopes(judge: Judge, hypothesis: Hypothesis) -> Slopes:
    """Slope of measured on nominal torque of each joint that moves."""
    nominal = judge.nominal(hypothesis).unsqueeze(-1)
    columns = torch.cat([nominal, judge.own(hypothesis)], -1).numpy()
    tau, moving = judge.torque(hypothesis), judge.moving(hypothesis)
    block = judge.samples.block.numpy()
    rows = []
    for j in judge.live(hypothesis):
        use = moving[:, j]
        x, y = columns[use, j], tau[use, j]
        owner = np.unique(block[use], return_inverse=True)[1]
        # Says nothing where the nominal torque is constant, in fewer than three blocks of time, or
        # beside friction that is many times larger.
        if x[:, 0].std() == 0.0 or owner.max() < 2:
            continue
        values = np.linalg.lstsq(x, y, rcond=1e-9)[0]
        # 0.1: spread of a joint's nominal torque, at the size that fits, over that of the measured
        # one: 0.5 and more on arms, but of wrists that no parameter moves
        if abs(values[0]) * x[:, 0].std() < 0.1 * y.std():
            continue
        left = torch.from_numpy(y - x @ values)
        fitted = fit_statistics(torch.from_numpy(x), left, torch.from_numpy(owner))
        low, high = fitted.interval(torch.from_numpy(values))[0].tolist()
        rows.append((j, float(values[0]), low, high))
    table = np.array([r[1:] for r in rows]).reshape(-1, 3)
    return Slopes(tuple(r[0] for r in rows), *table.T)


def other_moments(judge: Judge, hypothesis: Hypothesis, joints: Collection[int]) -> dict[int, str]:
    """Axes of other moments, by joint from 0: of the joints whose torque is as another component of
    the moment that the joint passes on is, in the axes of its link's frame (`x`, `y`, `z`), beside
    friction."""
    robot, axes = judge.robot, dict[int, str]()
    if robot.parameters is None or not robot.parameters.pi.any():
        return axes
    q, dq, ddq = judge.motion(hypothesis)[..., :3].unbind(-1)
    moments = joint_wrenches(robot, q, dq, ddq)[..., 3:].numpy()
    own, tau = judge.own(hypothesis).numpy(), judge.torque(hypothesis)
    moving = judge.moving(hypothesis)
    for j in joints:
        link, use = robot.own_links[j], moving[:, j]
        axis = robot.after[link, 2, :3].tolist()
        for k, name in enumerate("xyz"):
            x = np.column_stack([moments[use, link, k], own[use, j]])
            slope, *rest = np.linalg.lstsq(x, tau[use, j], rcond=1e-9)[0]
            left = (tau[use, j] - x @ [slope, *rest]).std() / tau[use, j].std()
            size = abs(math.log(max(abs(slope), 1e-300)))
            # 0.9: cosine of the angle from a joint's axis from which a moment is its torque
            if abs(axis[k]) < 0.9 and left < TOLD and size < math.log(CAD_SIZE):
                axes[j] = name
    return axes


def nominal_loss(judge: Judge, hypothesis: Hypothesis, size: float | None = None) -> float:
    """Sum of the joints' log errors of the nominal torque at one size, or at a size of each joint's
    own, with friction and rotor, none of them negative, and an offset."""
    nominal, own = judge.nominal(hypothesis).unsqueeze(-1), judge.own(hypothesis)
    columns = torch.cat([own, -own[..., -1:], *([nominal] if size is None else [])], -1).numpy()
    fixed = (0.0 if size is None else size) * nominal[..., 0].numpy()
    tau, moving, loss = judge.torque(hypothesis), judge.moving(hypothesis), 0.0
    for j in judge.live(hypothesis):
        use = moving[:, j]
        _, left = nnls(columns[use, j], tau[use, j] - fixed[use, j])
        spread = tau[use, j].std() * math.sqrt(use.sum())
        loss += float(np.log(shares((left / spread) ** 2, np.array(1.0))))
    return loss


def check_size(
    judge: Judge, log: Log, hypothesis: Hypothesis, fixes: Collection[str] = ()
) -> Check:
    """The unit of the torque as a whole."""
    robot = judge.robot
    if log.tau is not None and not bool(log.tau.any()):
        return judged("torque unit", "cannot tell", "the torque is zero throughout")
    if log.tau is None:
        # Currents without gains; nominal parameters suggest some.
        text = "the log has currents [A] and no drive gains"
        if robot.parameters is None:
            return worded_check("torque unit", "doubtful current", text=text, gains="K1,K2,..")
        slopes = nominal_slopes(judge, hypothesis)
        clear = [(slopes.joints[k], 1.0 / slopes.value[k]) for k in np.flatnonzero(slopes.clear)]
        if clear:
            guess = ", ".join(f"{j + 1}: {gain:.3g}" for j, gain in clear)
            text += f"; nominal parameters suggest [N m/A] {guess}"
        every = ",".join(f"{gain:.4g}" for _, gain in clear)
        return worded_check(
            "torque unit",
            "doubtful current",
            joints=[j for j, _ in clear],
            estimate=tuple(gain for _, gain in clear) or None,
            text=text,
            gains=every if len(clear) == robot.n else "K1,K2,..",
        )
    if robot.parameters is not None and robot.parameters.pi.abs().sum() > 0:
        sizes = _against_nominal(judge, hypothesis)
        if sizes is not None:
            return sizes
    return _against_limits(judge, log, fixes) or _plain_sense(judge, log, hypothesis, fixes)


def _against_nominal(judge: Judge, hypothesis: Hypothesis) -> Check | None:
    slopes = nominal_slopes(judge, hypothesis)
    overall = slopes.overall
    if overall is None:
        return None
    text = f"measured torque is {overall:.3g} times nominal (median of the joints)"
    interval = tuple(zip(slopes.low.tolist(), slopes.high.tolist(), strict=True))
    base = worded_check(
        "torque unit", "fine", joints=slopes.joints, estimate=tuple(slopes.value.tolist()),
        interval=interval, text=text,
    )  # fmt: skip
    off = abs(math.log(overall))
    if off < math.log(ODD_SIZE):
        return base
    # Friction, a spring or a payload that the model lacks makes a median of any size, and no unit.
    if nominal_loss(judge, hypothesis, overall) > nominal_loss(judge, hypothesis, 1.0) - CLEAR_GAIN:
        text += ", and the nominal torque of that size explains no more than the nominal one"
        return replace(base, verdict="cannot tell", evidence=text)
    verdict: Verdict = "wrong" if off > math.log(OTHER_UNIT) else "doubtful"
    low, high, apart = slopes.low[slopes.clear], slopes.high[slopes.clear], False
    for factor, name in _UNITS:
        if abs(math.log(overall / factor)) < math.log(CAD_SIZE):
            # A hundred is a size of gains and gears, too, which differ from joint to joint.
            beyond = low.max() > CAD_SIZE * factor or high.min() < factor / CAD_SIZE
            several = len(set(map(abs, hypothesis.tau.factors))) > 1
            apart = factor == 100.0 and (several or bool(beyond))
            if apart:
                continue
            repair = scaled(("tau",), (1.0 / factor,) * judge.robot.n)
            named = replace(base, verdict=verdict, evidence=f"{text}: {name}")
            return named.mended_by(repair)
    single = apart or len(set(map(abs, hypothesis.tau.factors))) > 2
    text += (
        ": of each joint another size: motors' torque before their gears, or currents"
        if single
        else ": a gain, a gear ratio, a load, or another robot's parameters"
    )
    own = ",".join(f"{f / overall:.4g}" for f in hypothesis.tau.factors)
    together = f'; together they are about `columns="tau=tau{{j}} *[{own}]"`' if single else ""
    return replace(base, verdict=verdict, evidence=text, fix=_CHECK_GAINS + together)


def _against_limits(judge: Judge, log: Log, fixes: Collection[str]) -> Check | None:
    limits = judge.robot.limits.torque
    assert log.tau is not None
    if limits is None or not bool(torch.isfinite(limits).all()) or not bool((limits != 0).any()):
        return None
    share = float((log.tau.abs().amax(0) / limits.abs().amax(-1).clamp(min=1e-9)).max())
    text = f"the largest torque is {share:.3g} times its limit"
    # 5e-3: share of its limit that an arm's largest torque is at least
    # 2.0: peaks above a rated torque
    plausible = (5e-3, 2.0)
    return _by_size(judge, text, share, plausible, fixes, largest=OTHER_UNIT)


def _plain_sense(judge: Judge, log: Log, hypothesis: Hypothesis, fixes: Collection[str]) -> Check:
    """Is the mass that the largest torque would hold at arm's length one an arm can have?"""
    assert log.tau is not None
    robot = judge.robot
    gravity = float(robot.gravity.norm())
    reach = reach_of(robot)
    turning = [k for k, kind in enumerate(robot.joint_types) if kind is JointType.REVOLUTE]
    # 0.2: reach below which an arm is none that stands on a desk [m]
    if gravity == 0.0 or reach < 0.2 or not turning or not judge.live(hypothesis):
        return judged(
            "torque unit",
            "cannot tell",
            "the robot has no nominal parameters, no torque limits and no reach to judge by",
        )
    mass = float(log.tau[:, turning].abs().max()) / (gravity * reach)
    text = f"the largest torque holds {mass:.3g} kg at the arm's length of {reach:.2g} m"
    density = mass / reach**3
    return _by_size(judge, text, density, DENSITY, fixes, largest=DENSITY[1], unit="kg/m^3")


def _by_size(
    judge: Judge,
    text: str,
    size: float,
    plausible: tuple[float, float],
    fixes: Collection[str],
    *,
    largest: float,
    unit: str = "",
) -> Check:
    """Fine, too small, or torque in a smaller unit: in which, if only one leaves a plausible
    size."""
    if size > largest:
        check = judged("torque unit", "wrong", f"{text}: N mm, N cm or mA?", estimate=size)
        choices = [
            Choice.by(name, scaled(("tau",), (1.0 / factor,) * judge.robot.n))
            for name, factor in _SMALL_UNITS.items()
            if plausible[0] < size / factor < plausible[1]
        ]
        return with_choices(check, choices, fixes) if choices else replace(check, fix=_CHECK_GAINS)
    check = judged("torque unit", "fine", text, estimate=size, unit=unit)
    if size < plausible[0]:
        text = f"{text}: amperes, motor side, or kN m?"
        return replace(check, verdict="doubtful", evidence=text, fix=_CHECK_GAINS)
    return check


def check_nominal(judge: Judge, log: Log, hypothesis: Hypothesis) -> list[Check]:
    """Joints whose torque is far from the nominal one, and about which the other joints' torques
    say nothing (such as the first, about a vertical axis)."""
    if judge.robot.parameters is None or log.tau is None:
        return []
    slopes = nominal_slopes(judge, hypothesis)
    overall = slopes.overall
    if overall is None or len(slopes.joints) < 3:
        return []
    low, high = slopes.low / overall, slopes.high / overall
    # A payload is many times the nominal torque of a wrist, and no fault: the other joints know.
    odd = [
        k
        for k, joint in enumerate(slopes.joints)
        if (low[k] > OTHER_UNIT or 0 < high[k] < 1.0 / OTHER_UNIT)
        # The other joints' torques would fit this one's at another size as well.
        and judge.score(hypothesis.scaled((joint,), tau=1.0 / slopes.value[k])).loss
        < judge.score(hypothesis).loss + CLEAR_GAIN
    ]
    if not odd:
        return []
    sizes = ", ".join(
        f"{slopes.value[k]:.3g} ({slopes.low[k]:.3g} to {slopes.high[k]:.3g})" for k in odd
    )
    check = worded_check(
        "torque against nominal",
        "doubtful",
        joints=[slopes.joints[k] for k in odd],
        estimate=tuple(float(slopes.value[k]) for k in odd),
        interval=tuple((float(slopes.low[k]), float(slopes.high[k])) for k in odd),
        said=sizes,
        overall=overall,
    )
    return [check]
