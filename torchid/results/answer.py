"""The answer of a diagnosis, the same for every kind of log: what each joint's error is, which
causes close it, how sure they are, and what to do.

What a log measures decides the unit alone: torque or current gives N m (N on prismatic joints),
positions under commands give mrad of the log's unit.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import product
from pathlib import Path
from textwrap import wrap
from typing import Any

import msgspec
from msgspec import UNSET, UnsetType

from torchid.files import UNCONFIRMED
from torchid.notebooks import html_table
from torchid.results.agreement import RunValue
from torchid.results.cause import (
    GLOSSES,
    LINK,
    WHENS,
    Cause,
    Error,
    When,
    common_name,
    law_sizes,
    remedy_of,
    values_of,
)
from torchid.results.friction import FrictionLaw
from torchid.results.record import Ends, Joint, Part, Real, Record, Result, Rows
from torchid.results.words import (
    PAYLOAD,
    count,
    digits,
    effect_words,
    joint_labels,
    joints_words,
    listed,
    percent,
    span,
    sure,
    unit_words,
)

LINE, LINES = 80, 3
"""Characters of a line, and lines of a headline that names more than one cause."""
MOST_VALUES = (6, 2)
"""Joints whose values it has, one by one: as many as there is room for."""
LARGEST = 3
"""Causes that it names, with sizes and places, where there is room for them."""
UNCHANGED = 0.99
"""Share of the error that is left, from which on the causes have closed nothing."""


KINDS = ("Stopped", "Earlier log", "Next time", "Caution")
"""How warnings begin that come first: that a search was, what is wrong with the log that causes are
held against, and those that ask for something; all others are for information."""

COLUMNS = ("joint", "before", "after", "noise", "cause (value ± std)", "sure", "what to do")


PLAIN_SERVO = "plain servo: gain, friction, inertia, usual offset and delay, fitted to this log"
"""What the error before is of where the robot's file has no servo."""

REMEDY = (
    "Give the simulator each joint's friction over speed; `torchid export` writes the nearest "
    "fields of its file."
)
"""Of a friction law."""


class NotTestable(Part, frozen=True):
    """An effect these data could not show.

    Attributes:
        effect: name.
        joints: none for a global effect.
        smallest_detectable: coefficient that would have been detected, in `unit`; None where no
            size would: its columns vanish or are exactly those of base parameters.
        unit: of the first coefficient.
        reason: one sentence.
        joint: the first of them.
    """

    effect: str
    joints: tuple[Joint, ...]
    smallest_detectable: float | None
    unit: str
    reason: str
    joint: Joint | None = None

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "joint", self.joints[0] if self.joints else None)
        super().__post_init__()


class JointError(Part, frozen=True, kw_only=True):
    """The error of one joint, on the data of the answer's errors [the answer's unit].

    Attributes:
        joint, name: which.
        before, after: of the model as given, and with the causes; of positions, of the file's
            servos (a plain one where it has none) and with the causes. Null of a joint that never
            moves.
        noise: lowest and highest estimate of what no model can close; NaN (null) where repeats do
            not tell it, for what is left may be misfit as well.
    """

    joint: Joint
    name: str
    before: Real
    after: Real
    noise: Ends

    @property
    def still(self) -> bool:
        """Whether it never moves, and so has no error to explain."""
        return math.isnan(self.before)

    @property
    def beyond_noise(self) -> float:
        """Mean square beyond the highest noise known; minus infinity where it never moves."""
        if self.still:
            return -math.inf
        return self.before**2 - max([x for x in self.noise if not math.isnan(x)], default=0.0) ** 2


@dataclass(frozen=True)
class JointRow:
    """What the answer says of one joint.

    Attributes:
        error: before and after.
        causes: its own, which most joints do not share.
        suspects: that are not sure enough, the likeliest first.
        small: effects that remove less than was asked for.
    """

    error: JointError
    causes: tuple[Cause, ...]
    suspects: tuple[Cause, ...]
    small: tuple[Cause, ...]

    @property
    def label(self) -> str:
        """The joint's number, and its name where it has one of its own."""
        j = self.error.joint
        return joint_labels([*[""] * j, self.error.name])[j]

    @property
    def never_moves(self) -> bool:
        """Whether it has no error to explain."""
        return self.error.still


class Answer(Part, frozen=True, kw_only=True):
    """What a diagnosis answers.

    Attributes:
        status: the verdict, as of the diagnosis.
        error: what it is: `the gap`, `the error of the file's servos`, or of a plain servo, which
            the file has none of.
        unit: of all errors.
        before, after: errors of the whole arm, and on which data all errors of the answer are: the
            root of the sum of the joints' mean squares; of positions the mean of the joints that
            move.
        left_out: the error after on motions left out in turn, where others were held out.
        noise: lowest and highest estimate of what no model closes [`unit`].
        closed, closed_ci95: share of the error beyond noise that the causes close; None where that
            cannot be said.
        noise_measured: whether repeats of a motion tell the noise: only then can all of the error
            be explained.
        joints: joint by joint.
        causes: those that close most first.
        unnamed: share of the error that the corrected model takes away by terms that the data need
            and that are not sure enough for a name; part of what all close.
        friction: the law of each joint that has friction, without its curve.
        suspects: causes that are not sure enough, the likeliest first; their remedy says what would
            settle them.
        small: causes that are sure and remove less than was asked for.
        reason: why nothing is named, where that is so.
        unexplained: what is left on the worst joint that no cause and no noise explains: without
            repeats more than 3 % of its torque, and three times the least noise; absent where there
            is none.
        doubt: what speaks against the log, said first; absent where nothing does.
        file_doubt: the same against the robot's file, of which the rest may be right.
        since: the earlier log that causes are held against; absent without one.
        stopped: whether most causes were not looked for, for want of time; absent of a whole one.
        glosses: what names of effects say that are not everybody's, of those that it names.
    """

    status: str
    error: str
    unit: str
    before: Error
    after: Error
    left_out: Error | None = None
    noise: Ends
    closed: float | None
    closed_ci95: tuple[float, float] | None = None
    noise_measured: bool = False
    joints: tuple[JointError, ...]
    causes: tuple[Cause, ...]
    unnamed: Real = 0.0
    friction: tuple[FrictionLaw, ...] = ()
    suspects: tuple[Cause, ...] = ()
    small: tuple[Cause, ...] = ()
    reason: str = ""
    unexplained: str | UnsetType = UNSET
    doubt: str | UnsetType = UNSET
    file_doubt: str | UnsetType = UNSET
    since: str | UnsetType = UNSET
    stopped: bool | UnsetType = UNSET
    glosses: dict[str, str] = msgspec.field(default_factory=dict)

    @classmethod
    def so_far(
        cls,
        error: str,
        unit: str,
        whole: tuple[float, float],
        joints: Iterable[tuple[str, float, float]],
        causes: Iterable[Cause],
    ) -> "Answer":
        """What is known while a search goes on: the error before and with the causes, of the whole
        arm and of each joint with its name."""
        nothing = (math.nan, math.nan)
        first, last = (Error(value=x, unit=unit, how="fitted") for x in whole)
        return cls(
            status="searching", error=error, unit=unit, before=first, after=last,
            noise=nothing, closed=None, causes=tuple(causes),
            joints=tuple(
                JointError(joint=j, name=name, before=before, after=after, noise=nothing)
                for j, (name, before, after) in enumerate(joints)
            ),
        )  # fmt: skip

    def explained_by(self, glosses: Callable[[Iterable[str]], dict[str, str]]) -> "Answer":
        """With what the names of its effects say, where they are not everybody's."""
        every = (*self.causes, *self.suspects, *self.small)
        names = (name for c in every for name in (c.effect, *c.ambiguous_with))
        return msgspec.structs.replace(self, glosses=glosses(names))

    def legend(self, text: str) -> str:
        """`Cogging: torque that ripples over position.`, of the names that stand in a text, and of
        words beside them."""
        said = text.lower()
        names = ((effect_words(name), gloss) for name, gloss in self.glosses.items())
        words = (*names, *GLOSSES.items())
        every = "; ".join(f"{name}: {gloss}" for name, gloss in words if name.lower() in said)
        return f"{every[:1].upper()}{every[1:]}." if every else ""

    @property
    def less(self) -> float:
        """Share of the error that the causes take away, 1 - after / before; NaN of no error."""
        before, after = self.before.value, self.after.value
        return 1.0 - after / before if before > 0 else math.nan

    @property
    def fails(self) -> str:
        """A sentence that the answer does not hold on data that were held out; empty where it
        does."""
        after, left_out = self.after, self.left_out
        # 2.0: error of held-out data over that of motions left out in turn, from which on it is
        # said first
        if left_out is None or not after.value > 2.0 * left_out.value or not self.causes:
            return ""
        return (
            f"The answer fails {after.words}: there it errs {after.size}, {self.given} "
            f"{self.before.size}; {left_out.words} it erred {left_out.size}."
        )

    @property
    def confirmed(self) -> bool:
        """Whether data that no model was fitted to confirm the causes: the error fell on them, on
        other motions most likely too, and nothing speaks against the log."""
        if not self.causes or self.after.how == "fitted" or self.fails or self.doubt:
            return False
        low = 1.0 if self.closed_ci95 is None else self.closed_ci95[0]
        fell = self.after.value < UNCHANGED * self.before.value
        return fell and self.closed is not None and low > 0

    @property
    def main_suspect(self) -> Cause | None:
        """The suspect that takes most of the error, where causes with a sure name close the lesser
        part of what the corrected model does; else None."""
        held = [c for c in self.suspects if c.share == c.share]
        named = sum(c.share for c in self.causes if c.share == c.share)
        unsure = bool(held) and self.unnamed > named
        return max(held, key=lambda c: c.share) if unsure else None

    @property
    def unconfirmed(self) -> str:
        """Why a corrected model is not to be relied on, which its file begins with; empty where
        data confirm it, or nothing is corrected."""
        if self.confirmed or self.status in ("no_gap", "negligible"):
            return ""
        change = f"error {digits(self.before.value)} -> {self.after.size} {self.after.words}"
        return f"{UNCONFIRMED} {self.doubt or self.fails or change}"

    @property
    def of_positions(self) -> bool:
        """Whether its errors are of positions."""
        return self.unit.startswith("m")  # mrad, mm

    @property
    def headline(self) -> str:
        """What lowers the error and how far, after a line with what speaks against the log."""
        if self.status == "searching":
            return self._so_far()
        text = self.fails or (self._of_causes() if self.causes else self._without_cause())
        return "\n".join(str(x) for x in (self.doubt, self.file_doubt, text) if x)

    def _without_cause(self) -> str:
        """Why nothing is named."""
        size, noise = self.before.size, span(self.noise)
        small = "that is new" if self.since else "that matters"
        none = {"no_gap": "beyond noise", "negligible": small}
        if math.isnan(self.noise[1]):  # noise may be all of it, and need not be
            none["no_gap"] = "that this log can tell from noise"
        said = {k: f"No gap {words}: {size} (noise {noise})." for k, words in none.items()}
        said["not_testable"] = "This log cannot show what causes a gap:"
        worst = max(self.joints, key=lambda j: j.beyond_noise)
        # Beside what speaks against all of the log no bracket of its noise does.
        gap = f"No known effect explains {self.error} of {size}"
        if self.stopped is not UNSET:
            gap = f"Most causes of {self.error} of {size} were not looked for in the time"
        if self.unexplained and not (self.doubt or self.stopped):
            gap = f"No known effect explains {self.unexplained}"
            gap += "." if self.noise_measured else "; record one motion twice."
        else:
            gap += "." if self.doubt else f" (noise {noise})."
            gap += f" It is largest on joint {worst.joint + 1}." if len(self.joints) > 1 else ""
        text = f"{said.get(self.status, gap)} {self.reason}".rstrip()
        if self.suspects and self.status in ("detected_unexplained", "not_testable"):
            why = "No cause is sure." if self.status == "detected_unexplained" else text
            text = f"{why} Most likely: {self.suspect_words(self.suspects[0])}."
        return text

    def _of_causes(self) -> str:
        """The largest causes with sizes and places, and how far all of them lower the error; beside
        an earlier log what is new, and what the model lacked already, in a sentence each."""
        after = self.after
        change = f"error {digits(self.before.value)} -> {after.size} {after.words}"
        if self.confirmed:
            change += f" ({percent(self.less)} less"
            # What has no name may as well cancel against the causes.
            if self.unnamed > 0 and percent(self.unnamed) != percent(0.0):
                change += f", {percent(self.unnamed)} unnamed"
            # 1 - 5e-4: share of the error beyond a measured noise from which on it is all of it
            if self.noise_measured and (self.closed or 0) >= (1 - 5e-4):
                change += ", to the noise"
            elif self.status in ("detected_unexplained", "partly_explained"):
                change += "; rest unexplained"
            change += ")"

        kinds = list(WHENS)

        def order(same: Sequence[Cause]) -> tuple[int, float]:
            return kinds.index(same[0].when), -math.hypot(*map(self.takes, same))

        groups = sorted(self.groups(self.entries), key=order)
        first = self.main_suspect
        perhaps = [] if first is None else [f"perhaps {first.name} {first.place}".rstrip()]
        fewest = 0 if perhaps else 1
        for most, values in product(range(LARGEST, fewest - 1, -1), MOST_VALUES):
            named = [self.sized(same, values) for same in groups[:most]]
            if self.since:
                text = f"{self._since(groups, named, perhaps)} {change[:1].upper()}{change[1:]}."
            else:
                left = [f"{len(groups) - most} {'more' if perhaps else 'smaller'}"]
                text = listed([*perhaps, *named, *left * (len(groups) > most)])
                text = text if self.confirmed else f"not confirmed: {text}"
                text = f"{text[:1].upper()}{text[1:]}: {change}."
            if len(wrap(text, LINE)) <= LINES:
                break
        return text

    def _since(
        self, groups: Sequence[Sequence[Cause]], named: Sequence[str], perhaps: Sequence[str]
    ) -> str:
        """`New since monday: A and B. Lacking already in monday: C.`; what is new and what is not
        share no sentence.

        Args:
            groups: all causes, the first of which are `named`.
            named: in words.
            perhaps: a suspect in words, of which it is open whether it is new.
        """
        out, unsure = [], bool(perhaps) or any(same[0].when is UNSET for same in groups)
        for when, (word, of) in WHENS.items():
            own = [k for k, same in enumerate(groups) if same[0].when == when]
            said = [*(perhaps if when is UNSET else ()), *(named[k] for k in own if k < len(named))]
            if left := sum(k >= len(named) for k in own):
                said.append(f"{left} more" if said else count(left, "cause"))
            if said:
                end = "" if self.confirmed else ", not confirmed"
                out.append(f"{word.capitalize()} {of} {self.since}{end}: {listed(said)}.")
            elif when == "new":
                out.append(f"Nothing is {'surely ' * unsure}new since {self.since}.")
        return " ".join(out)

    def _so_far(self) -> str:
        """Headline of a search that goes on: where the error is, and what removes most of it."""
        moving = [j for j in self.joints if j.before == j.before]
        worst = sorted(moving, key=lambda j: -j.before)[:2]
        joints = listed(f"joint {j.joint + 1} ({digits(j.before)})" for j in worst)
        text = f"So far: {self.error} is {self.before.size}, largest on {joints}."
        if self.causes:
            names = [
                same[0].name if same[0].effect == LINK else
                f"{same[0].name} ({self.where(same)})"
                for same in self.groups(self.causes)
            ]  # fmt: skip
            text += f" Likeliest: {listed(names, most=3)}; {self.after.size} remain."
        return text

    def takes(self, cause: Cause) -> float:
        """How much of the arm's error a cause takes away, nothing at least; of positions of its
        joints' error."""
        if math.isnan(cause.share):
            return 0.0
        if not self.of_positions:
            return max(cause.share, 0.0) * self.before.value
        own = [j for j in self.joints if (j.joint in cause.at or not cause.at) and not j.still]
        each = (min(cause.share * j.before, j.before - j.after) for j in own)
        return max((x for x in each if x > 0), default=0.0)

    def sized(self, same: Sequence[Cause], values: int = MOST_VALUES[0]) -> str:
        """`8.03 N m Coulomb friction on joint 2`, `torque gain on all joints (gain = 0.3)`; of what
        has no one number, and where no more than the kind is sure, how much it takes away.

        Args:
            same: causes of one name.
            values: joints whose values it has; of more the least and the largest.
        """
        first, name = same[0], common_name(same[0], same)
        kind = next((c.kind for c in same if c.branch), "")
        name = kind or name
        if first.effect == LINK and not kind:
            name = Cause(effect=LINK, joints=tuple(j for c in same for j in c.at)).name
        elif any(c.at for c in same):
            name += f" on {self.where(same)}"
        if first.window is not UNSET:
            name += f" {first.window.words}" if len(same) == 1 else f", {len(same)} times"
        size = first.known[0].sharp if first.known and len(same) == 1 else None
        if first.law is not UNSET:
            inner = law_sizes([c.law for c in same if c.law is not UNSET])
        elif len(same) > 1 and not kind and all(c.known for c in same):
            inner = values_of(same, most=values)
        elif size is None or kind:
            inner = f"{digits(math.hypot(*map(self.takes, same)), 2)} {unit_words(self.unit)}"
        elif size.plain and first.has_own_name and 1 in (len(first.sizes), first.effect == PAYLOAD):
            return f"{size.words} {name}"
        else:
            inner = size.named
        return f"{name} ({inner})"

    def suspect_words(self, cause: Cause) -> str:
        """`viscous friction on joint 3 (5.6 ± 0.7 N m s/rad, 82 %)`."""
        sizes = [cause.in_words(s) for s in cause.known[:1]]
        inner = ", ".join([*sizes, sure(cause.how_sure)])
        return f"{cause.name} {cause.place} ({inner})".replace("  ", " ")

    @property
    def entries(self) -> tuple[Cause, ...]:
        """The causes as people see them: several that are friction of one joint are its law, apart
        from those that are new."""
        laws, merged, gone = {law.joint: law for law in self.friction}, list[Cause](), list[Cause]()
        own: dict[Joint, dict[When | UnsetType, list[Cause]]] = {}
        for cause in self.causes:
            joint = cause.at[0] if len(cause.at) == 1 else -1
            if joint in laws and laws[joint].has(cause.effect):
                own.setdefault(joint, {}).setdefault(cause.when, []).append(cause)
        for joint, whens in own.items():
            law, (when, causes) = laws[joint], next(iter(whens.items()))
            # The law's numbers are of all of it: of what is new and what was there none are.
            if len(whens) > 1 or (len(causes) == 1 and law.unnamed <= 0):
                continue
            gone += causes
            one = Cause(
                effect="friction", joints=(joint,), how_sure=law.how_sure, when=when,
                share=law.unnamed + sum(c.share for c in causes), remedy=REMEDY, law=law,
            )  # fmt: skip
            merged.append(one)
        if not merged:
            return self.causes
        out = [*(c for c in self.causes if not any(c is x for x in gone)), *merged]
        return tuple(sorted(out, key=lambda c: 0.0 if math.isnan(c.share) else -c.share))

    def groups(self, causes: Sequence[Cause]) -> Iterator[list[Cause]]:
        """Causes of one name with one set of rivals together, in the order of what they close:
        those that are new, and those that the model had with other numbers."""
        kinds = dict.fromkeys(map(_kind, causes))
        for kind in kinds:
            yield sorted((c for c in causes if _kind(c) == kind), key=lambda c: c.at)

    def shared(self) -> list[tuple[Cause, ...]]:
        """Causes that most joints have, those of one name together; and each cause that is not of
        one joint alone. Friction laws are each joint's own."""
        out: list[tuple[Cause, ...]] = []
        for same in self.groups([c for c in self.entries if c.law is UNSET]):
            local = [c for c in same if len(c.at) == 1 and c.effect != LINK]
            # 0.5: share of the joints above which a cause that they have in common is one row
            many = len(local) > max(1.0, 0.5 * len(self.joints))
            out += [tuple(local)] if many else []
            out += [(c,) for c in same if not any(c is x for x in local)]
        return out

    def joint_rows(self) -> list[JointRow]:
        """A row a joint, the largest remaining error first; joints that never move at the end."""
        apart = [c for same in self.shared() for c in same]
        own = [c for c in self.entries if all(c is not x for x in apart)]

        def on(joint: Joint, causes: Iterable[Cause]) -> tuple[Cause, ...]:
            return tuple(c for c in causes if c.at == (joint,))

        rows = [
            JointRow(e, on(e.joint, own), on(e.joint, self.suspects), on(e.joint, self.small))
            for e in self.joints
        ]
        return sorted(rows, key=lambda r: math.inf if r.never_moves else -r.error.after)

    def rows(self) -> list[tuple[str, ...]]:
        """Cells under `COLUMNS`: joints and their own causes, then what joints share."""
        out: list[tuple[str, ...]] = []
        for row in self.joint_rows():
            if row.never_moves:
                out.append((row.label, "-", "-", "-", "never moves", "-", ""))
                continue
            noise = span(row.error.noise, 2, " - ")
            numbers = (digits(row.error.before), digits(row.error.after), noise)
            first, *others = [cause_cells((c,)) for c in row.causes] or [("-", "", "")]
            out.append((row.label, *numbers, *first))
            out += [("", "", "", "", *other) for other in others]
        return out + [(self.where(same), "", "", "", *cause_cells(same)) for same in self.shared()]

    def where(self, same: Sequence[Cause]) -> str:
        """`all joints`, `joints 1, 2 and 4`, `link 5`, `the arm`: where causes of one name act."""
        joints = sorted({j for c in same for j in c.at})
        if same[0].effect == LINK and joints:
            return joints_words(joints).replace("joint", "link")
        if len(joints) == len(self.joints) > 1:
            return "all joints"
        return joints_words(joints)

    @property
    def given(self) -> str:
        """What the error before is of, in words."""
        return "plain servo" if self.error.startswith("a plain servo") else "as given"

    @property
    def title(self) -> str:
        """Title of the table."""
        servo = "" if self.given == "as given" else f"; {PLAIN_SERVO}"
        return f"RMS error [{self.unit}] {self.after.whole}{servo}"

    @property
    def suspect_lines(self) -> list[str]:
        """Each suspect, and what would settle it."""
        return [f"{self.suspect_words(c)}: {remedy_of([c])}" for c in self.suspects]

    def __str__(self) -> str:
        """The headline, and the table with a space between its columns."""
        rows = [COLUMNS, *self.rows()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
        return "\n".join((self.headline, "", self.title, *lines))

    def _repr_html_(self) -> str:
        """The headline and the table, for notebooks."""
        suspects = f"<p>Suspects: {escape('; '.join(self.suspect_lines))}</p>"
        return (
            f"<p><b>{escape(self.headline)}</b></p><p>{escape(self.title)}</p>"
            + html_table(COLUMNS, self.rows())
            + (suspects if self.suspects else "")
        )


class Diagnosis(Result):
    """Where a model and its arm disagree, which causes explain it, how far they close it.

    `torchid.diagnose` makes it of every kind of log; `answer` is the same for all.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    >>> log = torchid.simulate(robot, motion, effects=[
    ...     {"effect": "viscous_friction", "joint": 2, "Fv": 0.5}])
    >>> settings = torchid.GapSettings(effects=("viscous_friction",))
    >>> found = torchid.diagnose(robot, log, settings=settings)
    >>> isinstance(found, Diagnosis), found.answer.unit, len(found.answer.joints)
    (True, 'N m', 3)
    """

    __slots__ = ()

    @property
    def answer(self) -> Answer:
        """What each joint's error is, which causes close it, and what to do."""
        raise NotImplementedError

    @property
    def agreement(self) -> Rows[RunValue]:
        """What each run alone wants of each cause, one row each; empty of one run."""
        raise NotImplementedError

    def write_corrected(self, path: str | Path, *, rows: bool = True) -> None:
        """Write the corrected robot, with its effects or servos, as a .yaml; of torques the log
        beside it, unless `rows` says no.

        Raises:
            TorchidError: the file cannot be written.
        """
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return self.answer._repr_html_()


class Stopped(Part, frozen=True):
    """A search that was stopped for want of time.

    Attributes:
        seconds: after which it was [s].
        left_out: what was not looked at, in words.
    """

    seconds: float
    left_out: tuple[str, ...]

    def __str__(self) -> str:
        """One sentence."""
        left_out = listed(self.left_out)
        return f"Stopped after {digits(self.seconds)} s (`time=...`); not looked at: {left_out}."


class DiagnosisRecord(Record, frozen=True, eq=False, kw_only=True):
    """A diagnosis as its JSON has it.

    Attributes:
        answer: what it answers; None in files of older versions.
        explanation: what the command printed beside it: tables and sentences.
        agreement: what each run alone wants of each cause; empty of one run.
        stopped_after: when the search was stopped for want of time, and what was not looked at;
            absent of a whole one.
    """

    stopped_after: Stopped | UnsetType = UNSET
    answer: Answer | None = None
    agreement: tuple[RunValue, ...] = ()
    explanation: dict[str, Any] | UnsetType = UNSET

    def _repr_html_(self) -> str:
        return super()._repr_html_() if self.answer is None else self.answer._repr_html_()


def ordered(warnings: Iterable[str]) -> tuple[str, ...]:
    """Warnings once each: first what asks for another log, then what qualifies a number, then the
    rest."""
    every = dict.fromkeys(warnings)
    return tuple(sorted(every, key=lambda text: [not text.startswith(kind) for kind in KINDS]))


def _kind(cause: Cause) -> tuple[object, ...]:
    """What causes of one line have in common."""
    return cause.effect, cause.when, cause.changed, frozenset(cause.ambiguous_with)


def cause_cells(same: Sequence[Cause]) -> tuple[str, str, str]:
    """Causes of one name with their values, how sure the least of them is, and what to do."""
    first = same[0]
    known = [c.how_sure for c in same if c.how_sure is not None]
    end = (sure(min(known, default=None)), remedy_of(same, short=True))
    when = f", {WHENS[first.when][0]}" if first.when else ""
    if len(same) == 1:
        name = "inertia" if first.effect == LINK and first.at else first.name
        return (f"{name} {first.values()}".rstrip() + first.rivals + when, *end)
    rivals = next((c.rivals for c in same if c.rivals), "")
    return (f"{common_name(first, same)} {values_of(same)}{rivals}{when}", *end)
