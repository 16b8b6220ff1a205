"""`torchid demo`: the whole promise on an arm whose faults are known."""

from pathlib import Path
from typing import Annotated

from torchid.app import options as opt
from torchid.app.output import Output
from torchid.app.signature import Fields, command


@command
def demo_command(
    *,
    seed: opt.Seed = 0,
    output: Annotated[Output, Fields("json_file", "quiet", "threads", out=Path("demo"))],
) -> None:
    """Examine the logs of a simulated 6R arm, identify it, name the causes of its gap, and compare
    them with a cause that was withheld. The report's robots: `torchid study kuka_lwr4 --quick`.

    Example: `torchid demo --out demo`

    Args:
        out: Folder for robot, logs, results and page.
        seed: Of the withheld cause, the motions and the noise.
    """
    from torchid.report import diagnosis
    from torchid.report.demo import introduction, report_of_demo
    from torchid.report.page.document import input_files
    from torchid.withheld.demo import demonstrate, write_files

    folder = output.out
    assert folder is not None  # it has a default
    output.begin()
    output.staged[folder / "demo.json"] = None  # an earlier answer goes with its logs
    files = write_files(folder, seed)
    output.finish()
    output.say(introduction(files))
    roles = [("robot", files.robot), *(("log", path) for path in files.logs)]
    roles.append(("held-out log", files.new))
    inputs = input_files([(role, str(path), path) for role, path in roles])
    with output.progress("examining the log") as progress:
        demo = demonstrate(files, seed, progress)
    paged = Output(report=folder / "gap.html", quiet=True)
    paged.keep(demo.diagnosis, "gap.json", diagnosis.report_of_diagnosis, seed=seed, files=inputs)
    output.put(folder / "gap.json", demo.diagnosis.save)
    output.put(folder / "identification.json", demo.identification.save)
    output.give(demo.plain(), "demo.json", lambda _: report_of_demo(demo))
    output.say(f"\nThe page: {folder / 'gap.html'}")
