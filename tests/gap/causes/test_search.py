from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.gap.causes.problems import NAMES, PLANTED, candidate, explanation, problem, search
from tests.gap.problems import ROBOT, measured, problem_of, wanted_of
from torchid.effects.gravity import EncoderOffset, TorqueGain
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.explain import WITH_BODIES, explain, with_bodies, with_likeliest
from torchid.gap.causes.judge import judge
from torchid.gap.causes.search import Search
from torchid.gap.torque import STAGES
from torchid.parallel.pace import Pace
from torchid.robot.inertia import InertialParameters


def test_friction_that_the_file_has_and_the_arm_has_not_is_a_change_to_nothing() -> None:
    """At the bound of what an arm can have: both laws are gone, and no other one acts backwards."""
    names = ("viscous_friction", "coulomb_friction")
    given = [PLANTED[name] for name in names]
    wanted = wanted_of((*NAMES, "power_law_friction", "thermal_friction_drift"))
    fit = explanation(Search(Library(problem_of(measured([]), wanted, given=given)))).fit
    found = {t.name: x.tolist() for t, x in zip(fit.terms, fit.values(), strict=True)}
    gone = {name: [-x for x in values] for name, (_, values) in zip(names, given, strict=True)}
    assert found.keys() == gone.keys()
    for name, values in gone.items():
        assert found[name] == pytest.approx(values, rel=0.1)


@pytest.mark.parametrize(("gain", "names"), [(-0.4, ["torque_gain"]), (-0.8, [])])
def test_what_no_arm_has_is_no_cause(gain: float, names: list[str]) -> None:
    """At its least, which takes away nothing that the model has, a coefficient has no name."""
    data = measured([(TorqueGain(1), (gain,))])
    fit = explanation(Search(Library(problem_of(data, wanted_of(("torque_gain",)))))).fit
    assert [t.name for t in fit.terms] == names


def test_a_turned_zero_of_the_last_joint_is_no_load() -> None:
    """It turns the last link, which ten numbers of a body do as well, and its slope less well."""
    offset = -0.15
    data = measured([(EncoderOffset(2, at=offset), [offset])])
    wanted = wanted_of((*NAMES, "encoder_offset", "payload", "link_inertia"), inertial=True)
    fit = explanation(Search(Library(problem_of(data, wanted)))).fit
    assert [(t.name, t.joints) for t in fit.terms] == [("encoder_offset", (2,))]
    assert fit.values()[0].tolist() == pytest.approx([offset], rel=0.02)


@pytest.mark.parametrize(("mass", "name"), [(0.0, "link_inertia"), (0.5, "payload")])
def test_a_centre_that_no_mass_moved_is_no_load(mass: float, name: str) -> None:
    """Ten numbers of the last link are a load's where their mass may have their moment."""
    pi = ROBOT.require_parameters("a test").pi.clone()
    pi[-1, :2] += torch.tensor([mass, 0.06], dtype=pi.dtype)
    real = ROBOT.with_parameters(InertialParameters(pi))
    wanted = wanted_of((*NAMES, "payload", "link_inertia"), inertial=True)
    fit = explanation(Search(Library(problem_of(measured([], real=real), wanted)))).fit
    assert [t.name for t in fit.terms] == [name]


def test_steps_are_told_and_no_set_comes_back() -> None:
    taken: list[frozenset[int]] = []
    of = Search(
        Library(problem("coulomb_friction")),
        lambda _, fit: taken.append(frozenset(t.root for t in fit.terms)),
    )
    explanation(of)
    assert len(taken[0]) == 1
    assert len(set(taken)) == len(taken)


def test_a_set_does_not_come_back_in_another_shape() -> None:
    """Shapes that are refined are terms of their own: a search could add and drop them for ever."""
    of = Search(Library(problem("coulomb_friction")))
    now = of.empty()
    shapes = [t for t in of.library.terms if t.name == "presliding_hysteresis" and t.place == 0]
    refined = of.library.like(shapes[1], shapes[0])
    one, other = (of.evidence.fit((t,), now.samples) for t in (shapes[0], refined))
    assert of._better([one], now, -np.inf) is not None
    of._take(one)
    assert of._better([other], now, -np.inf) is None


def test_a_cause_is_worth_what_it_lowers_where_it_was_not_fitted() -> None:
    of = search("viscous_friction")
    fit = of.again(explanation(of).fit)
    part = np.arange(of.library.gap.shape[1]) // 50 % 5
    whole, without = of.left_out(fit, part), of.left_out(fit, part, fit.terms[0])
    assert of.worth(whole, without) > 1
    assert of.worth(whole, whole) == 0


@pytest.mark.parametrize(
    ("times", "share", "worth_a_name"), [(0.5, 1.0, True), (1.5, 1.0, False), (1.5, 0.2, True)]
)
def test_a_cause_is_larger_than_what_the_model_left_itself(
    times: float, share: float, worth_a_name: bool
) -> None:
    """Over all of the log, or while it acts."""
    of = Search(Library(problem("viscous_friction")))
    fit = of.again(explanation(of).fit)
    part = np.arange(of.library.gap.shape[1]) // 50 % 5
    whole, without = of.left_out(fit, part), of.left_out(fit, part, fit.terms[0])
    of.library.known_noise = times * of.library.size
    assert (of.worth(whole, without, share) >= 1) == worth_a_name


def test_what_is_explained_has_its_errors_and_how_sure_it_is() -> None:
    explained = explain(problem("viscous_friction"))
    (one,) = explained.judged
    assert (one.name.name, one.name.joints) == ("viscous_friction", (1,))
    assert one.sure > 0.9
    assert explained.left[1] < 0.05
    assert explained.left.shape == (4,)
    assert explain(problem(None)).judged == []


def test_columns_are_made_anew_for_bodies_before_causes_are_exchanged(monkeypatch) -> None:
    """Whatever is exchanged is seen on the arm as it is; an arm that is right has one library."""
    changed, stages = iter([True, True, True]), list[str]()
    monkeypatch.setattr("torchid.gap.causes.explain._changed", lambda *_: next(changed))
    explain(problem("torque_offset"), pace=Pace(lambda stage, *_: stages.append(stage), STAGES))
    order = ["adding causes", WITH_BODIES, "exchanging causes"]
    assert [s for s in stages if s in order] == order
    assert list(changed) == [True]
    monkeypatch.undo()
    stages.clear()
    explain(problem("torque_offset"), pace=Pace(lambda stage, *_: stages.append(stage), STAGES))
    assert WITH_BODIES not in stages


def test_several_simple_causes_take_the_place_of_many_numbers() -> None:
    """Ten numbers of a link make a little of each; no exchange of one for one leads away."""
    planted = [PLANTED["coulomb_friction"], PLANTED["torque_offset"]]
    wanted = wanted_of((*NAMES, "link_inertia"), inertial=True)
    of = Search(Library(problem_of(measured(planted), wanted)))
    link = max((t for t in of.library.terms if t.name == "link_inertia"), key=lambda t: t.joints)
    then = of.simpler(of.again(of.evidence.fit((link,), of.library.rows)))
    assert {(t.name, t.joints) for t in then.terms} == {(e.name, e.joints) for e, _ in planted}
    assert link.key not in of.impossible
    assert of.simpler(then) is then


def test_what_is_likely_by_itself_takes_the_place_of_what_is_not() -> None:
    """A number stands beside the name that it is of, and so does a probability."""
    of = search("viscous_friction")
    dry, viscous = (candidate(of, f"{name}_friction", 1) for name in ("coulomb", "viscous"))
    draws, left = problem("viscous_friction").draws, np.zeros(4)
    fit = of.evidence.fit((dry,), of.library.rows)
    then = with_likeliest(of, fit, judge(of, fit, left, draws))
    assert then is not None
    assert then.terms == (viscous,)
    assert with_likeliest(of, then, judge(of, then, left, draws)) is None


def test_an_offset_is_read_on_the_arm_with_the_load_that_was_found() -> None:
    """Its torque is that of the load, too: columns are taken anew at the model found."""
    bodies = with_bodies(problem(None).given.model, loaded())
    own = problem(None).robot.require_parameters("a test").pi
    change = bodies.robot.require_parameters("a test").pi - own
    assert float(change[-1, 0]) == pytest.approx(2.0)
    assert float(change[:-1].abs().max()) == 0


def loaded() -> Fit:
    """A fit with a load of two kilograms at the tip."""
    of = Search(Library(problem(None, names=(*NAMES, "payload"))))
    (load,) = (t for t in of.library.terms if t.name == "payload")
    fit = of.evidence.fit((load,), of.library.rows)
    return replace(fit, x=np.array([2.0, *[0.0] * 9]))
