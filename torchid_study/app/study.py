"""`torchid study`: the report's studies as one command."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Output
from torchid.app.signature import Fields, Switch, command
from torchid.extraction.settings import Schedule
from torchid.files import make_folder
from torchid.robot.config_files import robot_file


@dataclass(frozen=True)
class Changes:
    """What is changed of a study's search.

    Attributes:
        runs, stages, generations, schedule: Instead of the study's own.
        seed: Of the searches.
    """

    runs: int | None = None
    stages: int | None = None
    generations: int | None = None
    schedule: Schedule | None = None
    seed: Annotated[int | None, typer.Option(min=0, max=opt.LARGEST_SEED)] = None


@command
def study_command(
    *,
    name: Annotated[str, typer.Argument(metavar="NAME")],
    quick: Switch = False,
    instead: Changes,
    figures: bool = True,
    engine: opt.Crew,
    output: Annotated[Output, Fields("json_file out report overwrite quiet threads"), "study.json"],
    device_name: opt.Device = "cpu",
) -> None:
    """Reproduce a study of the report: identify, extract six scenarios, classify, compare wrenches.

    Example: `torchid study kuka_lwr4 --quick --out study --report study.html`

    Args:
        name: 3r, 3r_friction, kuka_lwr4, kuka_lwr4_friction, all; or a study's yaml file.
        quick: A fifth of the runs, stages and generations.
        figures: Draw the figures into --out.
    """
    out = output.out
    from torchid_study.settings import load_study, study_file, study_names

    names = study_names() if name == "all" else [name]
    changed = {key: value for key, value in vars(instead).items() if value is not None}
    every = []
    for given in names:
        settings = load_study(given).quick() if quick else load_study(given)
        every.append(replace(settings, search=replace(settings.search, **changed)))
    from torchid.parallel.workers import of
    from torchid_study.report.study import page
    from torchid_study.study import run_study

    crew = engine.crew
    studies = []
    for given, settings in zip(names, every, strict=True):
        folder, file = None if out is None else out / settings.name, output.report
        if name == "all" and file is not None:
            # Each study has a page of its own: report_3r.html beside report.html.
            file = file.with_name(f"{file.stem}_{settings.name}{file.suffix}")
        robot_entry = ("robot", settings.robot, robot_file(settings.robot))
        files = output.hashed([("study", given, study_file(given)), robot_entry])
        with output.progress() as progress:
            report = of(progress, settings.name)
            study = run_study(settings, device=device_name, workers=crew, report=report)
        if folder is not None:
            make_folder(folder)
            study.save(folder / "study.json")
            if figures:
                page.write_study(study, folder)
        about = page.seeds_and_settings(study)
        output.write_page(partial(page.study_page, study), file, files=files, **about)
        output.finish()  # each study is whole by itself
        studies.append(study)
    records = [study.plain() for study in studies]
    together = {"schema": "torchid.studies/1", "studies": records}
    output.write_json(together if name == "all" else records[0], "study.json")
    for study in studies:
        output.tell(page.report_of_study(study))
        if out is not None:
            name = study.settings.name
            output.say(f"results of {name} are in {out / name}")
