"""Sentences of the stored answers follow from their numbers."""

import io
import itertools
import json
import math
import re

import msgspec
import pytest
from rich.console import Console

from tests.golden.answers import STORED
from torchid.effects.registry import KINDS
from torchid.report.brief import Screen, model_words
from torchid.report.page.answer import cause_line, first_steps
from torchid.results.answer import LARGEST, Answer, cause_cells
from torchid.results.cause import LINK, Cause, Error, common_name, remedy_of
from torchid.results.record import decode
from torchid.results.words import digits, sure

DOCUMENTS = {
    file.stem: data
    for file in sorted(STORED.glob("*.json"))
    if (data := json.loads(file.read_text())).get("answer")
}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
RIDDLES = ("…", "...", "unknown", "as listed below", "no known effect", "which:", "removed")
"""Words that nobody should have to look up, and signs that something was cut."""
FIELDS = re.compile(r"\bto (-?\d[\d., -]*)")
"""Numbers that a field is told."""


def answer_of(document: dict) -> Answer:
    """Remedies are not stored: those of the library."""
    answer = decode(json.dumps(document["answer"]).encode(), Answer, "a stored answer")
    put = msgspec.structs.replace
    causes = [
        put(c, remedy=KINDS[c.effect].remedy if c.effect in KINDS else f"Mend the {c.effect}.")
        for c in answer.causes
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
        assert after in text
        assert answer.after.words in text
        assert before in NUMBER.findall(text)
    assert answer.after.whole in answer.title
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


def test_a_step_takes_something_away_of_data_that_were_not_fitted(answer: Answer) -> None:
    steps = first_steps(answer)
    if not answer.confirmed:
        assert "Use m.yaml" not in model_words(answer, "m.yaml", "arm.urdf")
        return
    assert answer.after.how != "fitted"
    assert answer.after.value < answer.before.value
    assert steps
    for step in steps:
        same = [c for c in answer.entries if step.startswith(common_name(c, answer.entries))]
        assert sum(map(answer.takes, same)) > 0
        assert "(0 %" not in step


def test_without_a_fall_nothing_is_to_be_used(answer: Answer) -> None:
    """Where the error of the same answer stays, grows, is of fitted data, or a fault is sure."""
    put = msgspec.structs.replace
    before = answer.before
    for worse in (
        put(answer, after=before), put(answer, after=put(before, value=2 * before.value)),
        put(answer, after=put(answer.after, how="fitted")), put(answer, doubt="Wrong log: lag."),
    ):  # fmt: skip
        assert not worse.confirmed
        assert "Use m.yaml" not in model_words(worse, "m.yaml", "arm.urdf")
        for step, cause in itertools.product(first_steps(worse), worse.causes):
            assert not step.startswith(cause.name)
        if worse.status not in ("no_gap", "negligible"):
            assert worse.unconfirmed.startswith("not confirmed: ")


def test_no_cause_makes_it_worse(answer: Answer) -> None:
    assert not [c.effect for c in answer.causes if c.share <= 0]
    assert not answer.causes or answer.after.value < answer.before.value


def test_a_headline_has_the_three_largest_with_size_and_place(answer: Answer) -> None:
    if not answer.causes or answer.fails:
        return
    groups = sorted(
        answer.groups(answer.entries), key=lambda same: -math.hypot(*map(answer.takes, same))
    )
    for same in groups[:LARGEST]:
        assert answer.sized(same).lower() in answer.headline.lower()
        assert NUMBER.search(answer.sized(same))
        assert not same[0].at or answer.where(same) in answer.sized(same)
        if len(same) == 1 and same[0].known and same[0].law is msgspec.UNSET:
            assert same[0].known[0].rounded in answer.headline
    assert (f"{len(groups) - LARGEST} smaller" in answer.headline) == (len(groups) > LARGEST)
    assert not re.search(r"[(;] ?or ", answer.headline)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_screen_is_whole_and_plain(answer: Answer, width: int) -> None:
    """Nothing is cut by an ellipsis, no unit is 1, no bound is unknown."""
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(Screen(answer=answer, model=model_words(answer, "m.yaml", "arm.urdf")))
    text = " ".join(console.export_text().split())
    assert not [word for word in RIDDLES if word in text]
    assert not re.search(r"\d 1[,;) ]*$", text)


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
