"""Tables and sentences of a diagnosis hold its numbers."""

from dataclasses import replace

import pytest
import torch
from rich.console import Console

from tests.arms import mixed_arm
from tests.gap.diagnoses import FRICTION, OFFSET, VISCOUS, diagnosis
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.gap.diagnosis import HowFar
from torchid.gap.record import NotTestable, Parametric
from torchid.report.gap import remarks, tables
from torchid.report.gap_words import coefficients, effect_words, listed, measure, verdict
from torchid.report.table import percent
from torchid.simulation.two_models import Horizon, Rollout, TorqueGap


def text_of(d) -> str:
    console = Console(width=140, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    for table in tables(d):
        console.print(table)
    return " ".join(console.export_text().split())


SENTENCES = {
    "no_gap": "No gap: measured torque and the model of 3r differ by no more than noise "
    "(0.105 N m RMS over all joints; noise 0.0693 to 0.104). 2 effects could not have been seen "
    "in these data, on joints 1 and 3.",
    "parametric_only": "The inertial parameters of link 3 are wrong, and no other effect is "
    "needed; with corrected ones the gap shrinks by 93 % [90, 95].",
    "explained": "Joint 2 has Coulomb friction that the model lacks (0.61 ± 0.02 N m); with it "
    "the gap shrinks by 93 % [90, 95].",
    "detected_unexplained": "Part of the gap is unexplained (5 % of it); what is known: joint 2 "
    "has Coulomb friction that the model lacks (0.61 ± 0.02 N m); with it the gap shrinks by 93 % "
    "[90, 95]; what is left is no effect of the library.",
    "not_testable": "These data cannot show what causes a gap: exactly a sum of base parameters.",
}


@pytest.mark.parametrize("status", SENTENCES)
def test_verdict(status):
    assert verdict(diagnosis(status)) == SENTENCES[status]


def test_causes_that_close_nothing_are_not_told_as_known():
    d = diagnosis("detected_unexplained")
    far = replace(d.how_far, rms_after=d.how_far.rms_before, closed=0.0, closed_ci95=(-0.1, 0.1))
    said = verdict(replace(d, how_far=far))
    assert said.startswith("There is a gap, and the data fitted say joint 2 has Coulomb friction")
    assert said.endswith("so nothing is confirmed.")


def test_verdict_of_several_effects():
    d = diagnosis(findings=(VISCOUS, FRICTION, OFFSET), parametric=(Parametric((), 0.1, 0.01),))
    assert verdict(d) == (
        "The model lacks Coulomb friction on joint 2 (0.61 ± 0.02 N m), viscous friction on joint "
        "1 (0.20 ± 0.10 N m s/rad; or power law friction or time delay: these data cannot tell) "
        "and a torque offset on joint 3 (-0.13 N m), and the model's inertial parameters are wrong "
        "on the whole; with them the gap shrinks by 93 % [90, 95]."
    )


def test_verdict_of_one_effect_on_two_joints():
    other = replace(FRICTION, effect=CoulombFriction(2), joints=(2,), values=(0.3,))
    assert "Coulomb friction on joints 2 and 3 (0.61 ± 0.02 N m, 0.30 ± 0.02 N m)" in verdict(
        diagnosis(findings=(FRICTION, other))
    )


def test_verdict_of_an_effect_that_the_model_has():
    d = diagnosis()
    robot = replace(d.robot, effects=({"effect": "coulomb_friction", "joint": 2, "Fc": 0.3},))
    assert verdict(replace(d, robot=robot)).startswith(
        "The model's Coulomb friction of joint 2 is off (0.61 ± 0.02 N m)"
    )


def test_verdict_says_where_an_unexplained_gap_lies():
    said = verdict(diagnosis("detected_unexplained", findings=()))
    assert "no effect of the library explains" in said
    assert "joint 2 (98 % of it), at velocity reversals" in said


def test_verdict_without_a_closed_fraction():
    d = diagnosis()
    far = HowFar(d.how_far.rms_before, d.how_far.rms_after, None, None)
    assert "from 0.617 N m to 0.105 N m RMS" in verdict(replace(d, how_far=far))


def test_tables_hold_the_numbers():
    text = text_of(
        diagnosis(findings=(VISCOUS, FRICTION), parametric=(Parametric((2,), 0.1, 0.01),))
    )
    for part in (
        "velocity reversal 64 % [55, 71]",
        "transient 40 % [10, 60] at 12.2 s of run1; 1.0 s of run2",
        "Fc = 0.61 ± 0.02 N m",
        "Fv = 0.20 ± 0.10 N m s/rad",
        "power law friction",
        "90 %",
        "92 %",
        "> 99 %",
        "40 %",
        "inertia of link 3",
        CoulombFriction.meaning[:20],
        "joint 2: its value rises with the cut-off",
        "as given 0.08 0.61 0.05 0.617",
        "corrected 0.06 0.07 0.05 0.105",
        "2 % 93 % 5 % 93 % [90, 95]",
        "1: no size",
        "3: 0.4 N m",
        "too small beside the noise",
        "slow and fast",
    ):
        assert part in text, part
    assert "slow drift" not in text  # p = 0.6


def test_tables_of_every_status_are_drawn():
    for status in SENTENCES:
        text = text_of(diagnosis(status))
        assert ("which:" in text) == (status not in ("no_gap", "not_testable"))


def test_joints_of_one_reason_share_a_line():
    same = tuple(
        NotTestable("rotor_inertia", (j,), 0.1 * (j + 1), "kg m^2", "hidden") for j in range(3)
    )
    assert "1: 0.1 kg m^2; 2: 0.2 kg m^2; 3: 0.3 kg m^2" in text_of(diagnosis(not_testable=same))


def test_reasons_that_differ_in_a_number_share_a_line():
    two = (
        NotTestable("rotor_inertia", (0,), None, "kg m^2", "only 0.27 % of it is its own"),
        NotTestable("rotor_inertia", (1,), None, "kg m^2", "only 1.3 % of it is its own"),
    )
    text = text_of(diagnosis(not_testable=two))
    assert "1, 2: no size only 0.27 to 1.3 % of it is its own" in text


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.93, "93 %"), (0.998, "99.8 %"), (1.0, "100 %"), (0.002, "0.2 %"), (float("nan"), "-")],
)
def test_percent(value, expected):
    assert percent(value) == expected


def test_rollouts_are_told():
    d = diagnosis()
    rows = [
        Horizon(
            horizon_s=0.5, starts=8, ratio=0.31, ratio_ci95=(0.25, 0.4), diverged_before=0.1,
            diverged_after=0.0,
        ),
        Horizon(horizon_s=2.0, starts=0),
    ]  # fmt: skip
    rms = torch.ones(3, dtype=torch.float64)
    rollout = Rollout(
        starts=8, step_s=0.01, diverged_beyond=1.0, torque=TorqueGap(rms, rms, 1.0),
        horizons=tuple(rows), ignored_effects=(), fitted_on_these_data=False,
        sentences=("Too short for 2 s.",),
    )  # fmt: skip
    d = replace(d, how_far=replace(d.how_far, rollout=rollout))
    assert "0.5 s 0.31 [0.25, 0.40] 10 % 0 %" in text_of(d)
    assert "Too short for 2 s." in remarks(d)


def test_remarks_say_where_the_noise_is_from():
    said = remarks(diagnosis())
    assert "below 20 Hz" in said[0]
    assert "noise from the residual" in said[0]


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
    slide = replace(VISCOUS, effect=ViscousFriction(1), joints=(1,))
    assert coefficients(slide, mixed_arm("RPR")) == ["Fv = 0.20 ± 0.10 N s/m"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "c"], "a, b and c")],
)
def test_listed(words, expected):
    assert listed(words) == expected


def test_effect_words():
    assert effect_words("stribeck_friction") == "Stribeck friction"
