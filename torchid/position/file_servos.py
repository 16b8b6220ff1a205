"""The servos that a robot's file declares, beside a log: whether the joints follow them, which of
their numbers the log refutes, and which it leaves.

Torques that no load anchors stand in one scale: that of the file's own gain, where motions do as
well with it.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from torchid.position.data import GAP, PositionData
from torchid.position.effects import EFFECTS, GAINS
from torchid.position.fit import fit
from torchid.position.judge import Equations, losses_of, mostly_better, of_motions
from torchid.position.model import ServoArm
from torchid.position.record import ChangeRecord
from torchid.position.repeats import PositionNoise
from torchid.position.search import Found, slight
from torchid.simulation.servo import INDEX, PARAMETERS, PER_KP, TORQUES, Servos, as_share
from torchid.simulation.servo_loop import Windows, body_near, windows_of
from torchid.statistics.criteria import MOVED_STD
from torchid.typing import Bool

OPEN = 0.5
"""Standard deviation of a value, as a share of it, from which the log does not say it [1]."""
_TORQUES = [INDEX[name] for name in TORQUES]

Worth = dict[str, tuple[Tensor, Tensor]]
"""By effect: losses of windows (W, n) without it, NaN where it has no name, and with it [rad^2]."""


def follows(
    data: PositionData,
    servos: Servos,
    core: Mapping[str, Tensor],
    noise: PositionNoise,
    windows: Windows,
) -> tuple[Bool[Tensor, " n"], Found]:
    """Joints that servos of a robot's file follow, and those servos as they are nearest."""
    own = _as_file(data, servos, core, windows)
    # What windows leave alone is their starts'.
    least = GAP * noise.at_least(data.slight).square()
    near = [
        losses_of(data, own.servos, w).sum(0) <= w.rows * least
        for w in (windows, windows_of(data.tracks, None))
    ]
    return torch.stack(near).any(0), own


def _as_file(
    data: PositionData, servos: Servos, core: Mapping[str, Tensor], windows: Windows
) -> Found:
    """Servos of a robot's file, each as it is nearest to the log: as said, later by what commands
    are held by, or without a limit of torque, which files have behind the damping and servos
    before it."""
    ways = servos.joint.repeat(4, 1, 1)
    ways[1::2, :, INDEX["delay"]] += 0.5 * data.held
    ways[2:, :, INDEX["clip"]] = math.inf
    cost = [losses_of(data, replace(servos, joint=way), windows).sum(0) for way in ways]
    joint = ways[torch.stack(cost).argmin(0), torch.arange(servos.n)]
    fixed = {*core, "damping_share"}
    used = {p.name: servos.of(p.name) != p.neutral for p in PARAMETERS if p.name not in fixed}
    free = {**core, **{name: on for name, on in used.items() if bool(on.any())}}
    return Found(replace(servos, joint=joint), free, bool(servos.plane[4] > 0))


def weighing_otherwise(data: PositionData) -> PositionData:
    """The motions of an arm whose servos do not feel its weight, or, where the file's do not, of
    one whose servos do."""
    own = data.robot.require_parameters("gravity compensation").pi[:, :4]
    robot = replace(data.robot, compensated=own if data.robot.compensated is None else None)
    body = body_near(robot, data.q, data.dq, data.link).midway(data.tracks.last)
    return replace(data, robot=robot, body=body)


def beside_file(
    data: PositionData,
    found: Found,
    file: Servos,
    windows: Windows,
    squares: float,
    worth: Worth,
) -> tuple[Found, Bool[Tensor, " n"], Worth]:
    """What of a found model parts it from a file's servos.

    Each of the file's numbers takes its place again, all others refitted. The gain stays the
    file's, and torques in its scale, where motions are followed as well; the others are no causes
    then.

    Args:
        data: motions.
        found: the model.
        file: its servos.
        windows: to fit to.
        squares: share of the squared error by which a number must lower it to be named.
        worth: of effects beside plain servos.

    Returns:
        The model, joints whose gain is the file's, and what is worth a name beside the file.
    """
    least, every = slight(data, windows), torch.ones(found.servos.n, dtype=torch.bool)
    by_file, worth = ~every, dict(worth)
    for effect in (*GAINS, *(e for e in EFFECTS if e.parameters)):
        names = [p for p in PARAMETERS if p.name in effect.parameters]
        has = torch.stack([file.of(p.name) != p.neutral for p in names]).any(0)
        asked = every if effect in GAINS else has
        if not bool(asked.any()):
            continue
        joint, free = found.servos.joint.clone(), dict(found.free)
        if effect.parameters == ("kp",):
            joint[:, _TORQUES] *= (file.of("kp") / found.servos.of("kp"))[:, None]
        for name in effect.parameters:
            k = INDEX[name]
            joint[:, k] = torch.where(asked, file.joint[:, k], joint[:, k])
            free[name] = free.get(name, ~every) & ~asked
        begun = replace(found.servos, joint=joint)
        servos = fit(data, begun, free, windows, plane=found.plane, iterations=3)
        first = effect.parameters[0]
        factor = file.of(first) / found.servos.of(first)
        if first in TORQUES and first != "kp" and bool((factor.isfinite() & (factor > 0)).all()):
            # What is not free keeps its share of the gain; or, where that is not the file's, all
            # torques are others by one factor.
            scaled = found.servos.joint.clone()
            scaled[:, _TORQUES] *= torch.where(asked, factor, 1.0)[:, None]
            rest = {**free, "kp": free["kp"] & ~asked}
            begun = replace(found.servos, joint=scaled)
            other = fit(data, begun, rest, windows, plane=found.plane, iterations=3)
            one, two = (losses_of(data, s, windows).sum(0) for s in (servos, other))
            joint = torch.where(((one <= two) | by_file)[:, None], servos.joint, other.joint)
            servos = replace(servos, joint=joint)
        whole, without = (losses_of(data, s, windows) for s in (found.servos, servos))
        gain = of_motions(without - whole, windows)
        needed = (gain.sum(0) > squares * without.sum(0)) & (gain.sum(0) > least)
        needed &= asked & mostly_better(gain)
        if effect.parameters == ("kp",):
            by_file = ~needed
            joint = torch.where(by_file[:, None], servos.joint, found.servos.joint)
            free = {**found.free, "kp": found.free["kp"] & needed}
            found = Found(replace(found.servos, joint=joint), free, found.plane)
        before, with_it = worth.get(effect.name, (torch.full_like(whole, torch.nan), whole))
        shown = torch.where(asked, torch.where(needed, without, torch.nan), before)
        worth[effect.name] = shown, with_it
    return found, by_file, {k: v for k, v in worth.items() if bool(v[0].isfinite().any())}


def changes_of(
    start: ServoArm, known: Equations, shares: Tensor, still: Tensor
) -> tuple[ChangeRecord, ...]:
    """What was found of each number beside what the robot's file says of it, and of its masses."""
    known = replace(known, torque_std=torch.zeros_like(known.torque_std))
    every = (~still).nonzero().flatten().tolist()
    deviation = torch.full_like(known.servos.joint, torch.nan)
    deviation[:, [INDEX[name] for name in known.names]] = known.deviations(shares)
    free = torch.zeros_like(deviation, dtype=torch.bool)
    free[:, [INDEX[name] for name in known.names]] = known.mask
    out = []
    for j, (k, p) in itertools.product(every, enumerate(PARAMETERS)):
        share = bool(shares[j]) and p.name in TORQUES and p.name != "kp"
        on = bool(free[j, k])
        was, now = (float(servos.joint[j, k]) for servos in (start.servos, known.servos))
        if (was == p.neutral and not on) or p.name == "damping_share":
            continue
        new, std = was == p.neutral, float(deviation[j, k]) if on else math.nan
        before = 0.0 if start.std is None or share else float(start.std[j, k].nan_to_num(0.0))
        if share:
            was, now = (
                x / float(one.of("kp")[j]) for x, one in ((was, start.servos), (now, known.servos))
            )
        log = p.kind == "log" and 0 < min(now, was) <= max(now, was) < math.inf
        apart = abs(math.log(now / was)) if log else abs(now - was)
        if new and not (std < OPEN if p.kind == "log" else abs(now - was) > MOVED_STD * std):
            continue  # nothing, as far as the log says
        if new:
            state = "new"
        elif now == p.neutral:  # a limit may not have been reached
            state = "open" if math.isinf(now) else "gone"
        elif apart > MOVED_STD * math.hypot(std, before):
            state = "changed"
        else:
            state = "open" if std > OPEN * (1.0 if log else max(abs(now), abs(was))) else "as known"
        out.append(
            ChangeRecord(
                joint=j,
                parameter=as_share(p.name) if share else p.name,
                unit=PER_KP[p.unit] if share else p.unit,
                was=math.nan if new else was,
                now=math.nan if now == p.neutral else now,
                std=std,
                state=state,
            )
        )
    return tuple(out)
