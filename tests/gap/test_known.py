"""What is known of a model counts in its next diagnosis; and faults that are mended: by the public
functions alone, on short logs of the 3R."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

import torchid
from tests.gap.small_logs import ROBOT, Recording, arm, carrying, friction, logged
from tests.gap.test_contract import holds
from tests.marks import some
from torchid.effects.registry import KINDS
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.identification.knowledge import whole_arm
from torchid.log.model import Log
from torchid.results.cause import cut_line
from torchid.robot.inertia import InertialParameters
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import Robot

pytestmark = pytest.mark.usefixtures("types_unchecked")

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
SEARCHED = (*FRICTION, "payload", "joint_spring", "link_inertia")
FIRST, SECOND = Recording(runs=(0, 1)), Recording(runs=(7, 8))
TRUE = arm(friction(1, Fv=0.8), friction(2, Fc=0.5), friction(2, Fv=1.0), friction(3, Fc=0.2))


def settings(**more: object) -> GapSettings:
    return GapSettings(effects=SEARCHED, **more)  # type: ignore[arg-type]


def log_of(robot: Robot, how: Recording) -> Log:
    return logged(robot, how)


@cache
def first() -> TorqueDiagnosis:
    """A model of kinematics alone, fitted to the first session."""
    unknown = replace(ROBOT, parameters=None, effects=())
    return torchid.diagnose(unknown, log_of(TRUE, FIRST), settings=settings(background=FRICTION))


def names(found: TorqueDiagnosis) -> set[tuple[str, tuple[int, ...]]]:
    return {(f.effect, f.at) for f in found.which}


def test_a_first_session_is_known_afterwards() -> None:
    known = first().corrected.knowledge
    assert known is not None
    assert first().knowledge is None  # nothing was known before
    for joint in (1, 2, 3):
        assert 0 < known.std(f"viscous_friction Fv{joint}") < 0.1
    # As well as the values are: within four standard deviations of the truth.
    truth = {"viscous_friction Fv1": 0.8, "viscous_friction Fv2": 1.0, "coulomb_friction Fc2": 0.5}
    own = {f"{e['effect']} {k}{e['joint']}": v for e in first().corrected.effects
           for k, v in e.items() if k in ("Fv", "Fc")}  # fmt: skip
    for name, value in truth.items():
        assert abs(own[name] - value) < 4 * known.std(name) + 0.01


def test_nothing_changed_nothing_named() -> None:
    found = torchid.diagnose(first().corrected, log_of(TRUE, SECOND), settings=settings())
    assert names(found) == set()
    assert found.causes == found.which
    known, after = first().corrected.knowledge, found.corrected.knowledge
    assert known is not None
    assert after is not None
    assert found.knowledge is not None
    # What is known grows: friction to less than the share by which it may change by itself.
    for c in found.knowledge.coefficients:
        assert not c.changed
        assert c.after_std is not None
        assert c.before_std is None or c.after_std <= c.before_std
    assert len(after.sources) > len(known.sources)


def test_a_known_coefficient_that_changed_is_told_with_before_and_after() -> None:
    worn = arm(friction(1, Fv=0.8), friction(2, Fc=0.5), friction(2, Fv=2.5), friction(3, Fc=0.2))
    found = torchid.diagnose(first().corrected, log_of(worn, SECOND), settings=settings())
    assert names(found) == {("viscous_friction", (1,))}
    (size,) = found.which[0].sizes
    assert size.was == pytest.approx(1.0, abs=0.05)
    assert size.value == pytest.approx(2.5, abs=0.05)
    changed = [c for c in found.knowledge.coefficients if c.changed]
    assert [(c.name, c.before, c.after) for c in changed] == [
        ("viscous_friction Fv2", size.was, size.value)
    ]
    # Of what has changed the new session alone tells.
    assert found.corrected.knowledge is not None
    assert found.plain()["which"][0]["file"] == {"Fv": size.was}


def test_a_change_is_no_less_sure_than_what_was_known() -> None:
    """By five of its own standard deviations: what was known is exact, no block of one degree of
    freedom, whose Student's quantile would be six times as wide."""
    model, name = first().corrected, "viscous_friction Fv2"
    known = model.knowledge
    assert known is not None
    root = known.root.clone()
    root[:, known.rigid + known.coefficients.index(name)] *= known.std(name) / 0.3
    open_one = replace(model, knowledge=replace(known, root=root))
    worn = arm(friction(1, Fv=0.8), friction(2, Fc=0.5), friction(2, Fv=2.5), friction(3, Fc=0.2))
    found = torchid.diagnose(open_one, log_of(worn, SECOND), settings=settings())
    assert names(found) == {("viscous_friction", (1,))}
    (change,) = (c for c in found.knowledge.coefficients if c.changed)
    assert change.before_std == pytest.approx(0.3, rel=0.05)
    assert found.which[0].std["Fv"] == change.after_std < change.before_std
    assert found.which[0].how_sure > 0.9


def test_a_load_is_told_beside_what_is_known() -> None:
    loaded = replace(carrying(0.8, (0.0, 0.0, 0.1), 0.002), effects=TRUE.effects)
    found = torchid.diagnose(first().corrected, log_of(loaded, SECOND), settings=settings())
    told = {f.effect: f for f in found.which}
    assert set(told) == {"payload"}
    mass, std = told["payload"].parameters["m"], told["payload"].std["m"]
    assert abs(mass - 0.8) < 3 * std + 0.02


def test_another_load_is_told_beside_one_that_the_model_has() -> None:
    """A log tells the sum of a link and its load alone: what it has more is the other load."""
    place, inertia = (0.0, 0.0, 0.1), 0.002
    before, after = (replace(carrying(m, place, inertia), effects=TRUE.effects) for m in (0.8, 1.3))
    model = torchid.diagnose(first().corrected, log_of(before, SECOND), settings=settings())
    assert [e["effect"] for e in model.corrected.effects].count("payload") == 1
    third = log_of(after, Recording(runs=(3, 4)))
    found = torchid.diagnose(model.corrected, third, settings=settings())
    (cause,) = found.answer.causes  # which of the two it is, is anybody's guess
    assert {cause.effect, *cause.ambiguous_with} == {"payload", "link_inertia"}
    assert found.answer.after.value < 0.06 < 0.1 * found.answer.before.value
    masses = [
        float(whole_arm(d.corrected).require_parameters("a test").mass[-1]) for d in (model, found)
    ]
    assert masses[1] - masses[0] == pytest.approx(0.5, abs=0.05)


def test_a_change_hidden_in_what_was_open_is_no_gap_by_no_means() -> None:
    """Of a model of which little is known, a change is within what it left open."""
    model = first().corrected
    assert model.knowledge is not None
    loose = replace(model, knowledge=replace(model.knowledge, root=1e-4 * model.knowledge.root))
    worn = arm(friction(1, Fv=0.8), friction(2, Fc=0.5), friction(2, Fv=2.5), friction(3, Fc=0.2))
    found = torchid.diagnose(loose, log_of(worn, SECOND), settings=settings())
    assert found.status == "not_testable"
    assert found.knowledge is not None
    hiding = [j for j in found.knowledge.joints if j.hides]
    assert [j.joint for j in hiding] == [1]
    assert "drive joint 2" in hiding[0].motion


@pytest.mark.slow
def test_a_cause_within_what_the_model_left_before_is_no_name() -> None:
    """The model was seen to leave as much as the cause makes: it may be a part of that."""
    model = first().corrected
    assert model.knowledge is not None
    worn = arm(friction(1, Fv=0.8), friction(2, Fc=0.5), friction(2, Fv=1.4), friction(3, Fc=0.2))
    log = log_of(worn, SECOND)
    assert names(torchid.diagnose(model, log, settings=settings())) == {("viscous_friction", (1,))}
    speed = log.q.diff(dim=0) / log.t.diff().unsqueeze(1)
    made = 0.4 * speed.clamp(-5, 5).square().mean(0).sqrt()
    rough = replace(model, knowledge=replace(model.knowledge, left=1.2 * made))
    found = torchid.diagnose(rough, log, settings=settings())
    assert names(found) == set()
    assert found.status in ("negligible", "no_gap", "not_testable")


@pytest.mark.slow
def test_a_gain_that_is_known_is_known_but_may_have_changed() -> None:
    """Beside a model that nobody vouches for, a gain known to a thousandth is no explanation; a
    model that was fitted to the same sensor's torque shows that its scale has changed."""
    log = log_of(TRUE, SECOND)
    assert log.tau is not None
    scaled = log.replace(tau=log.tau * torch.tensor([1.0, 1.1, 1.0], dtype=torch.float64))
    wanted = replace(settings(gain_std=0.001), effects=(*SEARCHED, "torque_gain"))
    as_cad = torchid.diagnose(replace(first().corrected, knowledge=None), scaled, settings=wanted)
    assert ("torque_gain", (1,)) not in names(as_cad)
    changed = torchid.diagnose(first().corrected, scaled, settings=wanted)
    assert ("torque_gain", (1,)) in names(changed)


CASES: dict[str, tuple[Robot, Robot]] = {
    "nothing": (ROBOT, ROBOT),
    "friction": (ROBOT, TRUE),
    "changed": (arm(friction(2, Fv=1.0)), arm(friction(2, Fv=0.4))),
    "too much": (arm({"effect": "load_dependent_friction", "joint": 2, "mu": 0.05}), ROBOT),
    "small": (ROBOT, arm(friction(2, Fc=0.05))),
}


@pytest.mark.parametrize(
    "case", some(["friction", "changed", "nothing", "small", "too much"], slow=2, quick=1)
)
def test_every_answer_is_written_read_run_again_and_agrees_with_itself(
    case: str, tmp_path: Path
) -> None:
    given, true = CASES[case]
    log = log_of(true, FIRST)
    wanted = replace(settings(), effects=(*SEARCHED, "load_dependent_friction"))
    found = torchid.diagnose(given, log, settings=wanted)
    assert holds(found.plain()) == []
    found.save(tmp_path / "gap.json")
    again = torchid.load(tmp_path / "gap.json")
    assert again.corrected.n == 3
    torchid.write_robot(found.corrected, tmp_path / "corrected.yaml")
    corrected = torchid.load_robot(tmp_path / "corrected.yaml")
    second = torchid.diagnose(corrected, log_of(true, SECOND), settings=wanted)
    assert holds(second.plain()) == []
    assert second.which == ()


def test_a_small_cause_is_told_as_one() -> None:
    wanted = settings(worthwhile_torque=0.2)
    found = torchid.diagnose(ROBOT, log_of(CASES["small"][1], FIRST), settings=wanted)
    assert found.status == "negligible"
    assert found.which == ()
    (small,) = found.small
    assert (small.effect, small.joints) == ("coulomb_friction", (1,))
    assert small.parameters["Fc"] == pytest.approx(0.05, abs=0.02)


def pushed(
    windows: tuple[tuple[float, float], ...],
    seed: int,
    drift: float = 0.0,
    off: float = 1.0,
    compliance: float = 0.0,
) -> tuple[Robot, Log]:
    """The 3R, held in one pose and pushed with 20 N, to which its controller yields; and its model,
    whose masses are off."""
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(4000, dtype=torch.float64) / 100
    q = torch.tensor([0.2, -0.4, -0.9], dtype=torch.float64).repeat(4000, 1)
    noise = torch.randn(4000, 3, generator=g, dtype=torch.float64)
    tau = torchid.inverse_dynamics(ROBOT, q, 0 * q, 0 * q) + 0.05 * noise
    tau = tau + drift * torch.randn(4000, 3, generator=g, dtype=torch.float64).cumsum(0) / 100
    force = torch.tensor([20.0, 10.0, -15.0], dtype=torch.float64)
    yielded = q
    for a, b in windows:
        push = tool_jacobian(ROBOT, q)[..., :3, :].mT @ force
        there = push * (((t - a) / 0.1).clamp(0, 1) * ((b - t) / 0.1).clamp(0, 1)).unsqueeze(1)
        tau += there
        yielded = yielded - compliance * there
    pi = ROBOT.require_parameters("a test").pi * off
    return ROBOT.with_parameters(InertialParameters(pi)), Log(t, yielded, tau=tau)


@pytest.mark.parametrize(
    ("off", "compliance"),
    some([(1.2, 5e-4), (1.2, 0.0), (1.0, 0.0), (1.0, 2e-4)], slow=1, several=True),
)
def test_what_stands_still_and_is_pushed_is_a_contact(off: float, compliance: float) -> None:
    """Also where the arm yields, by up to 10 mrad: no spring is named for it."""
    robot, log = pushed(((10.0, 11.5), (25.0, 26.0)), 0, off=off, compliance=compliance)
    log = log.replace(t=log.t + 100.0)
    found = torchid.diagnose(robot, log)
    assert [f.effect for f in found.which] == ["contact", "contact"]
    for f in found.which:
        assert [s.value for s in f.sizes] == pytest.approx((20.0, 10.0, -15.0), abs=0.5)
    windows = sorted((f.window.from_s, f.window.to_s) for f in found.which)
    assert windows[0] == pytest.approx((110.0, 111.5), abs=0.2)
    assert windows[1] == pytest.approx((125.0, 126.0), abs=0.2)
    # The line to paste leaves what was not pushed.
    line = re.search(r"log\.select\((.*)\)$", cut_line(found.which).strip("`"))
    assert line is not None
    left = log.select(eval(line[1])).t
    inside = ((left > 110.2) & (left < 111.3)) | ((left > 125.2) & (left < 125.8))
    assert not bool(inside.any())
    assert 3600 < len(left) < 3900


@pytest.mark.parametrize("drift", [0.0, 0.5])
@pytest.mark.parametrize("off", [1.0, 1.2])
def test_what_stands_still_alone_shows_nothing(drift: float, off: float) -> None:
    robot, log = pushed((), 1, drift=drift, off=off)
    with pytest.raises(torchid.TorchidError, match="stands still"):
        torchid.diagnose(robot, log)


@pytest.mark.slow
def test_kinematics_are_not_told_of_base_parameters_alone() -> None:
    """Another split of the same base parameters has another torque of a displaced joint."""
    kind = KINDS["kinematic_error"]
    assert kind.of_bodies
    unknown = replace(ROBOT, parameters=None, effects=())
    wanted = replace(settings(), effects=(*FRICTION, "kinematic_error"))
    found = torchid.diagnose(unknown, log_of(TRUE, FIRST), settings=wanted)
    assert "kinematic_error" not in {f.effect for f in found.which}
