"""Tables and sentences of a diagnosis hold its numbers."""

import textwrap
from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from rich.console import Console

from tests.arms import mixed_arm
from tests.causes import errors, numbers
from tests.gap.diagnoses import FRICTION, OFFSET, VISCOUS, cause, diagnosis
from torchid.design.columns import Model
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.registry import KINDS
from torchid.gap.cause_records import body_cause, effect_cause
from torchid.gap.diagnosis import HowFar
from torchid.gap.record import Status
from torchid.report import gap
from torchid.report.diagnosis import report_of_diagnosis
from torchid.results.answer import COLUMNS, LINE, LINES, Answer, JointError, NotTestable
from torchid.results.cause import Cause, Size
from torchid.results.words import effect_words, listed, measure, percent


def text_of(d) -> str:
    console = Console(width=140, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    for part in report_of_diagnosis(d).parts:
        console.print(part)
    return " ".join(console.export_text().split())


def lines_of(screen, width: int) -> list[str]:
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(screen)
    return console.export_text().splitlines()


SENTENCES = {
    "no_gap": "No gap that this log can tell from noise: 0.105 N m (noise >= 0.0693). "
    "2 effects could not have been seen in it.",
    "parametric_only": "Inertia of link 3 (0.49 N m): error 0.617 -> 0.105 N m on motions left "
    "out (83 % less).",
    "explained": "0.61 N m Coulomb friction on joint 2: error 0.617 -> 0.105 N m on motions left "
    "out (83 % less).",
    "detected_unexplained": "0.61 N m Coulomb friction on joint 2: error 0.617 -> 0.105 N m on "
    "motions left out (83 % less; rest unexplained).",
    "not_testable": "This log cannot show what causes a gap: exactly a sum of base parameters.",
}


@pytest.mark.parametrize("status", SENTENCES)
def test_headline(status):
    assert diagnosis(status).answer.headline == SENTENCES[status]


def test_causes_that_close_nothing_are_not_confirmed():
    d = diagnosis("detected_unexplained")
    far = replace(d.how_far, rms_after=d.how_far.rms_before, closed=0.0, closed_ci95=(-0.1, 0.1))
    said = replace(d, how_far=far).answer.headline
    assert said == (
        "Not confirmed: 0.61 N m Coulomb friction on joint 2: error 0.617 -> 0.617 N m on motions "
        "left out."
    )


def test_headline_of_several_effects_names_those_that_close_most_in_three_lines():
    d = diagnosis(
        causes=(VISCOUS, FRICTION, OFFSET, body_cause((), share=0.1)),
    )
    assert d.answer.headline == (
        "0.61 N m Coulomb friction on joint 2, inertial parameters (0.062 N m), 0.2 N m s/rad "
        "viscous friction on joint 1 and 1 smaller: error 0.617 -> 0.105 N m on motions left out "
        "(83 % less)."
    )


def test_headline_of_one_effect_on_two_joints():
    other = cause(CoulombFriction(2), 0.3, 0.02, how_sure=0.999, share=0.9)
    answer = diagnosis(causes=(FRICTION, other)).answer
    said = "Coulomb friction on joints 2 and 3 (0.61, 0.3 N m): error "
    assert answer.headline.startswith(said)
    assert ("joints 2 and 3", "Coulomb friction 0.61, 0.3 N m") in [
        (row[0], row[4]) for row in answer.rows()
    ]


def test_headline_says_where_an_unexplained_gap_lies():
    said = diagnosis("detected_unexplained", causes=()).answer.headline
    assert said.startswith("No known effect explains the gap of 0.617 N m (noise >= 0.0693).")
    assert said.endswith("It is largest on joint 2.")


def test_headline_without_a_closed_fraction():
    d = diagnosis()
    far = HowFar(d.how_far.rms_before, d.how_far.rms_after, None, None)
    said = replace(d, how_far=far).answer.headline
    assert said.startswith("Not confirmed: 0.61 N m Coulomb friction on joint 2: error 0.617 -> ")


@given(
    names=st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=12, unique=True),
    joints=st.lists(st.integers(0, 6), min_size=1, max_size=7, unique=True),
    status=st.sampled_from(get_args(Status)),
    closed=st.none() | st.floats(-1.0, 1.0),
)
def test_a_headline_is_whole_and_a_row_has_all_cells(names, joints, status, closed):
    """Whatever is found: 240 characters, one cause at least, and every cause in the table."""
    causes = tuple(
        Cause(
            effect=name,
            joints=(j,),
            **numbers(Size(name="c", unit="N m", value=1.0, std=0.1)),
            how_sure=0.9,
            ambiguous_with=("time_delay", "backlash"),
            share=0.1,
            remedy="Do it, as follows.",
        )
        for name in names
        for j in joints
    )
    rows = tuple(
        JointError(joint=j, name=f"arm_{j}", before=9.0, after=8.0 - j, noise=(0.1, 0.2))
        for j in range(7)
    )
    answer = Answer(
        status=status, error="the gap", unit="N m", **errors(5.0, 1.0), noise=(0.1, 0.2),
        closed=closed, joints=rows, causes=causes,
    )  # fmt: skip
    lines = len(textwrap.wrap(answer.headline, LINE))
    assert lines <= LINES or ", " not in answer.headline.partition(":")[0]
    assert "…" not in answer.headline
    cells = answer.rows()
    assert all(len(row) == len(COLUMNS) for row in cells)
    text = " ".join(row[4] for row in cells)
    assert all(c.name.partition(" of ")[0] in text for c in causes)
    # The largest remaining error first.
    assert [row[0].split()[0] for row in cells if row[1]] == list("1234567")


def test_tables_hold_the_numbers():
    text = text_of(
        diagnosis(
            causes=(VISCOUS, FRICTION, body_cause((2,), share=0.1)),
        )
    )
    for part in (
        "reversal 64 % [55, 71]",
        "rest 40 % [10, 60]",
        "Fc = 0.61 ± 0.02 N m",
        "Fv = 0.20 ± 0.10 N m s/rad",
        "power law friction",
        "90 %",
        "> 99 %",
        "40 %",
        "inertia of link 3",
        CoulombFriction.meaning[:20],
        "joint 2: its value rises with the cut-off",
        "2 0.61 0.07 >= 0.04 98 % reversal",
        "closed beyond noise: 93 % [90, 95]; base parameters 2 %, effects 93 %, unexplained 5 %",
        "1: at no size",
        "3: 0.4 N m",
        "too small beside the noise",
        "slow and fast",
    ):
        assert part in text, part
    assert "slow drift" not in text  # p = 0.6


@pytest.mark.parametrize("width", [60, 80, 120])
def test_one_screen_says_it_all(width):
    """Joint, error before and after with its unit, cause, value, how sure, and what to do."""
    lines = lines_of(
        report_of_diagnosis(diagnosis(causes=(VISCOUS, FRICTION, OFFSET))).screen, width
    )
    worst = next(k for k, line in enumerate(lines) if line.split()[:1] == ["2"])
    row = " ".join(" ".join(lines[worst : worst + 2]).split())
    for part in ("0.61 -> 0.07", "Coulomb friction 0.61", "(> 99 %)"):
        assert part in row, (part, row)
    assert "[N m]" in " ".join(lines)
    text = " ".join(" ".join(lines).split())
    assert "Do first: Coulomb friction, joint 2 (90 % of the error): set the joint's dry" in text


def test_tables_of_every_status_are_drawn():
    for status in SENTENCES:
        text = text_of(diagnosis(status))
        assert ("causes of the error" in text) == (status not in ("no_gap", "not_testable"))


def test_joints_of_one_reason_share_a_line():
    same = tuple(
        NotTestable("rotor_inertia", (j,), 0.1 * (j + 1), "kg m^2", "hidden") for j in range(3)
    )
    assert "1: 0.1 kg m²; 2: 0.2 kg m²; 3: 0.3 kg m²" in text_of(diagnosis(not_testable=same))


def test_reasons_that_differ_in_a_number_share_a_line():
    two = (
        NotTestable("rotor_inertia", (0,), None, "kg m^2", "only 0.27 % of it is its own"),
        NotTestable("rotor_inertia", (1,), None, "kg m^2", "only 1.3 % of it is its own"),
    )
    text = text_of(diagnosis(not_testable=two))
    assert "1, 2: at no size only 0.27 to 1.3 % of it is its own" in text


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.93, "93 %"), (0.998, "99.8 %"), (1.0, "100 %"), (0.002, "0.2 %"), (float("nan"), "-")],
)
def test_percent(value, expected):
    assert percent(value) == expected


def test_remarks_say_where_the_noise_is_from():
    said = gap.remarks(diagnosis().record)
    assert "below 20 Hz" in said[0]
    assert "The noise is estimated from the residual" in said[0]


def test_remarks_say_what_stands_at_the_end_of_its_range():
    note = "a is at the end of its range: what lies beyond was not looked at"
    d = diagnosis(causes=(structs.replace(FRICTION, notes=(note,)),))
    assert f"Coulomb friction on joint 2: {note}." in gap.remarks(d.record)


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (0.6123, 0.0234, "0.61 ± 0.02 N m"),
        (0.6123, 0.0134, "0.612 ± 0.013 N m"),
        (12.34, 1.2, "12.3 ± 1.2 N m"),
        (1234.0, 56.0, "1230 ± 60 N m"),
        (0.5, None, "0.5 N m"),
        (0.5, float("nan"), "0.5 N m"),
        (0.5, 0.0, "0.5 N m"),
    ],
)
def test_measure(value, std, expected):
    assert measure(value, std, "N m") == expected


def test_units_of_prismatic_joints():
    given = Model(mixed_arm("RPR"), ())
    slide = effect_cause((ViscousFriction(1), [0.2]), [0.1], given, given, 0)
    assert slide.sizes[0].named == "Fv = 0.20 ± 0.10 N s/m"


@pytest.mark.parametrize(
    ("words", "expected"),
    [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "c"], "a, b and c")],
)
def test_listed(words, expected):
    assert listed(words) == expected


def test_effect_words():
    assert effect_words("stribeck_friction") == "Stribeck friction"
    assert effect_words("encoder_offset 3") == "encoder offset on joint 3"
    assert effect_words("link_inertia 3") == "inertia of link 3"
