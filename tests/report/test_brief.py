"""The answer on one screen of a terminal."""

import itertools
import math
import subprocess
import sys

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rich.console import Console

from tests.causes import errors, numbers
from torchid.effects.registry import KINDS
from torchid.report.brief import MOST_LINES, Screen, bar, model_words, short_label
from torchid.report.page.answer import first_steps
from torchid.results.answer import Answer, JointError
from torchid.results.cause import Cause, Size, Window
from torchid.results.friction import FrictionAt, FrictionDetail, FrictionLaw

WARNINGS = (
    "run1: time steps of 8 / 10 / 13 ms; resampled to 10 ms.",
    "run2: time steps of 2 / 10 / 12 ms; resampled to 10 ms.",
    "Caution: torque is computed from current.",
    "Next time: record one motion twice.",
)


def cause(name: str, joint: int, **about: object) -> Cause:
    size = Size(name="c", unit="N m", value=1.5, std=0.1)
    return Cause(effect=name, joints=(joint,), how_sure=0.9, share=0.1, **numbers(size),
                 remedy="Set it in the simulator, or clean the joint.", **about)  # fmt: skip


def answer(n: int, causes: tuple[Cause, ...], **about: object) -> Answer:
    joints = tuple(
        JointError(joint=j, name=f"arm_{j}_joint", before=9.0, after=8.0 - j / 4, noise=(0.1, 0.2))
        for j in range(n)
    )
    judged = {"on": ("run9",), "how": "held out"}
    return Answer(status="explained", error="the gap", unit="N m", **errors(20.0, 9.0, **judged),
                  noise=(0.1, 0.2), closed=0.5, joints=joints, causes=causes, **about)  # fmt: skip


def law(joint: int) -> FrictionLaw:
    """Of viscous and Coulomb friction."""
    names = ("viscous_friction", "coulomb_friction")
    details = tuple(FrictionDetail(detail=x, effects=(x,), how_sure=0.999) for x in names)
    at = tuple(FrictionAt(v, x, 0.1, -x, 0.1) for v, x in ((0.1, 1.2), (0.5, 1.9), (2.0, 3.4)))
    return FrictionLaw(joint=joint, how_sure=0.995, share=0.2, removes=(1.0,), unit="N m",
                       speed_unit="rad/s", details=details, at=at)  # fmt: skip


def lines_of(screen: Screen, width: int) -> list[str]:
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(screen)
    return console.export_text().splitlines()


@given(
    names=st.lists(st.sampled_from(sorted(KINDS)), min_size=0, max_size=12, unique=True),
    n=st.integers(1, 30),
    width=st.integers(60, 160),
    hints=st.booleans(),
)
@example(sorted(KINDS)[:9], 7, 60, False)
def test_a_screen_is_a_screen(names: list[str], n: int, width: int, hints: bool) -> None:
    """Whatever is found on however many joints: no more lines than fit, none longer than the
    terminal is wide, and the joint with the largest error in them."""
    causes = tuple(
        cause(name, j) for k, name in enumerate(names) for j in range(1 + (n - 1) % (k + 1))
    )
    suspects = tuple(cause("backlash", j) for j in range(n)) if hints else ()
    laws = tuple(map(law, range(n))) if hints else ()
    given_answer = answer(n, causes[:60], suspects=suspects, friction=laws)
    model = model_words(given_answer, "corrected.yaml", "robot.urdf")
    lines = lines_of(Screen(answer=given_answer, band=20.0, warnings=WARNINGS, model=model), width)
    shared = len(given_answer.shared())
    assert len(lines) <= MOST_LINES + 3 * max(0, shared - 3)
    assert all(len(line) <= width for line in lines)
    assert any(line.startswith("1 arm_0") for line in lines)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_rows_have_values_and_hints(width: int) -> None:
    """A named cause has its value and how sure it is; a joint without one says what may help."""
    given_answer = answer(
        3, (cause("backlash", 0),), suspects=(cause("joint_spring", 1),),
        small=(cause("time_delay", 2),),
    )  # fmt: skip
    text = " ".join(" ".join(lines_of(Screen(answer=given_answer), width)).split())
    for part in (
        "backlash 1.50 ± 0.10 N m (90 %)", "perhaps joint spring 1.50 ± 0.10 N m (90 %)",
        "small: time delay 1.50 ± 0.10 N m (90 %)",
        "Do first: backlash, joint 1 (10 % of the error): set it in the simulator, or clean",
    ):  # fmt: skip
        assert part in text, (part, text)


def test_what_all_joints_share_is_one_line_with_a_value_a_joint() -> None:
    causes = tuple(cause("viscous_friction", j) for j in range(3))
    lines = lines_of(Screen(answer=answer(3, causes)), 100)
    assert "all joints: viscous friction 1.5, 1.5, 1.5 N m (90 %)" in lines


def test_a_cause_of_a_hundredth_of_the_error_is_no_step_however_sure() -> None:
    """It is listed at its joint. A single cause is a step however small."""
    large, little = cause("backlash", 0), cause("end_stop", 1)
    little = msgspec.structs.replace(little, share=0.01, how_sure=0.999, remedy="Move the stop.")
    assert [s.split(",")[0] for s in first_steps(answer(2, (little, large)))] == ["backlash"]
    assert [s.split(",")[0] for s in first_steps(answer(2, (little,)))] == ["end stop"]


def test_what_takes_most_is_first_however_unsure() -> None:
    """The corrected model closes most by a term that has no sure name."""
    named = msgspec.structs.replace(cause("backlash", 0), share=0.04)
    held = [msgspec.structs.replace(cause("torque_gain", 1), share=x) for x in (0.2, 0.5)]
    one = msgspec.structs.replace(answer(2, (named,), suspects=(*held,)), unnamed=0.8)
    steps = first_steps(one)
    assert [s.split(":")[0] for s in steps] == [
        "to settle torque gain on joint 2", "backlash, joint 1 (4 % of the error)",
    ]  # fmt: skip
    small = msgspec.structs.replace(one, unnamed=0.01)
    assert [s.split(",")[0] for s in first_steps(small)] == ["backlash"]


def test_cautions_are_merged() -> None:
    lines = lines_of(Screen(answer=answer(2, ()), warnings=WARNINGS), 100)
    assert lines[-3:] == [
        "! Next time: record one motion twice.",
        "! Caution: torque is computed from current.",
        "! run1 and run2: time steps of 2 to 8 / 10 / 12 to 13 ms; resampled to 10 ms.",
    ]


def test_which_model_to_use() -> None:
    some = answer(2, (cause("backlash", 0),))
    assert model_words(some, "c.yaml", "r.urdf") == (
        "Use c.yaml, confirmed on run9: error 9 N m, as given 20. Export: torchid export c.yaml "
        "--to urdf --out exported"
    )
    assert "--save-model" in model_words(some, None, "r.urdf")
    push = cause("contact", 0, window=Window(trajectory="run9", from_s=3.0, to_s=3.4))
    beside = "error 9 N m (beside contact of this log alone), as given 20."
    assert beside in model_words(answer(2, (push,)), "c.yaml", "r.urdf")
    # An error without a sure cause is no reason to use a file as it is.
    unsure = msgspec.structs.replace(answer(2, ()), status="detected_unexplained")
    assert model_words(unsure, None, "r.urdf") == (
        "This log gives no model that is surely better: r.urdf errs 20 N m on run9, and no "
        "cause of it is sure."
    )


@pytest.mark.parametrize("status", ["no_gap", "negligible"])
@pytest.mark.parametrize(
    ("noise", "measured", "said"),
    [
        ((15.0, 19.0), True, "Use r.urdf as it is: its error of 20 N m is noise (15 to 19)."),
        ((5.0, 6.0), True, "no better model than r.urdf, which errs 20 N m (noise 5 to 6)."),
        ((15.0, math.nan), False, "than r.urdf, which errs 20 N m (noise >= 15)."),
        ((0.0, 30.0), False, "than r.urdf, which errs 20 N m (noise 0 to 30)."),
    ],
)
def test_a_file_is_used_as_it_is_where_its_error_is_noise(status, noise, measured, said) -> None:
    right = msgspec.structs.replace(
        answer(2, ()), status=status, noise=noise, noise_measured=measured
    )
    assert model_words(right, None, "r.urdf").endswith(said)


@pytest.mark.parametrize(
    ("label", "short"),
    [
        ("2 shoulder_lift_joint", "2 shoulder_lift"),
        ("2 elbow", "2 elbow"),
        ("3 joint_of_the_elbow_here", "3 of_the_elbow_here"),
    ],
)
def test_a_long_name_loses_what_says_nothing(label: str, short: str) -> None:
    assert short_label(label, 19) == short


def test_bars_are_on_one_scale() -> None:
    widths = [len(bar(b, a, 8.0)) for b, a in itertools.product((8.0, 4.0, 0.1), (0.1, 8.0))]
    assert widths == [8, 8, 4, 4, 0, 0]
    assert bar(8.0, 2.0, 8.0) == "██░░░░░░"


def test_the_screen_needs_no_torch() -> None:
    program = "import sys, torchid.report.explain; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
    assert done.stdout == b"False\n"


@pytest.mark.parametrize("width", [60, 80, 120])
def test_friction_of_a_joint_is_one_entry(width: int) -> None:
    """Several terms of it are a law, whose remedy is said once for all joints."""
    names = ("viscous_friction", "coulomb_friction")
    causes = tuple(cause(name, j) for j in range(3) for name in names)
    given_answer = answer(3, causes, friction=tuple(map(law, range(3))))
    text = " ".join(" ".join(lines_of(Screen(answer=given_answer), width)).split())
    assert text.count("friction 1.2, 1.9, 3.4 N m at 0.1, 0.5, 2 rad/s (> 99 %)") == 3
    assert "Do first: friction, all joints (60 % of the error): give the simulator" in text
    assert "Coulomb" not in text.partition("RMS error")[2]
