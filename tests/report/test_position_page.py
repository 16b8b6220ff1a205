"""The page of a diagnosis of commands and positions: where, which, how far, in mrad."""

from dataclasses import replace

import pytest
import torch
from msgspec import structs

from tests.position.diagnosed import diagnosis, finding
from tests.report.page.reading import parsed, rows_of, text_of
from torchid.position.record import Accuracy
from torchid.report.causes import cause_table
from torchid.report.diagnosis import page, report_of_diagnosis
from torchid.report.over_time import Run, motion_over_time
from torchid.report.page.document import origin, render
from torchid.report.position import nominal_table, remarks, where_table, worst_joints
from torchid.results.agreement import MotionScale
from torchid.results.replication import replication_of

PROFILE = finding("set_point_profile", 2, 14.0, 6.5, acceleration=39.0)
PLANE = finding("plane_contact", None, 8.0, 6.0)


@pytest.fixture(scope="module")
def found():
    return diagnosis(PROFILE, PLANE, servo="STS3215 kp=17.8")


def test_the_first_screen(found):
    made = origin(arguments=["torchid", "gap"], started=0.0, seeds={}, settings={}, files=())
    tree = parsed(render(page(found, made)))
    assert text_of(tree, "verdict").replace("\u00a0→\u00a0", " -> ") == found.answer.headline
    facts = text_of(tree, "facts")
    for said in ("35 mrad", "11.5 mrad", "5 mrad", "explained"):
        assert said in facts
    text = tree.text_content()
    assert "It errs most on joint 2 joint_2, above all at reversal: 21.0 mrad, 7.0 mrad" in text
    assert "set point profile" in text
    assert "acceleration = 39" in text
    assert "plane contact" in text
    assert "something to bear in mind" in text
    assert [f.get("id") for f in tree.xpath("//figure")] == ["motion", "where"]
    assert len(rows_of(tree, "Error of each motion, left out, per joint [mrad]")) == 2


@pytest.mark.slow
def test_without_a_finding():
    plain = diagnosis()
    made = origin(arguments=[], started=0.0, seeds={}, settings={}, files=())
    text = parsed(render(page(plain, made))).text_content()
    assert "No known effect explains a plain servo's error" in text
    assert not cause_table(plain.record)
    assert not nominal_table(plain.record)
    assert "nominal" not in plain.plain()


def test_figures_by_name(found):
    assert set(report_of_diagnosis(found).figures) == {"where", "motion"}
    assert worst_joints(found.record) == [1, 0]  # the third never moves
    assert "joint 1:" in found.plot("motion", joint=0).get_suptitle()
    # The joint is shown where the plain servo errs most: rows 400 to 599 of the first motion.
    motion = motion_over_time(found)
    rows, _ = motion.runs[0].window(1)
    assert rows.start <= 400
    assert rows.stop >= 599
    above, below = motion.draw(1).axes
    assert below.get_xlabel() == f"time in {motion.runs[0].name} [s]"
    assert [line.get_label() for line in above.lines] == [
        "command", "arm, measured", "plain servo", "corrected servo",
    ]  # fmt: skip
    assert max(abs(below.lines[1].get_ydata())) > 25


def test_nominal_beside_found(found):
    nominal = nominal_table(found.record)
    rows = [row for row in nominal.rows if row[0] == "2"]
    assert rows == [
        ("2", "STS3215", "kp", "17.8 N m/rad", "260 [250, 270] N m/rad"),
        (
            "2", "STS3215", "acceleration", "unknown",
            "39 [35.1, 42.9] rad/s² = 254 steps of the register",
        ),
        ("2", "STS3215", "resolution", "1.53 mrad", "1.53 mrad"),
    ]  # fmt: skip
    assert ("3", "STS3215", "kp", "17.8 N m/rad", "never moves") in nominal.rows
    kp = where_table(found.record).columns.index("kp")
    assert [row[kp] for row in where_table(found.record).rows][2] == "-"
    assert found.plain()["where"]["joints"][2]["kp"] is None
    (first, *_) = found.plain()["nominal"]
    assert first["joint"] == 1
    assert first["servo"] == "STS3215"
    assert first["values"] == {"kp": 17.8}
    assert first["register_units"]["acceleration"] == pytest.approx(0.1534, abs=1e-4)


@pytest.mark.slow
def test_a_plain_servo_that_is_enough_hides_what_is_small():
    made = diagnosis()
    tiny = Accuracy.of_joints(
        torch.tensor([0.1, 0.1, torch.nan]), torch.tensor([0.1, 0.1, torch.nan])
    )
    enough = replace(made, plain_servo=tiny, answered=tiny)
    assert enough.status == "no_gap"
    low, high = (float(x) for x in enough.unseen[:2].sort().values)
    assert 0.1 < low < high
    assert f"less than {low:.1f} to {high:.1f} mrad" in enough.answer.headline
    assert enough.record.where.joints[0].unseen_mrad == pytest.approx(float(enough.unseen[0]))


@pytest.mark.slow
def test_where_an_answer_is_worse_than_a_plain_servo_is_said():
    found = diagnosis(finding("end_stop", 2, 14.0, 6.0, stop_high=0.4))
    assert "worse" not in " ".join(remarks(found.record))
    before, after = (torch.tensor(x).double() for x in ((9.0, 14.0, 2.0), (60.0, 6.0, 9.0)))
    regimes = {"holding": (before, after), "low_speed": (before, after.flip(0))}
    changed = replace(found, regimes=regimes)
    said = " ".join(remarks(changed.record))
    assert "worse than a plain servo on joint 1 (holding), 9.0 -> 60.0 mrad" in said
    joint = replace(changed, answered=Accuracy.of_joints(after, found.answered.windows))
    said = " ".join(remarks(joint.record))
    assert "worse than a plain servo on joint 1, 9.0 -> 60.0 mrad." in said


@pytest.mark.slow
def test_a_size_whose_interval_holds_nothing_is_not_determined():
    one = finding("end_stop", 2, 14.0, 6.0, stop_high=0.4)
    unsure = structs.replace(one, ci95={"stop_high": (-2.0, 2.8)})
    texts = [str(c) for row in cause_table(diagnosis(unsure).record).rows for c in row]
    assert any("not determined" in text for text in texts)


def test_what_each_motion_wants_of_a_servo():
    scales = [MotionScale(f"run{k}", 0.0, 8.0, x, 0.05) for k, x in enumerate((0.9, 0.9, 1.6), 1)]
    again = replication_of(scales)
    found = diagnosis(structs.replace(PROFILE, replication=again), PLANE)
    assert [r.value for r in found.agreement] == pytest.approx([0.9 * 39, 0.9 * 39, 1.6 * 39])
    assert [r.verdict for r in found.record.agreement] == ["agrees", "agrees", "differs"]
    assert (
        "run3 wants set point profile on joint 2 of 62 ± 2 rad/s²"
        in report_of_diagnosis(found).parts[0]
    )
    # A factor on commands is 1 without the effect.
    scale = structs.replace(finding("command_gain", 1, 9.0, 4.0, scale=1.2), replication=again)
    assert [r.value for r in diagnosis(scale).agreement] == pytest.approx([1.18, 1.18, 1.32])


def test_what_is_shown_first_is_where_a_model_errs_most_while_the_joint_moves() -> None:
    """Not the rest in which a larger error stands still."""
    t = torch.arange(6000, dtype=torch.float64) / 50
    q = torch.where(t < 60, 0.3 * torch.sin(t), 0.3 * torch.sin(torch.tensor(60.0)))[:, None]
    error = torch.where(t < 60, 0.01 + 0.01 * (t > 40), 0.05)[:, None]
    run = Run("run", t, q, q + error, q, moving=torch.gradient(q, dim=0)[0].abs() > 1e-4)
    rows, _ = run.window(0)
    assert float(t[rows.start]) >= 40
    assert float(t[rows.stop - 1]) <= 62
    rests, _ = replace(run, moving=None).window(0)
    assert float(t[rests.start]) >= 58


@pytest.mark.parametrize(("source", "called"), [("my arm.urdf", "'my arm.urdf'"), ("", "ROBOT")])
def test_the_line_for_another_motion_names_the_robot_as_it_was_given(found, source, called):
    data = replace(found.data, robot=replace(found.data.robot, source=source))
    unsure = replace(found, data=data, closed_ci95=(-0.1, 0.4))
    made = origin(arguments=[], started=0.0, seeds={}, settings={}, files=())
    steps = dict(page(unsure, made).advice)["What to do first"]
    assert any(f"`torchid excite {called} --for gap.json" in step for step in steps)
