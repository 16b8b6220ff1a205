"""An earlier log beside the one that is asked: absent, in both, or new."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
import torch

from tests.gap.causes.problems import NAMES, PLANTED
from tests.gap.motions import ROBOT
from tests.gap.problems import CUTOFF, base_of_3r, measured, problem_of, wanted_of
from tests.gap.small_logs import Recording, arm, friction, logged
from torchid.design.columns import Columns, Model
from torchid.effects.friction import ViscousFriction
from torchid.effects.registry import Valued
from torchid.gap.causes.earlier import BOTH, NEW, TwoLogs
from torchid.gap.causes.evidence import Evidence
from torchid.gap.causes.explain import Explained, explain
from torchid.gap.problem import Problem
from torchid.gap.rows import kept
from torchid.gap.stacked import Earlier, at_rate, beside, earlier_of
from torchid.identification.knowledge import over_parameters

VISCOUS, OFFSET = PLANTED["viscous_friction"], PLANTED["torque_offset"]


def problem(before: Sequence[Valued], now: Sequence[Valued], *, free: bool = False) -> Problem:
    """A gap of the 3R beside an earlier log, each with effects of its own."""
    asked = problem_of(measured(now), wanted_of(NAMES, free=free))
    earlier = measured(before, seed=5)
    return beside(asked, Earlier(earlier.samples.segments, CUTOFF, "monday"))


@cache
def explained(before: tuple[str, ...], now: tuple[str, ...]) -> Explained:
    planted = [[PLANTED[name] for name in names] for names in (before, now)]
    return explain(problem(*planted))


def found(of: Explained) -> set[tuple[str, tuple[int, ...], str | None]]:
    return {(one.name.name, one.name.joints, one.when) for one in of.judged}


@pytest.mark.parametrize("name", PLANTED)
def test_what_came_since_is_new(name: str) -> None:
    assert found(explained((), (name,))) == {(name, PLANTED[name][0].joints, NEW)}


@pytest.mark.parametrize("name", PLANTED)
def test_what_the_model_lacked_already_is_in_both(name: str) -> None:
    assert found(explained((name,), (name,))) == {(name, PLANTED[name][0].joints, BOTH)}


def test_an_earlier_log_of_another_rate_and_band() -> None:
    """As the file beside a model holds it: fewer rows, and a lower cut-off than this one's."""
    asked = problem_of(measured([VISCOUS]), wanted_of(NAMES))
    rows = replace(kept(measured([], seed=5).samples, ROBOT), cutoff=0.75 * CUTOFF)
    of = beside(asked, earlier_of(rows, asked))
    assert of.data.samples.cutoff == rows.cutoff
    assert of.data.samples.rate == asked.data.samples.rate
    assert found(explain(of)) == {("viscous_friction", (1,), NEW)}


def test_an_earlier_log_is_prepared_as_this_one() -> None:
    asked = problem_of(measured([VISCOUS]), wanted_of(NAMES))
    earlier = earlier_of(logged(ROBOT, Recording(runs=(3,))), asked)
    assert earlier.cutoff == asked.data.samples.cutoff
    assert earlier.source
    assert beside(asked, earlier).data.samples.rate == asked.data.samples.rate


def test_friction_that_changes_by_itself_is_no_change() -> None:
    """By less than a session's share of it: 5 % of a model's friction are its own."""
    own = arm(friction(2, Fv=2.0))
    named = ["viscous_friction Fv2"]
    eye = torch.eye(len(base_of_3r().by_link), dtype=torch.float64)
    known = over_parameters(eye, base_of_3r(), (), "monday").over(named)
    root = torch.cat([known.root, torch.zeros(1, known.root.shape[1]).double()])
    root[-1, -1] = 1e3
    wanted = replace(wanted_of(NAMES), knowledge=replace(known, root=root))
    viscous = ViscousFriction(1)
    for value, expected in ((2.1, set()), (3.0, {("viscous_friction", (1,), NEW)})):
        asked = problem_of(measured([(viscous, [value])]), wanted, robot=own)
        asked = replace(asked, given=Columns(Model.of(own), asked.data.samples))
        earlier = measured([(viscous, [2.0])], seed=5)
        of = explain(beside(asked, Earlier(earlier.samples.segments, CUTOFF, "monday")))
        assert found(of) == expected


def test_of_nothing_nothing_is_said() -> None:
    assert found(explained((), ())) == set()


def test_both_questions_are_answered() -> None:
    of = explained(("viscous_friction",), ("viscous_friction", "torque_offset"))
    assert found(of) == {("viscous_friction", (1,), BOTH), ("torque_offset", (2,), NEW)}


def test_new_terms_are_zero_on_the_earlier_log_and_cost_what_the_others_do() -> None:
    library = TwoLogs(problem([], [VISCOUS]))
    earlier = ~library.asked
    pairs: dict[object, dict[str, float]] = {}
    for term in library.terms:
        assert term.since in (NEW, BOTH)
        assert term.key == (term.since, *term.form)
        pairs.setdefault(term.cause, {})[term.since] = term.shapes
        if term.since == NEW:
            assert not term.columns[..., earlier].any()
        elif term.name == "torque_offset":
            assert term.columns[..., earlier].any()
    for shapes in pairs.values():
        assert len(set(shapes.values())) == 1


def test_what_was_there_and_has_changed_since_pays_twice() -> None:
    evidence = Evidence(TwoLogs(problem([], [VISCOUS])))
    both, new = (
        next(t for t in evidence.library.terms if (t.name, t.since) == ("torque_gain", since))
        for since in (BOTH, NEW)
    )
    assert both.cause == new.cause
    assert evidence.price([both]) == evidence.price([new])
    assert evidence.price([both, new]) == pytest.approx(2 * evidence.price([new]))


def test_what_the_model_is_made_of_is_offered_as_new_alone() -> None:
    """Free base parameters hold rotor inertia of the first joint over both logs, and not as new."""
    library = TwoLogs(problem([], [], free=True))
    own = {t.since for t in library.terms if (t.name, t.joints) == ("rotor_inertia", (0,))}
    assert own == {NEW}


def test_samples_of_the_log_that_is_asked_are_left_out_in_turn_and_no_others() -> None:
    of = problem([], [VISCOUS])
    assert of.asked is not None
    assert bool((of.folds.fold[~of.asked] == -1).all())
    assert set(of.folds.fold[of.asked].tolist()) == set(range(of.folds.count))


def test_repeats_across_the_logs_tell_no_noise() -> None:
    """The same motion on both days: what differs is the change that is asked for."""
    of = problem([], [VISCOUS])
    first = sum(1 for b in of.data.samples.bounds if not bool(of.asked[b.start]))  # type: ignore[index]
    assert all((p.a < first) == (p.b < first) for p in of.repeats.pairs)


def test_a_segment_on_another_grid_is_the_same_motion() -> None:
    segment = measured([VISCOUS]).samples.segments[0]
    finer = at_rate(segment, 2.5 * segment.rate)
    back = at_rate(finer, segment.rate)
    count = back.length
    assert abs(count - segment.length) <= 1
    inner = slice(5, count - 5)
    assert torch.allclose(back.motion.q[inner], segment.motion.q[:count][inner], atol=1e-6)
    assert at_rate(segment, segment.rate).tau is segment.tau
