"""The whole procedure on small logs of the 3R: what is there is named, and nothing else.

Four runs of 8 s, of which the last repeats the first; every diagnosis is made once.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import msgspec
import pytest
import torch

from tests.gap.motions import ROBOT
from tests.marks import quick_first
from torchid.doctor.first import Doubts
from torchid.effects.registry import FAMILIES, KINDS, nominal_effects
from torchid.errors import LogError
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.diagnose import diagnose
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.report.brief import model_words
from torchid.results.answer import Answer
from torchid.results.cause import JudgedOn
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.sensors import Sensors, measured_log
from torchid.typing import Tensor

# A fit holds terms of different sizes, which its annotation gives one name.
pytestmark = pytest.mark.usefixtures("types_unchecked")

RUNS = (0, 1, 2, 0)
RATE = 125.0
NOISE = 0.05
FC = 0.6
QUICK = GapSettings()
WATCHED: list[Answer] = []
FRICTION = {"effect": "coulomb_friction", "joint": 2, "Fc": FC}
REAL = replace(ROBOT, effects=(FRICTION,))


def logged(robot: Robot, runs: tuple[int, ...] = RUNS, seed: int = 0, duration: float = 8.0) -> Log:
    """What sensors make of these runs of a robot: encoder steps, white torque noise."""
    moved = Log.concatenate(
        [
            trajectory_log(
                random_trajectory(ROBOT, k, duration=duration, fill=True), RATE, (f"run{k}",)
            )
            for k in runs
        ]
    )
    return measured_log(robot, synthetic_log(robot, moved), [], Sensors(torque_std=NOISE), seed)


def heavier(factors: tuple[float, ...]) -> Robot:
    """The 3R, its links' parameters scaled."""
    pi = ROBOT.require_parameters("a test").pi.clone()
    return ROBOT.with_parameters(
        InertialParameters(pi * torch.tensor(factors, dtype=torch.float64).unsqueeze(1))
    )


def without(*names: str) -> tuple[str, ...]:
    return tuple(name for name in KINDS if name not in names)


CASES: dict[str, Callable[[], TorqueDiagnosis]] = {
    "none": lambda: diagnose_torque(ROBOT, logged(ROBOT), settings=QUICK),
    "coulomb": lambda: diagnose_torque(ROBOT, logged(REAL), settings=QUICK, watch=WATCHED.append),
    "again": lambda: diagnose_torque(case("coulomb").corrected, logged(REAL), settings=QUICK),
    "parameters": lambda: diagnose_torque(heavier((1.1, 1.15, 1.2)), logged(ROBOT), settings=QUICK),
    "unknown": lambda: diagnose_torque(
        replace(ROBOT, parameters=None),
        logged(REAL),
        settings=replace(QUICK, background=("viscous_friction",)),
    ),
    "one run": lambda: diagnose_torque(ROBOT, logged(REAL, (0,), duration=16.0), settings=QUICK),
    "one quiet run": lambda: diagnose_torque(
        ROBOT, logged(ROBOT, (0,), duration=16.0), settings=QUICK
    ),
    "held out": lambda: diagnose_torque(
        ROBOT, logged(REAL, (0, 1, 0)), held_out=logged(REAL, (5,), 7), settings=QUICK
    ),
    "end held out": lambda: diagnose_torque(
        ROBOT, logged(REAL), settings=replace(QUICK, held_out_fraction=0.3)
    ),
    "not in the library": lambda: diagnose_torque(
        ROBOT, logged(REAL), settings=replace(QUICK, effects=without("coulomb_friction"))
    ),
    "no sign law": lambda: diagnose_torque(
        ROBOT,
        logged(REAL),
        settings=replace(
            QUICK,
            effects=tuple(k for k, f in FAMILIES.items() if f not in ("sign", "hysteresis")),
        ),
    ),
    "trusted": lambda: diagnose_torque(
        ROBOT, logged(REAL), settings=replace(QUICK, parameters="trusted")
    ),
    "free": lambda: diagnose_torque(
        ROBOT, logged(REAL), settings=replace(QUICK, parameters="free")
    ),
}

SLOW = (
    "trusted",
    "free",
    "one run",
    "held out",
    "end held out",
    "not in the library",
    "no sign law",
)


def marked(*names: str) -> list:
    return [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in names]


@cache
def case(name: str) -> TorqueDiagnosis:
    return CASES[name]()


def is_friction(found: TorqueDiagnosis) -> None:
    """Coulomb friction of joint 2 and nothing else, closed nearly all."""
    assert [(f.effect, f.joints) for f in found.which] == [("coulomb_friction", (1,))]
    (only,) = found.causes
    (only,) = found.which
    (size,) = only.sizes
    assert abs(size.value - FC) < max(3 * size.std, 0.005)
    assert size.std < 0.05 * FC
    assert only.how_sure > 0.99
    assert found.how_far.closed > 0.9
    assert (
        found.how_far.closed_ci95[0] <= found.how_far.closed <= found.how_far.closed_ci95[1] + 1e-9
    )
    worst = max(found.joints, key=lambda gap: gap.share)
    assert worst.joint == 1


@pytest.mark.slow
def test_the_least_worthwhile_size_is_the_users():
    """A friction of half a per cent of the joint's torque, well above the noise of its mean."""
    small = replace(ROBOT, effects=({"effect": "coulomb_friction", "joint": 2, "Fc": 0.025},))
    searched = replace(QUICK, parameters="trusted", effects=("coulomb_friction", "torque_offset"))
    names = []
    for share, of_torque in ((0.05, 0.01), (0.0, 0.0)):
        settings = replace(searched, worthwhile=share, worthwhile_torque=of_torque)
        found = diagnose_torque(ROBOT, logged(small), settings=settings)
        names.append([(f.effect, f.joints) for f in found.which])
    assert names == [[], [("coulomb_friction", (1,))]]


@pytest.mark.slow
def test_no_effect_no_gap():
    found = case("none")
    assert found.status == "no_gap"
    assert found.which == ()
    assert found.causes == ()
    assert found.floor.source == "repeats"
    assert nominal_effects(found.corrected) == []
    truth = torch.full((3,), NOISE)
    # White up to half the samples' rate, of which the report's band is a part.
    expected = truth * (found.band / (RATE / 2)) ** 0.5
    assert bool((found.floor.low < 1.15 * expected).all())
    assert bool((found.floor.high > 0.85 * expected).all())


@pytest.mark.parametrize("name", marked("coulomb", "trusted", "free", "one run", "held out"))
def test_friction_is_named_where_it_is(name):
    is_friction(case(name))
    assert case(name).status == "explained"


def test_all_of_the_gap_but_the_noise_is_closed():
    found = case("coulomb")
    after = found.how_far.rms_after
    assert bool((after < 1.2 * found.floor.high).all())
    assert float(found.how_far.rms_before[1]) > 5 * float(after[1])
    assert found.budget.structural > 0.9
    total = found.budget.parametric + found.budget.structural + found.budget.unexplained
    assert total == pytest.approx(1.0)
    assert [t.name for t in found.traces] == [f"run{k}" for k in RUNS]


@pytest.mark.slow
def test_the_corrected_model_has_no_gap():
    corrected = case("coulomb").corrected
    ((effect, values),) = nominal_effects(corrected)
    assert effect.name == "coulomb_friction"
    assert values[0] == pytest.approx(FC, abs=0.02)
    again = case("again")
    assert again.status == "no_gap"
    assert again.which == ()
    # The same log adds to what is known of the friction, and does not change it.
    ((effect, again_values),) = nominal_effects(again.corrected)
    assert effect.name == "coulomb_friction"
    assert again_values[0] == pytest.approx(values[0], abs=0.002)


@pytest.mark.slow
def test_coarse_encoders_are_no_gap():
    """Positions in steps of 0.2 degrees, differentiated twice, are no torque that the arm lacks."""
    log, step = logged(ROBOT, (0, 1, 2)), 4e-3
    found = diagnose_torque(
        ROBOT, log.replace(q=(log.q / step).round() * step, dq=None), settings=QUICK
    )
    assert found.status == "no_gap"
    assert found.cutoff < 8.0
    assert found.band == found.cutoff
    assert any("noise of the positions" in w for w in found.warnings)


@pytest.mark.slow
def test_wrong_parameters_are_no_effects():
    found = case("parameters")
    assert found.status == "parametric_only"
    assert {c.effect for c in found.causes} == {"link_inertia"}
    assert found.budget.parametric > 0.9
    assert found.how_far.closed > 0.9
    assert nominal_effects(found.corrected) == []


@pytest.mark.slow
def test_a_robot_without_parameters_is_fitted_first():
    found = case("unknown")
    assert any("fitted first" in w for w in found.warnings)
    assert found.robot.parameters is not None
    assert [(f.effect, f.joints) for f in found.which] == [("coulomb_friction", (1,))]
    (only,) = found.which
    assert abs(only.parameters["Fc"] - FC) < max(3 * only.std["Fc"], 0.01)
    # There is no viscous friction: once Coulomb's is named, none is left beside it.
    left = {(e.name, e.joints[0]): v[0] for e, v in nominal_effects(found.corrected)}
    assert left["coulomb_friction", 1] == pytest.approx(FC, abs=0.02)
    assert max(abs(left["viscous_friction", j]) for j in range(3)) < 0.02


@pytest.mark.slow
def test_the_model_that_was_fitted_has_its_background():
    fitted = {(e.name, e.joints[0]) for e, _ in nominal_effects(case("unknown").robot)}
    assert fitted == {("viscous_friction", j) for j in range(3)}


@pytest.mark.slow
def test_one_run_is_cut_into_stretches_and_that_is_said():
    for name in ("one run", "one quiet run"):
        found = case(name)
        assert any("stretches" in w for w in found.warnings)
        assert found.floor.source == "bracket"
        assert found.traces[0].valid.any()
    assert case("one quiet run").status == "no_gap"
    assert case("one quiet run").which == ()
    assert not any("stretches" in w for w in case("coulomb").warnings)


@pytest.mark.slow
def test_held_out_logs_are_judged():
    found = case("held out")
    assert [t.name for t in found.traces] == ["run5"]
    assert not any("stretches" in w for w in found.warnings)


def without_errors(found: TorqueDiagnosis) -> dict[str, object]:
    """What a diagnosis says of causes and of the model; a share is of parts that were left out in
    turn, and what a cause removes is of the data that are shown."""
    every = (*found.causes, *found.suspects, *found.small)
    causes = [msgspec.structs.replace(c, removes=()) for c in every]
    return {
        "causes": [repr(c) for c in causes],
        "effects": found.corrected.effects,
        "known": repr(found.corrected.knowledge),
        "bodies": found.corrected.require_parameters("a test").pi.tolist(),
        "covariance": None if found.covariance is None else found.covariance.matrix.tolist(),
        "suspect": found.answer.main_suspect,
    }


def noise_like(tau: Tensor) -> Tensor:
    return 5.0 * torch.randn(tau.shape, generator=torch.Generator().manual_seed(5)).to(tau)


HELD_OUT: dict[str, Callable[[Log], Log]] = {
    "of no model": lambda log: log.replace(tau=3 * log.tau.flip(0)),
    "as it is": lambda log: log,
    "doubled": lambda log: log.replace(tau=2 * log.tau),
    "noisy": lambda log: log.replace(tau=log.tau + noise_like(log.tau)),
    "slower": lambda log: log.select(slice(0, None, 2)),
}


@pytest.mark.parametrize("change", quick_first(HELD_OUT, 1))
def test_held_out_data_choose_nothing(change):
    """Names, probabilities, sizes, shares and the model have the same bits as without them."""
    log, apart = logged(REAL, (0, 1, 0)), logged(REAL, (5,), 7)
    alone = diagnose(ROBOT, log, settings=QUICK)
    beside = diagnose(ROBOT, log, held_out=HELD_OUT[change](apart), settings=QUICK)
    assert without_errors(beside) == without_errors(alone)
    assert beside.causes
    assert beside.answer.after.how == "held out"
    assert beside.answer.left_out == alone.answer.after


@pytest.mark.parametrize("held", [None, "of no model"])
def test_a_doubt_is_settled_by_the_log_that_is_asked(held, monkeypatch):
    """Whatever is held out: the causes take most of the error away on motions left out in turn."""
    monkeypatch.setattr("torchid.gap.diagnose.ask_first", lambda *_, **__: Doubts(short="Late."))
    apart = None if held is None else HELD_OUT[held](logged(REAL, (5,), 7))
    assert diagnose(ROBOT, logged(REAL, (0, 1, 0)), held_out=apart, settings=QUICK).doubt == ""


def test_a_cause_that_does_no_good_on_held_out_data_keeps_its_name_and_is_not_confirmed():
    log, apart = logged(REAL, (0, 1, 0)), logged(ROBOT, (6,), 8)
    other = diagnose_torque(ROBOT, log, held_out=apart, settings=QUICK)
    assert other.how_far.closed is None or other.how_far.closed < 0
    assert [c.effect for c in other.which] == ["coulomb_friction"]
    assert other.status == "detected_unexplained"
    assert not other.answer.confirmed
    assert other.answer.headline.startswith("The answer fails on run6")


@pytest.mark.nightly
def test_the_end_of_each_run_can_be_held_out():
    """The verdict is left open: it rests on three seconds of each run."""
    found = case("end held out")
    is_friction(found)
    assert len(found.traces) == len(RUNS)
    assert all(len(t.valid) < 0.4 * RATE * 8 for t in found.traces)


@pytest.mark.nightly
def test_an_effect_that_is_not_in_the_library_is_not_another_for_sure():
    """Other laws of friction on the same joint may together be as good as the one that is missing:
    within what is worth a name."""
    for name in ("not in the library", "no sign law"):
        found = case(name)
        families = {f.family for f in found.which}
        friction = bool(families & {"sign", "hysteresis"})
        assert families <= {"sign", "hysteresis", "speed", "time"}
        assert {j for f in found.which for j in f.joints} <= {1}
        assert found.status == "detected_unexplained" or friction, name


def test_a_log_held_out_twice_is_refused():
    with pytest.raises(LogError, match="held-out"):
        diagnose_torque(
            ROBOT, logged(ROBOT), held_out=logged(ROBOT, (5,)),
            settings=GapSettings(held_out_fraction=0.2),
        )  # fmt: skip


@pytest.mark.slow
def test_a_joint_that_never_moves_is_no_reason_to_stop():
    still = torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64)
    moved = Log.concatenate(
        [trajectory_log(random_trajectory(ROBOT, k, duration=8.0, fill=True), RATE) for k in RUNS]
    )
    moved = moved.replace(**{k: v * still for k, v in moved.signals.items()})
    log = measured_log(REAL, synthetic_log(REAL, moved), [], Sensors(torque_std=NOISE))
    found = diagnose_torque(ROBOT, log, settings=QUICK)
    assert any("joint 1 never moves" in w for w in found.warnings)
    assert [(f.effect, f.joints) for f in found.which] == [("coulomb_friction", (1,))]


def test_an_answer_stands_before_the_search_is_over():
    headline = case("coulomb").answer.headline
    assert {a.status for a in WATCHED} == {"searching"}
    assert headline not in {a.headline for a in WATCHED}
    first, last = WATCHED[0], WATCHED[-1]
    assert first.causes == ()
    assert [(c.effect, c.joints) for c in last.causes] == [("coulomb_friction", (1,))]
    assert last.causes[0].sizes[0].value == pytest.approx(FC, rel=0.02)
    assert first.after.value == pytest.approx(first.before.value)
    assert first.before.value == pytest.approx(case("coulomb").answer.before.value, rel=0.1)
    assert last.after.value < 0.1 * last.before.value


def test_an_answer_that_fails_on_held_out_data_says_so_first():
    """The arm rubs three times as much there: the error falls, and stays far above that of the
    motions that it was fitted on."""
    rubs = {size: replace(ROBOT, effects=(FRICTION | {"Fc": size},)) for size in (FC, 3 * FC)}
    log, apart = logged(rubs[FC], (0, 1, 2)), logged(rubs[3 * FC], (5,))
    apart = apart.replace(names=("monday",))
    found = diagnose_torque(ROBOT, log, held_out=apart, settings=QUICK)
    answer = found.answer
    assert (answer.after.on, answer.after.how) == (("monday",), "held out")
    assert answer.left_out is not None
    assert answer.left_out.on == tuple(log.names)
    assert 2 * answer.left_out.value < answer.after.value < answer.before.value
    said = f"The answer fails on monday: there it errs {answer.after.size}"
    assert answer.headline.startswith(said)
    assert found.which[0].judged == JudgedOn(on=tuple(log.names), how="left out in turn")
    # What is used next is said with the same numbers.
    assert model_words(answer, "c.yaml", "3r") == (
        f"c.yaml is not confirmed: error {answer.after.size} on monday, as given "
        f"{answer.before.size.split()[0]}."
    )
