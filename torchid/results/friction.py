"""The friction of one joint as one law: how sure it is, its torque over speed, and its details."""

import math
from typing import Annotated

import msgspec
from msgspec import UNSET, UnsetType

from torchid.results.record import Col, Joint, Part, Real
from torchid.results.words import digits, measure, percent, sure, unit_behind


class FrictionDetail(Part, frozen=True, kw_only=True):
    """One detail of a law.

    Attributes:
        detail: in plain words, e.g. `falls at low speed`.
        effects: of the library, that have it here.
        how_sure: probability of it; None of what was fitted or known in any case.
    """

    detail: str
    effects: tuple[str, ...]
    how_sure: float | None

    @property
    def words(self) -> str:
        """`falls at low speed 93 %`."""
        return self.detail if self.how_sure is None else f"{self.detail} {sure(self.how_sure)}"


def _lines(details: tuple[FrictionDetail, ...]) -> str:
    return "\n".join(d.words for d in details)


class FrictionAt(Part, frozen=True):
    """Torque at one speed.

    Attributes:
        speed: [rad/s; m/s].
        forwards, backwards: torque that moving the joint takes [N m; N], negative backwards; null
            in a direction in which the log does not move.
        forwards_std, backwards_std: standard deviations.
        given: of the robot's file, mean of both directions [N m; N]; null where it has none.
    """

    speed: Real
    forwards: Real
    forwards_std: Real
    backwards: Real
    backwards_std: Real
    given: Real = math.nan

    @property
    def size(self) -> float:
        """Mean of both directions, or the one that the log has."""
        both = [x for x in (self.forwards, -self.backwards) if not math.isnan(x)]
        return sum(both) / len(both) if both else math.nan

    def words(self, unit: str, speed_unit: str) -> str:
        """`at 0.5 rad/s: 1.0 ± 0.1 N m; not driven`: forwards, then backwards."""
        both = ((self.forwards, self.forwards_std), (self.backwards, self.backwards_std))
        torques = ["not driven" if math.isnan(x) else measure(x, std, unit) for x, std in both]
        return f"at {self.speed:.2g} {speed_unit}: {'; '.join(torques)}"


class FrictionCurve(Part, frozen=True):
    """Torque over speed, in the directions and at the speeds that a log has; between directions a
    curve has a gap.

    Attributes:
        speed: [rad/s; m/s], ascending.
        torque: of the corrected model [N m; N].
        half: half of its 95 % interval; zero where nothing of it was fitted.
        given: torque of the model as given.
    """

    speed: tuple[Real, ...]
    torque: tuple[Real, ...]
    half: tuple[Real, ...]
    given: tuple[Real, ...]


class FrictionLaw(Part, frozen=True, kw_only=True):
    """All friction of one joint: what the model has and what was found, together.

    What depends on load, position, time or the way since a reversal counts with its mean over the
    log at each speed.

    Attributes:
        joint: which.
        how_sure: probability that any friction is there that the model lacks, whichever it is;
            None where none was found.
        share: of the error that it takes away, the sum of its terms'.
        unnamed: part of its share by terms none of which has a name by itself.
        removes: what it takes away of each joint's error [N m; N], likewise.
        unit, speed_unit: of torque and speed.
        details: the surest first.
        at: slow, middle and fast: the speeds that a tenth, half and nine tenths of the motion stay
            below.
        curve: of a diagnosis; absent in its answer.
    """

    joint: Annotated[Joint, Col()]
    how_sure: Annotated[float | None, Col("sure", words=sure)]
    share: Annotated[Real, Col("removes", words=percent)]
    unnamed: Real = 0.0
    removes: tuple[Real, ...]
    unit: str
    speed_unit: str
    details: Annotated[tuple[FrictionDetail, ...], Col(words=_lines)]
    at: tuple[FrictionAt, ...]
    curve: FrictionCurve | UnsetType = UNSET

    @property
    def torques(self) -> Annotated[str, Col("forwards; backwards (value ± std)")]:
        """At each speed, a line each."""
        units = unit_behind(self.unit), unit_behind(self.speed_unit)
        return "\n".join(x.words(*units) for x in self.at)

    @property
    def brief(self) -> "FrictionLaw":
        """The law without its curve."""
        return msgspec.structs.replace(self, curve=UNSET)

    def has(self, effect: str) -> bool:
        """Whether an effect of its joint is a part of it."""
        return any(effect in d.effects for d in self.details)

    @property
    def _known(self) -> list[FrictionAt]:
        """Speeds that read differently, with a torque."""
        some = {digits(x.speed, 2): x for x in reversed(self.at) if not math.isnan(x.size)}
        return list(reversed(some.values()))

    @property
    def middle(self) -> FrictionAt | None:
        """At the middle speed; None without any."""
        return next(iter(self._known[len(self._known) // 2 :]), None)

    def words(self, every: bool = True) -> str:
        """`1.2, 1.9, 3.4 N m at 0.1, 0.5, 2 rad/s`, or at the middle speed alone; what the robot's
        file has before it: `0.8, 2, 3 -> 1.2, 1.9, 3.4 N m at ..`."""
        known = self._known if every else [x for x in (self.middle,) if x is not None]
        if not known:
            return ""
        sizes = ", ".join(digits(x.size, 2) for x in known)
        speeds = ", ".join(digits(x.speed, 2) for x in known)
        given = ", ".join(digits(x.given, 2) for x in known if not math.isnan(x.given))
        sizes = f"{given} -> {sizes}" if given else sizes
        return f"{sizes} {unit_behind(self.unit)} at {speeds} {unit_behind(self.speed_unit)}"
