"""The figure of a result by its kind: what `Result.plot` draws."""

from functools import partial
from typing import Any

from torchid import other_packages
from torchid.errors import TorchidError
from torchid.log.model import Log
from torchid.report.panels import Figure, Figures
from torchid.results.record import Result

DRAWN = other_packages.FIGURES | {
    "Log": "torchid.report.log:signals_figure signals",
    "TorqueDiagnosis": "torchid.report.diagnosis:kinds",
    "GapRecord": "torchid.report.diagnosis:kinds",
    "PositionDiagnosis": "torchid.report.diagnosis:kinds",
    "PositionRecord": "torchid.report.diagnosis:kinds",
    "Replay": "torchid.report.position:replay_figure positions",
    "Identification": "torchid.report.identification:kinds",
    "IdentificationRecord": "torchid.report.identification:parameter_figure parameters",
    "Atlas": "torchid.report.extraction:atlas_figure ranges",
    "AtlasRecord": "torchid.report.extraction:atlas_figure ranges",
    "Extraction": "torchid.report.extraction:search_figure search",
    "Found": "torchid.report.extraction:figures",
    "Examination": "torchid.report.doctor:torque_figure torque",
    "Comparison": "torchid.report.compare:forest_figure parameters",
}
"""By the name of a result's class what gives its figures by kind, or draws the only one, whose
kind stands behind it; loaded when it is needed."""


def draw(result: Result | Log, kind: str | None = None, **which: Any) -> Figure:
    """A figure of a result, as the commands and their pages draw it.

    Args:
        result: in memory, or read back: that has no torque over time; or a log.
        kind: which figure; the first of its kinds if None.
        which: what else it asks for: `joint` (from 0) of a gap's `gap`, `friction`, `torque` and
            `motion`, `trajectory` (from 0) of an identification's `torque`, `log` (from 0) of a
            replay's `positions`.

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
    place, _, kind = DRAWN.get(type(result).__name__, "").partition(" ")
    if not place:
        return {}
    function = other_packages.loaded(place)
    drawn: Figures = {kind: partial(function, result)} if kind else function(result)
    return drawn
