"""From a robot and its logs to base parameters: the whole job."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pytest
import torch

from tests.arms import arm as known_arm
from tests.identification.test_paper_tables import plan, true_parameters
from tests.identification.test_rows import a_log, arm
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import IdentificationError, LogError, TorchidError
from torchid.excitation.synthetic import HonestNoise, nominal_torque, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.export.dynamics import of_base
from torchid.identification.identify import Identification, Settings, identify
from torchid.identification.settings import Method
from torchid.identification.values import read_base
from torchid.json_data import write_json
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Limits, Robot

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
# The report's LWR has a negative Fv6.
EXACT = Settings(cutoff=None, reversal=0.0, method="ols", signs="free", effects=FRICTION)
QUICK = Settings(cutoff=5.0, reversal=0.0)
ROBOT = load_robot("3r_friction")


def effects_of(robot: Robot, names=FRICTION) -> tuple[str, ...]:
    return names if robot.effects else ()


@lru_cache
def honest(name: str = "3r_friction", seed: int = 0, rate: float = 200.0) -> Log:
    robot = load_robot(name)
    trajectory = trajectory_log(random_trajectory(robot, seed, count=3, fill=True), rate)
    return synthetic_log(robot, trajectory, HonestNoise(), seed)


def truth(found: Identification) -> torch.Tensor:
    """The robot's nominal parameters in the base parameters of an identification."""
    robot = found.robot
    nominal = dict(nominal_effects(robot))
    values = [v for e in found.effects for v in nominal.get(e, [0.0])]
    rigid = robot.parameters.to_paper_order()
    return found.base.project(torch.cat([rigid, torch.tensor(values, dtype=torch.float64)]))


@pytest.mark.parametrize("name", ["3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction"])
def test_without_noise_the_parameters_are_recovered_to_rounding(name):
    robot = load_robot(name)
    log = synthetic_log(robot, plan(robot))
    found = identify(robot, log, settings=replace(EXACT, effects=effects_of(robot)))
    expected = found.base.project(true_parameters(robot))
    assert float((found.values - expected).abs().max()) <= 1e-11
    assert bool(found.free.all())
    assert float(found.fit.relative_percent.max()) < 1e-9
    assert found.cutoff is None


@lru_cache
def by_default(name: str, seed: int) -> Identification:
    settings = Settings(signs="free" if name == "kuka_lwr4_friction" else "bounded")
    rate = 100.0 if name == "kuka_lwr4_friction" else 200.0
    return identify(load_robot(name), honest(name, seed, rate), settings=settings)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "seed"), [("3r", 0), ("3r", 1), ("3r_friction", 0), ("kuka_lwr4_friction", 0)]
)
def test_with_honest_noise_and_default_settings_the_truth_is_near(name, seed):
    """Of the rigid body and the effects that the robot has; what it has not is 0. The report's LWR
    has a negative Fv6, so there the signs are free."""
    found = by_default(name, seed)
    known = found.free
    error = ((found.values - truth(found))[known] / found.std[known]).abs()
    assert float(error.max()) < 5
    assert float(error.square().mean().sqrt()) < 1.6
    assert found.cutoff is not None
    assert 1 <= found.cutoff <= 40
    assert found.cutoff_choice is not None
    assert float(found.fit.relative_percent.max()) < 5


def with_effects(values: dict[str, list[float]]) -> Robot:
    """The 3R with other friction."""
    keys = {"viscous_friction": "Fv", "coulomb_friction": "Fc", "torque_offset": "F0"}
    records = tuple(
        {"effect": effect, "joint": j + 1, key: values[key][j]}
        for effect, key in keys.items()
        if key in values
        for j in range(3)
    )
    return replace(ROBOT, effects=records)


NEGATIVE = with_effects({"Fv": [0.07, -0.2, 0.04], "Fc": [0.2, 0.15, 0.18], "F0": [0.0, 0.1, 0.0]})


def negative_log() -> Log:
    plan_ = trajectory_log(random_trajectory(ROBOT, 3, count=2, fill=True), 200.0)
    return synthetic_log(NEGATIVE, plan_, HonestNoise(), 3)


def test_a_negative_friction_is_bounded_and_said():
    found = identify(NEGATIVE, negative_log(), settings=QUICK)
    assert "Fv2" in found.bounded
    k = found.base.names.index("Fv2")
    assert float(found.values[k]) == 0.0
    assert not bool(found.free[k])
    assert float(found.std[k]) == 0.0
    assert any("set to 0" in w and "Fv2" in w for w in found.warnings)
    assert found.wrong_sign == ()


def test_a_negative_friction_is_found_and_said_if_signs_are_free():
    found = identify(NEGATIVE, negative_log(), settings=replace(QUICK, signs="free"))
    assert "Fv2" in found.wrong_sign
    assert found.bounded == ()
    k = found.base.names.index("Fv2")
    assert float(found.values[k]) == pytest.approx(-0.2, abs=5 * float(found.std[k]))
    assert any("which physics forbids, and kept" in w and "Fv2" in w for w in found.warnings)


@pytest.mark.slow
def test_essential_parameters_drop_what_is_zero():
    robot = with_effects({"Fv": [0.07, 0.2, 0.04], "Fc": [0.2, 0.15, 0.18]})
    log = synthetic_log(
        robot, trajectory_log(random_trajectory(robot, 3, count=3, fill=True), 200.0),
        HonestNoise(), 3,
    )  # fmt: skip
    settings = replace(QUICK, signs="free", essential=True)
    found = identify(robot, log, settings=settings)
    zero = {"F01", "F02", "F03", "Ia3"}
    assert len(zero & set(found.dropped)) >= 3
    assert not {"Fv1", "Fv2", "Fv3", "Fc1", "Fc2", "Fc3"} & set(found.dropped)
    assert any("not distinguishable from 0" in w for w in found.warnings)
    kept = found.free
    ratio = found.values[kept].abs() / found.std[kept]
    assert float(ratio.min()) > found.uncertainty.quantile()
    assert bool((found.values[~kept] == 0).all())
    whole = identify(robot, log, settings=replace(settings, essential=False))
    assert float((found.fit.rmse / whole.fit.rmse).max()) < 1.02


def test_a_held_out_share_is_the_end_of_each_trajectory():
    log = honest()
    early, late = log.split(0.6, gap_s=0.0)
    share = identify(ROBOT, log, settings=replace(QUICK, held_out_fraction=0.4))
    apart = identify(ROBOT, early, held_out=late, settings=QUICK)
    assert torch.allclose(share.values, apart.values, rtol=1e-10)
    assert torch.allclose(share.held_out.rmse, apart.held_out.rmse, rtol=1e-10)
    assert share.held_out.trajectories == log.names
    assert len(share.held_out_predictions) == 3
    none = identify(ROBOT, early, settings=QUICK)
    assert none.held_out is None
    assert none.held_out_predictions == ()
    assert torch.allclose(none.values, apart.values, rtol=1e-10)


@pytest.mark.parametrize("fraction", [-0.1, 1.0, 1.5])
def test_a_held_out_share_lies_between_0_and_1(fraction):
    with pytest.raises(TorchidError, match="held-out fraction"):
        replace(QUICK, held_out_fraction=fraction)


def test_errors_under_another_filter():
    log, new = honest().split(0.6)
    same, other, explicit = (
        identify(ROBOT, log, held_out=new, settings=replace(QUICK, error_cutoff=f))
        for f in (None, 20.0, 5.0)
    )
    torch.testing.assert_close(same.values, other.values, rtol=1e-12, atol=1e-12)
    assert bool((other.held_out.rmse > same.held_out.rmse).all())
    assert torch.allclose(explicit.fit.rmse, same.fit.rmse)
    assert torch.allclose(explicit.held_out.rmse, same.held_out.rmse)


def test_trajectories_of_different_rates():
    log = a_log(ROBOT, rates=(100.0, 250.0, 400.0), durations=(20.0, 12.0, 10.0),
                noise=HonestNoise(encoder_step=1e-6))  # fmt: skip
    found = identify(ROBOT, log, settings=QUICK)
    error = ((found.values - truth(found)) / found.std)[found.free]
    assert float(error.abs().max()) < 5
    assert len(found.fit.trajectories) == 3


@pytest.mark.slow
def test_currents_times_gains():
    log = honest()
    gain = torch.tensor([10.0, 5.0, 2.0], dtype=torch.float64)
    amps = log.replace(tau=None, current=log.tau / gain)
    expected = identify(ROBOT, log, settings=QUICK).values
    geared = replace(ROBOT, drive_gain=gain)
    assert torch.allclose(identify(geared, amps, settings=QUICK).values, expected, rtol=1e-8)
    apart = identify(ROBOT, amps.with_torque(gain), settings=QUICK)
    assert torch.allclose(apart.values, expected, rtol=1e-8)
    early, late = amps.split(0.6)
    newton = [part.with_torque(gain) for part in (early, late)]
    both = identify(geared, early, held_out=late, settings=QUICK).held_out
    assert torch.allclose(
        both.rmse, identify(ROBOT, newton[0], held_out=newton[1], settings=QUICK).held_out.rmse
    )
    with pytest.raises(LogError, match="no torque"):
        identify(ROBOT, amps, settings=QUICK)


@pytest.mark.slow
def test_prediction_and_residual():
    found = by_default("3r_friction", 0)
    motion = Motion(*(torch.randn(4, 5, 3, dtype=torch.float64) for _ in range(3)))
    expected = nominal_torque(ROBOT, motion)
    got = found.predict(*motion.state)
    assert got.shape == (4, 5, 3)
    assert float((got - expected).abs().max()) < 0.05 * float(expected.abs().max())
    torch.testing.assert_close(
        found.residual(*motion.state, expected), expected - got, rtol=1e-12, atol=1e-12
    )
    one = found.predict(*(x[1, 2] for x in motion.state))
    assert torch.allclose(one, got[1, 2])


@pytest.mark.slow
def test_combinations():
    found = by_default("3r_friction", 0)
    for k in (0, 3, len(found.base) - 1):
        value, std = found.combination(found.base.grouping[k])
        assert value == pytest.approx(float(found.values[k]))
        assert std == pytest.approx(float(found.std[k]))
    two = found.base.grouping[0] - 2 * found.base.grouping[4]
    value, std = found.combination(two)
    v = found.covariance
    assert value == pytest.approx(float(found.values[0] - 2 * found.values[4]))
    assert std == pytest.approx(float((v[0, 0] + 4 * v[4, 4] - 4 * v[0, 4]).sqrt()))
    alone = torch.zeros(len(found.base.parameter_names), dtype=torch.float64)
    alone[found.base.parameter_names.index("m2")] = 1.0
    with pytest.raises(TorchidError, match="does not determine this combination"):
        found.combination(alone)


def test_a_combination_of_what_the_log_does_not_determine():
    """Its value 0 is a choice, not knowledge."""
    q = honest().q.clone()
    q[:, 1] = 0.3
    found = identify(ROBOT, honest().replace(q=q), settings=QUICK)
    k = found.base.names.index("Fv2")
    assert "Fv2" in found.undetermined
    with pytest.raises(TorchidError, match="this log does not determine"):
        found.combination(found.base.grouping[k])


@pytest.mark.slow
def test_intervals():
    found = by_default("3r_friction", 0)
    wide, narrow = found.interval(0.99), found.interval(0.5)
    assert torch.allclose(wide.mean(1), found.values)
    assert bool((wide[found.free, 0] < narrow[found.free, 0]).all())
    half = found.uncertainty.quantile(0.95) * found.std
    assert torch.allclose(found.interval()[:, 1] - found.values, half)
    percent = 100 * found.std / found.values.abs()
    assert torch.allclose(found.relative_std_percent[found.free], percent[found.free])


@pytest.mark.parametrize("method", ["ols", "wls", "huber"])
@pytest.mark.parametrize("covariance", ["diagonal", "full"])
@pytest.mark.parametrize("rows", ["all", "moving"])
def test_every_setting_finds_the_truth(method, covariance, rows):
    settings = replace(QUICK, method=method, covariance=covariance, rows=rows)
    found = identify(ROBOT, honest(), settings=settings)
    error = ((found.values - truth(found)) / found.std)[found.free]
    assert float(error.abs().max()) < 5


def test_prismatic_joints():
    robot = arm("RPRP")
    log = a_log(robot, rates=(200.0,), noise=HonestNoise(encoder_step=1e-6))
    found = identify(robot, log, settings=replace(QUICK, effects=()))
    error = ((found.values - truth(found)) / found.std)[found.free]
    assert float(error.abs().max()) < 5
    assert found.base.units[0] == "kg"


# --- bad input


def test_a_robot_without_limits_and_parameters():
    bare = replace(ROBOT, limits=Limits(), parameters=None, effects=())
    found = identify(bare, honest(), settings=QUICK)
    torch.testing.assert_close(
        found.values, identify(ROBOT, honest(), settings=QUICK).values, rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rows": "some"}, "rows"),
        ({"method": "lasso"}, "method"),
        ({"covariance": "banded"}, "covariance"),
        ({"signs": "positive"}, "signs"),
        ({"cutoff": "low"}, "cut-off"),
        ({"reversal": "slow"}, "reversal"),
        ({"reversal": -0.1}, "reversal"),
    ],
)
@pytest.mark.usefixtures("types_unchecked")
def test_unknown_choices_are_refused(change, message):
    with pytest.raises(TorchidError, match=message):
        Settings(**change)


# --- coverage of the intervals


def hardly_moving(amplitude: float) -> Log:
    """The 3R swinging by so little about a bent pose, with torque noise of 0.02 N m."""
    robot = load_robot("3r")
    t = torch.arange(3000, dtype=torch.float64) / 100
    w = torch.tensor([1.9, 2.7, 3.3], dtype=torch.float64)
    pose = torch.tensor([0.0, 0.3, 0.5], dtype=torch.float64)
    angle = t.unsqueeze(1) * w
    q = pose + amplitude * torch.sin(angle)
    dq, ddq = amplitude * w * torch.cos(angle), -amplitude * w**2 * torch.sin(angle)
    noise = torch.randn(q.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return Log(t, q, dq=dq, ddq=ddq, tau=inverse_dynamics(robot, q, dq, ddq) + 0.02 * noise)


@pytest.mark.parametrize("method", ["ols", "huber"])
@pytest.mark.parametrize("name", ["3r_friction", "ur10e", "panda"])
def test_both_bases_have_the_same_torque(name: str, method: Method, tmp_path: Path) -> None:
    """On the log, and on any other motion; the basis goes with the result's file."""
    robot = known_arm(name)
    plan = trajectory_log(random_trajectory(robot, 1, fill=True), 50.0)
    log = synthetic_log(robot, plan, HonestNoise(include_velocity=True), 0)
    settings = Settings(cutoff=5.0, reversal=0.0, method=method, signs="free")
    report, conditioned = (
        identify(robot, log, settings=replace(settings, basis=basis, held_out_fraction=0.3))
        for basis in ("report", "conditioned")
    )
    motion = torch.randn(3, 40, robot.n, dtype=torch.float64)
    one, two = report.predict(*motion), conditioned.predict(*motion)
    assert report.undetermined == report.bounded == ()
    assert float((one - two).abs().max() / one.abs().max()) < 1e-9
    assert report.held_out is not None
    assert conditioned.held_out is not None
    for field in ("rmse", "relative_percent", "relative_percent_moving", "relative_percent_raw"):
        errors = (getattr(r.held_out, field) for r in (report, conditioned))
        torch.testing.assert_close(*errors, rtol=1e-9, atol=0)
    # The same estimate, and as sure: of any combination of parameters, in either basis.
    for result, other in ((report, conditioned), (conditioned, report)):
        for k in range(len(other.base)):
            value, std = result.combination(other.base.grouping[k])
            assert value == pytest.approx(float(other.values[k]), rel=1e-6, abs=1e-7)
            assert std == pytest.approx(float(other.std[k]), rel=1e-6)
        path = tmp_path / f"{result.base.basis}.json"
        write_json(result.plain(), path)
        read = read_base(path, robot)
        assert (read.base.basis, read.base.names) == (result.base.basis, result.base.names)
        assert torch.allclose(of_base(robot, read).torque(Motion(*motion)), one, rtol=1e-9)
    assert conditioned.scaled_condition_number < 0.5 * report.scaled_condition_number


def test_rows_at_rest_are_left_out_by_default() -> None:
    assert Settings().rows == "moving"
    found = by_default("3r_friction", 0)
    assert found.settings.rows == "moving"
    shown = found.fit
    assert torch.equal(shown.judged("moving"), shown.relative_percent_moving)
    assert torch.equal(shown.judged("all"), shown.relative_percent)


@pytest.mark.slow
def test_a_fit_that_is_lost_in_rounding_is_refused() -> None:
    """Not a mass of 20 million kilograms with its standard deviation."""
    settings = Settings(cutoff=None, rows="all")
    with pytest.raises(IdentificationError, match="lost in rounding") as caught:
        identify(load_robot("3r"), hardly_moving(1e-3), settings=settings)
    assert "0.002" in str(caught.value)
    found = identify(load_robot("3r"), hardly_moving(0.5), settings=settings)
    assert found.scaled_condition_number < 1e4


def test_a_joint_without_a_torque_sensor_is_not_fitted():
    log = honest()
    silent = log.tau.clone()
    silent[:, 0] = 0.0
    found = identify(ROBOT, log.replace(tau=silent), settings=QUICK)
    whole = identify(ROBOT, log, settings=QUICK)
    assert any("joint 1 has no torque" in said for said in found.warnings)
    assert not any("inf" in said for said in found.warnings)
    worst = [float(f.fit.relative_percent[1:].max()) for f in (found, whole)]
    assert worst[0] < 1.05 * worst[1]
