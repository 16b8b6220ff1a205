"""What a careless log or fit must not get away with silently."""

from dataclasses import replace

import pytest
import torch

from torchid.errors import LogError
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.base_parameters import physical_signs
from torchid.identification.identify import Settings, identify
from torchid.identification.result import findings
from torchid.identification.tuning import CutoffChoice
from torchid.log.checks import check_log
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.yaml_file import from_mapping

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
QUICK = Settings(effects=FRICTION, cutoff=8.0, reversal=0.0)
ROBOT = load_robot("3r_friction")


def motion(seed: int = 0, rate: float = 100.0, **options: float) -> Log:
    return trajectory_log(random_trajectory(ROBOT, seed, fill=True, **options), rate)


def with_pauses(log: Log) -> Log:
    """The motion with a pause as long as itself at its end."""
    still = log.select(slice(log.samples - 1, log.samples))
    times = torch.arange(1, log.samples, dtype=torch.float64) * 0.01 + log.t[-1]
    hold = {name: x.expand(len(times), -1) for name, x in still.signals.items()}
    hold["dq"] = hold["ddq"] = torch.zeros(len(times), 3, dtype=torch.float64)
    signals = {name: torch.cat([x, hold[name]]) for name, x in log.signals.items()}
    zero = torch.zeros(log.samples + len(times), dtype=torch.int64)
    return log.replace(t=torch.cat([log.t, times]), trajectory=zero, **signals)


def test_friction_of_a_joint_that_rests_is_said_to_be_biased():
    """At rest the simulator has no Coulomb friction; rows at rest pull Fc down."""
    log = synthetic_log(ROBOT, with_pauses(motion()), HonestNoise(), 0)
    all_rows = identify(ROBOT, log, settings=replace(QUICK, rows="all"))
    (warning,) = (w for w in all_rows.warnings if "biased" in w)
    assert '`rows="moving"`' in warning
    moving = identify(ROBOT, log, settings=QUICK)
    assert not any("biased" in w or w.startswith("fit: rows at rest") for w in moving.warnings)
    fc = [moving.base.names.index(f"Fc{j}") for j in (1, 2, 3)]
    truth = torch.tensor([0.245, 0.1523, 0.1827], dtype=torch.float64)
    assert float((moving.values[fc] / truth - 1).abs().max()) < 0.05
    assert float((all_rows.values[fc] / truth - 1).abs().max()) > 0.05


@pytest.mark.slow
def test_what_one_stretch_determines_is_named_and_not_overconfident():
    """Joint 3 moves for a tenth of a second of twenty: its friction hangs on one block of 120."""
    plan = motion()
    start, stop = 902, 914
    q3 = plan.q[:, 2].clone()
    q3[:start], q3[stop:] = q3[start], q3[stop - 1]
    inside = torch.zeros(plan.samples, dtype=torch.float64)
    inside[start:stop] = 1.0
    once = plan.replace(
        q=torch.cat([plan.q[:, :2], q3[:, None]], 1),
        dq=torch.cat([plan.dq[:, :2], (plan.dq[:, 2] * inside)[:, None]], 1),
        ddq=torch.cat([plan.ddq[:, :2], (plan.ddq[:, 2] * inside)[:, None]], 1),
    )
    estimates, stds = [], []
    for seed in range(12):
        log = synthetic_log(ROBOT, once, HonestNoise(include_velocity=True), seed)
        found = identify(ROBOT, log, settings=replace(QUICK, cutoff=None, signs="free"))
        k = found.base.names.index("Fv3")
        estimates.append(float(found.values[k]))
        stds.append(float(found.std[k]))
        assert any("one short stretch" in w and "Fv3" in w for w in found.warnings)
    spread = float(torch.tensor(estimates, dtype=torch.float64).std())
    assert float(torch.tensor(stds, dtype=torch.float64).median()) > 0.5 * spread


def test_a_velocity_that_contradicts_position_is_not_used():
    log = synthetic_log(ROBOT, motion(), HonestNoise(include_velocity=True), 0)
    noise = torch.randn(
        log.samples, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    wrong = log.replace(dq=noise)
    found = identify(ROBOT, wrong, settings=QUICK)
    assert any("so the derivative is used" in w for w in found.warnings)
    assert float(found.fit.relative_percent.max()) < 2.0


def test_a_clock_that_is_off_is_refused():
    log = synthetic_log(ROBOT, motion(), HonestNoise(include_velocity=True), 0)
    with pytest.raises(LogError, match="every measured velocity is 20 times"):
        identify(ROBOT, log.replace(t=log.t * 20), settings=QUICK)


def test_a_sum_is_not_reported_under_one_name():
    """A vertical slider: its offset and its weight are one number."""
    slider = from_mapping(
        {
            "name": "slider",
            "dh": {"convention": "classical", "joints": [{"type": "P"}]},
            "limits": {"position": [1], "velocity": [1], "acceleration": [2]},
        },
        "slider",
    )
    mass = torch.tensor([[2.0, 0, 0, 0, 0.01, 0, 0, 0.01, 0, 0.01]], dtype=torch.float64)
    slider = slider.with_parameters(InertialParameters(mass))
    plan = trajectory_log(random_trajectory(slider, 0, fill=True), 100.0)
    log = synthetic_log(slider, plan, HonestNoise(), 0)
    settings = Settings(effects=("rotor_inertia", "torque_offset"), cutoff=8.0)
    data = identify(slider, log, settings=settings).plain()
    listed = [name for e in data["effects"] for name, v in e["parameters"].items() if v]
    named = [p["name"] for p in (*data["parameters"], *data["combined"])]
    for name in listed:
        assert not any(name in other and other != f"{name}1" for other in named)
    assert sorted(data["base_names"]) == sorted(
        [*(p["name"] for p in data["parameters"]), *(p["name"] for p in data["combined"]),
         *(f"{name}1" for name in listed)]
    )  # fmt: skip


@pytest.mark.parametrize("what", ["wrapped", "glued"])
def test_jumps_of_position_are_named(what):
    log = synthetic_log(ROBOT, motion(), HonestNoise(), 0)
    q = log.q.clone()
    if what == "wrapped":
        q[700:, 1] -= 2 * torch.pi
    else:
        q[700:] = q[700:] + 0.3
    warnings = check_log(log.replace(q=q), n=3, robot_name="3r")
    assert any("q2 jumps" in w and "t = 6.99" in w for w in warnings)
    assert check_log(log, n=3, robot_name="3r") == ()


def test_a_torque_in_another_unit_is_noticed():
    limits = torch.tensor([[-50.0, 50.0]] * 3, dtype=torch.float64)
    robot = replace(ROBOT, limits=replace(ROBOT.limits, torque=limits))
    log = synthetic_log(ROBOT, motion(), HonestNoise(), 0)
    assert not any("another unit" in w for w in identify(robot, log, settings=QUICK).warnings)
    milli = identify(robot, log.replace(tau=log.tau * 1000), settings=QUICK)
    assert any("another unit" in w for w in milli.warnings)


def test_a_useless_model_is_called_so():
    log = synthetic_log(ROBOT, motion(), HonestNoise(), 0)
    swapped = log.replace(tau=log.tau[:, [1, 0, 2]])
    found = identify(ROBOT, swapped, settings=QUICK)
    assert any("unexplained on joint" in w for w in found.warnings)
    good = identify(ROBOT, log, settings=QUICK)
    assert not any("unexplained" in w for w in good.warnings)


@pytest.fixture(scope="module")
def quick():
    return identify(ROBOT, synthetic_log(ROBOT, motion(), HonestNoise(), 0), settings=QUICK)


def test_values_that_no_body_has_are_named(quick):
    assert not any("no body" in w for w in findings(quick))
    k = int(physical_signs(quick.base, quick.effects).argmax())
    name = quick.base.names[k]
    assert k < quick.base.n_rigid
    std = float(quick.std[k])
    for value, said in ((-10 * std, True), (-0.1 * std, False)):
        values = quick.values.clone()
        values[k] = value
        found = [w for w in findings(replace(quick, values=values)) if "no body" in w]
        assert bool(found) == said
        assert all(f"{name} = " in w and "never negative" in w for w in found)


@pytest.mark.parametrize(
    ("cutoff", "scores", "said"),
    [(8.0, (9.0, 8.0, 7.0), True), (6.0, (9.0, 7.0, 8.0), False), (None, (9.0, 8.0, 7.0), False)],
)
def test_the_highest_cutoff_tried_is_said_to_be_it(quick, cutoff, scores, said):
    choice = CutoffChoice((4.0, 6.0, 8.0), scores, cutoff=cutoff)
    found = findings(replace(quick, cutoff_choice=choice))
    assert any("highest that was tried" in w for w in found) == said
