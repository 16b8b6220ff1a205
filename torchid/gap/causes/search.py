"""One search: causes join, leave, are exchanged and refined while the evidence rises.

Candidates are ranked with all samples, for noise that the missing cause itself makes leaves few of
them; the ten most likely are fitted, and each is compared with the samples that tell it from the
set at hand. The number of samples belongs to a pair, so that steps may lead back: a set that was
visited is not taken again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchid.effects.base import JointEffect, ModelEffect
from torchid.effects.inertia import Payload
from torchid.gap.causes.candidates import Library, Term, excluding
from torchid.gap.causes.events import planes, pushes
from torchid.gap.causes.evidence import Evidence, Fit
from torchid.gap.causes.screen import Screen
from torchid.parallel.pace import Pace
from torchid.statistics.evidence import solved

TRIED = 10
"""Candidates that are fitted in a step."""

BY_CHANCE = 3.0
"""Standard deviations beyond which a load's number is not by chance [1]."""

ONE_BODY = 0.01
"""Share of the squares of a torque by which a load and an error of its link are the same in a log,
for their slabs differ [1]."""

FORMS = 3
"""Forms of a joint's law that are tried as the first of two, and as the second."""

SEEDS = 4
"""Likeliest candidates that are tried with a second one where none helps alone."""

ALIKE = 1e-4
"""Share of the squares of a torque by which two are the same in a log [1]: of these the simpler
one, which the library has first, is taken."""

STEP = 0.5
"""Rise of the evidence from which a step is taken [nats]."""

SWAPS, FITTED, EXCHANGED = 20, 60, 20
"""Exchanges at most, one after the other; how many are fitted in a step, and how many of these are
compared."""

LEVELS = 3
"""Times that a shape is refined, each time three times more closely."""

JUDGED, USUAL = ("judging", "locating"), 10
"""Stages that follow a search, and the number of causes with which they take their shares."""

ROUNDS = 3
"""Times that the search goes over its steps at most, with shapes that were refined."""

SLOW, MORE = 2.0, 1.25
"""Samples that are alike, and residual over the noise of repeats, from which something is left to
explain on a joint [1]."""

ACTS = 0.1
"""Torque of a cause while it acts, over the most that it makes, at least [1]."""

OWN_BLOCKS = 4
"""Blocks of the samples in which a cause acts that acts at times only; every other one is left out
together [1]."""


def same_columns(one: Term, other: Term) -> bool:
    """Whether two terms have the same columns."""
    if one.place != other.place or one.columns.shape != other.columns.shape:
        return False
    return bool(np.array_equal(one.columns, other.columns))


def every_other(acts: np.ndarray) -> np.ndarray:
    """0 and 1 (N,) in turn, block by block, of the samples in which a cause acts; else below
    zero."""
    number = (acts.cumsum() - 1) * OWN_BLOCKS // max(acts.sum(), 1)
    return np.where(acts, number % 2, -1)


@dataclass(frozen=True, eq=False)
class Found:
    """What a search has found.

    Attributes:
        fit: the explanation.
        small: terms that the evidence has and that are not worth a name.
    """

    fit: Fit
    small: tuple[Term, ...]


class Search:
    """The search for one explanation.

    Args:
        library: of the candidates.
        watch: called with the search and each fit that it goes on from.
        pace: says how much time there is.
    """

    def __init__(
        self,
        library: Library,
        watch: "Callable[[Search, Fit], None] | None" = None,
        pace: Pace | None = None,
    ):
        self.library = library
        self.pace = pace or Pace(None, {})
        self.evidence = Evidence(library)
        self.screen = Screen(self.evidence)
        self.watch = watch or (lambda search, fit: None)
        self.visited: set[frozenset[int]] = set()
        self.impossible: set[object] = set()
        self._rises: dict[tuple[Fit, Fit], float] = {}
        self._secants: dict[tuple[int, float], Term | None] = {}

    def empty(self) -> Fit:
        """What is always fitted, alone."""
        # How many samples are independent follows from what is left, and what is left from a fit:
        # one guess, and once more.
        first = self.evidence.fit((), np.maximum(self.library.rows / 4, 4.0))
        return self.evidence.fit((), self.evidence.independent(first))

    def again(self, fit: Fit) -> Fit:
        """A fit with the samples that are independent in what it leaves."""
        return self.evidence.fit(fit.terms, self.evidence.independent(fit))

    def beside(self, terms: Sequence[Term], other: Term, samples: np.ndarray) -> Fit:
        """Terms with another one, whose columns are a secant at its estimate where it has one: of a
        change of finite size no slope tells."""
        fit = self.evidence.fit((*terms, other), samples)
        if other.effect is None or not other.effect.linearised or other.common:
            return fit
        secant = self._secant(other, float(f"{fit.values()[-1][0]:.1e}"))
        if secant is None:
            return fit
        brought = self.evidence.fit((*terms, secant), samples)
        return brought if self.evidence.value(brought) > self.evidence.value(fit) else fit

    def _secant(self, term: Term, value: float) -> Term | None:
        """A term with its columns as a secant at a value, which is the same one every time."""
        key = term.serial, value
        if key not in self._secants:
            assert term.effect is not None
            made = self.library.of_effect(term.effect.at_estimate([value]))
            self._secants[key] = None if made is None else self.library.like(made, term)
        return self._secants[key]

    def without(self, fit: Fit, term: Term) -> Fit:
        """A fit without a term, with as many samples."""
        return self.evidence.fit(excluding(fit.terms, [term]), fit.samples)

    def joined(self, start: Sequence[Term] = ()) -> Fit:
        """Causes that join one after the other; none is exchanged for another yet.

        Args:
            start: terms that the search begins with.
        """
        self.visited.clear()
        self.pace("adding causes")
        fit = self.empty()
        # Pushes first: a law that acts at an end or beyond a limit would explain one.
        self._offer(self._pushes(fit))
        there = {t.key for t in start}
        start = [*start, *(t for t in self.library.terms if t.shown and t.key not in there)]
        if start:
            fit = self.again(self.evidence.fit(start, fit.samples))
            fit = self.shrink(fit)
        return self.grow(fit)

    def completed(self, fit: Fit) -> Found:
        """Causes are exchanged, and others join, until nothing is likelier; those that are worth
        their names."""
        self.pace("exchanging causes")
        if self.pace.has_time("backlash and pushes"):
            self._offer([*self.library.plays(self._open(fit)), *self._pushes(fit)])
        for _ in range(ROUNDS):
            before = {t.key for t in fit.terms}
            fit = self.possible(self.refine(self.swap(self.grow(fit))))
            # Nothing joined or left: another round would try the same.
            if {t.key for t in fit.terms} == before:
                break
        # What is superfluous leaves, though the rest was there before.
        self.visited.clear()
        return self.worthwhile(self.as_loads(self.simpler(self.shrink(fit))))

    def simpler(self, fit: Fit) -> Fit:
        """Without the most numbers that turn bodies or frames, where other causes are likelier in
        their place: they also make a little of what several simple causes do, none of which alone
        is likelier there."""
        many = [t for t in fit.terms if t.inertial or (t.effect and t.effect.of_bodies)]
        if not many or not self.pace.has_time("simpler causes"):
            return fit
        most, there = max(many, key=lambda t: t.count), self.impossible
        self.impossible = there | {t.key for t in self.library.terms if t.cause == most.cause}
        then = self.refine(self.swap(self.grow(self.again(self.without(fit, most)))))
        self.impossible = there
        better = then.allowed and self._rise(then, fit) > STEP
        return self.shrink(self._take(then)) if better else fit

    def possible(self, fit: Fit) -> Fit:
        """Without terms that are as much as no arm has, which do not come back: on its way a search
        may lean on them for what has not joined yet."""
        beyond = [t for t, x in zip(fit.terms, fit.values(), strict=True) if t.is_beyond(x)]
        self.impossible |= {t.key for t in beyond}
        if not beyond:
            return fit
        return self.shrink(self.again(self.evidence.fit(excluding(fit.terms, beyond), fit.samples)))

    def as_loads(self, fit: Fit) -> Fit:
        """Errors of a link that are a load as well are told as one, for nothing but the file tells
        which they are; those that are no load as the link's."""
        terms = self.library.terms
        for k, term in enumerate(fit.terms):
            base = self.without(fit, term)
            for other in (t for t in terms if same_columns(t, term) and t.name != term.name):
                then = self.evidence.fit((*fit.terms[:k], other, *fit.terms[k + 1 :]), fit.samples)
                load = then if other.name == Payload.name else fit
                better = self.is_load(load, k) == (load is then)
                if better and then.allowed and self.alike(then, fit, base, ONE_BODY):
                    fit = then
                    break
        return fit

    def is_load(self, fit: Fit, k: int) -> bool:
        """Whether the k-th term's ten numbers may be a load's: its centre is within the arm's reach
        of the tool, or its mass is not known well enough to tell."""
        evidence = self.evidence
        every = (*evidence.nuisance, *fit.terms)
        first = sum(t.count for t in every) - sum(t.count for t in fit.terms[k:])
        white = evidence.white(every, fit.samples / fit.losses)[:, first : first + 4]
        std = BY_CHANCE * np.sqrt((white**2).sum(0))
        mass, *moment = fit.values()[k][:4] + np.array(evidence.library.problem.load[:4])
        least = np.linalg.norm(moment) - np.linalg.norm(std[1:])
        return bool(least <= (max(mass, 0.0) + std[0]) * self.library.scale.length)

    # ------------------------------------------------------------------ steps

    def likely(self, fit: Fit, without: frozenset[object] = frozenset()) -> list[Term]:
        """Candidates beside a fit that are looked at closely: the most likely if all samples are
        independent, and if as many are as in noise like what is left."""
        ranked = [
            self.screen.best(fit, samples, TRIED, without | self.impossible)
            for samples in (self.library.rows, self.evidence.independent(fit))
        ]
        found = {t.serial: t for some in ranked for _, t in some}
        return [found[serial] for serial in sorted(found)]

    def _take(self, fit: Fit) -> Fit:
        """The fit that the search goes on from."""
        self.visited.add(frozenset(t.root for t in fit.terms))
        self._rises.clear()
        self.pace.scale(JUDGED, (1 + len(fit.terms)) / USUAL)
        self.pace.tell()
        self.watch(self, fit)
        return self.again(fit)

    def _rise(self, fit: Fit, now: Fit) -> float:
        """Evidence of a fit over what is there."""
        if (fit, now) not in self._rises:
            self._rises[fit, now] = self.evidence.over(fit, now)
        return self._rises[fit, now]

    def _better(self, fits: Sequence[Fit], now: Fit, least: float) -> tuple[float, Fit] | None:
        """The fit with the most evidence over what is there, above a least rise; none that was
        visited."""
        best: tuple[float, Fit] | None = None
        for fit in fits:
            if frozenset(t.root for t in fit.terms) in self.visited:
                continue
            rise = self._rise(fit, now)
            # Of what makes the same torque in this log the first of the library is taken.
            if best is None:
                best = (rise, fit) if rise > least else None
            elif rise > best[0] and not self.alike(fit, best[1], now):
                best = rise, fit
        return best

    def alike(self, one: Fit, other: Fit, now: Fit, share: float = ALIKE) -> bool:
        """Whether two explanations change what is left in the same way."""
        left, a, b = (self.evidence.left(f) for f in (now, one, other))
        return float(((a - b) ** 2).sum()) <= share * float(((left - b) ** 2).sum())

    def grow(self, fit: Fit) -> Fit:
        """Causes join, and what they make superfluous leaves."""
        while len(fit.terms) < self.library.problem.settings.max_effects:
            if not self.pace.has_time("further causes"):
                return fit
            tried = [self.beside(fit.terms, t, fit.samples) for t in self.likely(fit)]
            step = self._better(tried, fit, STEP) or self._better(
                self._pairs(tried, fit), fit, STEP
            )
            if step is None:
                return fit
            # Its shape comes first: what a coarse one leaves would get names.
            before, fit = len(fit.terms), self._take(step[1])
            fit = self.shrink(self.refine(fit, range(before, len(fit.terms))))
        return fit

    def _pairs(self, tried: Sequence[Fit], now: Fit) -> list[Fit]:
        """Two terms at once: beside what one alone leaves, few samples may tell of it."""
        likely = sorted(tried, key=lambda f: -self._rise(f, now))[:SEEDS]
        out = []
        for one in (f for f in likely if f.allowed):
            # Seen with all samples as independent, and with as few as what is left allows: the
            # order of candidates differs.
            for samples in (self.library.rows, self.evidence.independent(one)):
                for _, other in self.screen.best(one, samples, SEEDS, frozenset(self.impossible)):
                    out.append(self.evidence.fit((*one.terms, other), now.samples))
        return out

    def shrink(self, fit: Fit) -> Fit:
        """Terms leave that the evidence does not need."""
        while fit.terms:
            tried = [self.without(fit, t) for t in fit.terms]
            step = self._better(tried, fit, 0.0)
            if step is None:
                return fit
            fit = self._take(step[1])
        return fit

    def swap(self, fit: Fit) -> Fit:
        """One term is exchanged for another, which must be likelier than nothing in its place, too:
        evidence is of pairs."""
        for _ in range(SWAPS):
            if not self.pace.has_time("exchanges of causes"):
                return fit
            tried = self._exchanged(fit)
            step = self._better(tried, fit, STEP)
            while step is not None:
                then = step[1]
                base = self.evidence.fit(then.terms[:-1], fit.samples)
                if self.evidence.over(then, base) > 0:
                    break
                # A better pair with something else is no reason to take what alone is unlikelier
                # than nothing.
                tried = [f for f in tried if f is not then]
                step = self._better(tried, fit, STEP)
            if step is None:
                return fit
            fit = self.shrink(self._take(step[1]))
        return fit

    def other_forms(self, fit: Fit, law: object) -> list[tuple[tuple[Term, ...], Fit]]:
        """Two other forms of a joint's law in the place of all that an explanation has of it: forms
        stand for each other together, as dry and viscous friction do for a power of the speed.

        Args:
            fit: the explanation.
            law: and in which log it acts.

        Returns:
            The forms and their fit; none where there are no two.
        """
        evidence, own = self.evidence, [t for t in fit.terms if (t.law, t.since) == law]
        gone = frozenset(t.key for t in own)

        def with_another(beside: Fit) -> list[Fit]:
            ranked = self.screen.ranked(beside, self.library.rows, gone)
            forms = [t for _, t in ranked if (t.law, t.since) == law][:FORMS]
            return [evidence.fit((*beside.terms, t), fit.samples) for t in forms]

        rest = evidence.fit(excluding(fit.terms, own), fit.samples)
        pairs = [two for one in with_another(rest) for two in with_another(one)]
        best = max(pairs, key=evidence.value, default=fit)
        there = best is not fit and best.allowed
        return [(best.terms[-2:], best)] if there else []

    def _exchanged(self, fit: Fit) -> list[Fit]:
        """Fits with one term for another: the likeliest with the samples at hand, and none that
        makes the same torque with as many coefficients."""
        every, tried = list[tuple[float, Fit, Fit, bool]](), list[tuple[float, Fit, Term, Term]]()
        for t in fit.terms:
            base = self.without(fit, t)
            # To first order, in noise as it is with all of them: rises are of one scale then.
            samples = fit.samples * base.losses / fit.losses
            ranked = self.screen.ranked(base, samples, frozenset(self.impossible))
            rise = self.evidence.value(fit) - self.evidence.value(base)
            own = next((gain for gain, u in ranked if u.key == t.key), rise)
            some = self.screen.spread(ranked, 2 * TRIED)
            tried += [(gain - own, base, t, u) for gain, u in some if u.root != t.root]
        tried.sort(key=lambda one: -one[0])
        for _, base, t, other in tried[:FITTED]:
            then = self.beside(base.terms, other, fit.samples)
            every.append((self.evidence.value(then), then, base, other.count >= t.count))
        values = sorted((value for value, *_ in every), reverse=True)
        least = values[EXCHANGED - 1] if len(values) > EXCHANGED else -np.inf
        return [
            then
            for value, then, base, simple in every
            if value >= least and not (simple and self.alike(then, fit, base))
        ]

    def refine(self, fit: Fit, which: Sequence[int] | None = None) -> Fit:
        """Shapes, and secants of changes of the model, a little otherwise: of some terms or all."""
        for k in range(len(fit.terms)) if which is None else which:
            if not self.pace.has_time("finer shapes"):
                break
            for level in range(LEVELS):
                term, values = fit.terms[k], fit.values()[k]
                fits = [
                    self.evidence.fit((*fit.terms[:k], t, *fit.terms[k + 1 :]), fit.samples)
                    for t in self._around(term, values, level)
                ]
                fits = [f for f in fits if f.allowed]
                best = max(fits, key=self.evidence.value, default=fit)
                if self.evidence.value(best) <= self.evidence.value(fit) + 1e-6:
                    break
                fit = best
        return self.again(fit)

    def _around(self, term: Term, values: np.ndarray, level: int) -> list[Term]:
        """A term with shapes near its own, and with its secant at the estimate."""
        library, effect = self.library, term.effect
        if effect is None or effect.inertial:
            return []
        if isinstance(effect, JointEffect):
            shapes = effect.finer(library.columns.motions, level, library.samples.cutoff)
            if shapes is None:
                return []
            names = [s.name for s in effect.shapes]
            found = library.columns.of_shapes(type(effect), effect.joint, shapes).numpy()
            made = [
                library.term(replace(effect, **dict(zip(names, v, strict=True))), effect.joint, x)
                for v, x in zip(shapes.tolist(), found, strict=True)
            ]
        else:
            assert isinstance(effect, ModelEffect)
            there = [] if len(term.joints) > 1 else [effect.at_estimate(values.tolist())]
            near = (*there, *effect.around(level, library.samples.interval))
            made = [library.of_effect(e) for e in near if e != effect]
        return [library.like(t, term) for t in made if t is not None]

    def _pushes(self, fit: Fit) -> list[Term]:
        """Pushes in windows, and planes, beside a fit."""
        left, weight = self.evidence.left(fit), self.library.rows / fit.losses
        found = [*pushes(self.library, left, weight), *planes(self.library, left, weight)]
        return self.library.offered(found)

    def _open(self, fit: Fit) -> list[int]:
        """Joints on which something is left to explain: more than differs between repeats; or, of a
        log without any, what is slower than noise."""
        library = self.library
        size = np.sqrt(fit.losses / library.rows)
        slow = library.rows / self.evidence.independent(fit)
        more = np.where(np.isnan(library.noise), slow > SLOW, size > MORE * library.noise)
        return [j for j in range(library.n) if more[j] and library.keep[j].any()]

    def _offer(self, terms: list[Term]) -> None:
        """Candidates that are looked at from now on."""
        there = {(t.key, t.effect) for t in self.library.terms}
        terms = [t for t in terms if (t.key, t.effect) not in there]
        if terms:
            self.library.add(terms)
            self.evidence.refresh()
            self._rises.clear()
            self.screen.refresh()

    # ------------------------------------------------------------------ worth

    def left_out(self, fit: Fit, part: np.ndarray, gone: Term | None = None) -> np.ndarray:
        """RMS (n,) that an explanation, or that without a term, leaves on parts of the log that it
        is not fitted on.

        Args:
            part: (N,) number of each sample's part; below zero of those that are always fitted.
        """
        evidence = self.evidence
        every = [*evidence.nuisance, *excluding(fit.terms, [] if gone is None else [gone])]
        _, spread, middle, *_ = evidence.slabs(every)
        full = np.concatenate([spread.T @ evidence.columns(every), evidence.gap[:, None]], 1)
        parts = {}
        for p in np.unique(part):
            some = full[:, :, part == p]
            parts[p] = some @ some.transpose(0, 2, 1)
        whole, out = sum(parts.values()), np.zeros(evidence.n)
        for g in (g for p, g in parts.items() if p >= 0):
            z, _, _ = solved(whole - g, fit.samples, evidence.floor, middle)
            v = np.append(z, -1.0)
            out += (v @ g) @ v
        rows = np.maximum(self.library.keep[:, part >= 0].sum(1), 1.0)
        return np.sqrt(np.maximum(out, 1e-300) / rows)

    def shared(self, fit: Fit, part: np.ndarray) -> np.ndarray:
        """Parts (N,) of which two share what acts at times only, every other block of the samples
        in which it acts: what happened in one part alone no other part could foresee."""
        part = part.copy()
        two = np.unique(part[part >= 0])[:2]
        for term in (t for t in fit.terms if t.rare):
            own = every_other(self.acting(fit, term) & (part >= 0))
            part[own >= 0] = two[own[own >= 0]]
        return part

    def worthwhile(self, fit: Fit) -> Found:
        """Without what lowers no joint's error by as much as is worth a name on motions left out;
        the least worthy leaves first."""
        motions = self.library.problem.folds.fold.numpy()
        small: list[Term] = []
        while fit.terms:
            own = self.shared(fit, motions)
            whole = self.left_out(fit, own)
            worth = [
                # What another sensor shows is there, however little of it the fit's torque has.
                np.inf
                if t.shown
                else max(
                    self.worth(whole, self.left_out(fit, own, t), self._share(fit, t)),
                    self._displaced(fit, t),
                )
                for t in fit.terms
            ]
            if min(worth) >= 1:
                break
            # One at a time: what was worthless beside it may be worth a name once it is gone.
            small.append(fit.terms[int(np.argmin(worth))])
            fit = self.again(self.without(fit, small[-1]))
        return Found(fit, tuple(small))

    def _share(self, fit: Fit, term: Term) -> float:
        """Share of the samples in which a term acts: of what happens once, or at an end of the
        travel; else all of them."""
        return float(self.acting(fit, term).mean()) if term.rare else 1.0

    def _displaced(self, fit: Fit, term: Term) -> float:
        """Torque that without a term the model's own corrections make in its place, over what is
        worth a name; nothing where these are as likely then."""
        evidence, library = self.evidence, self.library
        if not evidence.nuisance:
            return 0.0
        rest = self.without(fit, term)
        # The corrections that replace it are as likely beforehand as the term: then they are what
        # is there.
        if rest.known - fit.known <= evidence.price([term]):
            return 0.0
        own = evidence.nuisance[0]
        torque = np.tensordot(rest.x[: own.count] - fit.x[: own.count], own.columns, 1)
        size = np.sqrt((torque**2).sum(1) / library.rows)
        least = self.least(np.sqrt((evidence.gap**2).sum(1) / library.rows))
        return float((size / np.maximum(least, library.unexplained)).max())

    def least(self, error: np.ndarray, share: float = 1.0) -> np.ndarray:
        """Fall (n,) of joints' errors (n,) from which a cause is worth a name [N m; N]: a share of
        the error, that of a torque that is a share of the joint's, and that of what the model has
        left unexplained on its own log, which nobody knows the cause of either.

        Args:
            share: of the samples, in which the cause acts.
        """
        library, settings = self.library, self.library.problem.settings
        size = settings.worthwhile_torque * library.torque
        least = np.maximum(settings.worthwhile * error, 0.5 * size**2 / np.maximum(error, 1e-300))
        # Squares that the model left on its own log nobody knows the cause of; a fall within them
        # is none.
        beyond = error**2 - share * library.unexplained**2
        by = np.where(beyond > 0, error - np.sqrt(np.maximum(beyond, 0.0)), error)
        return np.maximum(np.maximum(least, by), 1e-300)

    def worth(self, after: np.ndarray, before: np.ndarray, share: float = 1.0) -> float:
        """Fall of the joints' errors by a cause, over what is worth a name; the largest of them.

        Args:
            after, before: (n,) RMS left out, with the cause and without it.
            share: of the samples, in which the cause acts.
        """
        return float(((before - after) / self.least(before, share)).max())

    def acting(self, fit: Fit, term: Term) -> np.ndarray:
        """Samples (N,) in which a term of an explanation makes a tenth of its largest torque, or
        more."""
        (x,) = (x for t, x in zip(fit.terms, fit.values(), strict=True) if t is term)
        torque = np.abs(np.tensordot(x, term.columns, 1))
        most = torque if term.place is not None else torque.max(0)
        return most > ACTS * most.max()
