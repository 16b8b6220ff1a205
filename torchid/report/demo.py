"""What `torchid demo` shows."""

from torchid.doctor.examine import conclusion
from torchid.report.brief import Screen
from torchid.report.identification import verdict
from torchid.report.table import Report, Table
from torchid.results.cause import Cause
from torchid.results.words import effect_words, sure
from torchid.withheld.demo import Demo, Files


def introduction(files: Files) -> str:
    """What the files are, before anything is done with them."""
    return (
        f"{files.robot}: a 6R arm as its maker describes it. The real one, which made three logs "
        "of 5 s, carries 1 kg and rubs on joint 2. A third cause is withheld: it was drawn from "
        f"the seed, and nothing reads {files.key} before the end "
        f"(SHA-256 {files.sealed[:16]}..).\n"
    )


def report_of_demo(demo: Demo) -> Report:
    """Each step under the command that does the same, and what was withheld at the end."""
    files, answer = demo.files, demo.diagnosis.answer
    logs = " ".join(str(path) for path in files.logs)
    return Report(
        parts=[
            f"$ torchid log doctor {files.robot} {logs}\n{conclusion(demo.examination)}\n",
            f"$ torchid identify {files.robot} {logs} --held-out {files.new}\n"
            f"{verdict(demo.identification)}\n",
            f"$ torchid gap {files.robot} {logs} --held-out {files.new}",
            Screen(answer=answer, band=demo.diagnosis.band, warnings=demo.diagnosis.warnings),
            opened_table(demo),
        ],
    )


def opened_table(demo: Demo) -> Table:
    """Every planted cause beside what came out; then what was named and not planted."""
    rows = [
        (
            _place(one.planted["effect"], one.planted.get("joint")),
            "withheld" if one.withheld else "known",
            f"{one.coefficient[0]} {one.coefficient[1]:.3g}",
            *_size_and_sureness(one.finding),
        )
        for one in demo.opened
    ]
    for f in demo.others:
        joint = f.joints[0] + 1 if len(f.joints) == 1 else None
        rows.append((_place(f.effect, joint), "not planted", "", *_size_and_sureness(f)))
    columns = ("cause", "was", "planted", "diagnosis", "sure")
    title = f"{demo.files.key} opened (SHA-256 {demo.files.sealed[:16]}..)"
    return Table(title, columns, rows, "pllll")


def _place(effect: str, joint: int | None) -> str:
    return effect_words(effect) + ("" if joint is None else f" on joint {joint}")


def _size_and_sureness(cause: Cause | None) -> tuple[str, str]:
    if cause is None:
        return "not named", ""
    return cause.sizes[0].words if cause.sizes else "", sure(cause.how_sure)
