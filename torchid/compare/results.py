"""Results of one kind compared, whatever their kind."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchid.compare.diagnoses import compare_diagnoses
from torchid.compare.identifications import compare_identifications
from torchid.compare.reading import Compared as Given
from torchid.compare.reading import read_identification, read_results
from torchid.compare.record import Comparison, GapComparison, SetComparison
from torchid.compare.sets import compare_sets, robot_of
from torchid.errors import TorchidError
from torchid.feasibility.sets import SetsRecord
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.identification.record import IdentificationRecord
from torchid.identification.result import Identification
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.robot.tree import Choice

Compared = Comparison | GapComparison | SetComparison


def compare_results(
    results: Sequence[str | Path | Identification | TorqueDiagnosis],
    *,
    robot: RobotLike | None = None,
    on: LogLike | None = None,
    seed: int = 0,
) -> Compared:
    """Which parameters agree between results within their intervals, which drift, which are never
    determined; whether standard deviations hold from run to run; how far apart the torques are.

    Args:
        results: two or more, in the order of time: identifications or diagnoses, or files of them
            (identification.json, gap.json) or of parameter sets (sets.json); all of one kind.
        robot: for the torque, where files do not record it.
        on: a log along whose motion the torques are compared; random motion if None.
        seed: of random motion and of null distributions.

    Returns:
        By their kind: Comparison, GapComparison or SetComparison.

    Raises:
        TorchidError: fewer than two, of different kinds or kinematics, files that hold no results,
            or a log but no robot.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=10.0, restarts=1, iterations=0).log()
    >>> settings = torchid.Settings(effects=(), cutoff=10.0)
    >>> runs = [torchid.identify(robot, torchid.simulate(robot, motion, seed=k), settings=settings)
    ...         for k in (1, 2)]
    >>> found = compare_results(runs)
    >>> found.labels, len(found.having("drift", "differ"))
    (('result 1', 'result 2'), 0)
    """
    robot = None if robot is None else as_robot(robot)
    on = None if on is None else as_log(on, robot)
    read = read_results(results)
    return compared(read, robot or common_robot(read), on=on, seed=seed)


def common_robot(results: Sequence[Given[Any]], choice: Choice | None = None) -> Robot | None:
    """The robot that results record or name; of identifications and diagnoses None where none
    records it.

    Args:
        results: of one kind.
        choice: of the part of a named URDF or MJCF: in place of the recorded one.

    Raises:
        TorchidError: files of sets that name different robots, or one that is not where it was.
    """
    if isinstance(results[0].record, SetsRecord):
        return robot_of(results, choice)
    return next((r.record.model for r in results if r.record.model is not None), None)


def compared(
    results: Sequence[Given[Any]], robot: Robot | None, *, on: Log | None = None, seed: int = 0
) -> Compared:
    """As `compare_results`, of results that were read."""
    if isinstance(results[0].record, IdentificationRecord):
        every = [read_identification(r) for r in results]
        return compare_identifications(every, robot=robot, on=on, seed=seed)
    if isinstance(results[0].record, GapRecord):
        return compare_diagnoses(results, on=on, seed=seed)
    if robot is None:
        raise TorchidError("sets are compared for a robot.", expected="its kinematics")
    return compare_sets(results, robot, on=on, seed=seed)
