"""`torchid demo`: the main job on the report's robots, in under a minute."""

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
    device_name: opt.Device = "cpu",
) -> None:
    """Identify the report's 3R and KUKA LWR IV+ from synthetic logs, and compare with the truth.

    Example: `torchid demo --out demo`

    Args:
        out: Folder for results.
    """
    from torchid.report.demo import shown
    from torchid.study.demo import demo_record, kuka_demo, paper_demo

    paper = paper_demo()
    with output.progress() as progress:
        kuka = kuka_demo(seed, opt.device(device_name), progress)
    output.give(demo_record(paper, kuka), "demo.json", lambda _: shown(paper, kuka))
