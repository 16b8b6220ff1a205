"""One friction law a joint: its curve is the arm's, with a band that holds it, and its parts add
up."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import torchid
from tests.arms import single_axis
from tests.marks import some
from torchid.effects.registry import KINDS

SETTINGS = torchid.GapSettings(
    effects=("viscous_friction", "coulomb_friction", "load_dependent_friction", "rotor_inertia"),
)


def motor(forwards: float = 0.0) -> torchid.Log:
    """Of 1.2 g m^2, with dry friction .1 N m and viscous .002 N m s; from some speed on it turns
    forwards only."""
    t = np.arange(0.0, 20.0, 1 / 200)
    q = forwards * t - 180 * np.cos(0.5 * t) - 20 / 1.3 * np.cos(1.3 * t)
    dq = forwards + 90 * np.sin(0.5 * t) + 20 * np.sin(1.3 * t)
    ddq = 45 * np.cos(0.5 * t) + 26 * np.cos(1.3 * t)
    noise = 0.002 * np.random.default_rng(0).standard_normal(len(t))
    tau = 1.2e-3 * ddq + 0.1 * np.tanh(dq / 0.5) + 0.002 * dq + noise
    return torchid.Log(t, q[:, None], dq=dq[:, None], tau=tau[:, None])


@cache
def found(forwards: float = 0.0, Fc: float = 0.0) -> torchid.Diagnosis:
    own = ({"effect": "coulomb_friction", "joint": 1, "Fc": Fc},) if Fc else ()
    return torchid.diagnose(replace(single_axis(), effects=own), motor(forwards), settings=SETTINGS)


@pytest.mark.parametrize("Fc", [0.0, 0.04])
def test_the_curve_is_the_arms_whatever_the_model_has_already(Fc):
    (law,) = found(Fc=Fc).friction
    curve = law.curve
    speed, torque, half, given = map(np.array, (curve.speed, curve.torque, curve.half, curve.given))
    truth = 0.1 * np.sign(speed) + 0.002 * speed
    assert np.abs(torque - truth).max() < 0.01
    assert (np.abs(torque - truth) < 2 * half + 1e-3).mean() > 0.9
    assert given == pytest.approx(Fc * np.sign(speed))
    assert speed.min() < -90
    assert speed.max() > 90
    for x in law.at:
        assert x.forwards == pytest.approx(0.1 + 0.002 * x.speed, abs=0.01)
        assert x.backwards == pytest.approx(-x.forwards, abs=0.01)
        assert 0 < x.forwards_std < 0.1


def test_details_that_take_each_others_place_are_one():
    """A load that never changes: dry friction is what grows with it. One of them is there for
    sure, and neither has a row that says otherwise."""
    t = np.arange(0.0, 20.0, 1 / 200)
    q = 0.1 * np.sin(t) + 0.03 * np.sin(2.6 * t)
    dq, ddq = (np.gradient(x, t) for x in (q, np.gradient(q, t)))
    noise = 0.2 * np.random.default_rng(0).standard_normal(len(t))
    tau = 95 * ddq + 20 * np.sign(dq) + 200 * dq + noise
    log = torchid.Log(t, q[:, None], dq=dq[:, None], tau=tau[:, None])
    effects = ("viscous_friction", "coulomb_friction", "bearing_moment_friction")
    robot = single_axis("P", mass=95.0)
    (law,) = torchid.diagnose(robot, log, settings=replace(SETTINGS, effects=effects)).friction
    (dry,) = (d for d in law.details if "coulomb_friction" in d.effects)
    assert dry.how_sure > 0.9
    assert {"coulomb_friction", "bearing_moment_friction"} <= set(dry.effects)
    assert dry.detail.startswith("dry, or ")


def test_it_is_the_sum_of_its_terms():
    diagnosis = found()
    (law,) = diagnosis.friction
    own = [f for f in diagnosis.which if KINDS[f.effect].branch == "friction"]
    assert len(own) == 2
    assert law.share == pytest.approx(sum(f.share for f in own))
    assert law.removes[0] == pytest.approx(sum(f.removes[0] for f in own))
    assert law.how_sure >= max(f.how_sure for f in own)
    details = {d.detail: d for d in law.details}
    assert set(details) >= {"dry", "viscous"}
    assert details["dry"].effects == ("coulomb_friction",)
    assert details["dry"].how_sure > 0.9


def test_of_a_direction_that_the_log_does_not_have_nothing_is_said():
    (law,) = found(forwards=120.0).friction
    assert all(math.isnan(x.backwards) and x.forwards > 0 for x in law.at)
    assert min(law.curve.speed) > 0
    assert law.words()


def test_friction_of_the_model_that_the_log_confirms_is_no_finding():
    own = (
        {"effect": "coulomb_friction", "joint": 1, "Fc": 0.1},
        {"effect": "viscous_friction", "joint": 1, "Fv": 0.002},
    )
    diagnosis = torchid.diagnose(replace(single_axis(), effects=own), motor(), settings=SETTINGS)
    (law,) = diagnosis.friction
    assert not diagnosis.which or all(KINDS[f.effect].branch != "friction" for f in diagnosis.which)
    assert law.how_sure is None
    assert {d.words for d in law.details} == {"dry", "viscous"}
    assert law.curve.torque == pytest.approx(law.curve.given)


def test_a_detail_of_the_model_stays_beside_one_that_changed():
    own = ({"effect": "viscous_friction", "joint": 1, "Fv": 0.002},)
    diagnosis = torchid.diagnose(replace(single_axis(), effects=own), motor(), settings=SETTINGS)
    (law,) = diagnosis.friction
    assert [f.effect for f in diagnosis.which if KINDS[f.effect].branch == "friction"] == [
        "coulomb_friction"
    ]
    details = {d.detail: d.how_sure for d in law.details}
    assert details["dry"] > 0.9
    assert details["viscous"] is None


@pytest.mark.parametrize("explained", some([False, True], slow=1, quick=1))
def test_a_model_that_explains_nothing_is_in_doubt_until_the_answer_says_why(explained):
    """Ten times the friction is another torque than this arm's, as of a log of another one."""
    effects = SETTINGS.effects if explained else ("rotor_inertia",)
    own = ({"effect": "coulomb_friction", "joint": 1, "Fc": 1.0},)
    robot, settings = replace(single_axis(), effects=own), replace(SETTINGS, effects=effects)
    warnings = torchid.diagnose(robot, motor(), settings=settings).warnings
    assert any("explains nothing" in text for text in warnings) != explained
