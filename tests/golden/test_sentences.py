"""Sentences of the stored answers follow from their numbers, and each rule finds what breaks it."""

import itertools
import json

import msgspec
import pytest

from tests.golden import sentences
from tests.golden.answers import STORED
from tests.golden.sentences import GIVEN, MODEL, RULES, answer_of
from torchid.effects.registry import KINDS
from torchid.report.brief import model_words
from torchid.report.page.answer import first_steps
from torchid.results.answer import Answer
from torchid.results.cause import Cause, Error, Window, remedy_of

DOCUMENTS = {
    file.stem: data
    for file in sorted(STORED.glob("*.json"))
    if (data := json.loads(file.read_text())).get("answer")
}
put = msgspec.structs.replace


@pytest.fixture(params=DOCUMENTS)
def answer(request) -> Answer:
    return answer_of(DOCUMENTS[request.param])


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_stored_answer_keeps_every_rule(name: str, rule: str) -> None:
    document = DOCUMENTS[name]
    assert list(RULES[rule](answer_of(document), document)) == []


def some_answer(**changes: object) -> Answer:
    return put(answer_of(DOCUMENTS["friction_and_load"]), **changes)


def with_first(**changes: object) -> Answer:
    first, *others = some_answer().causes
    return some_answer(causes=(put(first, **changes), *others), friction=())


EVENT = Window("run1", 3.2, 4.1)
BROKEN = [
    ("numbers_are_of_their_data", some_answer(before=put(some_answer().before, how="fitted")), {}),
    ("numbers_are_of_their_data", some_answer(after=put(some_answer().after, value=0.04)), {}),
    ("numbers_are_of_their_data", some_answer(), {"model_words": "Use m.yaml: error 19 N m."}),
    ("a_step_takes_something_away", some_answer(), {"first_steps": ["backlash (0 % of it): x"]}),
    ("a_step_takes_something_away", some_answer(), {"first_steps": []}),
    ("a_step_takes_something_away", some_answer(doubt="Lag."), {"model_words": "Use m.yaml."}),
    ("a_step_takes_something_away", some_answer(doubt="Lag."), {"first_steps": ["payload: x"]}),
    ("no_field_is_told_a_negative_number", some_answer(), {"remedy_of": "Set it to -45 N m."}),
    ("what_takes_nothing_says_so", with_first(share=-0.2), {"cause_cells": ("load 3 kg", "", "")}),
    ("a_cause_has_one_probability", some_answer(), {"cause_cells": ("", "12 %", "")}),
    ("a_cause_has_one_probability", with_first(how_sure=0.6), {"cause_line": ("", "", "5 %", "")}),
    ("the_headline_has_sizes_and_places", some_answer(), {"headline": "Friction (or load): 3 N."}),
    ("the_headline_has_sizes_and_places", some_answer(), {"headline": 9 * "Payload and more. "}),
    ("the_headline_has_sizes_and_places", some_answer(), {"headline": "Coulomb friction."}),
    ("words_need_no_glossary", some_answer(), {"screen_of": "friction, payload and..."}),
    ("words_need_no_glossary", some_answer(), {"screen_of": "joint 2: cogging 3 N m"}),
    ("words_need_no_glossary", some_answer(), {"screen_of": "2, 3 N m at 0.2, 0.2 rad/s"}),
    ("an_event_has_its_time", with_first(window=EVENT), {"screen_of": "contact 3 N"}),
    ("a_screen_is_one_screen", some_answer(), {"screen_of": 30 * "a line\n"}),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "answer", "said"), BROKEN)
def test_a_rule_finds_what_breaks_it(rule, answer, said, monkeypatch) -> None:
    document = DOCUMENTS["friction_and_load"] | {"which": []}
    for name, text in said.items():
        if name == "headline":
            monkeypatch.setattr(Answer, name, property(lambda self, text=text: text))
        else:
            monkeypatch.setattr(sentences, name, lambda *_, text=text: text)
    assert list(RULES[rule](answer, document))
    assert {name for name, *_ in BROKEN} == set(RULES)


def test_an_error_of_held_out_data_that_is_far_above_is_the_headline(answer: Answer) -> None:
    if not answer.causes:
        return
    worse = Error(value=9e3, unit=answer.unit, on=("new",), how="held out")
    left = Error(value=1.0, unit=answer.unit, how="left out in turn")
    said = put(answer, after=worse, left_out=left).headline
    assert said.startswith(f"The answer fails on new: there it errs 9000 {answer.unit}")
    held = put(worse, value=1.9)
    assert "fails" not in put(answer, after=held, left_out=left).headline


def test_without_a_fall_nothing_is_to_be_used(answer: Answer) -> None:
    """Where the error of the same answer stays, grows, is of fitted data, or a fault is sure."""
    before = answer.before
    for worse in (
        put(answer, after=before), put(answer, after=put(before, value=2 * before.value)),
        put(answer, after=put(answer.after, how="fitted")), put(answer, doubt="Wrong log: lag."),
    ):  # fmt: skip
        assert not worse.confirmed
        assert f"Use {MODEL}" not in model_words(worse, MODEL, GIVEN)
        for step, cause in itertools.product(first_steps(worse), worse.causes):
            assert not step.startswith(cause.name)
        if worse.status not in ("no_gap", "negligible"):
            assert worse.unconfirmed.startswith("not confirmed: ")


@pytest.mark.parametrize(
    ("was", "is_now", "said"),
    [(60.0, 15.0, "60 -> 15.0 ± 0.5 N m s/rad"), (None, 15.0, "15.0 ± 0.5 N m s/rad")],
)
def test_what_the_file_has_stands_before_what_the_arm_has(was, is_now, said) -> None:
    cause = Cause(
        effect="viscous_friction", joints=(0,), parameters={"Fv": is_now}, std={"Fv": 0.5},
        unit={"Fv": "N m s/rad"}, file={} if was is None else {"Fv": was},
        remedy=KINDS["viscous_friction"].remedy,
    )  # fmt: skip
    assert cause.values() == said
    assert remedy_of([cause]) == "Set the joint's damping to 15 N m s/rad in the simulator."


def spring(joint: int, k: float, share: float) -> Cause:
    return Cause(
        effect="joint_spring", joints=(joint,), parameters={"k": k, "c0": 0.1},
        std={"k": 0.2, "c0": 0.1}, unit={"k": "N m/rad", "c0": "N m"}, share=share, how_sure=0.99,
        remedy=KINDS["joint_spring"].remedy,
    )  # fmt: skip


def test_a_stiffness_that_no_file_takes_is_no_field() -> None:
    assert "-1" not in remedy_of([spring(0, -1.0, 0.5)])
    assert "no field" in remedy_of([spring(0, -1.0, 0.5)])


def test_a_small_spring_without_a_field_takes_none_from_a_large_one() -> None:
    answer = some_answer(causes=(spring(0, -1.0, 0.01), spring(1, 18.0, 0.8)))
    (first,) = [step for step in first_steps(answer) if "spring" in step]
    assert "joint 2 (80 %" in first
    assert "to 18 N m/rad" in first
