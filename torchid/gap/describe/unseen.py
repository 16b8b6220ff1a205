"""What a log could not show, and what would separate what it leaves open."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from torchid.design.gram import VISIBLE
from torchid.design.segments import when
from torchid.effects.base import Effect
from torchid.effects.registry import KINDS
from torchid.gap.cause_records import unit_of
from torchid.gap.causes.candidates import Term, are_bodies
from torchid.gap.describe.model import Explanation
from torchid.gap.record import Experiment, Informative
from torchid.results.answer import NotTestable
from torchid.robot.model import Robot


def next_experiment(
    found: Explanation, undecided: Sequence[tuple[Term, Term]]
) -> Experiment | None:
    """What would separate the largest ambiguity: in words, and where this log comes closest.

    Args:
        found: the explanation.
        undecided: causes of it, each with what it cannot be told from.
    """
    if not undecided:
        return None
    fit, evidence, block = found.fit, found.search.evidence, found.problem.block
    samples = found.problem.data.samples
    weight = fit.samples / fit.losses
    # Of the ambiguous causes that which holds most.
    term, other = max(undecided, key=lambda pair: float(weight @ found.without(pair[0]).losses))
    # Where the two explanations differ most, block by block.
    apart = evidence.left(fit) - evidence.left(found.instead(term, other))
    differs = np.bincount(block.numpy(), weight @ apart**2)
    best, total = int(differs.argmax()), max(1e-12, float(differs.sum()))
    instants = (block == best).nonzero().flatten()
    t = samples.t
    name, start = when(samples.segments, float(t[instants[0]]))
    # As much more of the same motion as makes the odds, if it is as clear as here.
    # 20.0: odds from which two explanations are told apart
    seconds = len(block) * samples.interval * 2 * math.log(20.0) / total
    joints = term.joints or other.joints
    # What to do, from the effects' own descriptions.
    both = "; and ".join(dict.fromkeys(KINDS[t.name].experiment for t in (term, other)))
    # 3600.0: seconds of the same motion beyond which only another motion can help
    return Experiment(
        separates=(term.name, other.name),
        joint=joints[0] if joints else None,
        do=both[:1].upper() + both[1:] + ".",
        most_informative=Informative(
            trajectory=name,
            from_s=start,
            to_s=start + float(t[instants[-1]] - t[instants[0]]),
            share=float(differs[best]) / total,
        ),
        seconds_of_the_same_motion=seconds if seconds < 3600.0 else None,
    )


def not_testable(found: Explanation) -> list[NotTestable]:
    """Effects that these data cannot show, one entry an effect and place: with the smallest first
    coefficient whose evidence would be positive on average."""
    data, wanted = found.problem.data, found.problem.wanted
    robot = found.solution.start.robot
    known, out = {t.key for t in found.terms}, list[NotTestable]()
    known |= {(name, (j,)) for name in wanted.background for j in range(robot.n)}

    def tell(
        kind: type[Effect], joints: tuple[int, ...], smallest: float | None, reason: str
    ) -> None:
        unit = unit_of(kind.coefficients[0].unit, joints[:1], robot)
        out.append(NotTestable(kind.name, joints, smallest, unit, reason))

    for size, left, term in _visible(found):
        if term.key in known:
            continue
        known.add(term.key)
        joints = () if term.common else term.joints
        reason, smallest = _hidden(found, size, left, term)
        if reason:
            tell(KINDS[term.name], joints, smallest, reason)
    # Effects that were no candidates: no bodies, no motion, or no torque that says anything.
    bodies = are_bodies(found.problem.given.model.robot)
    for kind in (KINDS[name] for name in wanted.names if not KINDS[name].needs & data.missing):
        if kind.of_bodies and not bodies and kind.starts(robot):
            tell(kind, (), None, "the model's links are no bodies (`torchid extract` finds some)")
        for joints in _places(kind, robot):
            asked = wanted.asks(kind.name) and (kind.name, joints) not in known
            if asked and set(joints) <= set(data.silent):
                tell(kind, joints, None, "the joint's torque holds no signal")
            elif asked:
                tell(kind, joints, None, NOT_EXCITED)
    return sorted(out, key=lambda x: (wanted.names.index(x.effect), x.joints))


def _places(kind: type[Effect], robot: Robot) -> list[tuple[int, ...]]:
    """Joints that an effect may be at; none of the whole arm's, nor of what is looked for later."""
    if kind.windowed or kind.of_bodies or kind.inertial or kind.costly:
        return []
    own = [e for e in kind.starts(robot) if len(e.joints) == 1]
    return list(dict.fromkeys(e.joints for e in own if e.identity == (kind.name, e.joints)))


NOT_EXCITED = "the motion does not excite it"
HIDDEN = "indistinguishable from a change of the inertial parameters"


def _visible(found: Explanation) -> Iterable[tuple[float, float, Term]]:
    """Of every candidate beside an explanation the squares of its first column in units of what is
    left, and what of them no combination of the explanation's columns holds; the clearest shape of
    each."""
    screen, fit, evidence = found.search.screen, found.fit, found.search.evidence
    every, weight = (*evidence.nuisance, *fit.terms), fit.samples / fit.losses
    white = evidence.white(every, weight)
    best: dict[object, tuple[float, float, Term]] = {}
    accepted = {t.key for t in fit.terms}
    crosses = screen.cross(every, weight) if every else []
    for k, stack in enumerate(screen.stacks):
        sizes = stack.squares(weight)[:, 0, 0]
        held = np.zeros_like(sizes)
        if every:
            held = ((white @ crosses[k][:, :: stack.low.shape[1]]) ** 2).sum(0)
        for term, size, left in zip(stack.terms, sizes, sizes - held, strict=True):
            skipped = term.parametric or term.change is not None or term.key in accepted
            if not skipped and left > best.get(term.key, (0.0, -math.inf, term))[1]:
                best[term.key] = float(size), float(left), term
    return best.values()


def _hidden(found: Explanation, size: float, left: float, term: Term) -> tuple[str, float | None]:
    """Why a candidate could not have been told, empty where it could; and from which first
    coefficient on its evidence would be positive on average, None of any."""
    library, evidence, fit = found.search.library, found.search.evidence, found.fit
    # What another sensor tells of is not hidden by the torque's noise.
    if term.seen is not None:
        return "", None
    if size <= 1e-9:
        return NOT_EXCITED, None
    share = left / size
    if share < 1e-6:
        return HIDDEN, None
    wide = 1 + left * float((term.spread[0] ** 2).sum())
    smallest = math.sqrt((2 * evidence.price([term]) + math.log(wide)) / left)
    if share < VISIBLE:
        return HIDDEN, smallest
    if term.place is not None:
        j = term.place
        squares = size * fit.losses[j] / fit.samples[j] / library.rows[j]
        # 0.5: torque, as a share of the joint's own, below which a testable effect must be
        # detectable
        if smallest * math.sqrt(squares) > 0.5 * library.torque[j]:
            return "noise hides it up to half of the joint's torque", smallest
    return "", smallest
