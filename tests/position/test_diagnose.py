"""Planted causes are named on their joints, and a plain servo is named plain."""

from dataclasses import replace

import pytest
import torch

from tests.marks import some
from tests.position.diagnosed import diagnosis, finding
from tests.position.planted import COUNT, planted, robot, true_servos
from torchid.effects.servo import INDEX, TORQUES
from torchid.position.answered import needed_effects
from torchid.position.data import prepare
from torchid.position.diagnose import diagnose_positions
from torchid.position.effects import BY_NAME, CORE
from torchid.position.problem import pose, some_of, with_motions
from torchid.position.record import Accuracy
from torchid.position.replay import replay
from torchid.position.servo_model import ServoModel
from torchid.report.brief import model_words
from torchid.report.position import remarks, where_table
from torchid.results.files import load
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Windows

CAUSES = {
    "stribeck_friction": {"stiction": (2, 4.0), "stribeck_speed": (2, 0.02)},
    "load_dependent_stribeck": {"stiction_share": (2, 0.3), "stribeck_speed": (2, 0.3)},
    "set_point_profile": {"acceleration": (2, 4.0)},
    "end_stop": {"stop_high": (3, 0.25)},
    "derivative_gain": {"kd": (2, 25.0)},
    "command_gain": {"scale": (2, 0.9)},
    "integral_action": {"integral": (2, 260.0)},
    "command_filter": {"lag": (2, 0.08)},
}


@pytest.mark.parametrize("cause", some([None, *CAUSES], 2))
def test_a_planted_cause_is_named(cause, tmp_path):
    extra = CAUSES[cause] if cause else {}
    servos = true_servos(3, **extra)
    log = planted(servos, motions=6, seconds=16.0, seed=4)
    result = diagnose_positions(robot(), log, held_out=next(iter(log.trajectories())))
    named = {(f.effect, f.joint) for f in result.findings}
    if cause is None:
        assert named == set()  # the delay and the offset of these servos are usual
    else:
        joint = next(iter(extra.values()))[0]
        assert (cause, joint) in named
        assert {j for _, j in named} == {joint}
        assert result.status == "explained"
        assert float(result.answered.whole[joint - 1]) < float(result.plain_servo.whole[joint - 1])
        # A spring on the joint, beside a weaker servo, makes the torque of a gain below 1.
        twins = [f for f in result.findings if "joint_spring" in f.ambiguous_with]
        assert [f.effect for f in twins] == ([cause] if cause == "command_gain" else [])
    # Its answer can be read by people and programs.
    result.save(tmp_path / "gap.json")
    again = load(tmp_path / "gap.json")
    assert again.plain() == result.plain()
    assert again.how_far.answered.whole_mrad < again.how_far.commanded.whole_mrad
    assert where_table(result.record)
    before, after = result.held_out
    assert f"Held-out logs: {after.whole_mrad:.1f} mrad" in " ".join(remarks(result.record))
    said = result.answer
    assert (said.before.value, said.after.value) == (before.whole_mrad, after.whole_mrad)
    assert said.after.on == (log.names[0],)
    assert said.after.how == "held out"
    assert said.left_out.value == result.answered.whole_mrad
    assert [len(found.plot("where").axes) for found in (result, again)] == [2, 2]
    # Its model, moved by the commands, goes where the arm went.
    moved = replay(result.corrected, log)
    assert float(moved.error.mean()) < 0.5 * again.how_far.commanded.whole_mrad
    assert len(moved.plot("positions").axes) == 3


def test_servos_that_fail_on_a_held_out_motion_say_so_first():
    """There the gains are a third: what was found is worth next to nothing, and all that is said of
    how far the error shrinks is of that motion."""
    servos = true_servos(3, dead_zone=(2, 0.02))
    log = planted(servos, motions=3, seconds=8.0, seed=4)
    weak = replace(servos, joint=servos.joint.clone())
    weak.joint[:, INDEX["kp"]] *= 0.3
    apart = planted(weak, motions=1, seconds=8.0, seed=9).replace(names=("monday",))
    found = diagnose_positions(robot(), log, held_out=apart)
    answer = found.answer
    assert [c.effect for c in answer.causes][:1] == ["dead_zone"]
    assert (answer.after.on, answer.after.how) == (("monday",), "held out")
    assert answer.left_out.value == found.answered.whole_mrad < 0.1 * answer.after.value
    said = f"The answer fails on monday: there it errs {answer.after.size}, plain servo "
    assert answer.headline.startswith(said)
    assert answer.closed < 0.1
    assert answer.closed_ci95 is None
    assert found.status != "explained"
    assert answer.title.startswith("RMS error [mrad] on monday, which was not fitted; plain servo:")
    assert model_words(answer, "m.yaml", "arm.urdf").startswith("m.yaml is not confirmed: ")
    assert [j.after for j in answer.joints] == found.held_out[1].whole.tolist()


@pytest.mark.nightly
def test_a_load_is_found_beside_servos():
    """A body at the last link, which gains and offsets of single joints follow in part only."""
    arm = robot()
    heavy = arm.with_payload(2.5, (0.1, 0.0, 0.0))
    result = diagnose_positions(arm, planted(true_servos(3), robot=heavy, seed=4))
    named = {f.effect: f for f in result.findings}
    assert set(named) - {"command_delay", "torque_offset"} == {"payload"}
    assert named["payload"].joint is None
    # What is heavier and stronger by one factor moves alike, but for the arm's own masses.
    mass = named["payload"].sizes[0]
    low, high = named["payload"].ci95["mass"]
    assert low <= 2.5 <= high
    assert result.status == "explained"
    # The corrected arm carries it, and a plain servo is judged on the arm as given.
    own, found = (x.require_parameters("a test").mass for x in (arm, result.corrected.robot))
    assert float((found - own)[-1]) == pytest.approx(mass.value)
    assert float(result.answered.windows.mean()) < float(result.plain_servo.windows.mean())


@pytest.mark.slow
def test_a_joint_that_flickers_never_moves():
    log = planted(true_servos(3), motions=2, seconds=8.0)
    q = log.q.clone()
    q[:, 1] = 0.3 + COUNT * (torch.arange(len(q)) % 7 == 0)
    q[:, 2] = 0.1
    assert prepare(robot(), log.replace(q=q)).still.tolist() == [False, True, True]


@pytest.mark.slow
def test_one_motion_is_taken_in_parts():
    log = planted(true_servos(3), motions=1, seconds=12.0)
    parts, warnings = with_motions(log)
    assert parts.trajectory_count == 4
    assert len(warnings) == 1
    assert torch.equal(parts.q, log.q)
    again, none = with_motions(parts)
    assert again is parts
    assert none == ()


@pytest.mark.parametrize("most", [10, 60, 500])
def test_windows_that_tell_more_are_taken_sooner_and_stand_for_fewer(most):
    count = 200
    rows = torch.arange(count)
    whole = Windows(rows * 100, torch.full((count,), 100), rows // 50, torch.ones(count).double())
    size = torch.where(rows % 40 == 0, 20.0, 1.0).double()
    some = some_of(whole, most, size)
    if most >= count:
        assert torch.equal(some.start, whole.start)
        assert bool((some.weight == 1).all())
        return
    assert len(some.start) == pytest.approx(most, abs=1)
    # A sum over all windows is estimated without bias from those that were taken.
    assert float(some.weight.sum()) == pytest.approx(count, rel=0.3)
    if most == 60:
        assert set(range(0, count, 40)) <= set((some.start // 100).tolist())


@pytest.mark.slow
def test_an_answer_says_whether_what_it_names_is_all():
    found = diagnosis(finding("set_point_profile", 2, 9.0, 3.0, acceleration=4.0))
    # Of (14 + 9) / 2 mrad of whole motions (6 + 4) / 2 are left; joint 3 never moves.
    assert found.closed == pytest.approx(1 - 5.0 / 11.5)
    assert found.status == "partly_explained"
    near = Accuracy.of_joints(*(0.2 * x for x in (found.answered.whole, found.answered.windows)))
    assert replace(found, answered=near).status == "explained"
    assert replace(found, findings=()).status == "detected_unexplained"
    quiet = replace(found, findings=(), plain_servo=near, answered=near)
    assert quiet.status == "no_gap"
    assert "rest unexplained" in found.answer.headline
    # A joint that never moves is neither a success nor a failure.
    assert (found.answered.whole_mrad, found.answered.windows_2s_mrad) == (5.0, 2.5)
    assert found.record.how_far.answered.whole_mrad == 5.0


@pytest.mark.parametrize(
    ("effect", "name", "size", "most", "left"),
    [
        ("command_delay", "delay", 0.05, 0.03, (0.02, 0.03, 0.02)),
        ("torque_offset", "offset", -4.0, 3.0, (0.0, -3.0, 0.5)),
    ],
)
def test_what_is_usual_is_no_cause(effect, name, size, most, left):
    every = torch.ones(3, dtype=torch.bool)
    model = ServoModel(true_servos(3, **{name: (2, size)}), {name: every})
    usual = {name: most * every}
    assert model.beyond(BY_NAME[effect], usual).tolist() == [False, True, False]
    less = model.without(BY_NAME[effect], every, usual)
    assert less.servos.of(name).tolist() == pytest.approx(left)


def test_a_speed_of_two_effects_stays_with_the_other():
    every = torch.ones(3, dtype=torch.bool)
    numbers = {"stiction": 2.0, "stiction_share": 0.2, "stribeck_speed": 0.3}
    servos = Servos.neutral(3, kp=260.0, **numbers)
    free = dict.fromkeys(numbers, every) | {"stiction": torch.arange(3) > 0}
    model = ServoModel(servos, free)
    more, share = BY_NAME["stribeck_friction"], BY_NAME["load_dependent_stribeck"]
    assert model.where(more).tolist() == [False, True, True]
    less = model.without(share, every, {})
    assert not less.where(share).any()
    assert less.where(more).tolist() == [False, True, True]
    assert less.servos.of("stribeck_speed").tolist() == pytest.approx([1.0, 0.3, 0.3])
    none = less.without(more, every, {})
    assert not none.free
    assert none.servos.of("stribeck_speed").tolist() == [1.0] * 3


@pytest.mark.parametrize(("offset", "named"), [(1.0, set()), (12.0, {("torque_offset", 2)})])
def test_an_offset_is_a_cause_beyond_what_masses_may_be_wrong_by(offset, named):
    """The second joint carries the arm's weight, the first turns about the vertical."""
    log = planted(true_servos(3, offset=(2, offset)), motions=3, seconds=8.0)
    usual = prepare(robot(), log).usual["offset"].tolist()
    assert usual[0] == pytest.approx(0.0, abs=1e-9)
    assert 1.0 < usual[1] < 12.0
    result = diagnose_positions(robot(), log)
    assert {(f.effect, f.joint) for f in result.findings} == named
    assert result.status == ("explained" if named else "no_gap")


def test_a_limit_is_not_held_to_be_worth_what_another_joints_is():
    """Without its limit the second joint moves otherwise, and shakes the third, whose own limit,
    far above its torques, is worth nothing."""
    servos, every = true_servos(3, clip=(2, 9.0)), torch.ones(3, dtype=torch.bool)
    servos.joint[2, [INDEX[name] for name in TORQUES]] *= 0.05
    problem = pose(robot(), planted(servos, motions=3, seconds=8.0))
    servos.joint[2, INDEX["clip"]] = 1e4
    free = dict.fromkeys(CORE, every) | {"clip": torch.tensor([False, True, True])}
    _, worth, _ = needed_effects(problem.few, ServoModel(servos, free), problem.squares)
    assert worth["saturation"][0].isfinite().any(0).tolist() == [False, True, False]


@pytest.mark.nightly
def test_without_masses_ratios_are_told():
    """Rods stand for the links: causes are named, and dry friction as a share of kp is right."""
    log = planted(true_servos(3, acceleration=(2, 4.0)), motions=6, seconds=16.0, seed=4)
    result = diagnose_positions(robot().with_parameters(None), log)
    assert bool(result.ratio_only.all())
    assert any("has no masses" in text for text in result.warnings)
    assert ("set_point_profile", 2) in {(f.effect, f.joint) for f in result.findings}
    assert float(result.answered.windows.mean()) < 0.3 * float(result.plain_servo.windows.mean())
    # The first joint turns about the vertical: what it feels of gravity is nothing either way.
    share = result.servos.of("coulomb") / result.servos.of("kp")
    assert float(share[0]) == pytest.approx(1.5 / 260.0, rel=0.2)
    assert float(replay(result.corrected, log).error.mean()) < 5.0
