"""The answer of a diagnosis on one screen of a terminal: at most `MOST_LINES` lines from 60 columns
on. It needs no torch, so that it is printed again at once."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from msgspec import UNSET
from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from torchid.errors import visible
from torchid.report.cautions import cautions
from torchid.report.page.answer import NAMED, first_steps, no_own_cause
from torchid.results.answer import Answer, JointRow, cause_cells, ordered
from torchid.results.cause import Cause
from torchid.results.words import count, digits, listed, span, sure
from torchid.statistics.criteria import EXCESS

MOST_LINES = 23
"""Of the screen; with the prompt's command and the files' line they are 25."""
MOST_JOINTS = 8
"""That have a row."""
CAUTION_LINES = 3
WIDE = 100
"""Columns from which noise and bars are shown."""
NAME = 18
"""Characters of a joint's name."""


@dataclass(frozen=True)
class Detail:
    """How much the screen says.

    Attributes:
        causes: of a joint that are listed.
        joints: that have a row.
        remedies: that are said.
        values: whether causes of a joint come with values.
        std: whether values come with standard deviations.
    """

    causes: int
    joints: int = MOST_JOINTS
    remedies: int = 1
    values: bool = True
    std: bool = True


_DETAILS = (
    Detail(9, remedies=2), Detail(9), Detail(2), Detail(1), Detail(1, std=False),
    Detail(1, 6, std=False), Detail(1, 5, std=False), Detail(1, 6, values=False),
    Detail(1, 5, values=False), Detail(1, 4, values=False), Detail(1, 3, 0, values=False),
    Detail(1, 2, 0, values=False), Detail(1, 1, 0, values=False),
)  # fmt: skip
"""From the most on; the first that fits is shown."""


@dataclass(frozen=True, kw_only=True)
class Screen:
    """The answer as a renderable of rich: headline, one row a joint, what joints share, what to do
    first, which model to use, and cautions.

    Attributes:
        answer: of a diagnosis.
        band: below which errors are counted [Hz]; None of positions.
        warnings: of the diagnosis, as they are.
        model: which model to use next, one sentence.
        robot: what a command line calls it.
        in_words: a warning of the library in the words of the command line.
    """

    answer: Answer
    band: float | None = None
    warnings: Sequence[str] = ()
    model: str = ""
    robot: str = "ROBOT"
    in_words: Callable[[str], str] = str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for detail in _DETAILS:
            parts = list(self._parts(detail, options.max_width))
            if sum(len(console.render_lines(part, options)) for part in parts) <= MOST_LINES:
                break
        yield from parts

    def _parts(self, detail: Detail, width: int) -> Iterator[Text | Table]:
        """From the headline to the cautions."""
        answer, rows, said = self.answer, self.answer.joint_rows(), list[str]()
        for line in answer.headline.split("\n"):
            yield Text(visible(line), "bold")
        if rows:
            band = f", below {digits(self.band)} Hz" if self.band else ""
            yield Text(visible(f"{answer.title}{band}"), "italic")
            cells = [self._cells(row, detail, width) for row in rows[: detail.joints]]
            said += (cell for row in cells for cell in row)
            yield self._table(cells, width)
            if rest := rows[detail.joints :]:
                left = max((r.error.after for r in rest if not r.never_moves), default=0.0)
                yield Text(
                    f"and {count(len(rest), 'more joint')}, {digits(left)} at most: --verbose"
                )
        for same in answer.shared():
            text, how_sure, _ = cause_cells(same)
            said.append(f"{answer.where(same)}: {text}{_bracket(how_sure)}")
            yield Text(visible(said[-1]))
        if legend := answer.legend(" ".join([answer.headline, *said])):
            yield Text(visible(legend), "italic")
        for k, step in enumerate(first_steps(answer, self.robot)[: detail.remedies]):
            yield Text(visible(f"{'Then' if k else 'Do first'}: {step}"))
        if self.model:
            yield Text(visible(self.model))
        yield from caution_lines([self.in_words(w) for w in self.warnings], width)

    def _table(self, cells: Sequence[Sequence[str]], width: int) -> Table:
        """One row a joint."""
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1), pad_edge=False)
        wide, given = width >= WIDE, self.answer.given.split(" (")[0]
        table.add_column("joint", no_wrap=True)
        table.add_column(f"{given} -> corrected" if wide else f"{given} -> now", no_wrap=True)
        if wide:
            table.add_column("noise", no_wrap=True)
            table.add_column("█ left ░ gone", no_wrap=True)
        table.add_column(
            "its own causes, value ± std (how sure)" if wide else "own cause (how sure)"
        )
        for row in cells:
            table.add_row(*(Text(visible(cell)) for cell in row))
        return table

    def _cells(self, row: JointRow, detail: Detail, width: int) -> list[str]:
        """Cells of the row of a joint."""
        answer, error, label = self.answer, row.error, short_label(row.label, NAME)
        if row.never_moves:
            return [label, "never moves"]
        cells = [label, f"{digits(error.before)} -> {digits(error.after)}"]
        if width >= WIDE:
            longest = max(j.before for j in answer.joints if not j.still)
            cells += [span(error.noise, 2), bar(error.before, error.after, longest)]
        said = "; ".join(_causes(row, detail)) or _may(row, detail) or no_own_cause(row, answer)
        return [*cells, said]


def _causes(row: JointRow, detail: Detail) -> list[str]:
    """Causes of a joint's row, those that remove most first; of those beyond a few the names, or
    how many."""
    causes = sorted(row.causes, key=lambda c: -c.share)
    shown = causes[: detail.causes]
    texts = [_named(c, detail) for c in shown]
    if more := [c.name for c in causes[detail.causes :]]:
        texts.append(f"also {', '.join(more)}" if len(more) <= NAMED else f"{len(more)} more")
    elif causes and detail.causes > len(causes) and (may := _may(row, detail)):
        texts.append(may)
    return texts


def _may(row: JointRow, detail: Detail) -> str:
    """What may lower what is left of a joint's error: a suspect, or an effect that is small."""
    every = [("perhaps", c) for c in row.suspects] + [("small:", c) for c in row.small]
    return next((f"{word} {_named(c, detail)}" for word, c in every), "")


def _named(cause: Cause, detail: Detail) -> str:
    """`torque gain 0.11 ± 0.02 (51 %)`."""
    values = f" {cause.values(detail.std)}{cause.rivals}".rstrip() if detail.values else ""
    return f"{cause.name}{values}{_bracket(sure(cause.how_sure))}"


def _bracket(how_sure: str) -> str:
    """` (82 %)`, where a probability is known."""
    return "" if how_sure == "-" else f" ({how_sure})"


def bar(before: float, after: float, longest: float) -> str:
    """`██░░░░░░`: what is left, and what the causes removed, on one scale."""
    # Characters of the longest bar
    bar_letters = 8
    whole = round(bar_letters * before / longest) if longest > 0 else 0
    left = min(whole, round(bar_letters * after / longest) if longest > 0 else 0)
    return "█" * left + "░" * (whole - left)


def short_label(label: str, length: int) -> str:
    """A joint's number and name; a long name without `joint`, then cut between its words."""
    if len(label) <= length:
        return label
    number, _, name = label.partition(" ")
    name = re.sub(r"[_ ]?joint(?=[_ ]|$)[_ ]?", "_", name).strip("_ ")
    label = f"{number} {name}".rstrip()
    return label[:length].rstrip("_ ")


def caution_lines(warnings: Sequence[str], width: int) -> Iterator[Text]:
    """The warnings that matter most, in at most `CAUTION_LINES` lines."""
    every, room, shown = cautions(ordered(warnings), len(warnings)), CAUTION_LINES, 0
    for text in every:
        lines = math.ceil((len(text) + 2) / (width - 1))
        last = room - lines <= 0 and shown + 1 < len(every)
        if lines > room or (last and lines + 1 > room):
            break
        room -= lines
        shown += 1
        yield Text.assemble(("! ", "yellow"), visible(text))
    if shown < len(every):
        more = count(len(every) - shown, "more caution")
        yield Text(f"! {more}: --verbose, or `torchid explain` of the JSON")


def model_words(answer: Answer, model: str | None, given: str, logs: str = "") -> str:
    """Which model to use next, and how much better it is on the data that judge it.

    Args:
        answer: of a diagnosis.
        model: file of the corrected model, or None where it was not kept.
        given: the robot's file or name.
        logs: options that name the logs again.
    """
    before, after = answer.before, answer.after
    if answer.status in ("no_gap", "negligible"):
        size, noise = before.size, span(answer.noise)
        if answer.noise_measured and before.value <= math.sqrt(EXCESS) * answer.noise[1]:
            return f"Use {given} as it is: its error of {size} is noise ({noise})."
        return f"This log gives no better model than {given}, which errs {size} (noise {noise})."
    if not answer.causes:
        errs = f"{given} errs" if answer.given == "as given" else "a plain servo errs"
        return (
            f"This log gives no model that is surely better: {errs} {before.size} {before.words}, "
            "and no cause of it is sure."
        )
    name, errs = model or "the corrected model", f"error {after.size}"
    # What happened once is no part of a model.
    if once := dict.fromkeys(c.name for c in answer.causes if c.window is not UNSET):
        errs += f" (beside {listed(once)} of this log alone)"
    whole = f"{answer.given} {digits(before.value)}"
    if not answer.confirmed:
        name = model or "The corrected model"
        return f"{name} is not confirmed: {errs} {after.words}, {whole}."
    text = f"Use {name}, confirmed {after.words}: {errs}, {whole}."
    if model is None:
        return f"{text} --save-model corrected.yaml keeps it."
    if not answer.of_positions:
        return f"{text} Export: torchid export {model} --to urdf --out exported"
    # A URDF has no servos; what an MJCF has no field for is refitted to the logs by others.
    words = f"torchid export {model} --to mjcf {logs} --out exported"
    return f"{text} Export: {' '.join(words.split())}"
