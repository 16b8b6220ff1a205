"""Commands that settle what a diagnosis of commands and positions leaves open.

Steps of several sizes tell delays, profiles and clips; slow ramps with holds tell gains, friction
at rest and dead zones; chirps tell inertia, rates and filters. Each of them, in several sizes, is
driven in simulation by the answered servos, and its normal equations say how well every parameter
would be known; those that help the open ones most are taken one after the other.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import torch
from msgspec import UNSET, UnsetType

from torchid.effects.servo import INDEX, PARAMETERS, as_share
from torchid.errors import RobotError, TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.limits import position_limits
from torchid.excitation.search import most_telling
from torchid.log.model import Log
from torchid.parallel.pace import Pace
from torchid.parallel.workers import Progress
from torchid.position.data import WINDOW_S, prepare
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.effects import BY_NAME, CORE
from torchid.position.fit import TOGETHER_S
from torchid.position.judge import Equations, equations
from torchid.position.model import ServoArm
from torchid.position.record import PositionRecord
from torchid.position.replay import replay
from torchid.position.rods import with_rods
from torchid.results.files import read_as
from torchid.results.record import Col, Joint, Part, Real, Record, Rows
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float, Tensor

MOTIONS = 4
"""That are written."""
SECONDS, RATE = 20.0, 50.0
"""Length of each [s], and commands a second [Hz]."""
STEPS, RAMPS, CHIRPS = (0.02, 0.08, 0.3), (0.2, 0.5, 0.9), (0.03, 0.1, 0.3)
"""Sizes of each kind, as shares of half of the range of positions."""
HELD_S, LEG_S = 1.0, 4.0
"""Between steps, and of a ramp or a hold [s]."""
LOWEST_HZ, HIGHEST_HZ = 0.1, 3.0
"""Of chirps."""
UNSURE = 0.2
"""A size whose 95 % interval is this share of it to either side, or more, is open [1]."""
SMALLER, SLOWER, TRIES = 0.6, 0.9, 5
"""Factors by which motions shrink that go too far, and of the speed that is too high; how often."""


class OpenParameter(Part, frozen=True, kw_only=True):
    """A parameter that is to be known better; half widths of 95 % intervals, as a share of what is
    positive.

    Attributes:
        joint, parameter: which.
        why: `unsure`, or the effect that it cannot be told from.
        now: half width by the diagnosis; null where it is not known.
        then: half width by the diagnosis and these motions.
    """

    joint: Annotated[Joint, Col()]
    parameter: Annotated[str, Col()]
    why: Annotated[str, Col("open because of")]
    now: Annotated[Real, Col("now ±", ".2g")]
    then: Annotated[Real, Col("then ±", ".2g")]


class NextCommandsRecord(Record, frozen=True, kw_only=True, tag="torchid.position_motion/1"):
    """Commands to drive next, as their JSON has them.

    Attributes:
        robot: its name.
        motions: what each of the log's trajectories is.
        open: what they are for; empty where nothing is open, and then they serve all parameters.
        seconds, rate: of each motion [s, Hz].
        warnings: one sentence each.
        seed: from a command.
    """

    robot: str
    motions: tuple[str, ...]
    open: tuple[OpenParameter, ...]
    seconds: Real
    rate: Real = msgspec.field(name="rate_hz")
    warnings: tuple[str, ...] = ()
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[OpenParameter]:
        """The open parameters."""
        return Rows(self.open)


class NextCommands(NextCommandsRecord, frozen=True, eq=False, kw_only=True):
    """Commands to drive next.

    Attributes:
        log: t, the commands u, and where the answered servos go with them, q; in the log's units.
        robot, motions, open, seconds, rate, warnings: as in their JSON, `NextCommandsRecord`.
    """

    log: Log

    def __repr__(self) -> str:
        return f"NextCommands('{self.robot}', {', '.join(self.motions)})"

    @property
    def record(self) -> NextCommandsRecord:  # type: ignore[override]  # no log in it
        """As the JSON has it."""
        return NextCommandsRecord.of(self)


def next_commands(
    result: PositionDiagnosis | PositionRecord | str | Path,
    robot: Robot,
    *,
    seconds: float = SECONDS,
    rate: float = RATE,
    usage: float = 1.0,
    clearance: Clearance | None = None,
    progress: Progress | None = None,
) -> NextCommands:
    """Commands that settle what a diagnosis of commands and positions leaves open.

    Args:
        result: a diagnosis, or its file.
        robot: that was diagnosed, with limits of velocity.
        seconds: of each motion [s].
        rate: of the commands [Hz].
        usage: share of the limits that may be used, of positions about the middle.
        clearance: distances to keep; checked at every sample of the simulated motion.
        progress: called with (stage, done, total).

    Raises:
        RobotError: limits are missing, or no motion keeps them.
        TorchidError: a robot with another number of joints, or no result of such logs.
    """
    found = result.record if isinstance(result, PositionDiagnosis) else result
    if not isinstance(found, PositionRecord):
        found = read_as(found, PositionRecord, "a diagnosis of commands and positions")
    n = len(found.where.joints)
    if robot.n != n:
        raise TorchidError(
            f"the diagnosis is of another robot than '{robot.name}'.",
            got=f"{robot.n} joints", expected=f"{n}, as '{found.robot}' has",
        )  # fmt: skip
    if not seconds >= 2 * WINDOW_S:
        raise TorchidError("such motions are longer.", got=seconds, expected=f"{2 * WINDOW_S:g} s")
    robot.limits.require("velocity", robot=robot.name, purpose="the design of commands")
    heavy = robot if robot.parameters is not None else with_rods(robot)
    servos = Servos.from_record(msgspec.to_builtins(found.servos), n, found.robot)
    arm = ServoArm(heavy, servos, torch.ones(n, dtype=torch.float64))
    still = torch.tensor([joint.never_moves for joint in found.where.joints])
    wanted = _candidates(robot, still, seconds, rate, usage)
    say = Pace(progress, {"motions within the limits": 50, "what they would tell": 50})
    say("motions within the limits")
    logs = _kept(arm, wanted, rate, usage, clearance)
    names, kept = list(logs), list(logs.values())
    if not kept:
        raise RobotError(
            f"robot '{robot.name}': no motion about the middle of its range keeps the limits.",
            hint="`usage=...`, or limits of position about a posture with more room",
        )
    say("what they would tell")
    # What each motion would tell, where the answered servos are the truth.
    data = prepare(heavy, Log.concatenate(kept))
    asked = _asked(found, servos, still)
    free = _free(servos, {name for _, name in asked}, still)
    told = equations(data, servos, free, windows_of(data.tracks, WINDOW_S))
    # Noise as large as what the diagnosis left.
    left = torch.tensor([1e-3 * joint.answered_mrad for joint in found.where.joints])
    square = left.to(torch.float64).nan_to_num(1e-3).clamp(min=1e-4).square()
    alike = torch.full_like(square, TOGETHER_S / data.tracks.dt)
    told = replace(told, square=square, alike=alike)
    shares = torch.tensor([joint.ratio_only for joint in found.where.joints])
    start = _start(told, asked, shares)
    places = [(j, told.names.index(name)) for j, name in asked if name in told.names]
    places = places or told.mask.nonzero().tolist()
    at_joints, at_columns = torch.tensor(places).unbind(-1)
    chosen = most_telling(
        start, told.gram,
        lambda x: _deviations(told, x, shares)[..., at_joints, at_columns].log().sum(-1), MOTIONS,
    )  # fmt: skip
    after = _deviations(told, start + told.gram[chosen].sum(0), shares)
    opened = tuple(
        OpenParameter(
            joint=j, parameter=name, why=why, now=now,
            then=HALF_95 * float(after[j, told.names.index(name)]),
        )
        for (j, name), (why, now) in asked.items()
        if name in told.names
    )  # fmt: skip
    scale = found.log_scale
    parts = []
    for k in chosen:
        u = kept[k].u
        assert u is not None
        parts.append(kept[k].replace(q=kept[k].q / scale, u=u / scale))
    warnings = position_limits(robot)[1]
    return NextCommands(
        robot=robot.name, log=Log.concatenate(parts), motions=tuple(names[k] for k in chosen),
        open=opened, seconds=seconds, rate=rate, warnings=warnings,
    )  # fmt: skip


def _candidates(
    robot: Robot, still: Tensor, seconds: float, rate: float, usage: float
) -> dict[str, Float[Tensor, "T n"]]:
    """Commands of all kinds and sizes, by what they are, about the middle of the range [rad]."""
    low, high = position_limits(robot, usage)[0].unbind(-1)
    middle, half = (low + high) / 2, (high - low) / 2 * ~still
    t = torch.arange(round(seconds * rate), dtype=torch.float64)[:, None] / rate
    g = torch.Generator().manual_seed(0)
    signs = (2.0 * torch.randint(0, 2, (1 + int(seconds / HELD_S), robot.n), generator=g) - 1).to(t)
    # One joint after the other changes, so that which one moves another is told, too.
    begun = t - HELD_S * torch.arange(robot.n) / robot.n
    wave = signs.gather(0, (begun / HELD_S).floor().long().clamp(min=0)) * (begun > 0)
    # Up, hold, down, hold, then the same below; joints are half a leg apart.
    leg = (t / LEG_S + 0.5 * (torch.arange(robot.n) % 2)) % 8
    corners = torch.tensor([0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0, 0.0], dtype=t.dtype)
    below = leg.floor().long()
    ramp = corners[below] + (leg - below) * (corners[below + 1] - corners[below])
    ramp = ramp * (t / LEG_S).clamp(max=1.0)
    # Exponential in time; a sine's phase is its frequency's integral.
    growth = math.log(HIGHEST_HZ / LOWEST_HZ) / seconds
    turns = LOWEST_HZ * (torch.exp(growth * t) - 1) / growth
    chirp = (2 * math.pi * turns + torch.arange(robot.n)).sin() * (t / HELD_S).clamp(max=1.0)
    kinds = (("steps", STEPS, wave), ("slow ramps", RAMPS, ramp), ("chirp", CHIRPS, chirp))
    return {
        f"{name} of {100 * share:g} % of half the range": middle + share * half * shape
        for name, shares, shape in kinds
        for share in shares
    }


def _kept(
    arm: ServoArm,
    wanted: Mapping[str, Float[Tensor, "T n"]],
    rate: float,
    usage: float,
    clearance: Clearance | None,
) -> dict[str, Log]:
    """Commands made smaller, joint by joint, until the simulated motions are within the limits;
    with these motions, and without those that are not after some tries."""
    robot, velocity = arm.robot, arm.robot.limits.velocity
    assert velocity is not None
    fastest = usage * velocity.abs().amin(-1)
    low, high = position_limits(robot)[0].unbind(-1)
    out: dict[str, Log] = {}
    left = dict(wanted)
    for _ in range(TRIES):
        logs = [
            Log(torch.arange(len(u), dtype=torch.float64) / rate, q=u[:1].expand_as(u), u=u)
            for u in left.values()
        ]
        for (name, u), log in zip(tuple(left.items()), replay(arm, logs).simulated, strict=True):
            # A motion is about as fast as its commands are large.
            peak = (log.q.diff(dim=0) * rate).abs().amax(0)
            size = torch.where(peak > fastest, SLOWER * fastest / peak, 1.0)
            outside = (log.q < low).any(0) | (log.q > high).any(0)
            if clearance is not None and bool((clearance.strain(log.q) > 1).any()):
                outside |= True
            size = torch.where(outside, size.clamp(max=SMALLER), size)
            if bool((size < 1).any()):
                left[name] = u[0] + size * (u - u[0])
            else:
                out[name] = log
                del left[name]
        if not left:
            break
    return {name: out[name] for name in wanted if name in out}


def _asked(
    found: PositionRecord, servos: Servos, still: Tensor
) -> dict[tuple[int, str], tuple[str, float]]:
    """What is open, by joint (from 0) and parameter: why, and the half width of its interval."""
    out: dict[tuple[int, str], tuple[str, float]] = {}
    every = [j for j in range(servos.n) if not bool(still[j])]
    for effect in found.which:
        joints = effect.joints or every
        for told, (low, high) in effect.ci95.items():
            value, name = effect.parameters[told], told.removesuffix(as_share(""))
            if name not in INDEX or not math.isfinite(value):
                continue
            log = PARAMETERS[INDEX[name]].kind == "log"
            half = math.log(high / low) / 2 if log and low > 0 else (high - low) / 2
            unsure = half > UNSURE * (1.0 if log else abs(value))
            for j in joints if unsure or effect.ambiguous_with else ():
                why = ", ".join(effect.ambiguous_with) or "unsure"
                out[j, name] = why, half
        for rival in effect.ambiguous_with:
            for name in BY_NAME[rival].parameters if rival in BY_NAME else ():
                for j in joints:
                    out.setdefault((j, name), (effect.effect, math.nan))
    return out


def _free(servos: Servos, asked: set[str], still: Tensor) -> dict[str, Tensor]:
    """Parameters with a slope at the answered servos, and the joints on which they have one."""
    out = {}
    for p in PARAMETERS:
        value = servos.of(p.name)
        on = value.isfinite() & ((value > 0) | (p.kind != "log")) & ~still
        if p.name in CORE or (p.name in asked and bool(on.any())):
            out[p.name] = on
        elif bool((value != p.neutral).any()):
            out[p.name] = on & (value != p.neutral)
    return out


def _start(
    told: Equations, asked: Mapping[tuple[int, str], tuple[str, float]], shares: Bool[Tensor, " n"]
) -> Float[Tensor, "n K K"]:
    """Normal equations of the prior, and of what the diagnosis knows of the open parameters."""
    gram, to = torch.diag_embed(told.prior), told.to_values(shares)
    for (j, name), (_, half) in asked.items():
        if name in told.names and half > 0:
            row = to[j, told.names.index(name)]
            gram[j] += told.noise[j] * (HALF_95 / half) ** 2 * torch.outer(row, row)
    return gram


def _deviations(
    told: Equations, gram: Float[Tensor, "*C n K K"], shares: Bool[Tensor, " n"]
) -> Float[Tensor, "*C n K"]:
    """Standard deviations of parameters, of some joints as shares of kp; what is not free is
    held."""
    on, to = told.mask, told.to_values(shares)
    held = gram * on[:, :, None] * on[:, None] + torch.diag_embed((~on).to(gram))
    inverse = torch.linalg.inv(held) * on[:, :, None] * on[:, None]
    variance = (to @ inverse @ to.mT).diagonal(dim1=-2, dim2=-1).clamp(min=0)
    return (told.noise[:, None] * variance).sqrt()
