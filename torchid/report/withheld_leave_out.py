"""What is said when the right name is not in the library, in words."""

from collections.abc import Mapping
from typing import Any

from torchid.report.withheld import counts_table, listed, markdown_table

_WORDS = {
    "right_family": "the right family is named",
    "hedged": "it is among the alternatives",
    "detected_unexplained": "detected, and said to be unexplained",
    "confident_wrong": "another family, for sure",
    "missed": "nothing is said to be there",
    "not_testable": "said to be invisible in these data",
}


def leave_out_headline(result: Mapping[str, Any]) -> str:
    """One sentence."""
    wrong = result["verdicts"]["confident_wrong"]
    text = f"{wrong['hits']} of {wrong['total']} answers name another family for sure"
    if wrong["share"] is not None:
        text += f": {_percent(wrong)}"
    if result["errors"]:
        text += f"; {len(result['errors'])} diagnoses failed"
    return text + "."


def leave_out_markdown(result: Mapping[str, Any]) -> str:
    """The whole report."""
    total = [
        [_WORDS[name], f"{found['hits']} of {found['total']}", _percent(found)]
        for name, found in result["verdicts"].items()
    ]
    cases = [
        [c["effect"], c["case"], c["verdict"].replace("_", " "), c["status"], listed(c["named"])]
        for c in result["cases"]
        if c["verdict"] in ("confident_wrong", "missed", "error")
    ]
    parts = [
        f"# Effects left out of the library: seed {result['seed']}",
        f"{leave_out_headline(result)} torchid {result['version']}. Intervals: 95 %.",
        markdown_table(["answer", "cases", "share"], total),
        "## By effect",
        counts_table("left out", result["by_effect"]),
        "## Cases that went wrong",
        markdown_table(["left out", "case", "answer", "status", "named"], cases),
    ]
    return "\n\n".join(parts) + "\n"


def _percent(found: Mapping[str, Any]) -> str:
    if found["share"] is None:
        return "-"
    low, high = found["ci95"]
    return f"{100 * found['share']:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
