"""What the packages beside torchid have, by name: where it stands, loaded when it is asked for.

`torchid_study` and `torchid_bench` come with torchid and import it. Torchid has nothing of them but
these texts, so that whoever needs none of them loads none of them.
"""

from importlib import import_module
from typing import Any

COMMANDS = {
    "wrenches": "torchid_study.app.wrenches:wrenches_command",
    "study": "torchid_study.app.study:study_command",
    "withheld make": "torchid_bench.app.withheld:make_command",
    "withheld run": "torchid_bench.app.withheld:run_command",
    "withheld score": "torchid_bench.app.withheld:score_command",
}
"""Functions of commands, by what is typed behind `torchid`."""
PUBLIC = {
    "equal_torque_study": "torchid_study.equal_torque.study",
    "compare_wrenches": "torchid_study.equal_torque.given_sets",
}
"""Modules of public names."""
RECORDS = {
    "torchid.wrenches/1 equal_torque": "torchid_study.equal_torque.study:EqualTorqueRecord",
    "torchid.wrenches/1 sets": "torchid_study.equal_torque.study:GivenSetsRecord",
    "torchid.study/1": "torchid_study.result:StudyRecord",
    "torchid.withheld.score/1": "torchid_bench.withheld.score_record:ScoreRecord",
}
"""Records of results, see `torchid.results.files`."""
FIGURES = {
    "EqualTorqueStudy": "torchid_study.report.wrenches:figures",
    "EqualTorqueRecord": "torchid_study.report.wrenches:figures",
    "GivenSets": "torchid_study.report.wrenches:figures",
    "GivenSetsRecord": "torchid_study.report.wrenches:figures",
}
"""Figures of results, see `torchid.report.plots`."""


def loaded(place: str) -> Any:
    """What stands at a place, `module:name`."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
