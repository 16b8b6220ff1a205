"""`torchid study`: the report's studies as one command."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Output
from torchid.app.signature import Fields, Switch, command
from torchid.extraction.settings import Schedule
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
    engine: opt.Crew,
    output: Annotated[Output, Fields("json_file out report overwrite quiet threads"), "study.json"],
    device_name: opt.Device = "cpu",
) -> None:
    """Reproduce a study of the report: identify, extract six scenarios, classify, compare wrenches.

    Example: `torchid study kuka_lwr4 --quick --out study --report study.html`

    Args:
        name: 3r, 3r_friction, kuka_lwr4, kuka_lwr4_friction, all; or a study's yaml file.
        quick: A fifth of the runs, stages and generations.
    """
    from msgspec import structs

    from torchid.files import make_folder
    from torchid_study.settings import load_study, study_file, study_names

    names = study_names() if name == "all" else [name]
    changed = {key: value for key, value in vars(instead).items() if value is not None}
    every = []
    for settings in map(load_study, names):
        search = settings.search
        if quick:
            # 5: a fifth, of which some is left
            least = {"runs": 4, "stages": 4, "generations": 10}
            small = {key: max(few, getattr(search, key) // 5) for key, few in least.items()}
            search = replace(search, **small)
        every.append(structs.replace(settings, search=replace(search, **changed)))
    from torchid.feasibility.sets import sets_record
    from torchid.parallel.workers import of
    from torchid.robot.library import load_robot
    from torchid_study.report.study import report_of_study, study_page
    from torchid_study.study import run_study

    studies = []
    for given, settings in zip(names, every, strict=True):
        file = output.report
        if name == "all" and file is not None:
            # Each study has a page of its own: report_3r.html beside report.html.
            file = file.with_name(f"{file.stem}_{settings.name}{file.suffix}")
        robot_entry = ("robot", settings.robot, robot_file(settings.robot))
        files = output.hashed([("study", given, study_file(given)), robot_entry])
        with output.progress() as progress:
            report = of(progress, settings.name)
            study = run_study(settings, device=device_name, workers=engine.crew, report=report)
        if output.out is not None:
            folder, robot = output.out / settings.name, load_robot(settings.robot)
            make_folder(folder)
            study.record.save(folder / "study.json")
            for part, sets in {"sets": study.best, "all_sets": study.every}.items():
                sets_record(sets, robot).save(folder / f"{part}.json")
        search = settings.search
        about = structs.asdict(settings) | {"search": asdict(search)}
        output.write_page(
            partial(study_page, study),
            file,
            files=files,
            seeds={"seed of the search": search.seed},
            settings=about,
        )
        output.finish()  # each study is whole by itself
        studies.append(study)
    records = [study.record.plain() for study in studies]
    together = {"schema": "torchid.studies/1", "studies": records}
    output.write_json(together if name == "all" else records[0], "study.json")
    for study in studies:
        output.tell(report_of_study(study))
        if output.out is not None:
            output.say(f"results of {study.record.study} are in {output.out / study.record.study}")
