"""Rules that what is said of an answer keeps, and how many answers break each.

    python -m tests.golden.sentences [-v] [FILE ...]

Without files those of `tests/golden/answers` and of `build/answers`, which the zoo, sealed cases
and public truths fill. A rule takes an answer and gives what is wrong with it, a sentence each.
"""

import io
import itertools
import json
import math
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console

from tests.documents import ROOT
from tests.golden.answers import STORED
from torchid.effects.registry import KINDS, glosses
from torchid.effects.servo import SERVO_KINDS
from torchid.report.brief import Screen, model_words
from torchid.report.page.answer import cause_line, first_steps
from torchid.results.answer import LARGEST, MOST_VALUES, Answer, cause_cells
from torchid.results.cause import LINK, WHENS, common_name, cut_line, remedy_of
from torchid.results.record import decode
from torchid.results.words import digits, effect_words, sure

KEPT = ROOT / "build" / "answers"
"""Answers of longer runs."""
MODEL, GIVEN = "m.yaml", "arm.urdf"
WIDTHS = (60, 80, 120)
HEADLINE = 3
"""Lines of a headline at 80 columns, at most."""
SCREEN = 25
"""Lines of a screen, with the command's and the files'."""
RIDDLES = (
    "…", "...", "unknown", "as listed below", "which:", "removed", "found in", "alone:",
)  # fmt: skip
"""Words that nobody should have to look up, and signs that something was cut."""
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
FIELDS = re.compile(r"\bto (-?\d[\d., -]*)")
"""Numbers that a field is told."""

GLOSSES = glosses((*KINDS, *SERVO_KINDS))
"""Names that are not everybody's."""

Breaks = Iterator[str]


def answer_of(document: dict[str, Any]) -> Answer:
    """Of a result's JSON. What the goldens do not store of causes is the library's."""
    plain = dict(document["answer"])
    for role in ("causes", "suspects", "small"):
        plain[role] = [
            {"remedy": KINDS[c["effect"]].remedy if c["effect"] in KINDS else "Mend it.", **c}
            for c in plain.get(role, ())
        ]
    answer = decode(json.dumps(plain).encode(), Answer, "a stored answer")
    return answer if answer.glosses else answer.explained_by(glosses)


def documents(files: list[Path]) -> dict[str, dict[str, Any]]:
    """Those that have an answer, by name."""
    every = {str(file): json.loads(file.read_text()) for file in sorted(files)}
    return {name: d for name, d in every.items() if isinstance(d, dict) and d.get("answer")}


def screen_of(answer: Answer, width: int, *warnings: str) -> str:
    """As a terminal shows it."""
    console = Console(width=width, record=True, file=io.StringIO())
    model = model_words(answer, MODEL, GIVEN)
    console.print(Screen(answer=answer, model=model, warnings=warnings))
    return console.export_text()


def numbers_are_of_their_data(answer: Answer, _: dict[str, Any]) -> Breaks:
    """Every error in a sentence is the one in the JSON, of the data that it names; those before and
    after are of the same data, of which the table's are, too."""
    before, after = answer.before, answer.after
    if (before.on, before.how, before.unit) != (after.on, after.how, after.unit):
        yield f"before is of {before.words}, after of {after.words}"
    if answer.left_out and (after.how, answer.left_out.how) != ("held out", "left out in turn"):
        yield f"{after.how} is held against {answer.left_out.how}"
    moving = [j for j in answer.joints if j.after == j.after]
    if answer.of_positions:
        whole = sum(j.after for j in moving) / max(len(moving), 1)
    else:
        whole = math.hypot(*(j.after for j in moving))
    if not math.isclose(whole, after.value, rel_tol=1e-6, abs_tol=1e-12):
        yield f"the table's errors make {whole:.4g}, and the answer says {after.value:.4g}"
    if after.whole not in answer.title:
        yield f"the table says '{answer.title}'"
    if answer.causes and after.value < before.value:
        for text in (answer.headline, model_words(answer, MODEL, GIVEN)):
            missing = [x for x in (after.size, after.words) if x not in text]
            missing += [x for x in (digits(before.value),) if x not in NUMBER.findall(text)]
            if missing:
                yield f"no {', '.join(missing)} in '{text}'"


def a_step_takes_something_away(answer: Answer, _: dict[str, Any]) -> Breaks:
    """Of data that were not fitted; without that nothing is to be done but to decide, and no file
    to be used."""
    steps, use = first_steps(answer), model_words(answer, MODEL, GIVEN)
    if not answer.confirmed:
        if f"Use {MODEL}" in use:
            yield f"not confirmed, and '{use}'"
        for step, cause in itertools.product(steps, answer.causes):
            if step.startswith(cause.name):
                yield f"not confirmed, and '{step}'"
        return
    if answer.after.how == "fitted" or not answer.after.value < answer.before.value:
        yield f"confirmed, and {answer.before.size} -> {answer.after.size} {answer.after.words}"
    if not steps:
        yield "confirmed, and nothing to do"
    main = answer.main_suspect
    if main is not None and not steps[0].startswith(f"to settle {main.name}"):
        yield f"most is perhaps {main.name}, and '{steps[0]}' is first"
    for step in steps[main is not None :]:
        entries = answer.entries
        same = [c for c in entries if step.startswith(common_name(c, entries))]
        if not sum(map(answer.takes, same)) > 0 or "(0 %" in step:
            yield f"it takes nothing away: '{step}'"


def no_field_is_told_a_negative_number(answer: Answer, _: dict[str, Any]) -> Breaks:
    for text in [remedy_of([c]) for c in answer.causes] + first_steps(answer):
        if any("-" in numbers.replace("->", "") for numbers in FIELDS.findall(text)):
            yield text


def what_takes_nothing_says_so(answer: Answer, _: dict[str, Any]) -> Breaks:
    """But where held-out data contradict all of them, which is the headline."""
    if answer.fails or not answer.confirmed:
        return
    for cause in answer.entries:  # forms of a joint's law may act against each other
        if cause.share <= 0 and "takes no error away" not in cause_cells((cause,))[0]:
            yield f"{cause.name} {cause.place} takes {cause.share:.2g}"
    if answer.causes and not answer.after.value < answer.before.value:
        yield f"{answer.before.size} -> {answer.after.size}"


def a_cause_has_one_probability(answer: Answer, document: dict[str, Any]) -> Breaks:
    """In the row, on the page, in the table of friction laws, and in `which`."""
    laws = {law.joint: law for law in answer.friction}
    for entry in answer.entries:
        said = {cause_cells([entry])[1], cause_line(entry)[2] or sure(entry.how_sure)}
        law = laws.get(entry.at[0]) if len(entry.at) == 1 else None
        if law is not None and entry.effect != LINK and law.has(entry.effect):
            said.add(sure(law.how_sure))
        if said != {sure(entry.how_sure)}:
            yield f"{entry.name} {entry.place}: {', '.join(sorted(said))}"
    whole = document["answer"]["causes"]
    for one in document.get("which", ()):
        if "located" not in one:  # of positions
            continue
        place = one["effect"], one["located"], one.get("window")
        same = [c for c in whole if (c["effect"], c["located"], c.get("window")) == place]
        if [c.get("how_sure") for c in same] != [one.get("how_sure")]:
            yield f"{one['effect']} in `which` is another than in the answer"


def the_headline_has_sizes_and_places(answer: Answer, _: dict[str, Any]) -> Breaks:
    """The largest causes, how many are smaller, and no rivals; three lines at 80 columns, and one
    for a doubt."""
    text = answer.headline
    lines = len(Console(width=80).render_lines(text.split("\n")[-1], pad=False))
    if lines > HEADLINE:
        yield f"{lines} lines: '{text}'"
    if not answer.causes or answer.fails:
        return
    if re.search(r"[(;] ?(or|likely) ", text):
        yield f"what is not sure: '{text}'"
    kinds = list(WHENS)
    groups = sorted(
        answer.groups(answer.entries),
        key=lambda same: (kinds.index(same[0].when), -math.hypot(*map(answer.takes, same))),
    )
    named = [
        same
        for same in groups
        if any(answer.sized(same, k).lower() in text.lower() for k in MOST_VALUES)
    ]
    if named != groups[: len(named)] or not (named or "perhaps " in text.lower()):
        yield f"not the largest: '{text}'"
    left = len(groups) - len(named)
    if left != sum(map(int, re.findall(r"\b(\d+) (?:smaller|more|causes?)\b", text))):
        yield f"not how many are smaller: '{text}'"
    if len(named) > LARGEST:
        yield f"too many: '{text}'"
    for same in named:
        if not NUMBER.search(answer.sized(same)):
            yield f"no size: '{answer.sized(same)}'"
        if same[0].at and answer.where(same) not in answer.sized(same):
            yield f"no place: '{answer.sized(same)}'"


def words_need_no_glossary(answer: Answer, document: dict[str, Any]) -> Breaks:
    """Nothing is cut by an ellipsis, no unit is 1, no bound is unknown; a name that is not
    everybody's has its gloss on the same screen."""
    warnings = document.get("warnings", ())
    for width in WIDTHS:
        text = " ".join(screen_of(answer, width, *warnings).split())
        text = re.sub(r"`\w+=\.\.\.`", "an option", text)
        for word in RIDDLES:
            if word in text:
                yield f"'{word}' at {width} columns: {text[max(text.index(word) - 40, 0) :][:80]}"
        for name, gloss in GLOSSES.items():
            if effect_words(name).lower() in text.lower() and gloss not in text:
                yield f"'{effect_words(name)}' has no gloss at {width} columns"
        if found := re.search(r"\d 1[,;) ]*$", text):
            yield f"a unit of 1: {found[0]}"
        if found := re.search(r"at ([\d.]+, )*([\d.]+), \2 rad/s", text):
            yield f"a speed twice: {found[0]}"


def an_event_has_its_time(answer: Answer, _: dict[str, Any]) -> Breaks:
    """And, unless something else comes first, the line that cuts it out."""
    text = " ".join(screen_of(answer, 120).split())
    for cause in answer.causes:
        if cause.window is not msgspec.UNSET and f"{cause.window.from_s:.1f}" not in text:
            yield f"{cause.name}: {cause.window.words}"
    cut = "" if answer.doubt or answer.fails else cut_line(answer.causes)
    if cut not in " ".join(first_steps(answer)):
        yield f"no line that cuts it out: {cut}"


def a_screen_is_one_screen(answer: Answer, document: dict[str, Any]) -> Breaks:
    for width in WIDTHS[1:]:
        lines = screen_of(answer, width, *document.get("warnings", ())).rstrip().count("\n") + 1
        if lines + 2 > SCREEN:
            yield f"{lines} lines at {width} columns"


RULES: dict[str, Callable[[Answer, dict[str, Any]], Breaks]] = {
    rule.__name__: rule
    for rule in (
        numbers_are_of_their_data, a_step_takes_something_away, no_field_is_told_a_negative_number,
        what_takes_nothing_says_so, a_cause_has_one_probability, the_headline_has_sizes_and_places,
        words_need_no_glossary, an_event_has_its_time, a_screen_is_one_screen,
    )
}  # fmt: skip


def main() -> int:
    given = [Path(name) for name in sys.argv[1:] if name != "-v"]
    every = documents(given or [*STORED.glob("*.json"), *KEPT.glob("*.json")])
    broken: dict[str, list[str]] = {name: [] for name in RULES}
    for file, document in every.items():
        answer = answer_of(document)
        for name, rule in RULES.items():
            found = list(rule(answer, document))
            broken[name] += [f"{Path(file).stem}: {text}" for text in found[:1]]
    print(f"{len(every)} answers")
    for name, texts in broken.items():
        print(f"{len(texts):4d} break: {name.replace('_', ' ')}")
        for text in texts if "-v" in sys.argv else ():
            print(f"       {text}")
    return int(any(broken.values()))


if __name__ == "__main__":
    sys.exit(main())
