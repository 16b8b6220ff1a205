"""Runs that agree, and runs that contradict the others, are told apart and said."""

import math

import msgspec
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.causes import numbers
from torchid.results.agreement import MotionScale, agreement, by_cause, disagreement
from torchid.results.cause import Cause, Size
from torchid.results.replication import agreement_of, of_few_runs, replication_of

FRICTION = Cause(
    effect="coulomb_friction",
    joints=(1,),
    **numbers(Size(name="Fc", unit="N m", value=0.5, std=0.02)),
)
STEPS = st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=6)


def runs_of(*factors: float, std: float = 0.02, cause: Cause = FRICTION):
    scales = [MotionScale(f"run{k}", 0.0, 8.0, x, std) for k, x in enumerate(factors, start=1)]
    return msgspec.structs.replace(cause, replication=replication_of(scales))


def odd_of(rows) -> list[str]:
    return [r.run for r in rows if r.verdict == "differs"]


@given(STEPS)
def test_runs_within_a_deviation_of_each_other_agree(steps):
    rows = agreement_of([runs_of(*(1 + 0.02 * x for x in steps))])
    assert not odd_of(rows)
    assert disagreement(rows) == ""
    assert agreement(rows).endswith("agree on 1 cause that more than one can tell.")


@given(STEPS.filter(lambda steps: len(steps) > 2), st.floats(0.6, 3.0), st.data())
def test_one_run_that_wants_another_size_is_named(steps, more, data):
    k = data.draw(st.integers(0, len(steps) - 1))
    factors = [1 + 0.02 * x + more * (i == k) for i, x in enumerate(steps)]
    rows = agreement_of([runs_of(*factors)])
    assert odd_of(rows) == [f"run{k + 1}"]
    assert disagreement(rows).startswith(f"run{k + 1} wants Coulomb friction on joint 2 of ")


def test_runs_that_agree_are_said_to_contradict_each_other_in_one_log_of_twenty():
    g = torch.Generator().manual_seed(3)
    drawn = 1 + math.hypot(0.1, 0.05) * torch.randn(400, 2, 3, generator=g, dtype=torch.float64)
    wrong = [
        bool(odd_of(agreement_of([runs_of(*x.tolist(), std=0.1) for x in log]))) for log in drawn
    ]
    assert 0.02 < sum(wrong) / len(wrong) < 0.08


def test_values_are_those_of_the_runs_alone_and_the_mean_has_their_spread():
    rows = agreement_of([runs_of(0.8, 0.8, 1.4, std=0.01)])
    assert [r.value for r in rows] == pytest.approx([0.4, 0.4, 0.7])
    assert [r.std for r in rows] == pytest.approx([0.005] * 3)
    assert rows[0].merged == pytest.approx(0.5, abs=1e-3)
    assert rows[0].spread == pytest.approx(3**0.5 / 10, rel=0.01)
    assert rows[0].merged_std == pytest.approx(rows[0].spread / 3**0.5, rel=0.01)


def test_what_the_model_knew_is_part_of_the_value():
    known = Size(name="Fc", unit="N m", value=0.5, std=0.02, was=0.3)
    cause = Cause(effect="coulomb_friction", joints=(1,), **numbers(known))
    rows = agreement_of([runs_of(1.0, 0.0, cause=cause)])
    assert [r.value for r in rows] == pytest.approx([0.5, 0.3])
    assert [r.wanted for r in rows] == [True, False]


def test_a_cause_is_of_few_runs_where_most_want_none_of_it():
    here = {("coulomb_friction", (1,))}
    assert of_few_runs([runs_of(0.0, 0.01, 3.0)]) == here
    assert of_few_runs([runs_of(0.0, 0.0, 0.01, 0.0, 2.5)]) == here
    for factors in ((1.0, 1.0, 1.0), (1.0, 1.0, 3.0), (1.0, 1.0, 0.0), (0.0, 2.0), (0.0, 1.0, 2.0)):
        assert not of_few_runs([runs_of(*factors)])


def test_where_no_most_of_the_runs_agree_all_differ():
    for factors in ((0.5, 1.5), (0.4, 0.4, 1.6, 1.6), (0.2, 1.0, 1.8)):
        rows = agreement_of([runs_of(*factors)])
        assert len(odd_of(rows)) == len(factors)
        text = f"from {rows[0].words} in run1 to {rows[-1].words} in run"
        assert text in disagreement(rows)


def test_a_run_that_can_not_tell_has_no_value():
    scales = [MotionScale(f"run{k}", 0.0, 8.0, x, s) for k, (x, s) in
              enumerate([(1.0, 0.02), (1.0, 0.02), (4.0, 0.6)], start=1)]  # fmt: skip
    rows = agreement_of([msgspec.structs.replace(FRICTION, replication=replication_of(scales))])
    last = rows[2]
    assert (last.verdict, last.wanted) == ("cannot tell", None)
    assert math.isnan(last.value)
    assert math.isnan(last.std)
    assert agreement(rows).startswith("run1 and run2 agree on 1 cause")


def test_nothing_is_said_of_one_run_or_of_what_has_no_size():
    parts = [MotionScale("run1", 10.0 * k, 10.0 * k + 10, x, 0.02) for k, x in enumerate((1, 3))]
    same = Size(name="Fc", unit="N m", value=0.5, std=0.02, was=0.5)
    bare = Cause(effect="link_inertia", joints=(1,))
    unchanged = Cause(effect="coulomb_friction", joints=(2,), **numbers(same))
    rows = agreement_of(
        [
            msgspec.structs.replace(FRICTION, replication=replication_of(parts)),
            FRICTION,
            runs_of(1, 3, cause=bare),
            runs_of(1, 3, cause=unchanged),
        ]
    )
    assert rows == ()
    assert agreement(rows) == ""


def test_sentences():
    offset = Cause(
        effect="torque_offset",
        joints=(0,),
        **numbers(Size(name="F0", unit="N m", value=0.2, std=0.01)),
    )
    rows = agreement_of([runs_of(0.9, 0.9, 1.4), runs_of(1.5, 1.5, 0.0, cause=offset)])
    assert len(by_cause(rows)) == 2
    assert disagreement(rows) == (
        "run3 wants Coulomb friction on joint 2 of 0.700 ± 0.010 N m, the others of 0.450 ± 0.007 "
        "N m; run3 wants no torque offset on joint 1, the others of 0.300 ± 0.003 N m, while run1 "
        "and run2 agree on everything. The corrected model is a mean of all: diagnose run3 apart."
    )
    assert disagreement(rows, most=1) == (
        "run3 wants Coulomb friction on joint 2 of 0.700 ± 0.010 N m, the others of 0.450 ± 0.007 "
        "N m; and 1 cause more, while run1 and run2 agree on everything. The corrected model is a "
        "mean of all: diagnose run3 apart."
    )
    rows = agreement_of([runs_of(0.0, 0.0, 3.0)])
    assert "of 1.500 ± 0.010 N m, the others none, while" in disagreement(rows)


def test_of_many_odd_runs_the_first_are_said():
    text = disagreement(agreement_of([runs_of(*[1.0] * 6, *[2.0] * 5)]))
    assert text.startswith("run7 wants Coulomb friction on joint 2 of 1.000 ± 0.010 N m, run8 ")
    assert "run9 wants" in text
    assert "run10 wants" not in text
    assert ", 2 runs more differ, the others of 0.500" in text
