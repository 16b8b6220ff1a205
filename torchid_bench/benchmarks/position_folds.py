"""How near servos fitted to some motions come on the others: folds of whole motions, each with its
own search from the start.

    python -m torchid_bench.benchmarks.position_folds ROBOT LOG... [--folds 5]

Prints RMS errors in mrad of the log's unit: of all rows together, and the mean over motions; whole
motions from the measured start, and windows of 2 s.
"""

from collections.abc import Sequence
from pathlib import Path

from torchid.log.model import Log
from torchid.position.answered import best_answer
from torchid.position.model import ServoArm
from torchid.position.problem import pose
from torchid.position.replay import replay
from torchid_bench.benchmarks.position_errors import HEADS, Model, judged, read_folds
from torchid_bench.benchmarks.runner import command, table


def main(robot: str, logs: Sequence[Path], *, folds: int = 5, only: Sequence[int] = ()) -> None:
    """Fit and judge all folds, or these alone."""
    arm, parts, places = read_folds(robot, logs, folds)

    def fitted(training: Log) -> Model:
        answered = best_answer(pose(arm, training))
        servos = ServoArm(arm, answered.model.servos, answered.motions.data.scale)
        return lambda log, seconds: replay(servos, [log], windows=seconds).simulated[0].q

    table(HEADS, judged({"torchid": fitted}, parts, places, only))


if __name__ == "__main__":
    command(main)
