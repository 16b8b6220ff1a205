"""Candidates of causes: every effect at every place with every shape, as columns of samples.

    gap = sum_k X_k x_k + noise,   x_k ~ N(0, P_k^-1)
    P_k = diag(4 / largest^2) + mean_j X_kj' X_kj / (SLAB^2 |gap_j|^2)

The slab says how large coefficients can be before the log is seen: on any arm and on this one; and
together they make no much larger torque than the gap that they are to explain (Zellner 1986). What
a model that was fitted before leaves open of itself is a nuisance: columns with the covariance that
it states, always fitted.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple, cast

import numpy as np
import torch

from torchid.design.bodies import body_sizes, links_near, usual_bodies
from torchid.design.columns import Columns, Model, Place, smoothed, together
from torchid.design.deflection import Compliance, compliance
from torchid.design.resonance import Swing
from torchid.effects.base import Effect, JointEffect, ModelEffect
from torchid.effects.file_mistakes import FileMistake
from torchid.effects.gravity import BaseTilt, EncoderOffset, KinematicError
from torchid.effects.inertia import Payload
from torchid.effects.motion import Motion
from torchid.effects.phase import JointElasticity
from torchid.effects.registry import KINDS
from torchid.gap.causes.misfit import noise_of_repeats
from torchid.gap.causes.scale import Scale
from torchid.gap.causes.windows import Windows
from torchid.gap.data import Data
from torchid.gap.problem import Problem
from torchid.gap.wanted import BASE
from torchid.identification.knowledge import known_names
from torchid.results.cause import LINK, When
from torchid.robot.model import Robot
from torchid.statistics.criteria import BODY_STD, WRONG_BODY
from torchid.tensors import give_back_memory

SLAB = 2.0
"""Standard deviation of a cause's torque before the log is seen, over the gap that it is to
explain [1]."""

OPEN_STD = 10.0
"""The same of what is fitted always and of which nothing is known, over the joint's torque [1]."""

LOAD, LEVER = 0.1, 0.3
"""Standard deviation of a load over the arm's mass, and of its lever over the arm's reach [1]."""

FLOOR = 1e-4
"""Torque that is rounding of a log, over the joint's torque [1]."""

SINGULAR = 1e-9
"""Precision of a slab along a direction of which nothing is known, over the largest [1]."""

ROUNDING = 1e-9
"""Size of a column, relative to the largest torque, that is rounding."""

FLAT = (EncoderOffset, KinematicError, BaseTilt)
"""Smooth changes of the model: evaluated on decimated samples, filtered before and not after."""

AS_LOGGED = 0.2
"""Correlation of logged torque with the model's from which other sensors may read it [1]: much else
may be in it, but it is there."""


@dataclass(frozen=True, eq=False)
class Term:
    """A candidate: an effect at a place with a shape.

    Attributes:
        name: of the effect, or `all_base`.
        effect: None of base parameters.
        joints: from 0; none of what belongs to the whole arm.
        place: the joint whose torque alone it changes; None of all joints.
        columns: (C, N) of that joint, or (C, n, N), zero where samples do not count [N m; N].
        spread: (C, C) root of the slab's covariance, spread spread'.
        low, high: (C,) least and largest correction of each coefficient.
        key: what it is, whatever its shape.
        law: its joint's law of which it is one form, (branch, joint); None of what is a cause
            itself.
        shapes: number of shapes of its key that are looked at.
        change: (L, 10) of the links' parameters per unit of the one coefficient, of a mistake of
            the robot's file.
        seen: what another sensor, or the torque above the fit's band, tells of the one coefficient:
            there the slab is centred, as wide as that is unsure.
        extra: what that adds to the evidence [nats].
        shown: whether it shows as much as is worth a name.
        since: beside an earlier log, `in both` of what acts in that one as well and `new` of what
            does not; else empty.
        before: (C, M) or (C, n, M) of what is new, what its columns would be on the M samples of
            the earlier log; None of all else, and of what happens once.
        origin: serial of the candidate of which it is another shape; below zero of none.
        serial: of its own, by which its products with others are kept.
    """

    name: str
    effect: Effect | None
    joints: tuple[int, ...]
    place: Place
    columns: np.ndarray
    spread: np.ndarray
    low: np.ndarray
    high: np.ndarray
    key: tuple[object, ...]
    law: tuple[str, int] | None = None
    shapes: int = 1
    change: np.ndarray | None = None
    seen: Compliance | Swing | None = None
    extra: float = 0.0
    shown: bool = False
    since: When | Literal[""] = ""
    before: np.ndarray | None = None
    origin: int = -1
    serial: int = field(init=False, default_factory=itertools.count().__next__)

    @property
    def count(self) -> int:
        """C."""
        return len(self.low)

    @property
    def root(self) -> int:
        """Serial of the candidate that it is, whatever its shape."""
        return self.serial if self.origin < 0 else self.origin

    @property
    def centre(self) -> np.ndarray:
        """(C,) where coefficients are expected."""
        return np.zeros(self.count) if self.seen is None else self.seen.value + self.low

    def is_beyond(self, x: np.ndarray) -> bool:
        """Whether one of its coefficients (C,) is at a least that no arm has; not what only takes
        away what the model has, which may be gone."""
        if self.effect is None or self.effect.inertial:
            return False
        least = np.array([low for low, _ in self.effect.ranges])
        return bool(((x <= self.low) & (self.low < 0) & (least != 0)).any())

    @property
    def common(self) -> bool:
        """Whether it is one coefficient that all joints share."""
        return self.key[-1:] == ("shared",)

    @property
    def form(self) -> tuple[object, ...]:
        """What it is, whatever its shape, in whichever log it acts."""
        return self.key[1:] if self.since else self.key

    @property
    def cause(self) -> tuple[object, ...]:
        """What is counted as one cause: a joint's law with all its forms, or the effect itself."""
        return self.form if self.law is None else self.law

    @property
    def parametric(self) -> bool:
        """Whether it corrects the links' own parameters."""
        return self.name in (BASE, LINK)

    @property
    def inertial(self) -> bool:
        """Whether it is a change of bodies."""
        return self.effect is None or self.effect.inertial

    @property
    def rare(self) -> bool:
        """Whether it happens once, or at an end of the travel."""
        return self.effect is not None and (self.effect.event or self.effect.at_ends)

    def __repr__(self) -> str:
        return self.name + "".join(f" {j + 1}" for j in self.joints)


class Pack(NamedTuple):
    """Candidates with equally many coefficients, of single joints or of the arm, whose columns are
    views of one array.

    Attributes:
        terms: M of them, joint by joint.
        columns: (n, M, C, N) of all joints; n is 1 of single joints.
    """

    terms: list[Term]
    columns: np.ndarray


def excluding(terms: Sequence[Term], gone: Sequence[Term]) -> tuple[Term, ...]:
    """Terms but for some of them."""
    return tuple(t for t in terms if all(t is not g for g in gone))


class Library:
    """All candidates for the gap of a model on a log.

    Args:
        problem: gap, samples, and what is looked for.
        events: contacts that are candidates, too.
        at: the model at which columns are taken; the one as given if None.

    Attributes:
        gap: (n, N) what is to be explained, zero where samples do not count [N m; N].
        rows: (n,) samples that count.
        asked: (N,) samples of the log that is asked; the others are of an earlier one.
        known_noise: (n,) what the model was seen to leave on its own log, RMS [N m; N]: nothing
            below it is explained.
        noise: (n,) RMS of what differs between repeats of a motion [N m; N]; nan without any.
        torque, size: (n,) RMS of the measured torque and of the gap [N m; N].
        nuisance: what is always fitted; None of a model that is taken as it is.
        terms: candidates.
        packs: the same, side by side.
    """

    def __init__(self, problem: Problem, events: Sequence[Effect] = (), at: Model | None = None):
        self.problem = problem
        self.data: Data = problem.data
        self.columns: Columns = problem.given if at is None else problem.given.at(at)
        self.samples = self.data.samples
        self.n = self.columns.n
        self.keep = self.data.keep.numpy().astype(float)
        self.rows = np.maximum(self.keep.sum(1), 1.0)
        self.gap = problem.given.gap.numpy() * self.keep
        tau = logged(self.columns).numpy() * self.keep
        self.torque = np.sqrt((tau**2).sum(1) / self.rows) + 1e-12
        asked = problem.asked
        self.asked = np.ones(self.keep.shape[1], bool) if asked is None else asked.numpy()
        self.size = self.rms(self.gap) + FLOOR * self.torque
        known, left = problem.wanted.knowledge, FLOOR * self.torque
        # An earlier log shows its own noise.
        if asked is None and known is not None and known.left is not None:
            left = np.maximum(left, known.left.numpy())
        self.known_noise = left
        self.scale = Scale(self.columns)
        self.noise = noise_of_repeats(problem)
        self.nuisance = self._nuisance()
        self.windows = Windows(self.samples, self.asked)
        made = (self.of_event(e) for e in events)
        self.terms: list[Term] = []
        self.packs: list[Pack] = []
        for some in (self._of_joints(), self._of_the_arm(), self._bodies(), made):
            self.add(self._with_shapes(some))
            give_back_memory()  # what columns were made in does not hold those of other kinds

    def add(self, terms: list[Term]) -> None:
        """Candidates that are looked at from now on."""
        groups: dict[tuple[bool, int], list[int]] = {}
        for k, t in enumerate(terms):
            groups.setdefault((t.place is None, t.count), []).append(k)
        packs, at = list[Pack](), dict[int, tuple[Pack, int]]()
        for (of_arm, count), own in groups.items():
            own.sort(key=lambda k: terms[k].place or 0)
            shape = self.n if of_arm else 1, len(own), count, self.gap.shape[1]
            packs.append(Pack([terms[k] for k in own], np.empty(shape)))
            at |= {k: (packs[-1], m) for m, k in enumerate(own)}
        # In the order of the library; each lets go of its own columns.
        for k, t in enumerate(terms):
            pack, m = at[k]
            view = pack.columns[:, m].transpose(1, 0, 2) if t.place is None else pack.columns[0, m]
            view[...] = t.columns
            terms[k] = pack.terms[m] = replace(t, columns=view)
        self.packs += packs
        self.terms += terms

    @property
    def unexplained(self) -> np.ndarray:
        """What the model left unexplained (n,) on a log that is not beside, RMS [N m; N]."""
        return self.known_noise

    def rms(self, x: np.ndarray) -> np.ndarray:
        """RMS (n,) of samples (n, N) of the log that is asked."""
        rows = np.maximum(self.keep[:, self.asked].sum(1), 1.0)
        return np.sqrt((x[:, self.asked] ** 2).sum(1) / rows)

    # ------------------------------------------------------------------ one candidate

    def term(self, effect: Effect, place: Place, columns: np.ndarray, **more: Any) -> Term | None:
        """An effect as a candidate; None of one that makes no torque in this log, or in a window
        too short to tell."""
        if effect.span is not None and np.subtract(*effect.span) > -self.windows.shortest:
            return None
        known = np.zeros(len(effect.coefficients))
        for other, values in self.problem.given.model.effects:
            if other == effect:
                known = known + np.array(values)
        high = self.scale.largest([effect]).numpy()
        low = np.maximum([least for least, _ in effect.ranges], -high)
        std = high / 2
        if effect.scale_of_torque and self.data.gain_said and self.problem.wanted.knowledge is None:
            std = np.full(len(known), self.data.gain_std)
        name, joints, seen = effect.name, effect.joints, self._seen(effect)
        law = (effect.law, joints[0]) if effect.law and len(joints) == 1 else None
        fields: dict[str, Any] = {"key": effect.identity, "law": law, "joints": joints, **more}
        if seen is not None:
            # Beside what may be on any arm: the other sensor's likelihood, with the cause or none.
            settings, wide = self.problem.settings, float(std[0])
            extra = 0.5 * (max(seen.value, 0.0) / seen.std) ** 2 - math.log(1 + wide / seen.std)
            fields["seen"], fields["extra"], std = seen, extra, np.array([seen.std])
            fields["shown"] = (
                seen.size >= settings.worthwhile_torque and seen.explained >= settings.worthwhile
            )
        return self._sized(name, effect, place, columns, std, low - known, high - known, **fields)

    def _sized(
        self,
        name: str,
        effect: Effect | None,
        place: Place,
        columns: np.ndarray,
        std: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        **fields: Any,
    ) -> Term | None:
        """A candidate whose slab is no wider than the gap allows."""
        columns = columns * (self.keep if place is None else self.keep[place])
        own = slice(None) if place is None else slice(place, place + 1)
        every = columns[None] if place is not None else columns.transpose(1, 0, 2)
        mean = every @ every.transpose(0, 2, 1) / self.rows[own][:, None, None]
        size = np.sqrt(np.diagonal(mean, axis1=1, axis2=2))
        felt = (size > ROUNDING * self.torque.max()).any(1)
        if not felt.any():
            return None
        # In units of the gap, joint by joint; a column that is nowhere has a slab all the same.
        weight = felt / (SLAB * self.size[own]) ** 2
        with np.errstate(divide="ignore"):
            precision = np.tensordot(weight, mean, 1) / felt.sum() + np.diag(std**-2.0)
        scale = np.sqrt(np.diagonal(precision))
        scale = np.where(scale > 0, scale, 1.0)
        unit = precision / scale / scale[:, None] + SINGULAR * np.eye(len(scale))
        spread = np.linalg.inv(np.linalg.cholesky(unit)).T / scale[:, None]
        return Term(
            name, effect, columns=columns, place=place, spread=spread, low=low, high=high, **fields
        )

    def same(self, term: Term) -> Term | None:
        """A term of another library in this one; None of what makes no torque here."""
        for t in self.terms:
            # Events have numbers in the order in which they were found.
            named = t.key == term.key or (t.effect is not None and t.effect.event)
            if named and t.effect == term.effect and t.count == term.count:
                return t
        if term.effect is None or term.inertial:
            return None
        found = self.of_effect(term.effect, term)
        return None if found is None else self.like(found, term)

    def like(self, made: Term, term: Term) -> Term:
        """What was made from an effect, as what it is another shape of."""
        return replace(made, key=term.key, shapes=term.shapes, since=term.since, origin=term.root)

    def of_effect(self, effect: Effect, like: Term | None = None) -> Term | None:
        """A candidate from an effect, at its place; of one that all joints share, `like` that."""
        if like is not None and len(like.joints) > 1 and like.common:
            return self._shared(type(effect))
        ((place, columns),) = self._columns([effect])
        return self.term(effect, place, columns)

    def _columns(self, effects: Sequence[Effect]) -> list[tuple[Place, np.ndarray]]:
        """Columns of effects of one kind."""
        first = effects[0]
        if isinstance(first, FLAT):
            arm = self.columns.model.arm_of(first)
            at_samples = self._motion
            return [
                (None, e.torque_columns(at_samples, arm).permute(2, 1, 0).numpy()) for e in effects
            ]
        return [(place, x.numpy()) for place, x in columns_of(self.columns, effects)]

    @cached_property
    def _motion(self) -> Motion:
        """The motion at the samples, low-passed."""
        every = [smoothed(m, self.samples) for m in self.columns.motions]
        pick = {k: self.samples.pick([getattr(m, k) for m in every]) for k in Motion._fields[:3]}
        torque = self.samples.pick([m.require("torque", "columns") for m in every])
        return together(every)._replace(
            **pick, torque=torque, t=self.samples.t, direction=None, age=None
        )

    def _seen(self, effect: Effect) -> Compliance | Swing | None:
        """What a link's own encoder, or its swinging, tells of its joint's compliance."""
        if not isinstance(effect, JointElasticity):
            return None
        if self.data.lag is None:
            return self.data.swings.get(effect.joint) if effect.damping > 0 else None
        load, q = self._load_and_position(effect.joint)
        return compliance(self.data.lag[effect.joint], load, q, self.samples.bounds)

    def _load_and_position(self, joint: int) -> torch.Tensor:
        """The model's torque of a joint and its position, as samples (2, N)."""
        each = [
            torch.stack([m.require("torque", "a load")[:, joint], m.q[:, joint]])
            for m in self.columns.motions
        ]
        return self.samples.of(each)

    def _swinging(self, effect: ModelEffect) -> ModelEffect:
        """An elastic joint as it swings, where its link is seen to; any other effect as it is."""
        if not isinstance(effect, JointElasticity) or effect.joint not in self.data.swings:
            return effect
        swing = self.data.swings[effect.joint]
        return replace(effect, at=swing.value, damping=swing.damping)

    def _with_shapes(self, terms: Iterable[Term | None]) -> list[Term]:
        """Candidates that make torque, each with the number of shapes of its key."""
        some = [t for t in terms if t is not None and self.problem.wanted.asks(t.name)]
        count: dict[object, int] = {}
        for t in some:
            count[t.key] = count.get(t.key, 0) + 1
        return self.offered([replace(t, shapes=max(t.shapes, count[t.key])) for t in some])

    def offered(self, terms: list[Term]) -> list[Term]:
        """Candidates as they are looked at."""
        return terms

    # ------------------------------------------------------------------ all of them

    def _kinds(self) -> list[type[Effect]]:
        """Effects that are looked for and that the log can show."""
        kinds = [KINDS[name] for name in self.problem.wanted.names]
        return [k for k in kinds if not (k.needs & self.data.missing or k.windowed or k.costly)]

    def _of_joints(self) -> Iterable[Term | None]:
        """Effects of one joint's motion, in all shapes of their grids."""
        motions, cutoff = self.columns.motions, self.samples.cutoff
        driven = [j for j in self.columns.model.robot.driven if self.keep[j].any()]
        for kind in self._kinds():
            if not issubclass(kind, JointEffect):
                continue
            for j in driven:
                # On a joint that does not slide, friction is whatever holds it.
                if not self.data.slides[j] and (kind.jumps or kind.family in ("speed", "time")):
                    continue
                grid = kind.grid(motions, j, cutoff)
                if not len(grid):
                    continue
                names = [s.name for s in kind.shapes]
                found = self.columns.of_shapes(kind, j, grid).numpy()
                for values, columns in zip(grid.tolist(), found, strict=True):
                    shaped = kind(j, **dict(zip(names, values, strict=True)))
                    yield self.term(shaped, j, columns)
        # The model's own, in shapes that no grid holds.
        for effect, _ in self.problem.given.model.effects:
            if isinstance(effect, JointEffect) and effect.shapes and self.keep[effect.joint].any():
                yield self.of_effect(effect)

    def _of_the_arm(self) -> Iterable[Term | None]:
        """Effects of the arm and its sensors, at all places; those that all joints share, too."""
        robot = self.columns.model.robot
        bodies, there = are_bodies(self.problem.robot), as_logged(self.columns)
        for kind in self._kinds():
            if not issubclass(kind, ModelEffect) or kind.inertial:
                continue
            if kind.of_bodies and not bodies:
                continue
            begun = cast(list[ModelEffect], kind.starts(robot))
            effects = [self._swinging(e) for e in begun if self._told(e, there)]
            if effects:
                for effect, (place, columns) in zip(effects, self._columns(effects), strict=True):
                    yield self.term(effect, place, columns)
            if kind.shared and len(effects) > 1:
                yield self._shared(kind)
        yield from self._file_mistakes()

    def _told(self, effect: ModelEffect, there: Sequence[bool]) -> bool:
        """Whether the log can tell of an effect: not on silent joints, nor of a sensor that reads a
        torque that is not there."""
        if not all(there[j] for j in effect.reads):
            return False
        return not effect.joints or any(self.keep[j].any() for j in effect.joints)

    def _shared(self, kind: type[Effect]) -> Term | None:
        """One coefficient that all joints share."""
        each = kind.candidates(self.columns.model.robot)
        columns = sum(self.columns.on_all_joints(e) for e in each).numpy()  # type: ignore[union-attr]
        joints = tuple(range(self.n))
        key = (kind.name, "shared")
        return self.term(each[0], None, columns, joints=joints, key=key, law=None)

    def _file_mistakes(self) -> Iterable[Term | None]:
        """Mistakes of the robot's file, where its parameters may be wrong and were fitted to no
        log."""
        wanted, robot = self.problem.wanted, self.problem.given.model.robot
        if not wanted.inertial or wanted.free or wanted.knowledge is not None:
            return
        regressor = self.columns.regressor
        for kind in self._kinds():
            if not issubclass(kind, FileMistake):
                continue
            begun = cast(list[FileMistake], kind.starts(robot))
            made = [(e, e.change(robot)) for e in begun]
            made = [(e, change) for e, change in made if bool(change.any())]
            for effect, change in made:
                columns = torch.tensordot(change, regressor, 2).unsqueeze(0).numpy()
                yield self.term(effect, None, columns, change=change.numpy())
            if kind.shared and len(made) > 1:
                change = torch.stack([c for _, c in made]).sum(0)
                columns = torch.tensordot(change, regressor, 2).unsqueeze(0).numpy()
                shared = {"joints": (), "key": (kind.name, "shared"), "change": change.numpy()}
                yield self.term(made[0][0], None, columns, **shared)

    def _bodies(self) -> Iterable[Term | None]:
        """Bodies: a load, the error of one link as usual or plainly wrong, and of all links."""
        wanted, robot = self.problem.wanted, self.problem.given.model.robot
        regressor = self.columns.regressor.numpy()
        pi = robot.require_parameters("a diagnosis").pi.double()
        size, none = body_sizes(pi).numpy(), np.full(10, np.inf)
        if Payload.name in wanted.names and not robot.tips:
            load = Payload()
            mass = LOAD * max(float(pi[:, 0].abs().sum()), self.scale.mass)
            lever = LEVER * self.scale.length
            std = mass * np.array([1.0] + [lever] * 3 + [lever**2] * 6)
            low = np.where(np.arange(10) == 0, -self.problem.load[0], -np.inf)
            yield self._sized(
                load.name, load, None, regressor[-1], std, low, none, key=load.identity, joints=()
            )
        if not wanted.inertial or wanted.free:
            return
        links = [link for link in robot.bodies if link in robot.own_links]
        if LINK in wanted.names:
            for link in links:
                effect = KINDS[LINK](robot.own_links.index(link))  # type: ignore[call-arg]
                for error in (BODY_STD, WRONG_BODY * BODY_STD):
                    yield self._sized(
                        LINK, effect, None, regressor[link], error * size[link], -none,
                        none, key=effect.identity, joints=effect.joints,
                    )  # fmt: skip
        if wanted.knowledge is None:
            flat, every = regressor[robot.bodies[0] :], size[robot.bodies[0] :].ravel()
            columns = flat.reshape(-1, *flat.shape[2:])
            free = np.full(len(every), np.inf)
            yield self._sized(
                BASE, None, None, columns, BODY_STD * every, -free, free, key=(BASE,), joints=()
            )

    def of_event(self, effect: Effect) -> Term | None:
        """What was found in a window of time, or at an end of the travel."""
        place, columns = self.columns.of(effect)
        more = {"key": self.windows.key(effect), "shapes": self.windows.count, "law": None}
        return self.term(effect, place, columns.numpy(), **more)

    # ------------------------------------------------------------------ what is always fitted

    def _nuisance(self) -> Term | None:
        """What the model leaves open of itself, in coordinates in which it is independent."""
        wanted = self.problem.wanted
        if wanted.free or wanted.background:
            kinds = [KINDS[name] for name in wanted.background]
            effects = [kind(j) for kind in kinds for j in range(self.n)]  # type: ignore[call-arg]
            return self._free(effects, base=wanted.free)
        if wanted.knowledge is None:
            return None
        # Links' parameters, and coefficients of the model's own effects, whose names are known.
        own = [(e, known_names(e)) for e, _ in self.problem.given.model.effects if not e.event]
        own = [(e, names) for e, names in own if set(names) <= set(wanted.knowledge.coefficients)]
        known = wanted.knowledge.over([x for _, names in own for x in names]).information.numpy()
        parts = [self.columns.regressor.flatten(0, 1).numpy()]
        parts += [self.columns.on_all_joints(e).numpy() for e, _ in own]
        columns = np.concatenate(parts) * self.keep
        # In units of what a column is in this log; what it does not show is left out.
        size = np.sqrt((columns**2).sum((1, 2)))
        shows = size > ROUNDING * size.max()
        columns, size, known = columns[shows], size[shows], known[np.ix_(shows, shows)]
        values, axes = np.linalg.eigh(known / np.outer(size, size))
        # What is hardly known makes no larger torque than the log holds some times.
        widest = OPEN_STD * float(np.sqrt((self.torque**2 * self.rows).sum()))
        std = np.maximum(values, widest**-2) ** -0.5
        return self._always(np.tensordot((axes / size[:, None]).T, columns, 1), std)

    def _free(self, effects: Sequence[Effect], base: bool = True) -> Term:
        """Base parameters, unless told otherwise, and coefficients of effects, of which nothing is
        known."""
        free = list(self.problem.wanted.base.by_link) if base else []
        parts = [self.columns.regressor.flatten(0, 1).numpy()[free]]
        parts += [self.columns.on_all_joints(e).numpy() for e in effects]
        columns = np.concatenate(parts) * self.keep
        size = np.sqrt((columns**2).sum(2) / self.rows)
        with np.errstate(divide="ignore"):
            std = OPEN_STD * np.where(size > 0, self.torque / size, 0.0).max(1)
        return self._always(columns, np.where(std > 0, std, 1.0))

    def _always(self, columns: np.ndarray, std: np.ndarray) -> Term:
        """Columns that are always fitted."""
        free = np.full(len(std), np.inf)
        return Term("model", None, (), None, columns, np.diag(std), -free, free, ("model",))

    # ------------------------------------------------------------------ what is looked at later

    def plays(self, joints: Iterable[int]) -> list[Term]:
        """Backlash on some joints."""
        out: list[Term] = []
        for kind in (KINDS[name] for name in self.problem.wanted.names):
            if not kind.costly or kind.needs & self.data.missing:
                continue
            for j in joints:
                some = [e for e in kind.starts(self.columns.model.robot) if e.joints == (j,)]
                found = zip(some, self._columns(some), strict=True) if some else ()
                out += self._with_shapes(self.term(e, place, x) for e, (place, x) in found)
        return out


def columns_of(columns: Columns, effects: Sequence[Effect]) -> list[tuple[Place, torch.Tensor]]:
    """Columns of effects of one kind, as `Columns.of` has them. What a sensor reads of another
    joint's torque is the torque that the log has: the model's lacks what no cause explains yet."""
    first = effects[0] if effects else None
    if first is not None and first.reads:
        torque = logged(columns)
        return [(e.joints[0], torque[list(e.reads)]) for e in effects]
    if isinstance(first, JointEffect) or len(effects) == 1:
        return [columns.of(e) for e in effects]
    return list(columns.of_several(effects))  # type: ignore[arg-type]


def logged(columns: Columns) -> torch.Tensor:
    """Samples (n, N) of the measured torque [N m; N]."""
    return columns.samples.of([s.tau.T for s in columns.samples.segments])


def as_logged(columns: Columns) -> list[bool]:
    """Of each joint, whether the log has the model's torque: not where it is passive, or has no
    sensor."""
    model = columns.samples.of([m.require("torque", "a log").T for m in columns.motions])
    measured = logged(columns)
    both = (model * measured).sum(1)
    return (both > AS_LOGGED * model.norm(dim=1) * measured.norm(dim=1)).tolist()


def are_bodies(robot: Robot) -> bool:
    """Whether a model's links are bodies: those of base parameters alone hardly ever are."""
    pi = robot.require_parameters("a diagnosis").pi.double()
    return links_near(pi, usual_bodies(pi), BODY_STD) is not None
