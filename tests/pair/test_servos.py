"""One joint's servo and its simulator: short motions, commands and positions alone."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

import torchid
from tests.marks import some
from tests.position.planted import planted, robot, true_servos
from torchid.effects.servo import INDEX
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.pair.align import aligned_trajectories
from torchid.pair.pair import PairDiagnosis, compare_pair
from torchid.pair.record import PairRecord
from torchid.report.pair import report_of_pair, verdict
from torchid.results.files import load
from torchid.robot.model import Robot
from torchid.robot.yaml_file import from_mapping

PENDULUM = {
    "name": "pendulum",
    "dh": {
        "convention": "classical",
        "joints": [{"type": "R", "a": 0.15, "alpha_deg": 0, "d": 0, "theta": 0}],
    },
    "gravity": [0, -9.81, 0],
    "parameters": {
        "mass": [0.3],
        "com": [[-0.02, 0, 0]],
        "inertia_about_link_frame": [[0.0001, 0, 0, 0.006, 0, 0.006]],
    },
}
SERVO = {"kp": 17.0, "damping": 0.6, "armature": 0.02, "coulomb": 0.05}
RATE = 50.0
KINDS = ("step", "late step", "ramp", "sine")


@cache
def pendulum() -> Robot:
    return from_mapping(PENDULUM, "pendulum")


@cache
def commands(kinds: tuple[str, ...], seed: int = 0) -> tuple[np.ndarray, ...]:
    """32 of 1 to 3 s; a step is there from the first sample on, so its command stands."""
    rng, out = np.random.default_rng(seed), []
    for k in range(32):
        t = np.arange(int(rng.uniform(1.0, 3.0) * RATE) + 1) / RATE
        size, frequency = rng.uniform(0.3, 1.0) * rng.choice([-1, 1]), rng.uniform(0.5, 1.5)
        shape = {
            "step": np.ones(len(t)),
            "late step": (t >= 0.3).astype(float),
            "ramp": t / t[-1],
            "sine": np.sin(2 * np.pi * frequency * t),
        }
        out.append(size * shape[kinds[k % len(kinds)]])
    return tuple(out)


@cache
def driven(
    kinds: tuple[str, ...] = KINDS, noise: float = 5e-4, seed: int = 0, **servo: float
) -> Log:
    """What a servo of these numbers does with the commands."""
    arm, logs = torchid.ServoArm.of(pendulum(), **{**SERVO, **servo}), []
    for u in commands(kinds):
        t = np.arange(len(u)) / RATE
        one = torch.from_numpy(u)[:, None]
        given = Log(torch.from_numpy(t), q=torch.zeros_like(one), u=one)
        logs.append(torchid.replay(arm, given).simulated[0])
    out = Log.concatenate(logs)
    drawn = torch.randn(out.q.shape, generator=torch.Generator().manual_seed(seed))
    return out.replace(q=out.q + noise * drawn.double())


MOVING = ("late step", "sine")


@cache
def weaker() -> PairDiagnosis:
    real = driven(MOVING, seed=1, kp=8.1, coulomb=0.2)
    return compare_pair(driven(MOVING), real, pendulum())


@pytest.mark.nightly
@pytest.mark.parametrize("kinds", some([("late step", "step"), KINDS, ("step",), ("ramp",)], 1))
def test_short_motions_have_one_clock(kinds):
    both = aligned_trajectories(driven(kinds), driven(kinds, seed=1, kp=8.1))
    assert len(both) == 32
    assert {b.clock.by for b in both} == {"u"}
    for b in both:
        assert b.clock.rate == pytest.approx(1.0, abs=1e-6)
        assert b.clock.start_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.nightly
def test_a_clock_of_another_rate_is_the_same_in_steps_ramps_and_sines():
    simulated = driven()
    both = aligned_trajectories(simulated.replace(t=0.5 * simulated.t), driven(seed=1, kp=8.1))
    assert [b.clock.rate for b in both] == pytest.approx([0.5] * 32, rel=1e-4)


def test_an_arm_that_never_moves_ends_in_an_error():
    u = torch.from_numpy(commands(("step",))[0])[:, None]
    still = Log(torch.arange(len(u)).double() / RATE, q=torch.zeros_like(u), u=u)
    with pytest.raises(LogError, match="no motion"):
        aligned_trajectories(still, still)


@pytest.mark.nightly
def test_the_weaker_gain_and_the_friction_of_the_real_servo_are_named():
    found = weaker()
    which = {(one.effect, one.more, one.only) for one in found.which}
    assert which == {("proportional_gain", "simulator", False), ("coulomb_friction", "arm", False)}
    assert all(one.how_sure > 0.9 for one in found.which)
    by_name = {s.parameter: s for s in found.servos}
    for name, simulated, real in (("kp", 17.0, 8.1), ("coulomb", 0.05, 0.2)):
        one = by_name[name]
        assert one.differs
        assert one.simulated == pytest.approx(simulated, rel=0.15)
        assert one.real == pytest.approx(real, rel=0.15)
        assert one.simulated_ci95[0] < one.simulated < one.simulated_ci95[1]
    words = verdict(found)
    assert "The real servo of joint 1 has a lower gain" in words
    assert "more dry friction" in words
    titles = [table.title for table in report_of_pair(found).parts]
    assert any(title.startswith("servos") for title in titles)


@pytest.mark.nightly
def test_the_servos_are_in_the_json(tmp_path: Path):
    path = tmp_path / "pair.json"
    weaker().save(path)
    read = load(path)
    assert isinstance(read, PairRecord)
    assert [(s.parameter, s.differs) for s in read.servos] == [
        (s.parameter, s.differs) for s in weaker().servos
    ]


@pytest.mark.nightly
def test_equal_servos_do_not_differ():
    found = compare_pair(driven(MOVING), driven(MOVING, seed=1), pendulum())
    assert found.servos
    assert found.which == ()
    assert not [s.parameter for s in found.servos if s.differs]
    assert "agree" in verdict(found)
    # What has no name is no agreement.
    other = replace(found, of_arm=weaker().of_arm)
    assert "no cause of that is sure" in verdict(other)


@pytest.mark.nightly
def test_what_both_servos_have_is_no_difference():
    """A dead zone of both, and a gain that is new beside it."""
    both = [driven(MOVING, seed=k, dead_zone=0.03, kp=kp) for k, kp in enumerate((17.0, 8.1))]
    found = compare_pair(*both, pendulum())
    assert [one.effect for one in found.which] == ["proportional_gain"]
    assert "dead_zone" in {c.effect for c in found.record.both}
    (zone,) = (s for s in found.servos if s.parameter == "dead_zone")
    assert not zone.differs


@pytest.mark.nightly
def test_what_only_the_simulated_servo_has_is_gone_on_the_arm():
    found = compare_pair(driven(MOVING, clip=2.5), driven(MOVING, seed=1), pendulum())
    assert [(o.effect, o.more, o.only) for o in found.which] == [("saturation", "simulator", True)]
    assert "no torque limit (2." in verdict(found)


@cache
def moved(mass: float = 0.0, **factors: float) -> Log:
    """What an arm does whose gains are other by a factor on the last two joints, with a load."""
    arm, servos = robot(), true_servos(3)
    for name, factor in factors.items():
        servos.joint[1:, INDEX[name]] *= factor
    heavy = arm.with_payload(mass, (0.1, 0.0, 0.0)) if mass else arm
    return planted(servos, motions=4, seconds=12.0, robot=heavy)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mass", "factors", "names"),
    [
        (1.5, {}, {"payload"}),
        (0.0, {"kp": 0.7}, {"proportional_gain"}),
        (0.0, {"kp": 0.75, "damping": 0.75}, {"proportional_gain", "viscous_friction"}),
    ],
)
def test_a_load_and_weaker_servos_are_told_apart(mass, factors, names):
    found = compare_pair(moved(), moved(mass, **factors), robot())
    named = {one.effect for one in found.which}
    assert named >= names
    assert ("payload" in named) == bool(mass)
    if mass:
        (load,) = found.which
        assert load.parameters["mass"] == pytest.approx(mass, rel=0.1)


@pytest.mark.nightly
def test_the_rate_of_a_log_is_no_delay():
    """A command that is held is later where rows are farther apart: of a log of 50 Hz beside one of
    100 Hz, whose rows are twice each."""
    slow = driven(MOVING)
    parts = []
    for part in driven(MOVING, seed=1).trajectories():
        t = torch.arange(2 * part.samples - 1) / (2 * RATE)
        rows = torch.arange(len(t)) // 2
        q = 0.5 * (part.q[rows] + part.q[(torch.arange(len(t)) + 1) // 2])
        parts.append(Log(t.double(), q=q, u=part.u[rows]))
    found = compare_pair(slow, Log.concatenate(parts), pendulum())
    assert "delay" not in {s.parameter for s in found.servos if s.differs}


@pytest.mark.nightly
def test_a_limit_that_the_real_servo_has_alone():
    real = driven(MOVING, seed=1, clip=2.5)
    found = compare_pair(driven(MOVING), real, pendulum())
    clip = next(s for s in found.servos if s.parameter == "clip")
    assert clip.differs
    assert clip.simulated_ci95 is None
    assert clip.real == pytest.approx(2.5, rel=0.15)
    assert "a torque limit" in verdict(found)


@pytest.mark.nightly
def test_without_masses_ratios_to_the_gain_are_compared():
    bare = replace(pendulum(), parameters=None)
    found = compare_pair(driven(MOVING), driven(MOVING, seed=1, damping=1.2), bare)
    assert "kp" not in {s.parameter for s in found.servos}
    damping = next(s for s in found.servos if s.parameter == "damping")
    assert (damping.per_kp, damping.unit, damping.differs) == (True, "s", True)
    assert damping.simulated == pytest.approx(0.6 / 17, rel=0.1)
    assert damping.real == pytest.approx(1.2 / 17, rel=0.1)
    assert any("shares of the gain" in w for w in found.record.warnings)
    assert math.isfinite(damping.real_ci95[1])


@pytest.mark.nightly
def test_logs_with_torque_have_no_servos():
    simulated = driven(MOVING)
    torque = 17.0 * (simulated.u - simulated.q)
    both = [simulated.replace(tau=torque), driven(MOVING, seed=1).replace(tau=torque)]
    assert compare_pair(*both).record.servos is None
