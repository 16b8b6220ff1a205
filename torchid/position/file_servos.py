"""The servos that a robot's file declares, beside a log: whether the joints follow them, which of
their numbers the log refutes, and which it leaves.

Torques that no load anchors stand in one scale: that of the file's own gain, where motions do as
well with it.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.effects.servo import (
    INDEX,
    PARAMETERS,
    PER_KP,
    TORQUES,
    ServoEffect,
    ServoParameter,
    as_share,
)
from torchid.position.data import UNEVEN, PositionData
from torchid.position.effects import EFFECTS, GAINS
from torchid.position.evidence import LeastFall
from torchid.position.judge import Equations
from torchid.position.model import ServoArm
from torchid.position.record import ChangeRecord
from torchid.position.repeats import PositionNoise
from torchid.position.search import Rivals
from torchid.position.servo_model import Motions, ServoModel, mostly_better
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Windows, body_near, windows_of
from torchid.statistics.criteria import CLEAR_EXCESS, MOVED_STD, SET_MASS, TELLING_STD
from torchid.typing import Bool, Float

_TORQUES = [INDEX[name] for name in TORQUES]

Worth = dict[str, tuple[Tensor, Tensor]]
"""By effect: losses of windows (W, n) without it, NaN where it has no name, and with it [rad^2]."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Servos of a robot's file beside motions.

    Attributes:
        motions: that they are beside.
        model: the servos as they are nearest.
        near: (n,) joints that follow them.
    """

    motions: Motions
    model: ServoModel
    near: Bool[Tensor, " n"]


def follows(
    motions: Motions, servos: Servos, core: Mapping[str, Tensor], noise: PositionNoise
) -> Followed:
    """Which joints servos of a robot's file follow."""
    model = as_file(motions, servos, core)
    near = near_enough(motions, model, noise.at_least(motions.data.slight))
    return Followed(motions, model, near)


def near_enough(
    motions: Motions, model: ServoModel, noise: Float[Tensor, " n"]
) -> Bool[Tensor, " n"]:
    """Joints that servos follow up to errors (n,) that call for no cause [rad]: in windows, in
    whole motions, or in all that was recorded without a break. What the first alone leave is their
    starts', at velocities that are not measured."""
    data, least = motions.data, CLEAR_EXCESS * noise.square()
    tracks = data.tracks
    gone = data.log.t[tracks.first] - data.log.t[tracks.last.roll(1)]
    begins = (gone - tracks.dt).abs() > UNEVEN * tracks.dt
    start = tracks.first[begins]
    length = torch.cat([start[1:], tracks.last[-1:] + 1]) - start
    breaks = Windows(start, length, begins.nonzero().flatten(), torch.ones(len(start)).double())
    near = [
        model.losses(Motions(data, windows)) <= windows.rows * least
        for windows in (motions.windows, windows_of(tracks, None), breaks)
    ]
    return torch.stack(near).any(0)


def as_file(motions: Motions, servos: Servos, core: Mapping[str, Tensor]) -> ServoModel:
    """Servos of a robot's file, each as it is nearest to the log: as said, later by what commands
    are held by, or without a limit of torque, where the file has it behind a damping that servos
    have behind the limit."""
    if motions.data.beside is not None:
        joint = motions.data.beside.servos.joint
    else:
        ways = servos.joint.repeat(4, 1, 1)
        ways[1::2, :, INDEX["delay"]] += 0.5 * motions.data.held
        ways[2:, servos.of("damping_share") > 0, INDEX["clip"]] = math.inf
        cost = [motions.losses(replace(servos, joint=way)).sum(0) for way in ways]
        joint = ways[torch.stack(cost).argmin(0), torch.arange(servos.n)]
    fixed = {*core, "damping_share"}
    used = {p.name: servos.of(p.name) != p.neutral for p in PARAMETERS if p.name not in fixed}
    free = {**core, **{name: on for name, on in used.items() if bool(on.any())}}
    return ServoModel(replace(servos, joint=joint), free, bool(servos.plane[4] > 0))


def weighing_otherwise(data: PositionData) -> PositionData:
    """The motions of an arm whose servos do not feel its weight, or, where the file's do not, of
    one whose servos do."""
    weights = data.robot.require_parameters("gravity compensation").pi[:, :4]
    robot = replace(data.robot, compensated=weights if data.robot.compensated is None else None)
    body = body_near(robot, data.q, data.dq, data.link).midway(data.tracks.last)
    return replace(data, robot=robot, body=body)


def beside_file(
    motions: Motions,
    model: ServoModel,
    file: Servos,
    squares: float,
    worth: Worth,
    doubted: Bool[Tensor, " n"],
) -> tuple[ServoModel, Bool[Tensor, " n"], Worth, Rivals]:
    """What of an answered model parts it from a file's servos.

    Each of the file's numbers takes its place again, all others refitted. The gain stays the
    file's, and torques in its scale, where motions are followed as well; the others are no causes
    then. But where they are followed as well with another gain and the file's number of a torque,
    either of these two may be wrong.

    Args:
        motions: to fit to.
        model: the answered one.
        file: its servos.
        squares: share of the squared error by which a number must lower it to be named.
        worth: of effects beside plain servos.
        doubted: joints whose gain, as the file has it, is no number to hold anything against.

    Returns:
        The model, joints whose gain is the file's, what is worth a name beside the file, and what
        does as well in its place.
    """
    by_file, worth, rivals = ~motions.every, dict(worth), Rivals()
    fall = LeastFall.beside(motions, model.servos)
    for effect in (*GAINS, *(e for e in EFFECTS if e.parameters)):
        names = [p for p in PARAMETERS if p.name in effect.parameters]
        has = torch.stack([file.of(p.name) != p.neutral for p in names]).any(0)
        asked = has if effect not in GAINS else ~doubted if effect is GAINS[0] else motions.every
        if not bool(asked.any()):
            continue
        held, scaled = _with_files_number(motions, model, file, effect, asked)
        whole, one = (motions.losses(m.servos) for m in (model, held))
        two = one if scaled is held else motions.losses(scaled.servos)
        for j in asked.nonzero().flatten().tolist():
            # A joint loses no more than where its number alone is the file's: others feel what a
            # joint does.
            here = torch.arange(len(asked)) == j
            alone = motions.losses(
                model.joined(ServoModel(file, {}), here, effect.parameters).servos
            )
            for way in (one, two):
                if float(alone[:, j].sum()) < float(way[:, j].sum()):
                    way[:, j] = alone[:, j]
        # Where the gain is the file's, another one is no way to keep the file's number.
        without = torch.where((one.sum(0) <= two.sum(0)) | by_file, one, two)
        needed = asked & _differs(motions, model, file, names)
        least = torch.maximum(fall.of(len(effect.parameters)), squares * without.sum(0))
        if effect is GAINS[0]:
            # The file's gain is no simpler where others of its numbers must go for it.
            more = _gone(motions, held, file, fall) - _gone(motions, model, file, fall)
            least = torch.minimum(least, fall.of(1.0, more))
            without = fall.risen(motions, without, more.clamp(min=0))
        needed &= _needed(motions, whole, without, least)
        either = needed & by_file & ~_needed(motions, whole, two, least)
        for j in torch.nonzero(either).flatten().tolist():
            rivals[effect.name, j] = (GAINS[0].name,)
        if effect is GAINS[0]:
            by_file = ~needed & ~doubted
            model = model.joined(held, by_file)
            fall = LeastFall.beside(motions, model.servos)
        before, with_it = worth.get(effect.name, (torch.full_like(whole, torch.nan), whole))
        named = torch.where(asked, torch.where(needed, without, torch.nan), before)
        worth[effect.name] = named, with_it
    worth = {k: v for k, v in worth.items() if bool(v[0].isfinite().any())}
    return model, by_file, worth, rivals


def with_files_scale(known: Equations, file: Servos) -> Equations:
    """How well torques are known as a whole, where the log has other torques of a servo as the file
    says, in the scale of its masses: were these wrong, all that agree would be so by one factor.

    Args:
        known: the answer.
        file: its servos.
    """
    sure = replace(known, torque_std=torch.zeros_like(known.torque_std))
    std, luck = sure.deviations(), torch.ones_like(known.torque_std)
    closest = torch.full_like(luck, math.inf)
    for k, name in enumerate(known.names):
        was, now = file.of(name), known.servos.of(name)
        if name not in TORQUES or name == "kp":
            continue
        p = PARAMETERS[INDEX[name]]
        log = p.kind == "log"
        share = std[:, k] if log else std[:, k] / was.abs()
        away = (now / was - 1) / share
        agrees = known.mask[:, k] & (was > 0) & was.isfinite() & (away.abs() < MOVED_STD)
        # Beside a file that says nothing of it.
        chance = share * (away.square() / 2).exp() / (p.prior if log else 1.0)
        luck = torch.where(agrees, luck * chance.clamp(max=1.0), luck)
        closest = torch.where(agrees & (share < closest), share, closest)
    told = torch.where(luck < 1 - SET_MASS, closest, math.inf)
    return replace(known, torque_std=torch.minimum(known.torque_std, told))


def _gone(
    motions: Motions, model: ServoModel, file: Servos, fall: LeastFall
) -> Float[Tensor, " n"]:
    """How many numbers beside the gain are others than a file's on each joint: those that cannot be
    the file's, nothing else refitted."""
    n, whole = model.servos.n, model.losses(motions)
    count = torch.zeros_like(whole)
    for effect in GAINS[1:]:
        sets = replace(
            model.servos,
            joint=model.servos.joint.repeat(n, 1, 1),
            plane=model.servos.plane.repeat(n, 1),
        )
        for j in range(n):
            for name in effect.parameters:
                sets.joint[j, j, INDEX[name]] = file.of(name)[j]
        count += motions.losses_of_sets(sets).diagonal() - whole > fall.of(1)
    return count


def _differs(
    motions: Motions, model: ServoModel, file: Servos, names: Sequence[ServoParameter]
) -> Bool[Tensor, " n"]:
    """Joints on which a number is not the file's; of a delay by what no row of a log hides."""
    hidden = [0.5 * motions.data.tracks.dt * (p.name == "delay") for p in names]
    apart = [(model.servos.of(p.name) - file.of(p.name)).abs() for p in names]
    return torch.stack([x > y for x, y in zip(apart, hidden, strict=True)]).any(0)


def _needed(
    motions: Motions, whole: Float[Tensor, "W n"], without: Float[Tensor, "W n"], least: Tensor
) -> Bool[Tensor, " n"]:
    """Joints that are followed worse without a number, by at least so much (n,), on most
    motions."""
    gain = motions.each(without - whole)
    return (gain.sum(0) > least) & mostly_better(gain)


def _with_files_number(
    motions: Motions, model: ServoModel, file: Servos, effect: ServoEffect, joints: Tensor
) -> tuple[ServoModel, ServoModel]:
    """A model with the file's numbers of an effect on some joints, all others refitted, in two
    ways: what is not free keeps its share of the gain, or all torques are others by one factor;
    these are one of what is no torque."""
    values, scaled = model.servos.joint.clone(), model.servos.joint.clone()
    first = effect.parameters[0]
    factor = file.of(first) / model.servos.of(first)
    if first == "kp":
        values[:, _TORQUES] *= factor[:, None]
    begun = model.at(values).joined(ServoModel(file, {}), joints, effect.parameters)
    held = begun.fitted(motions, 3, plane=True)
    if first == "kp" or first not in TORQUES or not bool((factor.isfinite() & (factor > 0)).all()):
        return held, held
    scaled[:, _TORQUES] *= torch.where(joints, factor, 1.0)[:, None]
    free = {**held.free, "kp": held.free["kp"] & ~joints}
    return held, replace(model.at(scaled), free=free).fitted(motions, 3, plane=True)


def changes_of(
    start: ServoArm,
    gains: Float[Tensor, " n"],
    known: Equations,
    shares: Bool[Tensor, " n"],
    still: Bool[Tensor, " n"],
) -> tuple[ChangeRecord, ...]:
    """What was found of each number beside what the robot's file says of it, and of its masses.

    Args:
        start: the file's arm.
        gains: (n,) of which its torques are shares: the file's, but for those that are doubted.
        known: the answer.
        shares: joints of which torques are told as shares of kp.
        still: joints that never move, of which nothing is said.
    """
    known = replace(known, torque_std=torch.zeros_like(known.torque_std))
    at = [INDEX[name] for name in known.names]
    std = torch.full_like(known.servos.joint, torch.nan)
    std[:, at] = torch.where(known.mask, known.deviations(shares), torch.nan)
    before = torch.zeros_like(std) if start.std is None else start.std.nan_to_num(0.0)
    out = []
    for j, (k, p) in itertools.product(
        (~still).nonzero().flatten().tolist(), enumerate(PARAMETERS)
    ):
        was, now = (float(servos.joint[j, k]) for servos in (start.servos, known.servos))
        if (was == p.neutral and bool(std[j, k].isnan())) or p.name == "damping_share":
            continue
        share = bool(shares[j]) and p.name in TORQUES and p.name != "kp"
        if share:
            was, now = was / float(gains[j]), now / float(known.servos.of("kp")[j])
        stds = float(std[j, k]), 0.0 if share else float(before[j, k])
        state = _state(p, was, now, stds)
        if state:
            out.append(
                ChangeRecord(
                    joint=j,
                    parameter=as_share(p.name) if share else p.name,
                    unit=PER_KP[p.unit] if share else p.unit,
                    was=math.nan if state == "new" else was,
                    now=math.nan if now == p.neutral else now,
                    std=stds[0],
                    state=state,
                )
            )
    return tuple(out)


def _state(p: ServoParameter, was: float, now: float, std: tuple[float, float]) -> str:
    """What became of a number of a file, whose standard deviations now and before are given; empty
    of one that is not there as far as the log says."""
    log = p.kind == "log" and 0 < min(now, was) <= max(now, was) < math.inf
    apart = abs(math.log(now / was)) if log else abs(now - was)
    if was == p.neutral:
        told = std[0] < TELLING_STD if p.kind == "log" else apart > MOVED_STD * std[0]
        return "new" if told else ""
    if now == p.neutral:  # a limit may not have been reached
        return "open" if math.isinf(now) else "gone"
    if apart > MOVED_STD * math.hypot(*std):
        return "changed"
    size = 1.0 if log else max(abs(now), abs(was))
    return "open" if std[0] > TELLING_STD * size else "as known"
