"""`torchid study`: the report's studies as one command."""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from torchid.app.options import LARGEST_SEED, Device, Json, Out, Quiet, Report, Threads, device
from torchid.app.output import Output, open_output, progress_bar
from torchid.app.page import Named, hashed, robot_input, write_report
from torchid.errors import TorchidError
from torchid.json_data import write_json

if TYPE_CHECKING:
    from torchid.report.page.origin import InputFile
    from torchid.study.result import Study
    from torchid.study.settings import StudySettings


def study_command(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="3r, 3r_friction, kuka_lwr4, kuka_lwr4_friction, all; or a study's yaml file.",
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="A fifth of the runs, stages and generations.")
    ] = False,
    runs: Annotated[int | None, typer.Option(help="Instead of the study's own.")] = None,
    stages: Annotated[int | None, typer.Option(help="Instead of the study's own.")] = None,
    generations: Annotated[int | None, typer.Option(help="Instead of the study's own.")] = None,
    schedule: Annotated[
        Literal["linear", "geometric"] | None, typer.Option(help="Instead of the study's own.")
    ] = None,
    engine: Annotated[
        Literal["batched", "cma"] | None, typer.Option(help="Instead of the study's own.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue from the checkpoints in --out.")
    ] = False,
    figures: Annotated[bool, typer.Option(help="Draw the figures into --out.")] = True,
    json_file: Json = None,
    out: Out = None,
    report: Report = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", min=0, max=LARGEST_SEED, help="Of the searches."),
    ] = None,
    quiet: Quiet = False,
    threads: Threads = None,
    device_name: Device = "cpu",
) -> None:
    """Reproduce a study of the report: identify, extract six scenarios, classify, compare wrenches.

    Example: `torchid study kuka_lwr4 --quick --out study --report study.html`
    """
    output = open_output(json_file, out, quiet, threads, report)
    from torchid.study.settings import load_study, study_names
    from torchid.study.study import remove_checkpoints

    if resume and out is None:
        raise TorchidError("--resume needs --out, where the checkpoints are.", expected="--out DIR")
    names = study_names() if name == "all" else [name]
    asked = {
        "runs": runs, "stages": stages, "generations": generations, "schedule": schedule,
        "engine": engine, "seed": seed,
    }  # fmt: skip
    all_settings = [_asked(load_study(n), quick, asked) for n in names]
    where = device(device_name)
    records = []
    for given, settings in zip(names, all_settings, strict=True):
        folder = None if out is None else out / settings.name
        own = output if name != "all" else _page_of(settings.name, output)
        files = hashed(own, [_study_input(given), robot_input(settings.robot)])
        found = _run(settings, folder, resume, where, own)
        records.append(_finish(found, folder, figures, own))
        _report(found, own, files)
    output.write_json(
        records[0] if name != "all" else {"schema": "torchid.studies/1", "studies": records},
        "study.json",
    )
    # Not sooner: of several studies, the first ones need not be searched again.
    for settings in all_settings:
        if out is not None:
            remove_checkpoints(settings, _checkpoints(out / settings.name))


def _checkpoints(folder: Path) -> Path:
    return folder / "checkpoints"


def _asked(settings: "StudySettings", quick: bool, asked: dict[str, Any]) -> "StudySettings":
    settings = settings.quick() if quick else settings
    given = {key: value for key, value in asked.items() if value is not None}
    return replace(settings, search=replace(settings.search, **given))


def _run(
    settings: "StudySettings", folder: Path | None, resume: bool, where: str, output: Output
) -> "Study":
    from torchid.study.study import run_study

    checkpoints = None
    if folder is not None:
        checkpoints = _checkpoints(folder)
        checkpoints.mkdir(parents=True, exist_ok=True)
    with progress_bar(output) as progress:
        return run_study(
            settings,
            checkpoints=checkpoints,
            resume=resume,
            device=where,
            report=None
            if progress is None
            else (lambda part, done, total: progress(f"{settings.name}: {part}", done, total)),
        )


def _finish(found: "Study", folder: Path | None, figures: bool, output: Output) -> dict[str, Any]:

    from rich.markup import escape

    from torchid.report.study.report import headline, tables, write_study
    from torchid.study.record import record

    for table in tables(found):
        output.say(table)
    output.warn(found.warnings)
    output.say(f"\n{escape(headline(found))}\n")
    data = record(found)
    if folder is not None:
        write_json(data, folder / "study.json")
        if figures:
            write_study(found, folder)
        output.say(f"results of {found.settings.name} are in {folder}")
    return data


def _page_of(name: str, output: Output) -> Output:
    """Of several studies, each has a page of its own: report_3r.html beside report.html."""
    page = output.page_file
    own = None if page is None else page.with_name(f"{page.stem}_{name}{page.suffix}")
    return replace(output, page_file=own, started=time.monotonic())


def _study_input(name: str) -> Named:
    from torchid.study.settings import study_file

    return "study", name, study_file(name)


def _report(found: "Study", output: Output, files: "Sequence[InputFile]") -> None:
    from torchid.report.page.study import study_page

    s = found.settings
    motions = {
        "excitation": s.excitation, "validation": s.validation, "sets' motion": s.sets_motion,
        "reference motion": s.wrench_motion,
    }  # fmt: skip
    write_report(
        output,
        lambda origin: study_page(found, origin),
        files=files,
        seeds={"seed of the search": s.search.seed}
        | {f"seed of the {name}": motion.seed for name, motion in motions.items()},
        settings={
            "effects": s.effects,
            "geometry": s.geometry,
            "total mass [kg]": s.total_mass,
            "search": _without_seed(asdict(s.search)),
            **{name: _without_seed(asdict(motion)) for name, motion in motions.items()},
            "seconds": dict(found.seconds),
        },
    )


def _without_seed(data: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key != "seed"}
