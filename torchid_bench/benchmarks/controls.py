"""Controls: what is named of healthy arms of which nothing has changed. Right is: nothing new.

    python -m torchid_bench.benchmarks.controls [--data DATA] [--rows ur10e,emps] [--jobs 2] [--page docs/controls.md]

DATA holds the folders of public logs that the zoo reads; which logs are asked of which models is in
controls.yaml. A model is what a diagnosis of one log leaves, saved with that log beside it; it is
made once, and asked of every other log as its owner would ask. Results are kept below --work, so
that an interrupted run goes on while the diagnosis is the same. The exit code is 1 where something
new is named, or a diagnosis failed.
"""

import json
import re
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

import torchid
from torchid.errors import TorchidError
from torchid.inputs import as_log
from torchid.json_data import plain
from torchid.log.model import Log
from torchid.report.table import pipe_table
from torchid.results.answer import Diagnosis
from torchid.robot.model import Robot
from torchid.statistics.criteria import LIKELY
from torchid.yaml_data import parsed_yaml
from torchid_bench.benchmarks.runner import command, digest, results
from torchid_bench.benchmarks.zoo import DATA, ROOT, SURE, cell_of
from torchid_bench.withheld import run

TABLE = Path(__file__).with_suffix(".yaml")
ENDS = {run.ERROR: "exit 70", run.REFUSED: "refused", run.LATE: "out of time"}
"""What is said of a control without a diagnosis."""
SHOWN = 4
"""New names of a control that the page shows."""


@dataclass(frozen=True)
class Control:
    """One question whose right answer is that nothing is new.

    Attributes:
        arm: folder of its logs.
        kind: `PAIR`, `MODEL`, one of `ALTERED`, or in words what is special.
        model: log that the model is made of; empty where the robot's own file is asked.
        asked: log.
        span: what is taken of it [s]; nothing: all.
    """

    arm: str
    kind: str
    model: str
    asked: str
    span: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """`ur10e: est_30s_12harm, asked of val_ptp10`; `ur10e: est_30s_12harm, half the rate`."""
        logs = (x.removeprefix("log_") for x in dict.fromkeys((self.model, self.asked)) if x)
        return f"{self.arm}: {', asked of '.join(logs)}" + f", {self.kind}" * (self.kind != PAIR)


PAIR, MODEL = "pair", "made a model"
"""Kinds of controls: of two motions, and what comes before any."""


def controls_of(table: Mapping[str, Mapping[str, Any]]) -> Iterator[Control]:
    """All controls, those of pairs first."""
    for arm, own in table.items():
        yield from (Control(arm, PAIR, *pair) for pair in own.get("pairs", ()))
    for arm, own in table.items():
        yield from (Control(arm, kind, own["alone"], own["alone"]) for kind in ALTERED)
        if "standing" in own:
            model, log, *span = own["standing"]
            yield Control(arm, "standing", model, log, tuple(span))
        if "simulated" in own:
            yield Control(arm, "its simulator's own log", "", own["simulated"])


# Logs


def dropped(log: Log, robot: Robot) -> Log:
    """With a tenth of its samples lost, here and there."""
    kept = torch.rand(log.samples, generator=torch.Generator().manual_seed(0)) >= 0.1
    return log.select(kept)


def noisy(log: Log, robot: Robot) -> Log:
    """With white noise of a thousandth of each signal's standard deviation."""
    g = torch.Generator().manual_seed(0)
    return log.replace(**{
        name: x + 1e-3 * x.std(0) * torch.randn(x.shape, generator=g, dtype=torch.float64)
        for name, x in log.signals.items() if name in ("q", "dq", "tau")
    })  # fmt: skip


def renamed(log: Log, robot: Robot) -> Log:
    """From a file of another name, with other names of columns, joints in another order."""
    signals = {name: x for name, x in log.signals.items() if name in ("q", "dq", "tau")}
    columns = {"time": log.t} | {
        f"{joint}_{signal}": x[:, k]
        for signal, x in signals.items() for k, joint in reversed([*enumerate(robot.driven_names)])
    }  # fmt: skip
    lists = {s: ", ".join(f"{joint}_{s}" for joint in robot.driven_names) for s in signals}
    words = ",".join(["t=time", *(f"{signal}=[{names}]" for signal, names in lists.items())])
    with TemporaryDirectory() as folder:
        file = Path(folder) / "tuesday.csv"
        rows = torch.stack([*columns.values()], 1).numpy()
        np.savetxt(file, rows, "%.12g", ",", header=",".join(columns), comments="")
        return torchid.read_log(file, columns=words)


ALTERED: dict[str, Callable[[Log, Robot], Log]] = {
    "its own log": lambda log, robot: log,
    "a tenth of the samples lost": dropped,
    "half the rate": lambda log, robot: log.select(slice(None, None, 2)),
    "1e-3 noise": noisy,
    "other names": renamed,
}
"""What a log of the same motion may have become, by name."""


# Answers


def said(found: Diagnosis) -> dict[str, Any]:
    """What an answer names, and whether that is new: not called 'in both'."""
    answer = found.answer
    return {
        "headline": answer.headline,
        "since": answer.since or None,
        "names": [
            {
                "name": " ".join(f"{c.name} {c.place}".split()),
                "size": c.values(),
                "sure": c.how_sure,
                "share": plain(c.share),
                "new": c.when != "in both",
            }
            for c in (*answer.causes, *answer.suspects)
        ],
    }


def new_names(result: Mapping[str, Any], above: float = LIKELY) -> list[dict[str, Any]]:
    """What a control names that is new, and surer than that."""
    names = (x for x in result.get("names", ()) if x["new"] and x["sure"] is not None)
    return [x for x in names if x["sure"] > above]


def measured(
    control: Control, arm: Mapping[str, Any], folder: Path, model: Path, whole: Path, limit: float
) -> dict[str, Any]:
    """Ask a control, whose model is made before, or make that; what is said, or why nothing is.

    Args:
        control: what is asked.
        arm: its entry of the table.
        folder: of its logs.
        model: file, with its log beside it.
        whole: file for the whole answer.
        limit: CPU seconds.
    """
    making, file = control.kind == MODEL, model if control.model else folder / arm["robot"]
    settings = torchid.GapSettings(background=tuple(arm.get("background", ()) if making else ()))

    def answer() -> dict[str, Any]:
        if not file.exists():
            raise TorchidError("there is no model of the earlier log.")
        robot = torchid.load_robot(file)
        log = as_log(folder / f"{control.asked}.parquet", robot)
        log = log.with_torque(arm["gain"]) if "gain" in arm else log
        if control.span:
            log = log.select((log.t >= control.span[0]) & (log.t <= control.span[1]))
        log = ALTERED[control.kind](log, robot) if control.kind in ALTERED else log
        found = torchid.diagnose(robot, log, settings=settings)
        if making:
            found.write_corrected(model)
        return {**found.plain(), "said": said(found)}

    made = run.written_answer(run.Job(control.name, file, (), whole, settings, None, limit), answer)
    why = made.get("error", "").replace(f"{folder}/", "")
    return {"status": made["status"], "why": why, "seconds": made["seconds"]} | made.get("said", {})


# The page

HEAD = """# Controls

Healthy arms of which nothing has changed: a model is made of one log of an arm, saved, and asked of another log of the same
arm (`torchid_bench/benchmarks/controls.yaml`). Right is that nothing new is named. Made by

```
make controls
```

on torchid {version}. New is what the answer does not call 'in both'; without an earlier log it is all that it names. New
names have their size, how sure they are, and their share of the error; of more than {shown} the surest are shown. Names above
{likely:g} that are 'in both' are counted apart. Of an arm that stands a refusal is the right answer. CPU seconds are those of the
answer, of {limit:g} at most.
"""


def page_of(done: Mapping[Control, Mapping[str, Any]], every: list[Control], limit: float) -> str:
    """The page in Markdown: what all controls have in common, and a row a control."""
    marks = ["---", "---", "--:", "--:", "---", "--:", "--:"]
    return "\n".join((
        HEAD.format(version=torchid.__version__, shown=SHOWN, likely=LIKELY, limit=limit),
        *(f"{line}\n" for line in summary(done)),
        pipe_table(TITLES, [cells(*one) for one in done.items()], marks) + "\n",
        *(f"Not asked yet: {c.name}.\n" for c in every if c not in done),
    ))  # fmt: skip


TITLES = (
    "control", "outcome", f"new > {LIKELY:g}", f"> {SURE:g}", "new names", "in both", "CPU s",
)  # fmt: skip


def cells(control: Control, result: Mapping[str, Any]) -> tuple[object, ...]:
    """A row of the page."""
    names = sorted(new_names(result), key=lambda x: -x["sure"])
    shown = [
        f"{x['name']} ({x['size']}; {x['sure']:.2f}; {100 * (x['share'] or 0):.2g} %)"
        for x in names[:SHOWN]
    ]
    more = [f"{len(names) - SHOWN} more"] * (len(names) > SHOWN)
    both = sum(not x["new"] and (x["sure"] or 0) > LIKELY for x in result.get("names", ()))
    alone = control.model and "since" in result and result["since"] is None
    return (
        control.name,
        outcome_of(result) + ", no earlier log" * bool(alone),
        len(names),
        len(new_names(result, SURE)),
        cell_of("; ".join([*shown, *more]) or result["why"]),
        both,
        f"{result['seconds']:.0f}",
    )


def outcome_of(result: Mapping[str, Any]) -> str:
    """`named`, `silent`, `refused`, `exit 70` or `out of time`."""
    return ENDS.get(result["status"]) or ("named" if new_names(result) else "silent")


def summary(done: Mapping[Control, Mapping[str, Any]]) -> Iterator[str]:
    """A line of pairs, and one of all controls."""
    pairs = [r for control, r in done.items() if control.kind == PAIR]
    for words, some in (("pairs of other motions", pairs), ("controls", [*done.values()])):
        if some:
            ends = [outcome_of(r) for r in some]
            sure = sum(bool(new_names(r, SURE)) for r in some)
            counts = ", ".join(f"{ends.count(end)} {end}" for end in ENDS.values())
            seconds = [r["seconds"] for r in some]
            yield (
                f"**{len(some)} {words}: new names above {LIKELY:g} in {ends.count('named')}, "
                f"above {SURE:g} in {sure}; {counts}; CPU s median "
                f"{statistics.median(seconds):.0f}, worst {max(seconds):.0f}.**"
            )


def main(
    *,
    data: Path = DATA,
    rows: tuple[str, ...] = (),
    jobs: int = 1,
    limit: float = run.LIMIT,
    work: Path = ROOT / "build" / "controls",
    page: Path | None = None,
) -> int:
    """Make models of arms (all) and ask their controls, each for so many CPU seconds at most, and
    write the page of all that are kept below `work`."""
    if not data.is_dir():
        named = "TORCHID_REAL_DATA names one"
        print(f"Controls are skipped: no folder of real logs at {data} ({named}).")
        return 0
    arms = parsed_yaml(TABLE.read_text())
    if unknown := [name for name in rows if name not in arms]:
        print(f"no arm {', '.join(unknown)}; there are {', '.join(arms)}")
        return 2
    every = [c for c in controls_of(arms) if (data / c.arm).is_dir()]
    chosen = [c for c in every if c.arm in (rows or arms)]
    work, begun = work.resolve(), time.monotonic()

    def file(control: Control) -> Path:
        """Of a result; that of another question or of other code has another name."""
        given = [arms[control.arm].get(x) for x in ("robot", "background", "gain")]
        slug = re.sub(r"[^a-z0-9]+", "-", control.name.lower())
        return work / f"{slug}-{digest(run.source_digest(), limit, control, given)}.json"

    def model(control: Control) -> Control:
        """What makes the model that is asked."""
        return Control(control.arm, MODEL, "", control.model or control.asked)

    (work / "answers").mkdir(parents=True, exist_ok=True)
    for some in ([*dict.fromkeys(model(c) for c in chosen if c.model)], chosen):
        cases = {
            file(c).stem: (
                c, arms[c.arm], data / c.arm, file(model(c)).with_suffix(".yaml"),
                work / "answers" / file(c).name, limit,
            )
            for c in some
        }  # fmt: skip
        for c, (_, result) in zip(some, results(measured, cases, work, jobs=jobs), strict=True):
            words = f"{outcome_of(result)}; {result.get('headline') or result['why']}"
            print(f"{time.monotonic() - begun:6.0f} s  {c.name}: {words}", flush=True)
    done = {c: json.loads(file(c).read_text()) for c in every if file(c).exists()}
    print(*summary(done), sep="\n")
    if page:
        page.write_text(page_of(done, every, limit))
    return int(any(outcome_of(done[c]) in ("named", ENDS[run.ERROR]) for c in chosen))


if __name__ == "__main__":
    command(main)
