"""A simulator's log against the arm's: clocks, faults of the set-up, effects of one side. The whole
withheld suite is torchid_bench.benchmarks.pairs."""

import runpy
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

import torchid
from tests.gap.small_logs import carrying
from tests.marks import some
from torchid.effects.motion import Motion
from torchid.effects.transient import Contact
from torchid.errors import TorchidError
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.settings import GapSettings
from torchid.log.filtering import central_difference, low_passed
from torchid.log.model import Log
from torchid.pair.align import aligned_trajectories
from torchid.pair.pair import compare_pair
from torchid.robot.library import load_robot
from torchid.simulation.sensors import Sensors, measured_log

FEW = GapSettings(effects=("coulomb_friction", "viscous_friction", "torque_offset"))
LOADS = GapSettings(effects=("payload", "link_inertia", "coulomb_friction"))
KP = torch.tensor([400.0, 900.0, 300.0], dtype=torch.float64)
KD = torch.tensor([20.0, 40.0, 15.0], dtype=torch.float64)


@cache
def log(
    effects: tuple[str, ...] = (), gain: float = 1.0, noise: float = 0.02, seed: int = 0
) -> Log:
    """The 3R along a motion, with commands that a servo of gains KP would need for it."""
    robot = load_robot("3r")
    records = {
        "Fc": {"effect": "coulomb_friction", "joint": 2, "Fc": 0.8},
        "all": [{"effect": "coulomb_friction", "joint": j + 1, "Fc": 0.5} for j in range(3)],
        "rotors": [{"effect": "rotor_inertia", "joint": j + 1, "Ia": 0.3} for j in range(3)],
    }
    parts = [records[e] if isinstance(records[e], list) else [records[e]] for e in effects]
    arm = replace(robot, effects=tuple(e for part in parts for e in part))
    motion = trajectory_log(random_trajectory(robot, 3, duration=10.0, fill=True), 200.0)
    true = synthetic_log(arm, motion)
    out = measured_log(arm, true, [], Sensors(torque_std=noise), seed=seed)
    assert true.tau is not None
    assert true.dq is not None
    return out.replace(u=out.q + (true.tau + KD * true.dq) / KP)


def clipped(one: Log) -> Log:
    """Torque of joint 2 clipped at 0.6 of its largest."""
    assert one.tau is not None
    limit = torch.full((3,), torch.inf, dtype=torch.float64)
    limit[1] = 0.6 * one.tau[:, 1].max()
    return one.replace(tau=one.tau.minimum(limit))


def names(found) -> list[tuple[str, tuple[int, ...]]]:
    return [(f.fault, f.joints) for f in found.faults]


def swapped(one: Log) -> Log:
    """Joints 1 and 2 in each other's place."""
    return one.replace(q=one.q[:, [1, 0, 2]], tau=one.tau[:, [1, 0, 2]])


def changed(one: Log, **signals: torch.Tensor) -> Log:
    return one.replace(**signals)


def test_clocks_of_another_start_and_rate_are_found():
    one = log()
    later = one.select(slice(150, 1900)).replace(t=one.t[150:1900] * 0.5 + 77.0)
    both = aligned_trajectories(later, one)[0]
    assert both.clock.rate == pytest.approx(0.5, rel=1e-4)
    assert both.clock.start_s == pytest.approx(-0.5 * 0.75, abs=2e-3)
    left = both.real["q"] - both.simulated["q"]
    assert float(left.abs().max()) < 1e-3


@pytest.mark.parametrize("rate", [1.013, 0.73, 1.6, 4.0])
@pytest.mark.parametrize("rows", [slice(None), slice(200, 1700)])
def test_a_clock_of_any_rate_is_found(rate, rows):
    one = log()
    part = one.select(rows)
    (both,) = aligned_trajectories(part.replace(t=rate * part.t), one)
    assert both.clock.rate == pytest.approx(rate, rel=1e-4)


@pytest.mark.slow
def test_equal_logs_differ_by_nothing():
    found = compare_pair(log(seed=1, noise=1e-4), log(), load_robot("3r"), settings=FEW)
    assert not found.faults
    assert found.which == ()
    assert found.record.which == ()
    assert all(r.p > 0.01 for r in found.record.torque.regimes)
    for one in found.record.torque.joints:
        assert one.rms < 2 * one.noise


@pytest.mark.parametrize(
    ("simulated", "answer"),
    [
        (swapped, ("joint_order", (0, 1))),
        (lambda x: changed(x, q=x.q * torch.tensor([1, 1, -1])), ("sign", (2,))),
        (lambda x: changed(x, tau=x.tau * torch.tensor([1, -1, 1])), ("sign", (1,))),
        (lambda x: x.replace(t=2 * x.t), ("time_step", ())),
        (lambda x: changed(x, u=x.u[torch.arange(x.samples) // 8 * 8]), ("held_control", ())),
        (clipped, ("clipped", (1,))),
        (lambda x: changed(x, tau=x.tau / 57.29578), ("gain_units", (0, 1, 2))),
        (lambda x: changed(x, tau=3.0 * x.tau), ("servo_gain", (0, 1, 2))),
    ],
)  # fmt: skip
def test_faults_of_the_set_up_without_a_model(simulated, answer):
    found = compare_pair(simulated(log(noise=1e-4)), log())
    assert names(found)[0] == answer
    assert found.record.which is None
    assert any("mend" in w for w in found.record.warnings)


@pytest.mark.slow
def test_gravity_that_the_simulator_lacks():
    robot, arm = load_robot("3r"), log(("all", "rotors"))
    clean, zero = log(("all", "rotors"), noise=1e-4), torch.zeros_like(arm.q)
    floating = clean.replace(tau=clean.tau - torchid.inverse_dynamics(robot, clean.q, zero, zero))
    # The servo's law is another question.
    found = compare_pair(floating.replace(u=None), arm.replace(u=None), robot)
    assert names(found) == [("gravity_compensation", (0, 1, 2))]
    assert found.faults[0].side == "simulator"
    assert not compare_pair(
        floating.replace(u=None), floating.replace(u=None), robot, force=True
    ).faults


@pytest.mark.slow
@pytest.mark.parametrize(
    ("applied", "lacking"), [("rotors", "coulomb_friction"), ("all", "rotor_inertia")]
)
def test_friction_or_rotors_that_the_simulator_never_has(applied, lacking):
    """They are effects that only the arm has, of every joint."""
    settings = replace(FEW, effects=(*FEW.effects, "rotor_inertia"))
    simulated, arm = log((applied,), noise=1e-4), log(("all", "rotors"))
    found = compare_pair(
        simulated.replace(u=None), arm.replace(u=None), load_robot("3r"), settings=settings
    )
    assert not found.faults
    assert {(w.effect, w.more, w.only) for w in found.which} == {(lacking, "arm", True)}
    assert sorted(j for w in found.which for j in w.joints) == [0, 1, 2]


@pytest.mark.nightly
def test_an_effect_of_one_side_is_named_with_its_side():
    robot = load_robot("3r")
    with_it, without = log(("Fc",)), log(noise=1e-4)
    more = compare_pair(without, with_it, robot, settings=FEW).which[0]
    assert (more.effect, more.joints, more.more, more.only) == (
        "coulomb_friction",
        (1,),
        "arm",
        True,
    )
    assert more.parameters["Fc"] == pytest.approx(0.8, abs=0.05)
    # Too much is an answer, too: a simulator with friction that neither its file nor the arm has.
    less = compare_pair(log(("Fc",), noise=1e-4), log(), robot, settings=FEW).which[0]
    assert (less.effect, less.joints, less.more) == ("coulomb_friction", (1,), "simulator")
    assert less.only
    assert less.file["Fc"] == pytest.approx(0.8, abs=0.05)


@pytest.mark.nightly
def test_a_load_that_only_the_simulator_carries():
    robot = load_robot("3r")
    light, motion = log(), log(noise=1e-4)
    heavy = carrying(0.5, (0.1, 0.02, 0.0), 2e-3)
    torque = torchid.inverse_dynamics(heavy, *_state(motion)) - torchid.inverse_dynamics(
        robot, *_state(motion)
    )
    loaded = motion.replace(tau=motion.tau + torque, u=None)
    found = compare_pair(loaded, light.replace(u=None), robot, settings=LOADS).which[0]
    assert found.effect in ("payload", "link_inertia")
    assert found.more == "simulator"


@pytest.mark.slow
def test_a_push_of_the_arm_has_its_force_and_its_time():
    """What happened once is in no model of the arm, and is told with its numbers all the same."""
    robot, one = load_robot("3r"), log(noise=1e-4)
    push = Contact(start=4.0, stop=6.0)
    force = torch.tensor([5.0, -4.0, 3.0], dtype=torch.float64)
    torque = push.torque_columns(Motion(*_state(one), t=one.t), robot) @ force
    pushed = log().replace(u=None)
    pushed = pushed.replace(tau=pushed.tau + torque)
    settings = replace(FEW, effects=(*FEW.effects, "contact"))
    (found,) = compare_pair(one.replace(u=None), pushed, robot, settings=settings).which
    assert (found.effect, found.more, found.only) == ("contact", "arm", True)
    sizes = {size.name: (size.was, size.value) for size in found.sizes}
    assert all(was == 0.0 for was, _ in sizes.values())
    assert max(abs(value) for _, value in sizes.values()) > 2.0
    assert found.window.from_s == pytest.approx(4.0, abs=0.3)


def _state(one: Log) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """q, dq, ddq of a log with hardly any noise, at 200 Hz."""
    dq = central_difference(low_passed(one.q.T, 200.0, 20.0), 200.0)
    return one.q, dq.T.contiguous(), central_difference(dq, 200.0).T.contiguous()


def test_bad_pairs():
    one = log()
    other = torch.randn(one.q.shape, generator=torch.Generator().manual_seed(0)).double()
    with pytest.raises(TorchidError, match="different commands"):
        compare_pair(one.replace(u=other), one)
    with pytest.raises(TorchidError, match="number of joints"):
        compare_pair(Log(one.t, one.q[:, :2]), one)
    with pytest.raises(TorchidError, match="k-th trajectory"):
        compare_pair(Log.concatenate([one, one]), one)
    with pytest.raises(TorchidError, match="another arm"):
        compare_pair(one, one, load_robot("ur10e"))


PAIRS = Path(__file__).parents[2] / "torchid_bench/benchmarks/pairs.py"


@pytest.mark.parametrize("number", some([0, 3, 4, 5, 7], 2))
def test_pairs_of_mujoco(number):
    """A handful of the generator's pairs, of a seed on which thresholds were chosen."""
    own = runpy.run_path(str(PAIRS))
    result = own["one"](903, number, False)
    assert result["right"], result
