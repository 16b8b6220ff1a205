"""One cause of the error, the same wherever it is told: in memory, in JSON, in sentences.

Its numbers are the arm's; what the robot's file has of them stands beside them. It needs no torch.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, UnsetType

from torchid.results.agreement import Replication, repeat_words
from torchid.results.friction import FrictionLaw
from torchid.results.record import Col, Joint, Part, Real, Values
from torchid.results.words import (
    BRANCHES,
    PAYLOAD,
    digits,
    effect_words,
    joints_words,
    listed,
    measure,
    number_list,
    percent,
    span,
    sure,
    unit_behind,
    unit_words,
)
from torchid.results.words import LINK as LINK  # asked by all that tell of causes
from torchid.statistics.criteria import LIKELY

MOST_SIZES = 3
"""Numbers of a cause that are shown in a table."""
MOST_NAMES, MOST_MEMBERS = 2, 3
"""Logs that a sentence names, and members of a set."""

NO_FIELD = "Give the simulator this torque: no field of its file takes a negative number."
"""What to do about a number with a sign that files cannot say."""

NO_LIMIT = "Take the file's limit out: the arm shows none."
"""What to do about a number that is infinite."""

How = Literal["fitted", "left out in turn", "held out"]
"""How data were judged: by a model that was fitted to them; by models each of which was fitted
without the part that it is judged on; by a model that none of them took part in."""

When = Literal["new", "in both"]
"""Of a cause, beside an earlier log: whether it came since, or the model lacked it already."""
WHENS: dict[When | UnsetType, tuple[str, str]] = {
    "new": ("new", "since"), UNSET: ("new or lacking already", "in"),
    "in both": ("lacking already", "in"),
}  # fmt: skip
"""That in words, and the one before the log's name, in the order of a sentence; unset where neither
is likely."""
GLOSSES = {
    "new since": "not there in that log, or less",
    "lacking already": "there in that log as well, so the model lacks it and the arm is as it was",
    "unexplained": "more than noise may be, and of no cause that is known",
}
"""What words say that stand beside causes."""

Role = Literal["named", "suspect", "small"]
"""What is told of a cause: its name; that it is not sure enough for one; that it is sure, and
removes less than was asked for."""


def held_out_words(names: Iterable[str]) -> str:
    """`run9`, `run8 and run9`, `3 held-out logs`."""
    every = list(dict.fromkeys(names))
    few = listed(every, nothing="held-out data")
    return few if len(every) <= MOST_NAMES else f"{len(every)} held-out logs"


class JudgedOn(Part, frozen=True, kw_only=True):
    """Data that something was judged on.

    Attributes:
        on: names of the logs.
        how: they were judged.
    """

    on: tuple[str, ...] = ()
    how: How

    @classmethod
    def by_names(cls, names: Iterable[str], how: How) -> "JudgedOn":
        """Data of trajectories' logs, each named once."""
        return JudgedOn(on=tuple(dict.fromkeys(names)), how=how)

    def error(self, value: float, unit: str) -> "Error":
        """An error on them."""
        return Error(value=value, unit=unit, on=self.on, how=self.how)

    @property
    def words(self) -> str:
        """`on run9`, `on motions left out`, `on the data that were fitted`."""
        if self.how == "held out":
            return f"on {held_out_words(self.on)}"
        if self.how == "fitted":
            return "on the data that were fitted"
        return f"on {'stretches' if len(self.on) == 1 else 'motions'} left out"

    @property
    def whole(self) -> str:
        """The words, with what was done to them: `on run9, which was not fitted`, `on motions left
        out of the fit`."""
        if self.how == LEFT_OUT.how:
            return f"{self.words} of the fit"
        was = "was" if len(set(self.on)) == 1 else "were"
        named = self.how == "held out" and 0 < len(self.on) <= MOST_NAMES
        return self.words + f", which {was} not fitted" * named


LEFT_OUT = JudgedOn(how="left out in turn")
"""Data each part of which was left out of the fit that it judges."""


class Error(JudgedOn, frozen=True, kw_only=True):
    """How far a model errs, and on which data.

    Attributes:
        value: RMS [its unit].
        unit: of it.
    """

    value: Real
    unit: str

    @property
    def size(self) -> str:
        """`0.31 N m`."""
        return f"{digits(self.value)} {unit_words(self.unit)}"


class Window(Part, frozen=True):
    """A stretch of a trajectory [s]."""

    trajectory: str
    from_s: float
    to_s: float

    @property
    def words(self) -> str:
        """`in run1 from 3.2 to 4.1 s`."""
        return f"in {self.trajectory} from {self.from_s:.1f} to {self.to_s:.1f} s"

    @property
    def outside(self) -> str:
        """The mask of all other samples of its log, in Python."""
        return f"((log.t < {self.from_s:.1f}) | (log.t > {self.to_s:.1f}))"


@dataclass(frozen=True)
class Size:
    """One number of a cause.

    Attributes:
        name, unit: of the number; unit 1 of a plain number.
        value: the arm's.
        std: standard deviation; None where the data do not determine it.
        was: what the robot's file has; None of what it has not.
    """

    name: str
    unit: str
    value: float
    std: float | None = None
    was: float | None = None

    @property
    def field(self) -> str:
        """Where a remedy sets a field of a file to it, as a pattern."""
        return rf"\bto {self.name}\b"

    @property
    def rounded(self) -> str:
        """The value with as many digits as its standard deviation leaves; `none` of no limit."""
        if math.isinf(self.value):
            return "none"
        return digits(float(measure(self.value, self.std, "").split()[0]), 6)

    @property
    def determined(self) -> bool:
        """Whether the data say more than its order of magnitude, or that it is not the file's."""
        off = 0.0 if self.was is None else abs(self.value - self.was)
        return self.std is None or self.std < max(abs(self.value), off)

    @property
    def words(self) -> str:
        """`0.61 ± 0.02 N m`; of what the file has too `60 -> 15.0 ± 0.3 N m s/rad`; of a limit that
        the arm has not `3.35 N m -> none`."""
        was = "" if self.was is None else f"{digits(self.was)} -> "
        if math.isinf(self.value):
            return f"{was.replace(' ->', f' {unit_behind(self.unit)} ->')}none"
        return was + measure(self.value, self.std, unit_behind(self.unit))

    @property
    def plain(self) -> bool:
        """Whether it stands before what it is of: `4 N m`; no change, plain number or limit, and
        nothing with a sign."""
        return self.was is None and self.unit != "1" and 0 < self.value < math.inf

    @property
    def sharp(self) -> "Size":
        """The number as rounded, without its standard deviation."""
        value = self.value if math.isinf(self.value) else float(self.rounded)
        return replace(self, std=None, value=value)

    @property
    def named(self) -> str:
        """`Fv = 5.6 ± 0.7 N m s/rad`."""
        return f"{self.name} = {self.words}"


def _effects(names: Iterable[str]) -> str:
    return ", ".join(map(effect_words, names)) or "-"


def _joints(joints: Iterable[int]) -> str:
    return number_list(joints, "all")


class Cause(Part, frozen=True, kw_only=True):
    """One cause of the error.

    Attributes:
        effect: its name, as `torchid effects` lists it; `link_inertia` of inertial parameters.
        family: of the effect.
        branch: of the tree of causes, `friction`, say, where no more than that is sure; then
            `effect` is the likeliest of these.
        role: what is told of it.
        joints: whose torque it changes: those that it is at; of what belongs to the whole arm those
            that feel it. Of inertial parameters links; none: all of them.
        located: joints that it is at, those of `joints` if not given; none of what belongs to the
            whole arm.
        common: whether one coefficient is common to all joints.
        ambiguous_with: effects that these data cannot separate from it.
        probabilities: of each of that set and of it alone, by name, where they are known [1].
        parameters: its numbers on the arm by name: coefficients, shapes and places.
        file: what the robot's file has of the coefficients; empty of an effect that it has not.
        std: standard deviations of the coefficients, and of shapes that were fitted with them; null
            where the data do not determine one.
        unit: of coefficients and shapes; `1` of plain numbers.
        shape, places: which of the parameters are shapes, and which places.
        main: the coefficient that makes most of its torque in these logs.
        how_sure: probability of it, or of what the name says where that is more: of the set, of the
            branch; the only one that is printed anywhere. None where none is known.
        share: of the error that it takes away, the mean over all orders in which causes may join,
            so that the shares of all causes add up [1].
        alone: share of the error that it takes away by itself [1].
        removes: (n,) what it takes away of each joint's error [N m; N]; they add up, too.
        closes_rms: of what has no name: root of the fall of the mean square of the error, on the
            joint where that is most [N m; N].
        judged: data that say how sure it is and what it takes away; absent where it is not known.
        window: of what happened once; else absent.
        when: whether it is new since an earlier log, or in both; absent without one.
        law: all friction of its joint, where this is several terms of it as one; else absent.
        replication: whether it is the same in every motion; null of what is asked no such thing.
        meaning: of the effect, in words.
        remedy: what to do, one sentence, in the names of its numbers; of what has no name what
            would settle it.
        source: of the effect's equation.
        notes: sentences, e.g. that a coefficient is not determined.
    """

    effect: str
    family: str = ""
    branch: str = ""
    role: Annotated[Role, Col()] = "named"
    joints: tuple[Joint, ...]
    located: tuple[Joint, ...] | None = None
    common: bool = False
    ambiguous_with: Annotated[tuple[str, ...], Col("could also be", words=_effects)] = ()
    probabilities: dict[str, Real] = msgspec.field(default_factory=dict)
    parameters: Values = msgspec.field(default_factory=dict)
    file: dict[str, Real] = msgspec.field(default_factory=dict)
    std: dict[str, float | None] = msgspec.field(default_factory=dict)
    unit: dict[str, str] = msgspec.field(default_factory=dict)
    shape: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    main: str = ""
    how_sure: Annotated[float | None, Col("sure", words=sure)] = None
    share: Annotated[Real, Col(words=percent)] = math.nan
    alone: Annotated[Real, Col("by itself", words=percent)] = math.nan
    removes: tuple[Real, ...] = ()
    closes_rms: Real = math.nan
    judged: JudgedOn | UnsetType = UNSET
    window: Window | UnsetType = UNSET
    when: When | UnsetType = UNSET
    law: FrictionLaw | UnsetType = UNSET
    replication: Annotated[Replication | None, Col("same size in", words=repeat_words)] = None
    meaning: str = ""
    remedy: Annotated[str, Col("what to do")] = ""
    source: str | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.located is None:
            msgspec.structs.force_setattr(self, "located", self.joints)
        super().__post_init__()

    @property
    def at(self) -> Annotated[tuple[Joint, ...], Col("joints", words=_joints)]:
        """Joints that it is at, from 0; links of inertial parameters; none: the whole arm."""
        return self.located or ()

    @property
    def changed(self) -> bool:
        """Whether the robot's file has it already, with other numbers."""
        return bool(self.file)

    @property
    def one_of_a_set(self) -> bool:
        """Whether it is the likeliest of a set none of which is likely by itself."""
        return self.probabilities.get(self.effect, 1.0) < LIKELY

    @property
    def has_own_name(self) -> bool:
        """Whether its name is that of its effect alone, of which its numbers and its remedy are."""
        return not self.one_of_a_set or bool(self.branch)

    @property
    def members(self) -> tuple[str, ...]:
        """Names of the effects of its set, the likeliest first, where no member is likely by
        itself: then the set has the name, for the probability is the set's. Else its own."""
        if not self.one_of_a_set:
            return (self.effect,)
        every = dict.fromkeys((self.effect, *self.ambiguous_with), 0.0) | self.probabilities
        return tuple(sorted(every, key=lambda name: -every[name]))

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Coefficients, that which makes most of its torque first."""
        return tuple(
            Size(name, self.unit.get(name, ""), float(value), std, self.file.get(name))
            for name, std in sorted(self.std.items(), key=lambda item: item[0] != self.main)
            if name not in self.shape
            and isinstance(value := self.parameters.get(name), float | int)
        )

    @property
    def numbers(self) -> Annotated[str, Col("value ± std")]:
        """All of its numbers, a line each, those that the data determine first, then shapes."""
        shapes = self.shape if self.role != "small" else ()
        lines = [
            *(s.named for s in self.sizes if s.determined),
            *(f"{s.name}, not determined" for s in self.sizes if not s.determined),
            *(Size(x, self.unit[x], float(self.parameters[x]), self.std.get(x)).named  # type: ignore
              for x in shapes),
        ]  # fmt: skip
        return "\n".join(lines) or "-"

    @property
    def no_field(self) -> bool:
        """Whether its remedy sets a field of the file to a number that is negative there."""
        return any(s.value < 0 and re.search(s.field, self.remedy) for s in self.sizes)

    @property
    def known(self) -> tuple[Size, ...]:
        """Sizes that the data determine; of a change of the file those that the file has; none
        where another of its set is likelier, whose they are not."""
        if self.members[0] != self.effect:
            return ()
        return tuple(
            s for s in self.sizes if s.determined and (s.was is not None or not self.changed)
        )

    @property
    def kind(self) -> str:
        """The cause's branch in words, where no more is sure; else empty."""
        return BRANCHES[self.branch] if self.branch else ""

    @property
    def name(self) -> Annotated[str, Col("effect")]:
        """What is as sure as is said: the cause's name, in words; its set's, where no member is
        likely by itself; its branch's."""
        own = effect_words(self.effect)
        if self.effect == LINK:
            links = f"{'s' * (len(self.at) > 1)} {listed(str(k + 1) for k in self.at)}"
            own = f"inertia of link{links}" if self.at else "inertial parameters"
        words = [own if m == self.effect else effect_words(m) for m in self.members]
        if not self.branch:
            return f"{'one of ' * (len(words) > 1)}{listed(words, 'or', most=MOST_MEMBERS)}"
        likeliest = self.members[0] == self.effect
        return f"{self.kind} ({f'likely {own}' if likeliest else 'one of ' + listed(words, 'or')})"

    def values(self, std: bool = True) -> str:
        """The cause's numbers: `0.61 ± 0.02 N m`, `c0 = 8.8 ± 0.5 N m, k = 1.0 ± 0.2 N m/rad`, `60
        -> 15 N m s/rad`; where the data determine none of them, or bodies have none, how much of
        the error it removes; of a load that its mass is not known; of what removes nothing that.
        Without standard deviations the first alone. Of a law `1.2, 1.9, 3.4 N m at 0.1, 0.5, 2
        rad/s`."""
        none = "; takes no error away" * (self.share <= 0)
        if self.law is not UNSET:
            return self.law.words(std) + none
        massless = self.effect == PAYLOAD and any(not s.determined for s in self.sizes[:1])
        when = "" if self.window is UNSET else f", {self.window.words}"
        end = "; mass not known" * massless + when + none
        sizes = self.known[: 1 if self.effect == PAYLOAD else MOST_SIZES]
        if not sizes:
            return "" if math.isnan(self.share) else f"{percent(self.share)} of the error{end}"
        return ", ".join(map(self.in_words, sizes if std else (sizes[0].sharp,))) + end

    def in_words(self, size: Size) -> str:
        """One of its numbers, with its name where it has several."""
        return size.words if len(self.sizes) == 1 and self.has_own_name else size.named

    @property
    def rivals(self) -> str:
        """`, or Stribeck friction`: what the log cannot separate from it, where its name does not
        say so."""
        said = self.one_of_a_set and not (self.branch and self.members[0] == self.effect)
        others = [] if said else list(map(effect_words, self.ambiguous_with))
        more = f" or {len(others) - 1} others" if len(others) > 2 else ""
        return f", or {others[0] if more else listed(others, 'or')}{more}" if others else ""

    @property
    def place(self) -> str:
        """`on joint 2`; nothing of the whole arm, or where the name has it."""
        return "" if self.effect == LINK or not self.at else f"on {joints_words(self.at)}"


def values_of(same: Sequence[Cause], most: int | None = None) -> str:
    """The main number of causes of one name, joint by joint: `60 -> 15, 20, 12 N m s/rad`, with its
    name where they have several or it has no unit; of more than `most` joints the least and the
    largest. Nothing while none has a number."""
    sized = [c for c in same if c.sizes]
    if not sized:
        return ""
    size = max(sized, key=lambda c: c.share if c.share == c.share else 0.0).sizes[0]
    by_joint = sorted(same, key=lambda c: c.at)
    own = [next((s for s in c.sizes if s.name == size.name), None) for c in by_joint]
    if most is not None and len(own) > most:
        some = sorted((s for s in own if s is not None), key=lambda s: s.value)
        text = _side_by_side([some[0], some[-1]]).replace(", ", " to ")
    else:
        text = _side_by_side(own)
    several = size.unit == "1" or any(len(c.sizes) > 1 for c in same)
    name = f"{size.name} = " if several else ""
    return f"{name}{text} {unit_behind(size.unit)}".rstrip()


def law_sizes(laws: Sequence[FrictionLaw]) -> str:
    """Friction at the middle speed: `0.41 N m at 0.54 rad/s`, of several joints `0.09 to 0.41 N
    m`."""
    if len(laws) == 1:
        return laws[0].words(every=False)
    sizes = [law.middle.size for law in laws if law.middle] or [math.nan]
    return f"{span((min(sizes), max(sizes)), 2)} {unit_behind(laws[0].unit)}"


def _side_by_side(sizes: Sequence[Size | None]) -> str:
    """Values of several joints: what the file has, once where it is the same everywhere, and the
    arm."""
    was = ["" if s is None or s.was is None else f"{digits(s.was)} -> " for s in sizes]
    one = was[0] if len(set(was)) == 1 else ""
    each = zip(was, sizes, strict=True)
    return one + ", ".join(
        ("" if one else old) + ("-" if s is None else s.rounded) for old, s in each
    )


def remedy_of(same: Sequence[Cause], short: bool = False) -> str:
    """What to do about causes of one remedy, with the arm's numbers: `Set the joint's damping to
    15, 20 N m s/rad in the simulator.`

    Args:
        same: of one remedy; if one of them has no field, none has.
        short: its first clause alone.
    """
    text = same[0].remedy
    if any(math.isinf(s.value) for c in same for s in c.sizes):
        return NO_LIMIT
    if any(c.no_field for c in same):
        return NO_FIELD
    if short:
        text = re.split(r"[,;:(]", text, maxsplit=1)[0].strip().rstrip(".")
    for size in same[0].sizes:
        by_joint = sorted(same, key=lambda c: c.at)
        own = [s for c in by_joint for s in c.sizes if s.name == size.name]
        if not re.search(size.field, text) or len(own) < len(same):
            continue
        values = f"to {', '.join(s.rounded for s in own)} {unit_behind(size.unit)}"
        text = re.sub(size.field, values.rstrip(), text)
    return text


def cut_line(same: Sequence[Cause]) -> str:
    """What cuts events out of each log with some: `in Python, of run1: log = log.select(..)`."""
    each: dict[str, list[str]] = {}
    for window in (c.window for c in same if c.window is not UNSET):
        each.setdefault(window.trajectory, []).append(window.outside)
    masks = {k: x[0][1:-1] if len(x) == 1 else " & ".join(x) for k, x in each.items()}
    return "; ".join(f"in Python, of {k}: `log = log.select({x})`" for k, x in masks.items())


def common_name(cause: Cause, others: Sequence[Cause]) -> str:
    """The name of a cause among others: of one effect no more than is sure of each."""
    if cause.effect == LINK:  # whose name has its place
        return cause.name
    own = (c for c in others if c.effect == cause.effect and (c.branch or c.one_of_a_set))
    return next(own, cause).name
