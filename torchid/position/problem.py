"""What a diagnosis of commands and positions is asked: motions, windows of them, and what a plain
servo and the robot's file leave there."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from torchid.effects.servo import INDEX
from torchid.log.checks import near
from torchid.log.model import Log
from torchid.position.data import WINDOW_S, PositionData, missing_commands, prepare, tracks_of
from torchid.position.effects import CORE, KEPT
from torchid.position.file_servos import Followed, as_file, follows, near_enough
from torchid.position.fit import errors_of_one
from torchid.position.in_mujoco import Beside, FileInMujoco, along_lines, held, late
from torchid.position.judge import equations
from torchid.position.known_numbers import contradicted
from torchid.position.model import ServoArm
from torchid.position.repeats import PositionNoise, noise_of_repeats
from torchid.position.rods import PER_METRE
from torchid.position.search import plain
from torchid.position.servo_model import Motions, ServoModel
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import MIDDLE, Windows, windows_of
from torchid.statistics.criteria import ALIKE_LOSS, WORTHWHILE
from torchid.typing import Bool, Float

MOST_WINDOWS = 250
"""That a search looks at [1]: more do not change what it finds, only how long it takes."""

ROUNDS = 2
"""Of fits of a file's numbers, each about where the file's own simulator goes with those before."""

JUMP_S, PLACES = 0.3, (0.0, 0.25, 0.5, 0.75, 1.0)
"""Time after a jump of the commands that tells when it was [s]; and when it may have been [samples
after the row before]."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A question.

    Attributes:
        data: motions, of the robot as given.
        few, more: motions as a search, and the last fit, look at them.
        simple: plain servos with any delay, fitted to as many, where a search begins.
        start: the arm that the robot's file describes; None where it has no servos.
        squares: share of the squared error by which an effect must lower it to be named.
        warnings: about the log, one sentence each.
        trusted: whether the masses of the robot's file are right.
        types: of the joints' servos: those of one name are units of one type.
        sheets: what their makers say of them, values by parameter.
        gains: (n,) that all else that is known says where the file's contradicts it, else nan
            [N m/rad].
    """

    data: PositionData
    few: Motions
    more: Motions
    simple: ServoModel
    start: ServoArm | None
    squares: float
    warnings: tuple[str, ...]
    gains: Float[Tensor, " n"]
    trusted: bool = False
    types: Sequence[str] = ()
    sheets: Sequence[Mapping[str, float]] = ()

    @cached_property
    def noise(self) -> PositionNoise:
        """What no servo closes, where repeats tell it."""
        return noise_of_repeats(self.data, self.simple.servos)

    @cached_property
    def plain(self) -> ServoModel:
        """Plain servos that are no later, and pulled at no more, than is usual: what named causes
        are held against."""
        model, usual = self.simple, self.data.usual
        for effect in KEPT:
            if bool((beyond := model.beyond(effect, usual)).any()):
                model = model.without(effect, beyond, usual)
        return model if model is self.simple else model.fitted(self.few, 8)

    @cached_property
    def file(self) -> Followed | None:
        """The servos of the robot's file as they are nearest."""
        return None if self.start is None else self.followed(self.few)

    @cached_property
    def doubted(self) -> Bool[Tensor, " n"]:
        """Joints whose gain, as the file has it, all else that is known contradicts."""
        return self.gains.isfinite()

    @cached_property
    def believed(self) -> ServoArm | None:
        """The arm that the robot's file describes, but for gains that are doubted."""
        return None if self.start is None else believed(self.start, self.gains)

    @cached_property
    def given(self) -> Servos | None:
        """The servos of the robot's file as they are nearest, with its gains; None without any."""
        if self.file is None or self.start is None:
            return None
        gains = self.start.servos.of("kp").masked_fill(~self.doubted, torch.nan)
        return with_gains(self.file.model.servos, gains)

    def followed(self, motions: Motions) -> Followed:
        """How motions, of this arm or one like it, follow the servos of the robot's file."""
        assert self.believed is not None
        return follows(motions, self.believed.servos, self.simple.free, self.noise)


def pose(
    robot: Robot, log: Log, start: ServoArm | None = None, worthwhile: float = WORTHWHILE
) -> Problem:
    """The question of a log; arguments are those of `diagnose_positions`.

    Raises:
        LogError: as `prepare`.
    """
    log, alike = with_motions(log)
    scaled = start is not None and bool((start.scale != 1).any())
    data = prepare(robot, log, start.scale if start is not None and scaled else None)
    if start is not None:
        data = replace(data, damping_share=start.servos.of("damping_share"))
    windows = windows_of(data.tracks, WINDOW_S)
    some = some_of(windows, MOST_WINDOWS)
    held = plain(Motions(data, some))
    ways = Ways(some, start, _own_simulator(data, log, start, bool(alike)))
    way, gains = ways.as_given(data, held), torch.full_like(data.damping_share, torch.nan)
    if start is not None and way is None:
        plainly = equations(data, held.servos, held.free, some)
        gains = contradicted(data, start.servos, plainly)
        if bool(gains.isfinite().any()):
            # What the file's own simulator does with these numbers says nothing.
            ways = Ways(some, believed(start, gains), None)
    data, simple = way or ways.nearest(data, held)
    telling = _telling(data, simple, windows)
    few, more = (Motions(data, some_of(windows, k * MOST_WINDOWS, telling)) for k in (1, 3))
    squares = 1.0 - (1.0 - worthwhile) ** 2
    apart = () if data.beside is None else data.beside.words()
    warnings = (*alike, *missing_commands(log), *_cautions(data), *apart)
    return Problem(data, few, more, simple, start, squares, warnings, gains)


def believed(start: ServoArm, gains: Float[Tensor, " n"]) -> ServoArm:
    """The arm of a file with other gains, where they are no nan."""
    return replace(start, servos=with_gains(start.servos, gains))


def with_gains(servos: Servos, gains: Float[Tensor, " n"]) -> Servos:
    """Servos with other gains, where they are no nan."""
    joint, k = servos.joint.clone(), INDEX["kp"]
    joint[:, k] = torch.where(gains.isfinite(), gains, joint[:, k])
    return replace(servos, joint=joint)


def _own_simulator(
    data: PositionData, log: Log, start: ServoArm | None, parts: bool
) -> Callable[[PositionData, bool], PositionData] | None:
    """Motions beside MuJoCo's replay of the robot's file, with commands that hold from row to row
    or not; None where no file of its own says all of the arm.

    Args:
        data: motions.
        log: all of its rows.
        start: the servos of the file.
        parts: whether the motions are parts of one.
    """
    file = None if start is None else FileInMujoco.of(data.robot)
    if file is None or start is None:
        return None
    fast, servos = tracks_of(log, data.scale), start.servos

    def beside(data: PositionData, holds: bool) -> PositionData:
        commands = held(fast, parts) if holds else along_lines(data.tracks, parts)
        data = replace(data, tracks=file.taken(data.tracks), set_points={})
        return replace(data, beside=Beside(file, data, late(servos, data), commands))

    return beside


Way = tuple[PositionData, ServoModel]
"""Motions, and servos that were fitted to them."""


@dataclass(frozen=True, eq=False)
class Ways:
    """How commands may have been sent, and by which servos the arm may have gone: plain ones, or
    those of its file, by our kernel or by the file's own simulator.

    Attributes:
        windows: of the motions.
        start: the file's servos, if it has any.
        own: the motions beside the file's own simulator, if it has one.
    """

    windows: Windows
    start: ServoArm | None
    own: Callable[[PositionData, bool], PositionData] | None

    def as_given(self, data: PositionData, plain: ServoModel) -> Way | None:
        """The motions beside the file's own simulator, where they follow it as it is; else None."""
        if self.own is None:
            return None
        way = self.own(data, True)
        motions = Motions(way, self.windows)
        near = near_enough(motions, self._file(way), data.slight)
        return (way, plain.fitted(motions, 8)) if bool((near | data.still).all()) else None

    def nearest(self, data: PositionData, held: ServoModel) -> Way:
        """The motions, and plain servos there, with commands that hold until the next one; or that
        go on between rows, where servos follow them nearer: no row tells then when they jumped.

        Args:
            data: with commands that hold.
            held: plain servos that were fitted to them.
        """
        motions = Motions(data, self.windows)
        fits = self._by_file(data, holds=True)
        if not bool(data.tracks.jumping.any()):
            return self._followed((data, held), fits)[:2]
        best = min([held, *(m for x, m in fits if x is data)], key=lambda m: self._left(data, m))
        sent, model = self._sent(data, best)
        model = model if best is held else held.fitted(Motions(sent, self.windows), 8)
        # Both from where either may begin.
        held = min(held, model.fitted(motions, 8), key=lambda m: float(m.losses(motions).sum()))
        ways = (
            self._followed((data, held), fits),
            self._followed((sent, model), self._by_file(sent, holds=False)),
        )
        return ways[ways[0][2] - ways[1][2] > math.log(ALIKE_LOSS)][:2]

    def _left(self, data: PositionData, model: ServoModel) -> float:
        """Mean logarithm of the losses on joints that move, over what calls for no cause, which
        comes on top: what is below is neither way's."""
        motions = Motions(data, self.windows)
        return float((model.losses(motions) / motions.slight + 1).log()[~data.still].mean())

    def _by_file(self, data: PositionData, *, holds: bool) -> list[Way]:
        """The file's servos with all of their numbers refitted by our kernel; and by the file's own
        simulator, if it has one, as they are and refitted."""
        if self.start is None:
            return []
        ways = [(data, self._refitted(data))]
        if self.own is not None:
            data = self.own(data, holds)
            for _ in range(ROUNDS):
                assert data.beside is not None
                data = replace(data, beside=data.beside.about(self._refitted(data).servos))
            ways += [(data, self._file(data)), (data, self._refitted(data))]
        return ways

    def _file(self, data: PositionData) -> ServoModel:
        assert self.start is not None
        motions = Motions(data, self.windows)
        return as_file(motions, self.start.servos, dict.fromkeys(CORE, motions.every))

    def _refitted(self, data: PositionData) -> ServoModel:
        return self._file(data).fitted(Motions(data, self.windows), 8, plane=True)

    def _followed(self, plain: Way, fits: Sequence[Way]) -> tuple[PositionData, ServoModel, float]:
        """The motions beside the file's own simulator, unless our kernel alone follows them much
        nearer; plain servos there; and what the nearest servos leave."""
        data, simple = plain
        alone = min(self._left(*way) for way in (plain, *fits) if way[0] is data)
        beside = min((self._left(*way) for way in fits if way[0] is not data), default=math.inf)
        if beside - alone > math.log(ALIKE_LOSS):
            return data, simple, alone
        data = fits[-1][0]
        simple = simple.fitted(Motions(data, self.windows), 8)
        return data, simple, min(beside, self._left(data, simple))

    def _sent(self, data: PositionData, model: ServoModel) -> tuple[PositionData, ServoModel]:
        """The motions with commands that go on between rows, and jump where the servos say, fitted
        there."""
        at = data.tracks.jumping.nonzero().flatten()

        def sent(jump_at: Tensor) -> PositionData:
            return replace(data, tracks=replace(data.tracks, jump_at=jump_at), held=0.0)

        every, row = windows_of(data.tracks, WINDOW_S), torch.zeros_like(data.q)
        after = at[:, None] + torch.arange(max(2, round(JUMP_S / data.tracks.dt)))
        jump_at = torch.full_like(row[:, 0], MIDDLE)
        for _ in range(3):
            ways = [sent(jump_at.clone().index_fill_(0, at, place)) for place in PLACES]
            apart = [
                every.on_rows(errors_of_one(x, model.servos, every), row.clone()) for x in ways
            ]
            squares = torch.stack(apart).square().sum(2)[:, after.clamp(max=len(row) - 1)].sum(2)
            jump_at[at] = torch.tensor(PLACES, dtype=row.dtype)[squares.argmin(0)]
            model = model.fitted(Motions(sent(jump_at), self.windows), 8)
        return sent(jump_at), model


def with_motions(log: Log) -> tuple[Log, tuple[str, ...]]:
    """The log with enough motions to hold some out: one long motion is taken in parts, which is
    said."""
    if log.trajectory_count > 1:
        return log, ()
    parts = torch.arange(log.samples) * 4 // log.samples
    names = tuple(f"{log.names[0]}[part {k + 1}]" for k in range(4))
    return log.replace(trajectory=parts, names=names), (
        "One motion only: its quarters are held out in turn, which are more alike than motions are",
    )


def _cautions(data: PositionData) -> tuple[str, ...]:
    """What to know about joints and robot, one sentence each."""
    names = data.robot.joint_names
    out = [
        f"joint {j + 1} {names[j]} never moves, so its servo is not identified."
        for j in torch.nonzero(data.still).flatten().tolist()
    ]
    if not data.weighed:
        out.append(
            f"robot '{data.robot.name}' has no masses: its links were taken for rods of "
            f"{PER_METRE:g} kg per metre, so gains, friction and inertias are right in their "
            "ratios alone."
        )
    out += [
        _of_range(data, j)
        or f"joint {j + 1}: dq is {float(s):.3g} times the rate of q, so q and u are taken to be "
        "in another unit than radians, by that factor"
        for j, s in enumerate(data.scale)
        if s != 1
    ]
    return tuple(out)


def _of_range(data: PositionData, joint: int) -> str:
    """How to read a joint that is logged as a fraction, or per cent, of its range; empty where its
    velocities do not say so."""
    limits, q = data.robot.limits.position, data.log.q[:, joint]
    if limits is None or not bool(limits[joint].isfinite().all()):
        return ""
    low, span = float(limits[joint, 0]), float(limits[joint, 1] - limits[joint, 0])
    for whole, words in ((1.0, "a fraction"), (100.0, "per cent")):
        inside = -0.1 * whole < float(q.min()) <= float(q.max()) < 1.1 * whole
        if not inside or not near(float(data.scale[joint]) * whole, span):
            continue
        factors, zeros = ["1"] * data.robot.n, ["0"] * data.robot.n
        factors[joint], zeros[joint] = f"{span / whole:.5g}", f"{-low * whole / span:.5g}"
        line = f"*[{','.join(factors)}] - [{','.join(zeros)}]"
        return (
            f"joint {joint + 1} {data.robot.joint_names[joint]} is logged as {words} of its range: "
            f"q = {span / whole:.4g} q{joint + 1} {low:+.4g} rad. Its zero is not known here; read "
            f"it with the columns q=q{{j}} {line},u=u{{j}} {line}"
        )
    return ""


def some_of(windows: Windows, most: int, size: Tensor | None = None) -> Windows:
    """At most so many windows, each with what it stands for.

    Args:
        windows: all of them.
        most: to take.
        size: (W,) how much each tells; the chance to be taken grows with it. None: all alike.
    """
    if size is None:
        size = torch.ones(len(windows.start), dtype=torch.float64)
    chance = (size / size.sum() * most).clamp(max=1.0)
    for _ in range(20):  # what is certain leaves more of the chances to the others
        free = chance < 1
        rest = most - float((~free).sum())
        if rest <= 0 or not bool(free.any()):
            break
        chance = torch.where(free, (size / size[free].sum() * rest).clamp(max=1.0), 1.0)
    # Evenly spaced along the sum of chances: no draw, and every stretch of the log has its share.
    ends = chance.cumsum(0) + 0.5
    rows = torch.nonzero(ends.floor() > (ends - chance).floor()).flatten()
    some = windows.some(rows)
    return replace(some, weight=some.weight / chance[rows])


def _telling(data: PositionData, model: ServoModel, windows: Windows) -> Float[Tensor, " W"]:
    """How much windows tell: the plain servo's error there, and no less than half of the typical
    one, so that none is left to chance alone."""
    error = errors_of_one(data, model.servos, windows)
    rms = (error.square().sum(0) / (error != 0).sum(0).clamp(min=1)).mean(1).sqrt()
    return rms + rms.median() / 2
