"""Every effect that needs no trusted model, identified beside free base parameters."""

from dataclasses import replace
from functools import lru_cache

import pytest
import torch

from tests.marks import quick_first
from torchid.effects.base import Motion
from torchid.effects.registry import KINDS, nominal_effects, not_fitted
from torchid.effects.written import split_list
from torchid.errors import RobotError, TorchidError
from torchid.excitation.synthetic import nominal_torque
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.export.results import dynamics_of
from torchid.identification.asked import asked_effects
from torchid.identification.identify import Identification, Settings, identify
from torchid.identification.values import prior_of, read_base, read_identification
from torchid.json_data import write_json
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

PLAIN = ("viscous_friction", "coulomb_friction")
EXACT_MOTION = Settings(cutoff=None, reversal=0.0)
NOISE = 0.01
"""Of the torque, as a share of each joint's RMS."""

# As asked for with its shape, true coefficients.
CASES = {
    "gear_coupling:joint=3,source_joint=2,ratio=1": {"Fvm": 0.2, "Iam": 0.02, "Fcm": 0.3},
    "joint_spring:joint=2,curvature=-1": {"k": 2.0, "c0": 0.5},
    "power_law_friction:joint=1,a=1.7": {"F2": 0.4},
    "stribeck_friction:joint=2,vs=0.3": {"Fs": 0.8},
    "load_dependent_friction:joint=2": {"mu": 0.08},
    "load_dependent_stribeck:joint=2,vs=0.3": {"mus": 0.08},
    "presliding_hysteresis:joint=2,length=0.1": {"Fh": 0.6},
    "load_hysteresis:joint=2,length=0.05": {"mu_h": 0.06},
    "end_stop:joint=1,limit=2,towards=1": {"ks": 20.0},
    "cogging:joint=3,k=9": {"a_s": 0.2, "a_c": 0.1},
    "motor_ripple:joint=2,k=9": {"a_s": 0.04, "a_c": 0.02},
    "position_dependent_friction:joint=1,k=3": {"a_s": 0.4, "a_c": 0.2},
    "torque_crosstalk:joint=3,source_joint=2": {"C": 0.05},
    "torque_gain:joint=2": {"gain": 0.06},
    "thermal_friction_drift:joint=1,T=20": {"dFv": 0.3, "dFc": -0.4},
    "asymmetric_friction:joint=3": {"dF": 0.3, "dFv": 0.2},
}
SEARCHED = [text for text in CASES if KINDS[text.partition(":")[0]].shapes]


def arm(cases: dict[str, dict[str, float]] | None = None) -> Robot:
    """The 3R with dry and viscous friction, and with effects as asked for, with coefficients."""
    robot = replace(load_robot("3r_friction"), effects=())
    pairs = [(a.effect, v) for w, v in (cases or {}).items() for a in asked_effects([w], robot)]
    plain = [
        {"effect": name, "joint": j + 1, key: value}
        for name, key, value in zip(PLAIN, ("Fv", "Fc"), (0.3, 0.4), strict=True)
        for j in range(3)
    ]
    more = [e.record(list(values.values())) for e, values in pairs]
    return replace(robot, effects=(*plain, *more))


def driven(robot: Robot, seed: int = 0, cold: float = 0.0) -> Log:
    """Two trajectories of 20 s, their motion exact, their torque with white noise."""
    plan = trajectory_log(random_trajectory(robot, seed, count=2, fill=True), 50.0)
    clock = cold + torch.arange(plan.samples, dtype=torch.float64) / 50
    parts = [
        nominal_torque(robot, Motion(plan.q[s], plan.dq[s], plan.ddq[s], t=clock[s]))
        for s in plan.slices()
    ]
    tau = torch.cat(parts)
    generator = torch.Generator().manual_seed(seed)
    size = NOISE * tau.square().mean(0).sqrt()
    noise = torch.randn(tau.shape, generator=generator, dtype=torch.float64)
    return plan.replace(tau=tau + size * noise, current=None)


@lru_cache
def identified(written: str, searched: bool) -> Identification:
    name, _, rest = written.partition(":")
    places = [p for p in rest.split(",") if p.startswith(("joint", "source_joint"))]
    asked = ":".join((name, ",".join(places))) if searched else written
    settings = replace(EXACT_MOTION, effects=(*PLAIN, asked))
    robot = arm({written: CASES[written]})
    return identify(robot, driven(robot), settings=settings)


def coefficients(found: Identification, values: dict[str, float]) -> list[tuple[float, float]]:
    """Value and standard deviation of the last effect's coefficients."""
    names = found.effects[-1].coefficient_names()
    at = [found.base.names.index(name) for name in names]
    assert len(names) == len(values)
    return [(float(found.values[k]), float(found.std[k])) for k in at]


@pytest.mark.parametrize("written", CASES)
def test_an_effect_is_found_within_its_standard_deviations(written):
    found = identified(written, False)
    assert found.effects[-1] == asked_effects([written], found.robot)[0].effect
    assert not any("searched" in w for w in found.warnings)
    for (value, std), true in zip(
        coefficients(found, CASES[written]), CASES[written].values(), strict=True
    ):
        assert abs(value - true) < 3 * std
        assert std < 0.3 * abs(true)
    assert float(found.fit.relative_percent.max()) < 130 * NOISE


@pytest.mark.parametrize("written", quick_first(SEARCHED, 4))
def test_a_shape_that_is_not_given_is_searched(written):
    found = identified(written, True)
    true = asked_effects([written], found.robot)[0].effect
    assert any(true.name in w and "was searched" in w for w in found.warnings)
    assert found.effects[-1].identity == true.identity
    assert found.effects[-1].shape_values == pytest.approx(true.shape_values, rel=0.15, abs=0.1)
    assert float(found.fit.relative_percent.max()) < 130 * NOISE


def test_what_motions_cannot_show_is_left_out_and_said():
    robot = arm()
    log = driven(robot)
    still = log.replace(q=log.q.clone(), dq=log.dq.clone(), ddq=log.ddq.clone())
    for signal in (still.q, still.dq, still.ddq):
        signal[:, 0] = 0.0
    tau = nominal_torque(robot, Motion(still.q, still.dq, still.ddq))
    settings = replace(EXACT_MOTION, effects=("viscous_friction", "cogging:joint=1"))
    found = identify(robot, still.replace(tau=tau), settings=settings)
    assert [e.name for e in found.effects] == ["viscous_friction"] * 3
    assert any("left out" in w and "cogging of joint 1" in w for w in found.warnings)


@pytest.mark.nightly
def test_a_filter_and_two_searched_effects_of_one_joint():
    """With the automatic filter shapes and sizes are near the truth, and the fit is better than
    without them."""
    robot = arm(
        {
            "stribeck_friction:joint=2,vs=0.3": {"Fs": 0.8},
            "cogging:joint=2,k=9": {"a_s": 0.6, "a_c": 0.3},
        }
    )
    log = driven(robot)
    settings = Settings(effects=(*PLAIN, "stribeck_friction:joint=2", "cogging:joint=2"))
    found, without = (
        identify(robot, log, settings=replace(settings, effects=effects))
        for effects in (settings.effects, PLAIN)
    )
    stribeck, cogging = found.effects[-2:]
    assert cogging.k == pytest.approx(9, rel=0.02)
    assert 0.1 < stribeck.vs < 0.9
    assert found.fit.rmse[1] < 0.5 * without.fit.rmse[1]


def test_held_out_motion_goes_on_warming_up():
    """The end of a log is as warm as its beginning left it; a later log is warmer still."""
    written = "thermal_friction_drift:joint=1,T=20"
    robot = arm({written: CASES[written]})
    settings = replace(EXACT_MOTION, effects=(*PLAIN, written))
    log = driven(robot)
    later = driven(robot, seed=1, cold=40.0)
    after = identify(robot, log, held_out=later, settings=settings)
    assert float(after.held_out.relative_percent.max()) < 130 * NOISE
    cut = identify(robot, log.select(log.trajectory == 0), settings=replace(
        settings, held_out_fraction=0.3
    ))  # fmt: skip
    assert float(cut.held_out.relative_percent.max()) < 130 * NOISE


@pytest.mark.parametrize("written", CASES)
def test_it_predicts_and_is_exported(written):
    found = identified(written, False)
    plan = trajectory_log(random_trajectory(found.robot, 7, fill=True), 50.0)
    motion = Motion(plan.q, plan.dq, plan.ddq, t=plan.t)
    tau = nominal_torque(found.robot, motion)
    predicted = found.predict(*motion.state, t=motion.t)
    assert float((predicted - tau).norm() / tau.norm()) < 5 * NOISE
    exported = dynamics_of(found, found.robot)
    torch.testing.assert_close(exported.torque(motion), predicted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("written", ["stribeck_friction:joint=2,vs=0.3", next(iter(CASES))])
def test_it_is_read_back(written, tmp_path):
    found = identified(written, False)
    data = found.plain()
    entry = data["effects"][-1]
    assert set(entry) == {"effect", "joints", "parameters", "std", "places"}
    place = entry["places"][0]
    assert place["joint"] == found.effects[-1].joints[0] + 1
    for shape in found.effects[-1].shapes:
        assert place[shape.name] == getattr(found.effects[-1], shape.name)
    assert entry["parameters"].keys() == CASES[written].keys()
    assert set(data["effects"][0]) == {"effect", "joints", "parameters", "std"}
    write_json(data, tmp_path / "found.json")
    assert found.record.placed == found.effects
    read = read_base(tmp_path / "found.json", found.robot)
    assert read.effects == found.effects
    torch.testing.assert_close(read.values, found.values)
    with pytest.raises(TorchidError, match="the design of the next motion") as caught:
        prior_of(read_identification(tmp_path / "found.json"), found.robot, "a file")
    assert found.effects[-1].name in str(caught.value)


def test_time_and_past_are_asked_for():
    warm = identified("thermal_friction_drift:joint=1,T=20", False)
    dahl = identified("presliding_hysteresis:joint=2,length=0.1", False)
    state = [torch.zeros(3, dtype=torch.float64)] * 3
    with pytest.raises(TorchidError, match="needs the time"):
        warm.predict(*state)
    with pytest.raises(TorchidError, match="depends on the past"):
        dahl.predict(*state)


def test_a_name_alone_is_on_every_place_and_a_spring_shares_its_offset():
    robot = arm()
    found = asked_effects(
        ["gear_coupling:ratio=1", "torque_offset", "joint_spring:curvature=0"], robot
    )
    assert [a.effect.joints for a in found[:4]] == [(0, 1), (1, 0), (1, 2), (2, 1)]
    assert [a.effect.joints for a in found[4:]] == [(0,), (1,), (2,)] * 2
    effects = ("torque_offset", "joint_spring:joint=3,curvature=0")
    result = identify(robot, driven(robot), settings=replace(EXACT_MOTION, effects=effects))
    assert "F03 + c03" in result.base.names
    entry = result.plain()["effects"][-1]
    assert entry["parameters"]["c0"] == [None]
    assert abs(entry["parameters"]["k"][0]) < 5 * entry["std"]["k"][0]


def test_effects_of_two_kinds_may_have_coefficients_of_one_name():
    robot = arm()
    effects = ("cogging:joint=1,k=9", "position_dependent_friction:joint=1,k=2")
    result = identify(robot, driven(robot), settings=replace(EXACT_MOTION, effects=effects))
    assert {"cogging.a_s1", "position_dependent_friction.a_s1"} <= set(result.base.names)


REFUSED = [
    ("payload", "it is a body"),
    ("link_inertia:joint=2", "it is a body"),
    ("contact", "happened once"),
    ("dropped_samples", "happened once"),
    ("base_tilt", "trusted parameters"),
    ("encoder_offset:joint=1", "trusted parameters"),
    ("kinematic_error", "trusted parameters"),
    ("time_delay", "trusted parameters"),
    ("filter_lag", "trusted parameters"),
    ("joint_elasticity", "trusted parameters"),
    ("backlash", "trusted parameters"),
    ("torque_gain", "same as heavier bodies"),
    ("stiction", "unknown effect"),
    ("joint_spring:joint=4", "no such place"),
    ("gear_coupling:joint=1,source_joint=3", "no such place"),
    ("joint_spring:k=2", "is what is identified"),
    ("joint_spring:stiffness=2", "does not belong"),
    ("joint_spring:joint", "cannot be read"),
    ("joint_spring:joint=two", "not a number"),
    ("viscous_friction:joint=1,viscous_friction:joint=1", "named twice"),
]


@pytest.mark.parametrize(("written", "said"), REFUSED)
def test_what_cannot_be_identified_is_refused_with_the_reason(written, said):
    with pytest.raises(TorchidError, match=said):
        asked_effects(split_list(written), arm())


def test_every_effect_is_either_identified_or_refused():
    covered = {w.partition(":")[0] for w in CASES} | {
        "saturation",
        "drive_saturation",
        "torque_offset",
        "rotor_inertia",
    }
    refused = {name for name, kind in KINDS.items() if not_fitted(kind) is not None}
    assert covered | {*PLAIN} | refused == set(KINDS)


def test_a_shape_out_of_its_range_is_refused():
    with pytest.raises(RobotError, match="must be positive"):
        asked_effects(["stribeck_friction:vs=-1"], arm())


def test_the_truth_is_what_the_arm_lists():
    """The helper's arm: seven effects, of which the last is the case's."""
    written = "torque_crosstalk:joint=3,source_joint=2"
    assert [e.name for e, _ in nominal_effects(arm({written: CASES[written]}))][
        -1
    ] == "torque_crosstalk"
