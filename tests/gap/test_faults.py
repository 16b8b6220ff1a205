"""Faults that a diagnosis had, or could have: by the public functions alone, on small logs of the
3R whose gap is known."""

import json
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import torch

import torchid
from tests.gap.small_logs import (
    NOISE,
    ONCE,
    ROBOT,
    Recording,
    arm,
    friction,
    logged,
    true_motion,
)
from tests.gap.small_logs import carrying as loaded
from tests.marks import quick_first
from torchid.effects.base import Motion
from torchid.effects.registry import KINDS
from torchid.errors import TorchidError
from torchid.excitation.synthetic import nominal_torque, synthetic_log
from torchid.gap.settings import GapSettings
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import Robot
from torchid.simulation.sensors import Sensors, measured_log

pytestmark = pytest.mark.usefixtures("types_unchecked")

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")


def quick(*effects: str, **more: Any) -> GapSettings:
    return GapSettings(effects=effects or FRICTION, **more)


def diagnosed(robot: Robot, log: Log, settings: GapSettings) -> dict[str, Any]:
    """The record, as a program reads it, and `corrected` as a robot beside it."""
    found = torchid.diagnose(robot, log, settings=settings)
    return json.loads(json.dumps(found.plain())) | {"robot_": found.corrected}


def answered(call: Callable[[], Any]) -> Any:
    """What a call returns, or the message of the TorchidError that ends it; nothing else may."""
    try:
        return call()
    except TorchidError as error:
        return str(error)


def named(found: dict[str, Any]) -> set[tuple[str, tuple[int, ...]]]:
    return {(e["effect"], tuple(e["joints"])) for e in found["which"]}


# What is reported as closed belongs to what is answered.


def rms_left(corrected: Robot, how: Recording, log: Log, band: float) -> torch.Tensor:
    """(n,) RMS below `band` [Hz] of measured minus modelled torque, along the true motion, without
    the second that the filter loses at either end of a run."""
    assert log.tau is not None
    low, second = ZeroPhaseFilter(how.rate, band), round(how.rate)
    left = []
    for rows in log.slices():
        part = true_motion(how).select(rows)
        assert part.dq is not None
        motion = Motion(part.q, part.dq, part.ddq, t=part.t - part.t[0])
        error = (log.tau[rows] - nominal_torque(corrected, motion)).T.contiguous()
        left.append(low.apply(error)[:, second:-second])
    return torch.cat(left, 1).square().mean(1).sqrt()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("real", "how"),
    [
        (arm(friction(2, Fc=0.6)), Recording()),
        (arm(friction(1, Fv=0.6), friction(2, Fc=0.5)), Recording()),
        (ROBOT, Recording()),
        pytest.param(arm(friction(2, Fc=0.6)), Recording(runs=ONCE), marks=pytest.mark.slow),
    ],
    ids=["coulomb", "two effects", "nothing", "no repeats"],
)
def test_what_is_left_is_what_the_answered_model_leaves(real, how) -> None:
    log = logged(real, how)
    found = diagnosed(ROBOT, log, quick())
    left = rms_left(found["robot_"], how, log, found["band_hz"])
    said = torch.tensor([e["after"] for e in found["how_far"]["per_joint"]], dtype=torch.float64)
    # Left-out rows and rows near reversals differ; another model would leave several times this.
    assert said.tolist() == pytest.approx(left.tolist(), rel=0.25)


@pytest.mark.nightly
@pytest.mark.parametrize("hz", [None, 2.0])
@pytest.mark.slow
def test_an_empty_answer_closes_nothing(hz) -> None:
    """Friction that one run in three shows, at the size of the noise: folds may find what all rows
    together do not confirm."""
    weak = arm(friction(2, Fc=0.4 * NOISE), friction(3, Fv=0.4 * NOISE))
    found = diagnosed(ROBOT, logged(weak, Recording(runs=ONCE, colour_hz=hz)), quick())
    if found["answer"]["causes"]:
        assert all(e["how_sure"] >= 0.5 for e in found["which"])
        return
    assert (found["how_far"]["closed"] or 0.0) == pytest.approx(0.0, abs=1e-6)
    assert found["budget"]["structural"] == 0
    assert found["budget"]["parametric"] == 0
    for joint in found["how_far"]["per_joint"]:
        assert joint["after"] == pytest.approx(joint["before"], rel=1e-6)


# A simulator with too much of an effect.


def once_each(corrected: Robot) -> bool:
    kept = [(e["effect"], e["joint"]) for e in corrected.effects]
    return len(kept) == len(set(kept))


SIZES: dict[str, dict[str, float]] = {
    "viscous_friction": {"Fv": 1.0},
    "coulomb_friction": {"Fc": 1.0},
    "torque_offset": {"F0": 1.0},
    "joint_spring": {"k": 4.0, "c0": 0.0},
    "rotor_inertia": {"Ia": 0.5},
    "power_law_friction": {"F2": 1.0, "a": 2.0},
    "stribeck_friction": {"Fs": 1.0, "vs": 0.2},
    "asymmetric_friction": {"dF": 0.5, "dFv": 0.5},
    "cogging": {"a_s": 0.5, "a_c": 0.0, "k": 4.0},
}
CHEAP = ("viscous_friction",)


@pytest.mark.parametrize("share", [0.5, 1.5], ids=["too small", "too large"])
@pytest.mark.parametrize(
    "name", [n if n in CHEAP else pytest.param(n, marks=pytest.mark.nightly) for n in SIZES]
)
def test_too_large_by_half_is_named_as_surely_as_too_small(name, share) -> None:
    shapes = {s.name for s in KINDS[name].shapes}
    own = {"effect": name, "joint": 2}
    real = own | SIZES[name]
    simulated = own | {k: v if k in shapes else share * v for k, v in SIZES[name].items()}
    library = tuple(dict.fromkeys((name, *FRICTION)))
    # Alone, friction that differs by direction would drive the joint in one of them.
    dry = [friction(2, Fc=1.0), friction(2, Fv=1.0)]
    beside = dry if name == "asymmetric_friction" else []
    found = diagnosed(arm(simulated, *beside), logged(arm(real, *beside)), quick(*library))
    assert named(found) == {(name, (2,))}
    coefficient = next(iter(SIZES[name]))
    (only,) = found["which"]
    given = only["file"][coefficient]
    assert given == pytest.approx(share * SIZES[name][coefficient])
    assert (only["parameters"][coefficient] > given) == (share < 1)
    assert once_each(found["robot_"])


# Nothing raises but a TorchidError.


def planar(robot: Robot = ROBOT) -> Robot:
    """The 3R with its masses in the plane of joints 2 and 3: none of their motion is felt by the
    vertical joint 1."""
    pi = robot.require_parameters("a test").pi.clone()
    pi[:, 3] = 0.0  # m z
    pi[:, [6, 8]] = 0.0  # Jxz, Jyz
    return robot.with_parameters(InertialParameters(pi))


SCARA = """
name: scara
dh:
  convention: classical
  joints:
    - {type: R, a: 0.3, alpha: 0, d: 0, theta: 0}
    - {type: R, a: 0.25, alpha: 0, d: 0, theta: 0}
    - {type: P, a: 0, alpha: 0, d: 0, theta: 0}
parameters:
  mass: [3, 2, 1]
  com: [[-0.15, 0, 0], [-0.1, 0, 0], [0, 0, 0.1]]
  inertia_about_com:
    - [0.02, 0, 0, 0.03, 0, 0.03]
    - [0.02, 0, 0, 0.03, 0, 0.03]
    - [0.01, 0, 0, 0.01, 0, 0.005]
"""
"""Gravity and the third axis are along the first two: at rest these carry exactly nothing."""


@pytest.mark.parametrize(
    "still", quick_first([(0.0, 0.0, 1.0), (0.0, 1.0, 1.0)], 1), ids=["exactly", "rounding"]
)
def test_crosstalk_from_a_joint_without_torque(still, tmp_path) -> None:
    robot = planar()
    if still[1] == 0:
        path = tmp_path / "scara.yaml"
        path.write_text(SCARA)
        robot = torchid.load_robot(str(path))
    moved = true_motion(Recording())
    factor = 0.2 * torch.tensor(still, dtype=torch.float64)
    moved = moved.replace(**{k: v * factor for k, v in moved.signals.items()})
    true = synthetic_log(robot, moved)
    assert true.tau is not None
    assert float(true.tau[:, 0].abs().max()) < 1e-12
    log = measured_log(robot, true, [], Sensors(torque_std=NOISE), 0)
    found = diagnosed(robot, log, quick("torque_crosstalk", "coulomb_friction"))
    assert named(found) == set()


def standing(samples: int = 2000) -> Log:
    """The 3R held in one pose, as an encoder and a torque sensor see it."""
    t = torch.arange(samples, dtype=torch.float64) / 100
    q = torch.tensor([0.1, 0.4, -0.7], dtype=torch.float64).repeat(samples, 1)
    noise = torch.randn(samples, 3, generator=torch.Generator().manual_seed(0)).double()
    held = torch.zeros_like(q)
    return Log(t, q, tau=torchid.inverse_dynamics(ROBOT, q, held, held) + NOISE * noise)


SHAPED = arm(
    friction(2, Fc=0.8), {"effect": "stribeck_friction", "joint": 2, "Fs": 0.8, "vs": 0.1},
    {"effect": "power_law_friction", "joint": 1, "F2": 0.8, "a": 1.5},
)  # fmt: skip
"""A model with laws whose shapes no grid holds."""


@pytest.mark.parametrize("pushed", [False, True])
def test_of_an_arm_that_stands_no_law_of_its_model_is_named(pushed: bool) -> None:
    log = standing()
    noise = torch.randn(log.q.shape, generator=torch.Generator().manual_seed(1)).double()
    if pushed:
        push = tool_jacobian(ROBOT, log.q)[..., :3, :].mT @ torch.tensor([20.0, 10, -15]).double()
        log = log.replace(tau=log.tau + push * ((log.t > 8) & (log.t < 10)).double()[:, None])
    log = log.replace(q=log.q + 3e-5 * noise)
    found = answered(lambda: diagnosed(SHAPED, log, GapSettings()))
    if pushed:
        assert {e["effect"] for e in found["which"]} == {"contact"}
    else:
        assert "stands still" in found


def constant(log: Log, *joints: int) -> Log:
    assert log.tau is not None
    tau = log.tau.clone()
    tau[:, list(joints)] = 3.0
    return log.replace(tau=tau)


@pytest.mark.parametrize(
    "made",
    [
        lambda log: constant(log, 1),
        lambda log: constant(log, 0, 1, 2),
        lambda log: log.select(slice(0, 260)),
    ],
    ids=["one joint constant", "all constant", "two seconds"],
)
def test_what_is_not_looked_for_is_no_candidate_where_the_model_has_it(made) -> None:
    """Fails as of 0.3.0: the answer sorted what it could not see by a list that lacked it."""
    log = made(logged(arm(friction(2, Fc=0.8)), Recording(runs=(0, 1))))
    found = diagnosed(SHAPED, log, quick("coulomb_friction"))
    assert {e["effect"] for e in found["which"]} <= {"coulomb_friction"}
    assert {e["effect"] for e in found["not_testable"]} <= {"coulomb_friction"}


# Nothing is named beside the one clear effect.


@pytest.mark.nightly
@pytest.mark.parametrize("how", [Recording(), Recording(runs=ONCE)], ids=["repeats", "once"])
def test_a_ripple_of_two_per_mille_is_no_effect(how) -> None:
    """Coulomb friction of joint 2, and beside it a ripple of 0.2 % of the joint's torque."""
    real = arm(friction(2, Fc=1.0))
    log = logged(real, how)
    assert log.tau is not None
    size = 0.002 * float(log.tau[:, 1].square().mean().sqrt())
    ripple = torch.zeros_like(log.tau)
    ripple[:, 1] = size * torch.sin(40 * log.q[:, 1])
    settings = quick(*FRICTION, "backlash", "cogging", "thermal_friction_drift")
    found = diagnosed(ROBOT, log.replace(tau=log.tau + ripple), settings)
    assert named(found) == {("coulomb_friction", (2,))}


@pytest.mark.nightly
@pytest.mark.parametrize("hz", [None, 2.0], ids=["white", "coloured"])
def test_no_drift_at_the_end_of_its_range(hz) -> None:
    """Noise alone, and noise that wanders as a warming arm does."""
    real = arm(friction(1, Fc=0.5))
    settings = quick("thermal_friction_drift", "coulomb_friction")
    how = Recording(runs=ONCE, colour_hz=hz, seed=3)
    found = diagnosed(ROBOT, logged(real, how), settings)
    for entry in found["which"]:
        if entry["effect"] == "thermal_friction_drift":
            assert 5.0 * 1.01 < entry["parameters"]["T"] < 3 * how.duration


# What must not matter.

TWO = arm(friction(1, Fv=0.6), friction(2, Fc=0.5))


@cache
def plain() -> dict[str, Any]:
    return diagnosed(ROBOT, logged(TWO), quick())


def in_other_units(factor: float) -> tuple[Robot, Log]:
    """Masses, inertias, friction, and so torque and its noise, times a factor."""
    pi = ROBOT.require_parameters("a test").pi
    log = logged(TWO)
    assert log.tau is not None
    return (
        ROBOT.with_parameters(InertialParameters(factor * pi)),
        log.replace(tau=factor * log.tau),
    )


def cut_in_two() -> tuple[Robot, Log]:
    log = logged(TWO)
    half = log.trajectory < 2
    return ROBOT, Log.concatenate([log.select(half), log.select(~half)])


def later(seconds: float) -> tuple[Robot, Log]:
    log = logged(TWO)
    return ROBOT, log.replace(t=log.t + seconds)


def twice() -> tuple[Robot, Log]:
    """Every run appended once more: it is no news."""
    log = logged(TWO)
    return ROBOT, Log.concatenate([log, log])


CHANGES: dict[str, tuple[Callable[[], tuple[Robot, Log]], float]] = {
    "two files": (cut_in_two, 1.0),
    "a million seconds later": (lambda: later(1e6), 1.0),
    "newton metres times 1000": (lambda: in_other_units(1000.0), 1000.0),
    "every run twice": (twice, 1.0),
}
"""What is changed, and what coefficients are multiplied by."""


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_the_answer_does_not_change(name) -> None:
    change, factor = CHANGES[name]
    found = answered(lambda: diagnosed(*change(), quick()))
    if isinstance(found, str):
        # The same run twice says nothing about the noise: refusing it is an answer, too.
        assert name == "every run twice", found
        assert "twice" in found
        return
    assert (
        named(found) == named(plain()) == {("viscous_friction", (1,)), ("coulomb_friction", (2,))}
    )
    assert found["status"] == plain()["status"]
    by_name = {e["effect"]: e for e in found["which"]}
    for one in plain()["which"]:
        other = by_name[one["effect"]]
        for coefficient, std in one["std"].items():
            difference = other["parameters"][coefficient] / factor - one["parameters"][coefficient]
            assert abs(difference) < 2 * std, coefficient
            if name != "every run twice":
                assert other["std"][coefficient] / factor == pytest.approx(std, rel=0.3)


# A joint whose torque says nothing.


@pytest.mark.slow
@pytest.mark.parametrize("dead", [0.0, 0.5], ids=["zero", "noise"])
@pytest.mark.parametrize("runs", [ONCE, (0, 1, 2, 0)], ids=["once", "repeated"])
def test_nothing_is_told_of_a_joint_whose_torque_follows_no_motion(
    dead: float, runs: tuple[int, ...]
) -> None:
    """A model that predicts torque there has a large gap, of which no effect is the cause; what is
    told of the other joints stays."""
    log = logged(arm(friction(2, Fv=0.8)), Recording(runs=runs))
    assert log.tau is not None
    tau = log.tau.clone()
    tau[:, 2] = dead * torch.randn(len(tau), generator=torch.Generator().manual_seed(3))
    found = diagnosed(arm(friction(3, Fc=1.0)), log.replace(tau=tau), quick())
    assert named(found) == {("viscous_friction", (2,))}
    assert any("joint 3: neither the model nor any rigid body" in w for w in found["warnings"])
    reasons = {e["reason"] for e in found["not_testable"] if e["joints"] == [3]}
    assert reasons == {"the joint's torque holds no signal"}
    third = found["how_far"]["per_joint"][2]
    assert third["after"] == pytest.approx(third["before"])
    # All of it may be noise: as much as the repeats tell at least, and without repeats no less.
    low, high = third["noise_floor_rms"]
    assert low == pytest.approx(third["before"], rel=0.05 if high is None else 0.2)


def test_an_offset_under_a_load_has_its_size() -> None:
    """The load of the arm as it stands turns with its joint: a position read 0.05 rad too small,
    with two kilograms at the tip."""
    how = Recording(seed=3)
    true = true_motion(how)
    heavy = loaded(2.0, (0.3, 0.0, 0.0), 0.01)
    motion = Motion(true.q, true.dq, true.ddq, t=true.t)
    assert true.dq is not None
    assert true.ddq is not None
    g = torch.Generator().manual_seed(4)
    tau = nominal_torque(heavy, motion)
    tau = tau + NOISE * torch.randn(tau.shape, generator=g, dtype=tau.dtype)
    read = true.q - 0.05 * torch.eye(3, dtype=torch.float64)[1]
    log = true.replace(q=read, ddq=None, tau=tau)
    found = diagnosed(ROBOT, log, quick("payload", "encoder_offset", *FRICTION))
    sizes = {(e["effect"], tuple(e["joints"])): e["parameters"] for e in found["which"]}
    assert sizes["encoder_offset", (2,)]["offset"] == pytest.approx(0.05, rel=0.03)
    assert sizes["payload", (1, 2, 3)]["mx"] == pytest.approx(0.6, rel=0.03)


def test_torque_in_percent_of_its_rating_is_a_gain_of_each_joint():
    """Twice and five times the size is no other body."""
    scale = torch.tensor([2.0, 10 / 3, 5.0], dtype=torch.float64)
    log = logged(ROBOT)
    log = log.replace(tau=log.tau * scale)
    found = torchid.diagnose(ROBOT, log, settings=quick("torque_gain", *FRICTION))
    assert {(f.effect, f.joints) for f in found.which} == {("torque_gain", (j,)) for j in range(3)}
    gains = {f.joints[0]: f.sizes[0].value for f in found.which}
    assert [gains[j] for j in range(3)] == pytest.approx((scale - 1).tolist(), rel=0.03)


def test_an_effort_that_is_no_torque_names_nothing():
    """Where most joints' torque is not the model's, friction of the last one is no cause."""
    how = Recording(runs=ONCE)
    log, speed = logged(ROBOT, how), true_motion(how).dq
    assert speed is not None
    other = torch.stack([0.3 * log.q[:, 0], 0.2 * log.q[:, 1], 2.0 * speed[:, 2]], -1)
    found = torchid.diagnose(ROBOT, log.replace(tau=other), settings=quick(), force=True)
    assert found.status == "detected_unexplained"
    assert found.which == ()
