"""`torchid withheld`: check the diagnosis on data whose cause was withheld from it."""

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import open_output, progress_bar
from torchid.errors import TorchidError

PLANTED = ("coulomb_friction", "load_dependent_friction", "cogging")
"""Effects that are planted by default: a step, one that scales with load, a periodic one."""

withheld_app = typer.Typer(
    name="withheld",
    no_args_is_help=True,
    help="Check the diagnosis on data whose cause was withheld from it.",
)

SetArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="A set of cases, from `torchid withheld make`.")
]
RequiredSeed = Annotated[
    int,
    typer.Option("--seed", min=0, max=opt.LARGEST_SEED, help="Seed that all cases are drawn from."),
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", min=1, help="Processes, of one thread each (default: all cores)."),
]
Again = Annotated[
    bool,
    typer.Option("--again", help="Replace answers of another torchid, or with other settings."),
]
Keys = Annotated[
    Path | None,
    typer.Option("--keys", metavar="FILE", help="What was planted (default: DIR.keys.json)."),
]


@withheld_app.command("make")
def make_command(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the set.")],
    cases: Annotated[int, typer.Option("--cases", min=1, max=9999, help="Number of cases.")],
    seed: RequiredSeed,
    keys: Keys = None,
    jobs: Jobs = None,
    json_file: opt.Json = None,
    quiet: opt.Quiet = False,
) -> None:
    """Simulate arms with planted effects, independently of torchid, and seal what was planted.

    Example: `torchid withheld make --out cases --cases 200 --seed 4711`
    """
    output = open_output(json_file, None, quiet)
    from torchid.withheld.case_set import keys_beside
    from torchid.withheld.make import make

    sealed = keys_beside(out) if keys is None else keys
    with progress_bar(output) as progress:
        made = make(out, cases, seed, keys=sealed, jobs=processes(jobs), progress=progress)
    output.say(f"{cases} cases in {out}, keys in {sealed}")
    output.say(f"SHA-256 of the keys: {made.keys_sha256}")
    output.write_json(
        {"folder": str(out), "keys": str(sealed), "keys_sha256": made.keys_sha256, "seed": seed},
        "make.json",
    )


@withheld_app.command("run")
def run_command(
    folder: SetArgument,
    rollout: Annotated[
        bool,
        typer.Option(
            "--rollout/--no-rollout",
            help="Simulate short motions with the model before and after; no score needs it.",
        ),
    ] = False,
    again: Again = False,
    jobs: Jobs = None,
    json_file: opt.Json = None,
    quiet: opt.Quiet = False,
) -> None:
    """Diagnose every case of a set; no key is read. What is answered already stays.

    Example: `torchid withheld run cases --jobs 2`
    """
    output = open_output(json_file, None, quiet)
    from torchid.withheld.case_set import read_cases
    from torchid.withheld.run import ERROR, default_settings, jobs_of, run

    found = read_cases(folder)
    todo = jobs_of(found, default_settings(rollout=rollout))
    with progress_bar(output) as progress:
        answers = run(todo, jobs=processes(jobs), again=again, progress=progress)
    failed = {case: a["error"] for case, a in answers.items() if a["status"] == ERROR}
    output.say(f"{len(answers) - len(failed)} of {len(answers)} cases diagnosed in {folder}")
    output.warn(tuple(f"{case}: {error}" for case, error in failed.items()))
    statuses: dict[str, int] = {}
    for answer in answers.values():
        statuses[answer["status"]] = statuses.get(answer["status"], 0) + 1
    output.write_json({"folder": str(folder), "statuses": statuses, "errors": failed}, "run.json")


@withheld_app.command("score")
def score_command(
    folder: SetArgument,
    keys: Keys = None,
    baselines: Annotated[
        bool, typer.Option("--baselines/--no-baselines", help="Three simple methods beside ours.")
    ] = True,
    oracle: Annotated[
        bool,
        typer.Option("--oracle/--no-oracle", help="The diagnosis that is told what is there."),
    ] = True,
    truth: Annotated[
        bool,
        typer.Option(
            "--truth/--no-truth",
            help="Simulate cases again without noise: how far gaps are really closed.",
        ),
    ] = True,
    partial: Annotated[
        bool, typer.Option("--partial", help="Leave out cases that have no answer yet.")
    ] = False,
    jobs: Jobs = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    quiet: opt.Quiet = False,
) -> None:
    """Open the keys and score the answers, beside simple methods and one that is told.

    Example: `torchid withheld score cases --keys cases.keys.json --out result`
    """
    output = open_output(json_file, out, quiet)
    from torchid.files import atomic_write
    from torchid.report.withheld import headline, markdown, score_table
    from torchid.report.withheld_figures import figures
    from torchid.withheld.case_set import keys_beside, read_answers, read_cases, read_keys
    from torchid.withheld.compare import baseline_answers, oracle_answers
    from torchid.withheld.summary import require_answers, summary
    from torchid.withheld.truth import true_shares

    found = read_cases(folder)
    opened = read_keys(found, keys_beside(folder) if keys is None else keys)
    answers = read_answers(found)
    require_answers(found, answers, partial=partial)
    with progress_bar(output) as progress:
        count = processes(jobs)
        simple = baseline_answers(found, tuple(answers), count, progress) if baselines else None
        told = oracle_answers(found, opened, tuple(answers), count, progress) if oracle else None
        true = true_shares(found, opened, answers, count, progress) if truth else None
    result = summary(found, opened, answers, baselines=simple, oracle=told, truly_closed=true)
    output.verdict(headline(result))
    output.say(score_table(result), f"SHA-256 of the keys: {result['keys_sha256']}, as sealed")
    output.write_json(result, "score.json")
    drawn = output.draw(lambda: figures(result))
    if out is not None:
        with atomic_write(out / "score.md") as text:
            text.write(markdown(result, drawn))
        output.say(f"written to {out}: {', '.join(['score.json', 'score.md', *drawn])}")


@withheld_app.command("leave-out")
def leave_out_command(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of cases, answers and the report.")
    ],
    seed: RequiredSeed,
    effects: Annotated[
        str, typer.Option(help="Effects to leave out in turn, comma-separated; `all`.")
    ] = "all",
    per_effect: Annotated[
        int, typer.Option("--per-effect", min=1, help="Cases of each effect.")
    ] = 1,
    again: Again = False,
    jobs: Jobs = None,
    json_file: opt.Json = None,
    quiet: opt.Quiet = False,
) -> None:
    """Take every effect out of the library in turn, and diagnose cases that have it.

    Example: `torchid withheld leave-out --out left-out --seed 4711 --per-effect 2`
    """
    output = open_output(json_file, out, quiet)
    from torchid.files import atomic_write
    from torchid.report.withheld import leave_out_headline, leave_out_markdown
    from torchid.withheld.leave_out import leave_out

    with progress_bar(output) as progress:
        result = leave_out(
            out,
            seed,
            effects=opt.searched(effects),
            per_effect=per_effect,
            jobs=processes(jobs),
            again=again,
            progress=progress,
        )
    output.say(leave_out_headline(result))
    output.write_json(result, "leave_out.json")
    with atomic_write(out / "leave_out.md") as text:
        text.write(leave_out_markdown(result))
    output.say(f"written to {out}: leave_out.json, leave_out.md")


@withheld_app.command("own")
def own_command(
    robot: opt.RobotArgument,
    logs: opt.LogArguments,
    held_out: opt.HeldOut = None,
    background: Annotated[
        str,
        typer.Option(metavar="A,B,C", help="As for `torchid gap`."),
    ] = "none",
    parameters: Annotated[
        Literal["trusted", "free", "auto"], typer.Option(help="As for `torchid gap`.")
    ] = "auto",
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    gain: opt.Gain = None,
    plant: Annotated[
        str,
        typer.Option(
            metavar="A,B,C", help="Effects of one joint to plant in the log; `none` for none."
        ),
    ] = ",".join(PLANTED),
    joints: Annotated[
        str, typer.Option(metavar="J1,J2,..|all", help="Joints where they are planted.")
    ] = "all",
    jobs: Jobs = None,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
) -> None:
    """Check the diagnosis on your own arm: withhold what it accepted, plant what is known.

    Every effect accepted on LOG... is taken out of the corrected model and sought again on logs
    that took no part (--held-out; else the second half of every trajectory). Then known effects are
    added to the measured torque, to see from which size on they are found.

    Example: `torchid withheld own panda.urdf run1.parquet run2.parquet --held-out run3.parquet`
    """
    output = open_output(json_file, out, quiet)
    from torchid.gap.settings import GapSettings
    from torchid.report.withheld import own_headline, own_tables
    from torchid.robot.library import load_robot
    from torchid.withheld.own import check_own, own_record

    places = None
    if joints.strip() != "all":
        parts = [part.strip() for part in joints.split(",")]
        if not all(part.isdigit() for part in parts):
            raise TorchidError("--joints takes numbers, separated by commas.", got=joints)
        places = [int(part) - 1 for part in parts]
    settings = GapSettings(background=opt.names(background), parameters=parameters, seed=seed)
    found = load_robot(robot, tip=tip)
    log, apart = opt.read_both(logs, held_out, gain, found, columns, topic)
    with progress_bar(output) as progress:
        result = check_own(
            found,
            log,
            untouched=apart,
            settings=settings,
            plant=opt.names(plant),
            joints=places,
            jobs=processes(jobs),
            progress=progress,
        )
    output.verdict(own_headline(result))
    output.say(*own_tables(result))
    if not result.whole:
        output.say("untouched data: the second half of every trajectory (--held-out for others)")
    output.write_json({**own_record(result), "seed": seed}, "own.json")


def processes(jobs: int | None) -> int:
    """The --jobs option; all cores that this process may use, by default."""
    if jobs is not None:
        return jobs
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
