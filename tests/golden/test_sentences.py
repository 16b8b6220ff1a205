"""Sentences of the stored answers follow from their numbers."""

import json
import re

import msgspec
import pytest

from tests.golden.answers import STORED
from torchid.effects.registry import KINDS
from torchid.report.brief import model_words
from torchid.report.page.answer import cause_line, first_steps
from torchid.results.answer import Answer, cause_cells
from torchid.results.cause import LINK, Cause, Error, remedy_of
from torchid.results.record import decode
from torchid.results.words import digits, sure

DOCUMENTS = {
    file.stem: data
    for file in sorted(STORED.glob("*.json"))
    if (data := json.loads(file.read_text())).get("answer")
}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
FIELDS = re.compile(r"\bto (-?\d[\d., -]*)")
"""Numbers that a field is told."""


def answer_of(document: dict) -> Answer:
    """Remedies are not stored: those of the library."""
    answer = decode(json.dumps(document["answer"]).encode(), Answer, "a stored answer")
    put = msgspec.structs.replace
    causes = [
        put(c, remedy=KINDS[c.effect].remedy if c.effect in KINDS else "") for c in answer.causes
    ]
    return put(answer, causes=tuple(causes))


@pytest.fixture(params=DOCUMENTS)
def answer(request) -> Answer:
    return answer_of(DOCUMENTS[request.param])


def sentences(answer: Answer) -> list[str]:
    """All that is said of how far the error shrinks."""
    return [answer.headline, model_words(answer, "m.yaml", "arm.urdf")]


def test_an_error_in_a_sentence_is_of_the_data_that_it_names(answer: Answer) -> None:
    before, after = digits(answer.before.value), answer.after.size
    if not answer.causes or not answer.after.value < answer.before.value:
        return
    for text in sentences(answer):
        assert f"{after} {answer.after.words}" in text
        assert before in NUMBER.findall(text)
    assert answer.title.endswith(answer.after.whole)
    # A table's errors are of the same data: their sum of squares, of positions their mean.
    moving = [j for j in answer.joints if j.after == j.after]
    squares = sum(j.after**2 for j in moving) ** 0.5
    mean = sum(j.after for j in moving) / len(moving)
    expected = mean if answer.of_positions else squares
    assert answer.after.value == pytest.approx(expected, rel=1e-6)


def test_errors_before_and_after_are_of_the_same_data(answer: Answer) -> None:
    before, after = answer.before, answer.after
    assert (before.on, before.how, before.unit) == (after.on, after.how, after.unit)
    assert before.unit == answer.unit
    if answer.left_out is not None:
        assert (after.how, answer.left_out.how) == ("held out", "left out in turn")


def test_an_error_of_held_out_data_that_is_far_above_is_the_headline(answer: Answer) -> None:
    if not answer.causes:
        return
    worse = Error(value=9e3, unit=answer.unit, on=("new",), how="held out")
    left = Error(value=1.0, unit=answer.unit, how="left out in turn")
    said = msgspec.structs.replace(answer, after=worse, left_out=left).headline
    assert said.startswith(f"The answer fails on new: there it errs 9000 {answer.unit}")
    held = msgspec.structs.replace(worse, value=1.9)
    assert "fails" not in msgspec.structs.replace(answer, after=held, left_out=left).headline


def test_no_field_is_told_a_negative_number(answer: Answer) -> None:
    told = [remedy_of([c]) for c in answer.causes] + first_steps(answer)
    for text in told:
        for numbers in FIELDS.findall(text):
            assert "-" not in numbers.replace("->", ""), text


def test_a_cause_has_one_probability(answer: Answer) -> None:
    """In the row, on the page, in the table of friction laws."""
    laws = {law.joint: law for law in answer.friction}
    for entry in answer.entries:
        assert cause_cells([entry])[1] == sure(entry.how_sure)
        assert cause_line(entry)[2] in ("", sure(entry.how_sure))
        own = [c for c in answer.causes if c.at == entry.at] if len(entry.at) == 1 else []
        law = laws.get(entry.at[0]) if own else None
        if law is not None and entry.effect != LINK and law.has(entry.effect):
            assert law.how_sure == entry.how_sure


@pytest.mark.parametrize("name", [n for n, d in DOCUMENTS.items() if "budget" in d])
def test_a_cause_is_one_wherever_it_stands(name: str) -> None:
    document = DOCUMENTS[name]
    causes = {(c["effect"], *c["located"]): c for c in document["answer"]["causes"]}
    for one in document["which"]:
        assert causes.pop((one["effect"], *one["located"])) == one
    assert all(c["effect"] == LINK and not c["joints"] for c in causes.values())


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


def test_a_stiffness_that_no_file_takes_is_no_field() -> None:
    spring = Cause(
        effect="joint_spring", joints=(0,), parameters={"k": -1.0, "c0": 0.1},
        std={"k": 0.2, "c0": 0.1}, unit={"k": "N m/rad", "c0": "N m"},
        remedy=KINDS["joint_spring"].remedy,
    )  # fmt: skip
    assert "-1" not in remedy_of([spring])
    assert "no field" in remedy_of([spring])
