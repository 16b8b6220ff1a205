"""The figure of a result by its kind: what `Result.plot` draws."""

from collections.abc import Callable
from functools import partial
from typing import Any

from torchid.compare.record import Comparison, GapComparison, SetComparison
from torchid.doctor.examine import Examination
from torchid.errors import TorchidError
from torchid.extraction.convex.atlas import Atlas
from torchid.extraction.extract import Extraction
from torchid.extraction.found import Found
from torchid.extraction.record import AtlasRecord
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.identification.record import IdentificationRecord
from torchid.identification.result import Identification
from torchid.log.model import Log
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import Replay
from torchid.position.record import PositionRecord
from torchid.report import (
    compare,
    doctor,
    equal_torque,
    extraction,
    given_sets,
    identification,
    position,
    withheld,
)
from torchid.report import gap_figures as gap
from torchid.report.log import signals_figure
from torchid.report.over_time import motion_over_time
from torchid.report.panels import Figure, Figures
from torchid.report.skeleton import skeleton_of
from torchid.report.study.page import drawings
from torchid.results.record import Result
from torchid.study.equal_torque.given_sets import GivenSets
from torchid.study.equal_torque.study import EqualTorqueStudy
from torchid.study.result import Study
from torchid.withheld.score_record import ScoreRecord


def draw(result: Result | Log, kind: str | None = None, **which: Any) -> Figure:
    """A figure of a result, as the commands and their pages draw it.

    Args:
        result: in memory, or read back: that has no torque over time; or a log.
        kind: which figure; the first of its kinds if None.
        which: what else it asks for: `joint` (from 0) of a gap's `gap`, `torque` and `motion`,
            `trajectory` (from 0) of an identification's `torque`, `log` (from 0) of a replay's
            `positions`.

    Returns:
        A matplotlib Figure, which needs no display.

    Raises:
        TorchidError: there is no such figure of this result, with those that there are.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    >>> settings = torchid.Settings(effects=(), cutoff=10.0)
    >>> found = torchid.identify(robot, torchid.simulate(robot, motion), settings=settings)
    >>> len(draw(found, "parameters").axes)  # the same as found.plot("parameters")
    1
    """
    drawn = kinds(result)
    name = next(iter(drawn), "") if kind is None else kind
    if name not in drawn:
        raise TorchidError(
            f"there is no such figure of {type(result).__name__}.",
            got=kind,
            available=list(drawn),
            hint=None if drawn else "its table: to_frame()",
        )
    try:
        figure = drawn[name](**which)
    except TypeError as error:
        if not which:
            raise
        raise TorchidError(f"the figure '{name}' takes no {', '.join(which)}.") from error
    if figure is None:
        raise TorchidError(f"there is nothing to show in '{name}'.")
    return figure


def kinds(result: Result | Log) -> Figures:
    """What can be drawn of a result, by name."""
    match result:
        case Log():
            return {"signals": partial(signals_figure, result)}
        case TorqueDiagnosis() | GapRecord():
            return _gap(result)
        case PositionDiagnosis() | PositionRecord():
            return position.kinds(result)
        case Replay():
            return {"positions": partial(position.replay_figure, result)}
        case Identification():
            return _identification(result)
        case IdentificationRecord():
            return {"parameters": partial(identification.parameter_figure, result)}
        case Atlas():
            return kinds(result.record)
        case AtlasRecord():
            return {"ranges": partial(extraction.atlas_figure, result)}
        case Extraction():
            return {"search": partial(extraction.search_figure, result, None)}
        case Found():
            return extraction.figures(result)
        case Examination():
            return {"torque": partial(doctor.torque_figure, result)}
        case EqualTorqueStudy():
            return equal_torque.figures(result)
        case GivenSets():
            return given_sets.figures(result)
        case Study():
            return {picture.name: picture.draw for picture in drawings(result)}
        case Comparison() | GapComparison() | SetComparison():
            return compare.figures(result)
        case ScoreRecord():
            return withheld.figures(result.plain())
    return {}


def _gap(found: TorqueDiagnosis | GapRecord) -> Figures:
    """By kind; those of one joint take it as `joint`."""
    record = found.record
    assert isinstance(record, GapRecord)
    drawn: dict[str, Callable[..., Figure | None]] = {"where": partial(gap.map_figure, record)}
    drawn |= {k: v for k, v in gap.figures(found).items() if not k.startswith("gap_joint")}
    if isinstance(found, TorqueDiagnosis) and found.traces:
        drawn |= {"gap": partial(gap.joint_figure, found), "robot": partial(skeleton_of, found)}
        if (motion := motion_over_time(found)) is not None:
            drawn["motion"] = motion.draw
    return drawn


def _identification(result: Identification) -> Figures:
    runs = (*result.held_out_predictions, *result.fit_predictions)

    def torque(trajectory: int = 0) -> Figure:
        if not 0 <= trajectory < len(runs):
            raise TorchidError(
                "there is no such trajectory.", got=trajectory, expected=f"0..{len(runs) - 1}"
            )
        held_out = trajectory < len(result.held_out_predictions)
        return identification.run_figure(result, runs[trajectory], held_out)

    return {
        "parameters": partial(identification.parameter_figure, result.record),
        "torque": torque,
    }
