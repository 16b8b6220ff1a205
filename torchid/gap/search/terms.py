"""Candidates of a search: effects at their places, and the columns that each of them has."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import torch

from torchid.design.bodies import (
    Bodies,
    body_sizes,
    links_near,
    some_body,
    together,
    usual_bodies,
)
from torchid.design.columns import Columns, Model, Place, on_joint
from torchid.design.deflection import Compliance, compliance
from torchid.design.gram import Gram, inverse_root
from torchid.design.resonance import Swing
from torchid.effects.base import Coefficient, Effect, JointEffect, ModelEffect
from torchid.effects.file_mistakes import FileMistake
from torchid.effects.gravity import TorqueCrosstalk
from torchid.effects.phase import JointElasticity
from torchid.effects.registry import KINDS, Valued
from torchid.gap.data import Data
from torchid.gap.search.scale import Scale
from torchid.gap.wanted import BASE, Wanted
from torchid.identification.knowledge import known_names
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order
from torchid.robot.knowledge import Knowledge
from torchid.robot.model import Robot
from torchid.statistics.criteria import BODY_STD, WRONG_BODY
from torchid.typing import Bool, Float, Int, Tensor

EXPLAINS = 3.0
"""Standard deviations of a coefficient beside the laws of its joint from which a coarse grid
explains something: what is worth a name has more, and a column of the fine grid has most of it in
common with a neighbour's."""

AS_LOGGED = 0.2
"""Correlation of logged torque with the model's from which other sensors may read it [1]: much else
may be in it, but it is there."""

T = TypeVar("T")

LINK = "link_inertia"
PAYLOAD = "payload"


@dataclass(frozen=True, eq=False)
class Term:
    """An effect at a place, as a part of a model.

    Attributes:
        name: of the effect, or `all_base`.
        effects: whose coefficients the columns belong to: one; several that share theirs; none for
            base parameters.
        place: the joint whose torque alone the columns are in, or None.
        at: (C,) rows of the columns in the joint's matrix, or among the common ones.
        coefficients: C of them; base parameters have one description for all.
        known: what the model as given has of each.
        instead: (joint, term, coefficients) of the model's own effect that this one stands in the
            place of: the same effect with another shape.
        sigma: (C,) standard deviations of the coefficients before the log is seen; None: unknown.
        bodies: what is known of them as corrections of bodies, in the place of `sigma`, with which
            candidates are only ranked; None: nothing.
        seen: what is known of it beside the fit's torque: from other sensors, or above its band.
        most: (C,) size of each coefficient on this robot, beyond which it is something else; None:
            any.
        change: (L, 10) of the links' parameters per unit of the one coefficient, of a mistake of
            the robot's file.
        wrong: whether it is a body, or the scale of a torque, that would be plainly wrong.
        information: (C, F) its rows of the inverse covariance of all F coefficients of the fixed
            terms, where the model knows how sure it is: the correction is what that leaves open.
    """

    name: str
    effects: tuple[Effect, ...]
    place: Place
    at: Int[Tensor, " C"]
    coefficients: tuple[Coefficient, ...]
    known: tuple[float, ...]
    instead: tuple[tuple[int, "Term", Tensor], ...] = ()
    sigma: Float[Tensor, " C"] | None = None
    bodies: Bodies | None = None
    seen: Compliance | Swing | None = None
    information: Float[Tensor, "C F"] | None = None
    wrong: bool = False
    change: Float[Tensor, "L 10"] | None = None
    most: Float[Tensor, " C"] | None = None

    @cached_property
    def limits(self) -> Float[Tensor, "C 3"]:
        """Of each coefficient: what the model has of it already, the least whole, and the largest
        correction. A term that stands in the place of the model's own is the whole of it."""
        known = [0.0] * len(self.known) if self.instead else self.known
        if self.information is not None:
            # What is left open of the model's own is bounded by what is known of it.
            bounds = [(v, -torch.inf, torch.inf) for v in known]
            return torch.tensor(bounds, dtype=torch.float64).reshape(-1, 3)
        every = self.effects[0].ranges if self.effects else [c.range for c in self.coefficients]
        least, largest = zip(*every, strict=True)
        out = torch.tensor([known, least, largest], dtype=torch.float64)
        if self.most is not None:
            out[2] = self.most
        return out.T

    @cached_property
    def optional(self) -> Bool[Tensor, " C"]:
        """Which coefficients with a sign the effect may lack and stay what it is: those that are
        not essential to it, of which the model as given has nothing."""
        essential = self.effects[0].essential if self.effects else ()
        each = zip(self.coefficients, self.known, strict=True)
        return torch.tensor(
            [
                bool(essential) and k not in essential and c.non_negative and not known
                for k, (c, known) in enumerate(each)
            ]
        )

    @cached_property
    def ridge(self) -> Float[Tensor, " C"]:
        """Inverse variances of the coefficients before the log is seen; zero where unknown."""
        unknown = torch.zeros(len(self.at), dtype=torch.float64)
        return unknown if self.sigma is None else self.sigma**-2

    @cached_property
    def centre(self) -> Float[Tensor, " C"]:
        """Where the coefficients are expected: at what another sensor says."""
        zero = torch.zeros(len(self.at), dtype=torch.float64)
        return zero if self.seen is None else zero + self.seen.value - self.known[0]

    @cached_property
    def places(self) -> Int[Tensor, " C"]:
        """The joint whose torque alone each column is in; -1 where there is none."""
        return torch.full_like(self.at, -1 if self.place is None else self.place)

    @property
    def alone(self) -> Effect | None:
        """Its one effect; None of base parameters, and of several that share their coefficients."""
        return self.effects[0] if len(self.effects) == 1 else None

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints, from 0, that it acts at; none of what belongs to the whole arm."""
        return () if self.alone is None else self.alone.joints

    @cached_property
    def key(self) -> tuple[object, ...]:
        """What it is, whatever its shape: effect and place, or that all joints share it."""
        return (self.name, len(self.effects)) if self.alone is None else self.alone.identity

    @property
    def inertial(self) -> bool:
        """Whether it corrects the model's own parameters."""
        return self.name in (BASE, LINK)

    @property
    def of_links(self) -> bool:
        """Whether it changes links' parameters, as a body or as a mistake of the file."""
        return self.inertial or self.change is not None

    @cached_property
    def count(self) -> int:
        """C."""
        return len(self.at)

    @cached_property
    def shapes(self) -> int:
        """Number of its parameters that are searched beside the coefficients, how wrong a body may
        be among them; none of the model's own effect, whose shape is given."""
        own = any(self.known) and not self.inertial
        return len(self.effects[0].shapes) if self.effects and not own else int(self.wrong)


def excluding(terms: Sequence[T], gone: Sequence[T]) -> list[T]:
    """Terms but for some of them."""
    return [t for t in terms if all(t is not g for g in gone)]


@dataclass(frozen=True, eq=False)
class Candidates:
    """All candidates, and the normal equations of their columns.

    Attributes:
        columns: at the model whose gap is to be explained.
        gap: (n, N) what is to be explained.
        keep: (n, N) samples that count.
        gram: joint by joint.
        terms: candidates.
        fixed: terms that are always in the model.
        given: effects of the model as given, with their coefficients.
    """

    columns: Columns
    gap: Float[Tensor, "n N"]
    keep: Bool[Tensor, "n N"]
    gram: Gram
    terms: tuple[Term, ...]
    fixed: tuple[Term, ...]
    given: tuple[Valued, ...] = ()


def term_columns(columns: Columns, term: Term) -> Float[Tensor, "C n N"]:
    """A term's columns on all joints, at the columns' model."""
    if term.name == BASE:
        flat = columns.regressor.flatten(0, 1)
        return flat[term.at]
    if term.change is not None:
        return torch.tensordot(term.change, columns.regressor, 2).unsqueeze(0)
    if term.name in (LINK, PAYLOAD):
        # A body is the ten rows of its link; the payload those of the last one.
        robot = columns.model.robot
        last = term.name == PAYLOAD
        return columns.regressor[-1 if last else robot.own_links[term.effects[0].joints[0]]]
    every = [columns_of(columns, [e])[0] for e in term.effects]
    return sum(x if place is None else on_joint(x, place, columns.n) for place, x in every)  # type: ignore[return-value]


def columns_of(
    columns: Columns, effects: Sequence[Effect]
) -> list[tuple[Place, Float[Tensor, "..."]]]:
    """Columns of effects of one kind, as `Columns.of` has them. What a sensor reads of another
    joint's torque is the torque that the log has: the model's lacks what no cause explains yet."""
    if effects and isinstance(effects[0], TorqueCrosstalk):
        torque = logged(columns)
        return [(e.joint, torque[[e.read]]) for e in effects if isinstance(e, TorqueCrosstalk)]
    if len(effects) > 1:
        return list(columns.of_several(effects))  # type: ignore[arg-type]
    return [columns.of(e) for e in effects]


def logged(columns: Columns) -> Float[Tensor, "n N"]:
    """Samples of the measured torque [N m; N]."""
    return columns.samples.of([s.tau.T for s in columns.samples.segments])


def candidates_of(
    columns: Columns,
    gap: Float[Tensor, "n N"],
    data: Data,
    wanted: Wanted,
    given: Model,
    extra: Sequence[Effect] = (),
) -> Candidates:
    """Columns of all candidates at a model, put into normal equations.

    Args:
        columns: at the model.
        gap: what is to be explained.
        data: which samples count, and what the log holds.
        wanted: what is looked for.
        given: the model as given.
        extra: further shapes and windows of effects.
    """
    rows = _Rows(columns, data, wanted, given)
    terms = [*_bodies(columns, wanted), *_of_the_arm(rows, gap, extra)]
    # The model's own, which are corrected within what is known of them, candidates or not.
    own = [e for e, _ in given.effects if wanted.knowledge is not None and not e.event]
    there = {e for t in terms for e in t.effects}
    beside = [
        rows.put((e,), *columns_of(columns, [e])[0])
        for e in own
        if isinstance(e, ModelEffect) and not e.inertial and e not in there
    ]
    for name in wanted.names:
        if KINDS[name].shared and not issubclass(KINDS[name], FileMistake):
            shared = tuple(KINDS[name].candidates(columns.model.robot))  # type: ignore[attr-defined]
            terms.append(rows.put(shared, None, sum(columns.on_all_joints(e) for e in shared)))  # type: ignore[arg-type]
    # Once a joint's columns are in its matrix, they are not needed any more.
    gram = Gram(rows.filled[None], columns.n)
    for joint in range(columns.n):
        terms += _of_joint(rows, joint, extra)
        there = {t.effects[0] for t in terms if t.place == joint}
        for e in own:
            if isinstance(e, JointEffect) and e.joint == joint and e not in there:
                beside.append(rows.put((e,), joint, columns.of(e)[1]))
        gram.add(joint, rows.taken(joint), gap[joint], data.keep[joint])
    # Own columns stand behind the common ones.
    terms, beside = (
        [t if t.place is None else replace(t, at=t.at + rows.filled[None]) for t in some]
        for some in (terms, beside)
    )
    scale = Scale(columns)
    terms = [replace(t, most=scale.largest(t.effects)) if t.effects else t for t in terms]
    terms = _standing_in(terms, given.effects)
    if wanted.knowledge is not None:
        fixed = known_terms([*terms, *beside], wanted.knowledge, given.effects)
    else:
        # What is always in the model is no candidate, nor are bodies beside free base parameters.
        asked = [(t.name, t.effects) for t in fixed_terms(columns, wanted)]
        fixed = tuple(t for t in terms if (t.name, t.effects) in asked)
        terms = [t for t in excluding(terms, fixed) if not (wanted.free and t.inertial)]
    chosen = tuple(t for t in terms if wanted.asks(t.name, t.joints))
    return Candidates(columns, gap, data.keep, gram, chosen, fixed, given.effects)


class _Rows:
    """Columns that take their rows in the joints' matrices, one after the other; first the common
    ones, which all joints have."""

    def __init__(self, columns: Columns, data: Data, wanted: Wanted, given: Model):
        self.columns, self.data, self.wanted, self.given = columns, data, wanted, given
        self._common = [columns.regressor.flatten(0, 1)]
        self._own: list[list[Tensor]] = [[] for _ in range(columns.n)]
        # Rows of the common ones, and of each joint's own.
        self.filled = Counter[Place]({None: len(self._common[0])})

    def put(self, effects: tuple[Effect, ...], place: Place, x: Float[Tensor, "C ..."]) -> Term:
        """Columns become a term."""
        first = self.filled[place]
        (self._common if place is None else self._own[place]).append(x)
        self.filled[place] += len(x)
        effect, data = effects[0], self.data
        # Another sensor says what a coefficient is, or else physics how large it can be.
        seen = _seen(self.columns, data, effect)
        sizes = [c.largest / 2 for c in effect.coefficients] if seen is None else [seen.std]
        # A model that was fitted to the arm's own logs is in units of its sensors: a scale that is
        # another one now has changed, by whatever amount.
        scale = effect.scale_of_torque and self.wanted.knowledge is None
        if scale and data.gain_said:
            sizes = [data.gain_std]
        return Term(
            effect.name, effects, place, torch.arange(first, first + len(x)), effect.coefficients,
            _known(effects, self.given.effects), sigma=torch.tensor(sizes, dtype=torch.float64),
            seen=seen, wrong=scale and not data.gain_said,
        )  # fmt: skip

    def taken(self, joint: int) -> list[Tensor]:
        """All columns of a joint's matrix, its own for the last time."""
        own, self._own[joint] = self._own[joint], []
        return [*(x[:, joint] for x in self._common), *own]


def _of_the_arm(rows: _Rows, gap: Float[Tensor, "n N"], extra: Sequence[Effect]) -> list[Term]:
    """Effects of the whole arm, and mistakes of its file."""
    columns, terms, there = rows.columns, list[Term](), set[Effect]()
    for every in _model_effects(rows.wanted, rows.data, columns, extra):
        some = [e for e in every if e not in there]
        starts = list(zip(some, columns_of(columns, some), strict=True))
        finer = [e for e in _between(columns, gap, rows.data.keep, starts) if e not in there]
        for effect, (place, x) in (*starts, *zip(finer, columns.of_several(finer), strict=True)):
            terms.append(rows.put((effect,), place, x))
        there |= {*some, *finer}
    for made, change in _file_mistakes(rows.wanted, rows.given.robot):
        x = torch.tensordot(change, columns.regressor, 2).unsqueeze(0)
        terms.append(replace(rows.put(made, None, x), change=change))
    return terms


def _of_joint(rows: _Rows, joint: int, extra: Sequence[Effect]) -> list[Term]:
    """Effects of one joint: all shapes of the grid, and some that no grid holds."""
    columns, wanted, terms = rows.columns, rows.wanted, list[Term]()
    driven = joint in columns.model.robot.driven
    for kind in _joint_kinds(wanted, rows.data, joint) if driven else ():
        shapes = kind.grid(columns.motions, joint, columns.samples.cutoff)
        if not len(shapes):  # a ripple on a joint that never moves
            continue
        names = [s.name for s in kind.shapes]
        effects = [kind(joint, **dict(zip(names, v, strict=True))) for v in shapes.tolist()]
        found = columns.of_shapes(kind, joint, shapes)
        terms += [rows.put((e,), joint, x) for e, x in zip(effects, found, strict=True)]
    for shaped in _own_shapes(wanted, rows.given.effects, joint, extra):
        terms.append(rows.put((shaped,), joint, columns.of(shaped)[1]))
    return terms


def are_bodies(robot: Robot) -> bool:
    """Whether a model's links are bodies: those of base parameters alone hardly ever are."""
    pi = robot.require_parameters("a diagnosis").pi.double()
    return links_near(pi, usual_bodies(pi), BODY_STD) is not None


def _bodies(columns: Columns, wanted: Wanted) -> list[Term]:
    """Payload, links and all base parameters: rows of the regressor, link by link. Links that are
    bodies stay bodies, near to what they were; of numbers that no body has only the size is
    known."""
    robot = columns.model.robot
    n = robot.n_links
    pi = robot.require_parameters("a diagnosis").pi.double()
    sigma, usual = BODY_STD * body_sizes(pi), usual_bodies(pi)
    links = links_near(pi, usual, BODY_STD)
    out = []
    for link in robot.bodies:
        at = torch.arange(link * PARAMETERS_PER_LINK, (link + 1) * PARAMETERS_PER_LINK)
        # With several tips, what one of them carries is an error of its link.
        if link == n - 1 and PAYLOAD in wanted.names and not robot.tips:
            effect: Effect = KINDS[PAYLOAD]()
            known, body = (0.0,) * len(at), some_body(usual[-1])
            out.append(Term(PAYLOAD, (effect,), None, at, effect.coefficients, known, bodies=body))
        if wanted.inertial and LINK in wanted.names and link in robot.own_links:
            effect = KINDS[LINK](robot.own_links.index(link))  # type: ignore[call-arg]
            known, near = tuple(pi[link].tolist()), links[link] if links else None
            # A single link that is wrong may be plainly so.
            wide = None if near is None else replace(near, metric=near.metric / WRONG_BODY**2)
            about = WRONG_BODY * sigma[link]
            out.append(
                Term(
                    LINK, (effect,), None, at, effect.coefficients, known, (), about, wide,
                    wrong=True,
                )
            )  # fmt: skip
    described = (Coefficient("", "", False, "a base parameter"),)
    if links and not wanted.free:
        # All links at once: whatever base parameters do, and no more.
        first = robot.bodies[0]
        at = torch.arange(first * PARAMETERS_PER_LINK, n * PARAMETERS_PER_LINK)
        every = together([b.shifted(k * PARAMETERS_PER_LINK) for k, b in enumerate(links[first:])])
        zero, free = (0.0,) * len(at), sigma[first:].flatten()
        out.append(Term(BASE, (), None, at, described * len(at), zero, (), free, every))
        return out
    # A base parameter's prior is that of the parameters grouped into it, link by link.
    numbers = wanted.base.by_link
    grouping = wanted.base.grouping[: wanted.base.n_rigid, : wanted.base.n_rigid_parameters]
    spread = (grouping[:, paper_order(n).argsort()] * sigma.flatten()).norm(dim=1)
    base = Term(
        BASE, (), None, torch.tensor(numbers), described * len(numbers), (0.0,) * len(numbers)
    )
    return [*out, base if wanted.free else replace(base, sigma=spread)]


def _seen(columns: Columns, data: Data, effect: Effect) -> Compliance | Swing | None:
    """What a link's own encoder, or its swinging, tells of its joint's compliance; None where
    neither does."""
    if not isinstance(effect, JointElasticity):
        return None
    if data.lag is None:
        return data.swings.get(effect.joint) if effect.damping > 0 else None
    samples, joint = columns.samples, effect.joint
    parts = [
        torch.stack([m.require("torque", effect.name)[:, joint], m.q[:, joint]])
        for m in columns.motions
    ]
    load, q = samples.of(parts)
    return compliance(data.lag[joint], load, q, samples.bounds)


def _model_effects(
    wanted: Wanted, data: Data, columns: Columns, extra: Sequence[Effect]
) -> Iterator[list[ModelEffect]]:
    """Effects of the whole arm at all their places, where the log holds what they need; kind by
    kind, then those that were refined or found in a window. Nothing is told of joints whose torque
    holds no signal, for nothing there could speak against it."""
    silent = frozenset(data.silent)
    bodies, there = are_bodies(columns.model.robot), as_logged(columns)
    for name in wanted.names:
        kind = KINDS[name]
        # Columns of bodies are none where only their base parameters are known.
        unknown = bool(kind.needs & data.missing) or (kind.of_bodies and not bodies)
        if issubclass(kind, ModelEffect) and not (unknown or kind.inertial or kind.windowed):
            found = [_swinging(e, data) for e in kind.starts(columns.model.robot)]
            # What another sensor reads is a torque that is there, as the log has it.
            read = [e for e in found if not isinstance(e, TorqueCrosstalk) or there[e.read]]
            yield [e for e in read if not e.joints or not silent.issuperset(e.joints)]
    yield from ([e] for e in extra if isinstance(e, ModelEffect))


def as_logged(columns: Columns) -> list[bool]:
    """Of each joint, whether the log has the model's torque: not where it is passive, or has no
    sensor."""
    model = columns.samples.of([m.require("torque", "a log").T for m in columns.motions])
    measured = logged(columns)
    both = (model * measured).sum(1)
    return (both > AS_LOGGED * model.norm(dim=1) * measured.norm(dim=1)).tolist()


def _between(
    columns: Columns,
    gap: Float[Tensor, "n N"],
    keep: Bool[Tensor, "n N"],
    starts: Sequence[tuple[ModelEffect, tuple[Place, Tensor]]],
) -> list[ModelEffect]:
    """What stands between starts of a kind, on the joints where one of them explains something of
    what the laws of the joint leave of its gap."""
    out: list[ModelEffect] = []
    for joint in sorted({j for effect, _ in starts for j in effect.joints[:1]}):
        own = [(e, place, x) for e, (place, x) in starts if e.joints[:1] == (joint,)]
        finer = [f for e, *_ in own for f in e.between()]
        if not finer:
            continue
        counts = keep[joint]
        laws = columns.laws(joint)[:, counts]
        laws = inverse_root(laws @ laws.T).T @ laws
        felt = [x[:, joint] if place is None else x * (place == joint) for _, place, x in own]
        y, x = (z - (z @ laws.T) @ laws for z in (gap[joint, counts], torch.cat(felt)[:, counts]))
        power = x.square().sum(1) * y.square().sum() / max(1, len(y))
        if bool(((x @ y).square() > EXPLAINS**2 * power).any()):
            out += finer
    return out


def _file_mistakes(
    wanted: Wanted, robot: Robot
) -> Iterator[tuple[tuple[Effect, ...], Float[Tensor, "L 10"]]]:
    """Mistakes of the robot's file, where its parameters may be wrong and were fitted to no log:
    effects, and the change of its parameters per unit coefficient; of one link, and of all."""
    kinds = [KINDS[name] for name in wanted.names if issubclass(KINDS[name], FileMistake)]
    if not wanted.inertial or wanted.free or wanted.knowledge is not None:
        return
    for kind in kinds:
        assert issubclass(kind, FileMistake)
        each = [(e, e.change(robot)) for e in kind.starts(robot) if isinstance(e, FileMistake)]
        yield from (((e,), change) for e, change in each if bool(change.any()))
        if kind.shared:
            yield tuple(e for e, _ in each), torch.stack([change for _, change in each]).sum(0)


def _swinging(effect: ModelEffect, data: Data) -> ModelEffect:
    """An elastic joint as it swings, where its link is seen to; any other effect as it is."""
    swing = data.swings.get(effect.joint) if isinstance(effect, JointElasticity) else None
    if swing is None:
        return effect
    return replace(effect, at=swing.value, damping=swing.damping)  # type: ignore[call-arg]


def _joint_kinds(wanted: Wanted, data: Data, joint: int) -> Iterator[type[JointEffect]]:
    """Effects of one joint's motion; of friction nothing is told on a joint that does not slide."""
    for name in dict.fromkeys((*wanted.names, *wanted.background)):
        kind = KINDS[name]
        if issubclass(kind, JointEffect) and not kind.needs & data.missing:
            # On a joint that does not slide, friction is whatever holds it.
            friction = kind.jumps or kind.family in ("speed", "time")
            if bool(data.slides[joint]) or not friction:
                yield kind


def _own_shapes(
    wanted: Wanted, given: Sequence[Valued], joint: int, extra: Sequence[Effect]
) -> list[JointEffect]:
    """Shapes that no grid holds: the model's own, with its options, and refined ones."""
    # Shapes that differ from the kind's default, and those that a search refined.
    own = [e for e, _ in given if isinstance(e, JointEffect) and (e.shapes or e != type(e)(joint))]
    own += [e for e in extra if isinstance(e, JointEffect)]
    return [e for e in dict.fromkeys(own) if e.joint == joint and e.name in wanted.names]


def _known(effects: tuple[Effect, ...], given: Sequence[Valued]) -> tuple[float, ...]:
    """Coefficients that the model as given has of exactly this effect; zeros where it has none."""
    total = [0.0] * len(effects[0].coefficients)
    for other, values in given:
        if len(effects) == 1 and other == effects[0]:
            total = [a + b for a, b in zip(total, values, strict=True)]
    return tuple(total)


def _standing_in(terms: Sequence[Term], given: Sequence[Valued]) -> list[Term]:
    """Other shapes of an effect that the model has stand in its place, not beside it."""
    # The model's own effects, as terms.
    own = {t.alone: t for t in terms if t.alone}
    out = []
    for term in terms:
        alone = None if term.place is None else term.alone
        joint = -1 if term.place is None else term.place
        instead = [
            (joint, own[effect], torch.tensor(values, dtype=torch.float64))
            for effect, values in given
            if alone and effect in own and effect != alone and effect.identity == alone.identity
        ]
        out.append(replace(term, instead=tuple(instead)) if instead else term)
    return out


def known_terms(
    terms: Sequence[Term], knowledge: Knowledge, given: Sequence[Valued]
) -> tuple[Term, ...]:
    """What the model as given leaves open of itself: corrections of base parameters and of its
    effects' coefficients, as far as these are known. They are always in the model, and cost no
    evidence but their distance from what is known.

    Args:
        terms: all, with their rows in the matrices.
        knowledge: of the model as given.
        given: its effects.
    """
    base = next(t for t in terms if t.name == BASE)
    own = {t.alone: t for t in terms if t.alone}
    found = [(own[e], known_names(e)) for e, _ in given if e in own]
    found = [(t, names) for t, names in found if set(names) <= set(knowledge.coefficients)]
    # The base parameters first, in the coordinates of their term, then coefficients by name.
    asked = knowledge.over([name for _, names in found for name in names])
    rows = torch.cat([base.at, torch.arange(asked.rigid, len(asked.information))])
    information = asked.information[rows.unsqueeze(1), rows]
    parts = information.split([len(t.at) for t in (base, *(t for t, _ in found))])
    return tuple(
        replace(t, information=part, sigma=None, seen=None, instead=())
        for t, part in zip((base, *(t for t, _ in found)), parts, strict=True)
    )


def fixed_terms(columns: Columns, wanted: Wanted) -> tuple[Term, ...]:
    """Terms that are always in the model: base parameters where they are free, and a background.
    Their rows in any matrix are still to be given."""
    # Base parameters, and the background on every joint.
    out = [t for t in _bodies(columns, wanted) if t.name == BASE] if wanted.free else []
    for name in wanted.background:
        for joint in range(columns.n):
            effect: Effect = KINDS[name](joint)  # type: ignore[call-arg]
            at = torch.arange(len(effect.coefficients))
            known = (0.0,) * len(at)
            out.append(Term(name, (effect,), joint, at, effect.coefficients, known))
    return tuple(out)
