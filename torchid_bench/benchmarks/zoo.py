"""The zoo: logs of real arms, the commands that their owners would type, and whether the answer is right.

    python -m torchid_bench.benchmarks.zoo [--public] [--data DATA] [--rows emps,kuka] [--jobs 2] [--page docs/zoo.md]

DATA holds folders of public logs, which are not part of this project: most of their licences do not
allow it. What is known of them is in gap_truths.yaml, written from their sources before any run;
--public takes public_truths.yaml, whose labels are other people's, in the place of it. Each
command runs as a process of its own in a folder of links to the logs. Results are kept a row at a time
below --work, so that an interrupted zoo goes on while torchid's code is the same. The exit code is 1 where a command crashed, a good log
was refused, or an answer is surely wrong.
"""

import hashlib
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from torchid.report.table import pipe_table
from torchid.yaml_data import parsed_yaml
from torchid_bench.benchmarks.runner import command, digest, results

ROOT = Path(__file__).resolve().parents[2]
TRUTHS, PUBLIC = (Path(__file__).with_name(f"{name}_truths.yaml") for name in ("gap", "public"))
DATA = Path(os.environ.get("TORCHID_REAL_DATA") or ROOT.parent / "shared" / "data")
PUBLIC_DATA = Path(os.environ.get("TORCHID_PUBLIC_DATA") or ROOT / "build" / "public")
SURE = 0.9
"""Probability above which an answer claims a cause."""
UNKNOWN = ("detected_unexplained", "not_testable")
"""Statuses of an answer that has a gap, and that may have no cause for it."""
ANYTHING = "no known effect"
"""Name of what may be any effect."""
FAULT = 70
"""Exit code of a fault of torchid."""
ANSWER = "answer{}.json"
"""Where a row's k-th command writes its JSON."""
ANSWERS = ROOT / "build" / "answers"
"""Where those of diagnoses are kept for `python -m tests.golden.sentences`."""
VERDICTS = ("right", "honest", "missed", "wrong", "refused", "crash")
"""From the best to the worst; a row is as good as the worst of its truths."""
FAILS = ("wrong", "refused", "crash")


@dataclass(frozen=True)
class Truth:
    """What an answer has to say.

    Attributes:
        names: any of these says it.
        joints: from 1, at one of which it has to be; at all of them for `equal`; none: anywhere.
        of: parameter of which a value is known; empty where none is.
        value: that value, or the largest one for `at_most`.
        within: how exactly, as a share of the value.
        kind: `named`, `value`, `at_most` or `equal`.
    """

    names: tuple[str, ...]
    joints: tuple[int, ...] = ()
    of: str = ""
    value: float = 0.0
    within: float = 0.0
    kind: str = "named"

    def words(self, number: str = "") -> tuple[str, str]:
        """What it is of, and where with which number: `coulomb_friction Fc`, `2: 21 ± 1 (20)`."""
        of = "" if self.of in ("", self.names[0]) else f" {self.of}"
        joints = " ".join(map(str, self.joints))
        if not number:
            return f"{self.names[0]}{of}", joints
        known = f" ({self.value:.4g})" if self.kind in ("value", "at_most") else ""
        return f"{self.names[0]}{of}", f"{joints}: {number}{known}".removeprefix(": ")


@dataclass(frozen=True)
class Absent:
    """What is known not to be there: names, or all that no truth holds where there are none; at
    these joints, or anywhere where there are none."""

    names: tuple[str, ...] = ()
    joints: tuple[int, ...] = ()


@dataclass(frozen=True)
class Row:
    """One row of the zoo; see the head of gap_truths.yaml.

    Attributes:
        log: words for what is wrong with it; none of a good one.
        source, published: where its folder is from, and the best figure of others for its question.
    """

    name: str
    folder: str
    known: str
    commands: tuple[str, ...]
    log: tuple[str, ...] = ()
    truths: tuple[Truth, ...] = ()
    absent: tuple[Absent, ...] = ()
    files: tuple[tuple[str, str], ...] = ()
    source: str = ""
    published: str = ""


@dataclass(frozen=True)
class Claim:
    """What an answer says is there.

    Attributes:
        name: of an effect, a check, or a quantity.
        joints: from 1; none of the whole arm.
        sizes: value and standard deviation by name; None where none is known.
        sure: probability; 0 of what the answer leaves open.
        instead: names from which it cannot be told.
    """

    name: str
    joints: tuple[int, ...] = ()
    sizes: tuple[tuple[str, float, float | None], ...] = ()
    sure: float = 0.0
    instead: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """One command that ran.

    Attributes:
        command: as typed.
        exit: its code; negative for a signal; None where the time was over.
        seconds: of CPU, with its children.
        headline: the sentence that its user reads first.
        complaints: what it says against the log.
        trouble: the end of its standard error where it failed.
        claims: what it says; none where it wrote no answer.
    """

    command: str
    exit: int | None
    seconds: float
    headline: str = ""
    complaints: str = ""
    trouble: str = ""
    claims: tuple[Claim, ...] = ()


def _truths(entry: dict[str, Any]) -> Iterator[Truth]:
    """Truths of one entry: one a joint, but one of all joints where these are alike."""
    names, joints = tuple(entry["is"]), tuple(entry.get("joints", ()))
    of, within = entry.get("of", ""), float(entry.get("within", 0.0))
    if "equal" in entry:
        yield Truth(names, joints, of, 0.0, float(entry["equal"]), "equal")
        return
    kind = (
        "at_most" if "at_most" in entry else "value" if {"value", "values"} & {*entry} else "named"
    )
    values = entry.get("at_most", entry.get("values", entry.get("value", 0.0)))
    places: list[tuple[int, ...]] = [(j,) for j in joints] or [()]
    every = values if isinstance(values, list) else [values] * len(places)
    for place, value in zip(places, every, strict=True):
        yield Truth(names, place, of, float(value), within, kind)


def row_of(name: str, entry: dict[str, Any]) -> Row:
    """A row from its entry of the yaml.

    Raises:
        TypeError, KeyError, ValueError: the entry is not of the schema in the yaml's head.
    """
    unknown = {*entry} - {field.name for field in fields(Row)} - {"silent"}
    if unknown:
        raise ValueError(f"{name}: unknown keys {', '.join(sorted(unknown))}")
    absent = [
        Absent(() if a["names"] == "all" else tuple(a["names"]), tuple(a.get("joints", ())))
        for a in entry.get("absent", ())
    ]
    if entry.get("silent"):
        absent.append(Absent((), tuple(entry["silent"])))
    return Row(
        name=name,
        folder=entry["folder"],
        known=entry["known"],
        commands=tuple(entry["commands"]),
        log=() if entry["log"] == "good" else tuple(entry["log"]),
        truths=tuple(t for own in entry.get("truths", ()) for t in _truths(own)),
        absent=tuple(absent),
        files=tuple(entry.get("files", {}).items()),
        source=entry.get("source", "").strip(),
        published=entry.get("published", ""),
    )


def rows_of(truths: Path = TRUTHS) -> dict[str, Row]:
    """All rows of a file by name."""
    return {name: row_of(name, own) for name, own in parsed_yaml(truths.read_text()).items()}


# What an answer says


def claims(document: dict[str, Any]) -> tuple[Claim, ...]:
    """What a result's JSON says, in one form for all commands."""
    if "answer" in document:
        return (*_causes(document), *_servos(document))
    if "checks" in document:
        sure = {"wrong": 1.0, "doubtful": 0.5, "cannot tell": 0.0}
        named = [c for c in document["checks"] if c["verdict"] in sure]
        return tuple(Claim(c["name"], tuple(c["joints"]), (), sure[c["verdict"]]) for c in named)
    if "frames" in document:
        return _payload(document)
    return (*_identified(document), *_errors(document))


def _causes(document: dict[str, Any]) -> Iterator[Claim]:
    """Causes, as sure as they or their sets are, with the arm's values and their changes from the
    file's; suspects, small ones and those not testable are left open, and anything is where a gap is
    there that no known effect explains."""
    answer = document["answer"]
    for key in ("causes", "suspects", "small"):
        for c in answer[key]:
            value, file = c["parameters"], c["file"]
            sizes = tuple((x, value[x], std) for x, std in c["std"].items())
            sizes += tuple((f"{x} change", v - file[x], s) for x, v, s in sizes if x in file)
            sure = c["how_sure"] if key == "causes" and c["how_sure"] is not None else 0.0
            if sure and c["ambiguous_with"]:
                sure = max(sure, min(1.0, sum(c["probabilities"].values())))
            yield Claim(c["effect"], tuple(c["located"]), sizes, sure, tuple(c["ambiguous_with"]))
    for c in document.get("not_testable") or ():
        yield Claim(c["effect"], tuple(c["joints"]))
    if not answer["causes"] and answer["status"] in UNKNOWN:
        yield Claim(ANYTHING)


def _servos(document: dict[str, Any]) -> Iterator[Claim]:
    """Gains of servos; those that are ratios, or of joints that never move, are left open."""
    for j in document["where"]["joints"]:
        if "ratio_only" in j:
            if j["ratio_only"] or j["never_moves"] or j["kp"] is None:
                yield Claim("kp", (j["joint"],))
            else:
                low, high = j["kp_ci95"]
                std = None if low is None or high is None else (high - low) / 4
                yield Claim("kp", (j["joint"],), (("kp", j["kp"], std),), 1.0)


def _payload(document: dict[str, Any]) -> tuple[Claim, ...]:
    """The load, open where all of its numbers may be zero; numbers that no motion determines are
    open."""
    own = document["parameters"]
    sizes = tuple(
        (name, value, row[k] ** 0.5)
        for k, (name, value, row, known) in enumerate(
            zip(own["names"], own["value"], own["covariance"], own["determined"], strict=True)
        )
        if known and value is not None and row[k] is not None
    )
    seen = document["seen"] or any(abs(value) > 2 * std for _, value, std in sizes)
    unknown = [Claim("payload")] if not all(own["determined"]) else []
    return (Claim("payload", (), sizes, 1.0 if seen else 0.0), *unknown)


def _identified(document: dict[str, Any]) -> Iterator[Claim]:
    """Base parameters and friction, those that were estimated for sure; a coefficient that is held
    at a bound is open."""
    held = document["bounded"]
    for p in document["parameters"]:
        sure = 1.0 if p["estimated"] else 0.0
        yield Claim("base_parameter", (), ((p["name"], p["value"], p["std"]),), sure)
    for e in document["effects"]:
        for name, values in e["parameters"].items():
            every = zip(e["joints"], values, e["std"].get(name, [None] * len(values)), strict=True)
            for joint, value, std in every:
                sure = 0.0 if f"{name}{joint}" in held else 1.0
                yield Claim(e["effect"], (joint,), ((name, value, std),), sure)


def _errors(document: dict[str, Any]) -> Iterator[Claim]:
    """Shares of the torque that are missed [%]: of what was held out, else of the fit."""
    own = document.get("held_out") or document["fit"]
    for ending in ("", "_moving"):
        for k, value in enumerate(own[f"relative_error_percent{ending}"]):
            if value is not None:
                yield Claim(f"relative_error{ending}", (k + 1,), (("", value, None),), 1.0)


# Whether it is right


def _speaks_of(claim: Claim, truth: Truth) -> bool:
    """Whether a claim is of what a truth is of; one of the whole arm is of every joint."""
    here = not claim.joints or not truth.joints or bool({*claim.joints} & {*truth.joints})
    named = bool({claim.name, *claim.instead} & {*truth.names, ANYTHING})
    return here and named and (truth.of != "" or truth.kind != "value")


def _value(claim: Claim, name: str) -> tuple[float, float] | None:
    """A claim's number of that name, and its standard deviation (0 where none is known)."""
    for own, value, std in claim.sizes:
        if own == name and value is not None:
            return value, std or 0.0
    return None


def verdict_of_truth(truth: Truth, said: Sequence[Claim]) -> tuple[str, str]:
    """How an answer meets one truth, and the number that it gives.

    `right` is said above `SURE`, with a value within its tolerance; `honest` is said as one of a set,
    as a suspect or as what the log does not tell, or with an interval (95 %) that reaches the
    tolerance; `wrong` is a sure value outside of both; `missed` is not said at all.
    """
    if truth.kind == "equal":
        return _alike(truth, said)
    verdict, shown = "missed", ""
    for claim in (c for c in said if _speaks_of(c, truth)):
        of_it = claim.name in truth.names
        size = _value(claim, truth.of) if truth.kind in ("value", "at_most") else None
        if truth.kind in ("value", "at_most") and size is None and claim.sizes and truth.of:
            continue  # other numbers of the same thing
        own = "right" if of_it and claim.sure > SURE else "honest"
        if size is not None:
            text = f"{size[0]:.3g}" + (f" ± {size[1]:.2g}" if size[1] else "")
            if own == "right":
                own = _of_number(truth, *size)
            if own == "wrong" or not shown:
                shown = text
        elif truth.kind in ("value", "at_most"):
            own = "honest"
        if own == "wrong":
            return own, shown
        verdict = min(verdict, own, key=VERDICTS.index)
    return verdict, shown


def _of_number(truth: Truth, value: float, std: float) -> str:
    """Whether a number is determined and within its tolerance, or its interval reaches it."""
    room = truth.within * abs(truth.value)
    if truth.kind == "at_most":
        return "right" if value <= truth.value + room else "missed"
    off = abs(value - truth.value)
    if off <= room and std < abs(truth.value):
        return "right"
    return "honest" if off <= room + 2 * std else "wrong"


def _alike(truth: Truth, said: Sequence[Claim]) -> tuple[str, str]:
    """Whether numbers of several joints are the same, of those that are sure."""
    sure = [c for c in said if _speaks_of(c, truth) and c.sure > SURE]
    values = [v for c in sure if (v := _value(c, truth.of)) is not None]
    if not values:
        return ("honest" if any(_speaks_of(c, truth) for c in said) else "missed"), ""
    low, high = min(values), max(values)
    shown = f"{low[0]:.3g} to {high[0]:.3g}"
    if high[0] <= low[0] * (1 + truth.within):
        return ("right" if len(values) == len(truth.joints) else "honest"), shown
    reach = high[0] - 2 * high[1] <= (low[0] + 2 * low[1]) * (1 + truth.within)
    return ("honest" if reach else "wrong"), shown


def false_claims(row: Row, said: Sequence[Claim]) -> tuple[Claim, ...]:
    """What is named for sure and known not to be there. Of a set all has to be absent."""
    true = {name for t in row.truths for name in t.names}
    quantities = {"kp", "base_parameter", "relative_error", "relative_error_moving"}

    def absent(name: str, claim: Claim, rule: Absent) -> bool:
        named = name in rule.names if rule.names else name not in true | quantities
        if not rule.joints:
            return named
        return named and bool({*claim.joints} & {*rule.joints})

    return tuple(
        claim
        for claim in said
        if claim.sure > SURE
        and any(all(absent(n, claim, a) for n in (claim.name, *claim.instead)) for a in row.absent)
    )


def judged(row: Row, steps: Sequence[Step]) -> tuple[str, str]:
    """The verdict of a row, and why. A doctor that refuses a good log does not hide whether the
    answer after it is right: that is in the reason."""
    for step in steps:
        if step.exit is None:
            return "crash", f"no answer after {step.seconds:.0f} s"
        if step.exit < 0 or step.exit == FAULT or "Traceback" in step.trouble:
            return "crash", step.trouble
    last = steps[-1]
    verdict, parts = met(row, last.claims)
    failed = [s for s in steps if s.exit]
    if not row.log and failed:
        reason = failed[0].headline or failed[0].trouble
        return "refused", reason if last.exit else "; ".join([reason, *parts])
    if row.log:
        text = " ".join(f"{s.complaints} {s.trouble}" for s in steps).lower()
        if not any(word.lower() in text for word in row.log):
            return max(verdict, "missed", key=VERDICTS.index), "; ".join(
                [f"no word of {' or '.join(row.log)}", *parts]
            )
        if last.exit and not last.claims:
            return "right", "refused, as it should be"
    return verdict, "; ".join(parts)


def met(row: Row, said: Sequence[Claim]) -> tuple[str, list[str]]:
    """How an answer meets all truths of a row: the worst verdict, and phrases about them."""
    worst, parts = "right", []
    by: dict[str, dict[str, list[str]]] = {}
    count: Counter[str] = Counter()
    for truth in row.truths:
        own, shown = verdict_of_truth(truth, said)
        worst = max(worst, own, key=VERDICTS.index)
        what, where = truth.words(shown)
        by.setdefault(own, {}).setdefault(what, []).append(where)
        count[own] += 1
    if row.truths:
        parts.append(f"{count['right']} of {len(row.truths)} right")
    few = len(row.truths) <= 4
    for verdict in (("right",) if few else ()) + ("honest", "missed", "wrong"):
        if by.get(verdict):
            word = "open" if verdict == "honest" else verdict
            each = (f"{what} {_listed(where)}".strip() for what, where in by[verdict].items())
            parts.append(f"{word}: {'; '.join(each)}")
    if false := false_claims(row, said):
        worst = "wrong"
        parts.append(f"absent, named: {names(false)}")
    return worst, parts


def _listed(where: Sequence[str]) -> str:
    """Joints alone as `1 2 3`, with numbers as `1: 21 (20), 2: 33 (40)`."""
    return (", " if any(":" in w or "(" in w for w in where) else " ").join(where)


def names(said: Iterable[Claim]) -> str:
    """Names with their joints: `coulomb_friction 1 2 5, payload`; a set with `|`."""
    by: dict[str, list[int]] = {}
    for claim in said:
        key = " \\| ".join((claim.name, *claim.instead))
        by.setdefault(key, []).extend(claim.joints)
    return ", ".join(" ".join((name, *map(str, sorted(set(at))))) for name, at in by.items())


# Running


def run_row(row: Row, data: Path, work: Path, limit: float) -> tuple[Step, ...]:
    """Run a row's commands one after the other until one fails, in a folder of links; a doctor that
    finds something wrong ends nothing. The steps are without their claims."""
    folder = work / key(row)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # What is in a row's own folder counts more than a folder of that name beside it.
    others = (p for p in data.iterdir() if p.is_dir())
    linked = {p.name: p for p in (*others, *(data / row.folder).iterdir())}
    for name, file in linked.items():
        (folder / name).symlink_to(file.resolve())
    for name, text in row.files:
        (folder / name).write_text(text)
    steps: list[Step] = []
    for k, line in enumerate(row.commands):
        steps.append(run_command(line, folder, ANSWER.format(k), limit))
        if steps[-1].exit not in ((0, 1) if "doctor" in line else (0,)):
            break
    return tuple(steps)


def run_command(command: str, folder: Path, answer: str, limit: float) -> Step:
    """Run one command line of `torchid` in a folder, for at most so many seconds."""
    arguments = [sys.executable, "-m", *shlex.split(command), "--json", answer]
    before = _cpu_seconds()
    with subprocess.Popen(
        arguments, cwd=folder, text=True, start_new_session=True, env=os.environ | {"COLUMNS": "200"},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            out, err = process.communicate(timeout=limit)
            code: int | None = process.returncode
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # its children, too
            out, err = process.communicate()
            code = None
    seconds = _cpu_seconds() - before
    (folder / answer).with_suffix(".txt").write_text(out + err)
    file = folder / answer
    document = json.loads(file.read_text()) if file.exists() else {}
    return Step(
        command=command,
        exit=code,
        seconds=seconds,
        headline=_headline(file if document else None, document, out, err),
        complaints=_complaints(document),
        trouble=err[-1500:] if code != 0 else "",
    )


def _cpu_seconds() -> float:
    """CPU seconds of all children that ended so far, user and system."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _headline(file: Path | None, document: dict[str, Any], out: str, err: str) -> str:
    """A diagnosis' headline, the doctor's conclusion, the first paragraph of others, or the error."""
    if file is not None and "answer" in document:
        import torchid

        return str(torchid.load(file).answer.headline)
    if "conclusion" in document:
        return str(document["conclusion"])
    if not document:
        errors = [line for line in err.splitlines() if line.lower().startswith("error")]
        return (errors or err.splitlines()[-1:] or [""])[0]
    skipped = ("written", "For a simulator")
    lines = "\n".join(line for line in out.splitlines() if not line.startswith(skipped))
    return " ".join(lines.strip().split("\n\n")[0].split())


def _complaints(document: dict[str, Any]) -> str:
    """What an answer says against its log."""
    doubt = document.get("answer", {}).get("doubt", "")
    checks = [c for c in document.get("checks", ()) if c["verdict"] in ("wrong", "doubtful")]
    complaints = [f"{c['name']}: {c['evidence']}" for c in checks]
    return " ".join((doubt or "", *document.get("warnings", ()), *complaints))


@cache
def code() -> str:
    """A fingerprint of torchid's files: results of other code are not kept."""
    files = sorted(p for p in (ROOT / "torchid").rglob("*") if p.suffix in (".py", ".yaml"))
    return hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()


def key(row: Row) -> str:
    """Name of a row's result: that of other commands, other files or other code has another."""
    return f"{row.name}-{digest(code(), row.folder, row.commands, row.files)}"


def measured(row: Row, data: Path, work: Path, limit: float) -> list[dict[str, Any]]:
    """Run a row; its steps without their claims."""
    steps = run_row(row, data, work, limit)
    ANSWERS.mkdir(parents=True, exist_ok=True)
    name = f"{'public' if row.source else 'zoo'}_{row.name}"
    for k, asked in enumerate(row.commands[: len(steps)]):
        if " gap " in asked and steps[k].exit == 0:
            shutil.copy(work / key(row) / ANSWER.format(k), ANSWERS / f"{name}_{k}.json")
    return [{k: v for k, v in asdict(s).items() if k != "claims"} for s in steps]


def kept_steps(row: Row, work: Path) -> tuple[Step, ...]:
    """A row's result of this or an earlier run, its claims read from the answers that are kept
    beside it; none where there is none."""
    folder, file = work / key(row), work / f"{key(row)}.json"
    kept = json.loads(file.read_text()) if file.exists() else []
    answers = [folder / ANSWER.format(k) for k in range(len(kept))]
    claimed = [claims(json.loads(a.read_text())) if a.exists() else () for a in answers]
    return tuple(Step(**s, claims=c) for s, c in zip(kept, claimed, strict=True))


# The page

HEAD = """# {title}

Logs of real arms that nobody here made, the commands that their owners would type, and what is known of them from their
sources, written down before any run (`torchid_bench/benchmarks/{truths}`). Made by

```
{command}
```

on torchid {version}. CPU seconds are those of all commands of a row. A name counts from a probability of {sure:g}, on its joints; `|`
parts names of a set.

| verdict | meaning |
|---|---|
| right | the answer has all that is known, values within their tolerance, and nothing that is known to be absent |
| honest | it leaves the rest open: one of a set, a suspect, not testable, no known effect, an interval (95 %) that reaches the truth |
| missed | it lacks something that is known |
| wrong | it is sure of something that is known to be absent, or of a value outside of its tolerance |
| refused | a good log was refused |
| crash | a fault of torchid, or no answer in time |
"""


def page_of(
    measured_rows: dict[str, tuple[Row, tuple[Step, ...]]],
    every: Sequence[str],
    public: bool = False,
) -> str:
    """The page in Markdown; of public truths with what others publish, and their sources."""
    import torchid

    counts = dict.fromkeys(VERDICTS, 0)
    head = HEAD.format(
        title="Public truths" if public else "The zoo",
        truths=(PUBLIC if public else TRUTHS).name,
        command="python -m torchid_bench.benchmarks.zoo "
        + ("--public --page docs/public-truths.md" if public else "--page docs/zoo.md"),
        version=torchid.__version__,
        sure=SURE,
    )
    titles = ["row", "log", "known", "CPU s", "exit", "headline", "names above 0.9", "truths"]
    titles += ["published by others", "verdict"] if public else ["verdict"]
    body, total = [], 0.0
    for name, (row, steps) in measured_rows.items():
        verdict, why = judged(row, steps)
        counts[verdict] += 1
        seconds = sum(s.seconds for s in steps)
        total += seconds
        last = steps[-1]
        sure = [c for c in last.claims if c.sure > SURE]
        if any(c.name == "base_parameter" for c in sure):
            sure = []  # numbers of a fit are no names of causes
        why = "" if why == last.headline else why
        codes = " ".join("-" if s.exit is None else str(s.exit) for s in steps)
        cells = (name, row.folder, row.known, f"{seconds:.0f}", codes, cell_of(last.headline))
        others = (cell_of(row.published),) if public else ()
        body.append((*cells, names(sure), cell_of(why), *others, f"**{verdict}**"))
    marks = ["--:" if title == "CPU s" else "---" for title in titles]
    lines = [pipe_table(titles, body, marks)]
    listed = ", ".join(f"{n} {verdict}" for verdict, n in counts.items() if n)
    lines += ["", f"**{len(measured_rows)} rows: {listed}; {total:.0f} CPU s.**"]
    left = [name for name in every if name not in measured_rows]
    if left:
        lines += ["", f"Not measured yet: {', '.join(left)}."]
    if public:
        sources = dict.fromkeys(row.source for row, _ in measured_rows.values())
        lines += ["", "## Sources", "", "Folders of the one that `TORCHID_PUBLIC_DATA` names:", ""]
        lines += [f"- {source}" for source in sources]
    lines += ["", "## Commands"]
    for name, (row, _) in measured_rows.items():
        lines += ["", f"{name}:", "", "```", *row.commands, "```"]
    return head + "\n" + "\n".join(lines) + "\n"


def cell_of(text: str, longest: int = 400) -> str:
    """Text of a cell: one line, no markup, not endless."""
    one = " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")
    return one if len(one) <= longest else one[: longest - 1] + "…"


def main(
    *,
    public: bool = False,
    data: Path | None = None,
    rows: tuple[str, ...] = (),
    jobs: int = 1,
    limit: float = 3600.0,
    work: Path = ROOT / "build" / "zoo",
    page: Path | None = None,
) -> int:
    """Run rows (all), each command for so many seconds at most, and write the page of all rows that
    are kept below `work`."""
    data = data or (PUBLIC_DATA if public else DATA)
    if not data.is_dir():
        named = "TORCHID_PUBLIC_DATA" if public else "TORCHID_REAL_DATA"
        print(f"The zoo is skipped: no folder of real logs at {data} ({named} names one).")
        return 0
    every = rows_of(PUBLIC if public else TRUTHS)
    if unknown := [name for name in rows if name not in every]:
        print(f"no row {', '.join(unknown)}; there are {', '.join(every)}")
        return 2
    asked = {name: every[name] for name in rows or every if (data / every[name].folder).is_dir()}
    if absent := [name for name in rows or every if name not in asked]:
        print(f"Not there, so left out: {', '.join(absent)}.")
    work, started = work.resolve(), time.monotonic()
    cases = {key(row): (row, data, work, limit) for row in asked.values()}
    done = results(measured, cases, work, jobs=jobs)
    for row, _ in zip(asked.values(), done, strict=True):
        verdict, why = judged(row, kept_steps(row, work))
        print(f"{time.monotonic() - started:6.0f} s  {row.name}: {verdict}; {why}", flush=True)
    kept = {n: (row, steps) for n, row in every.items() if (steps := kept_steps(row, work))}
    if page:
        page.write_text(page_of(kept, list(every), public))
    return int(any(judged(*kept[name])[0] in FAILS for name in asked))


if __name__ == "__main__":
    command(main)
