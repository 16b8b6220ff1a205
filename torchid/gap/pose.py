"""From a robot and its logs to what there is to explain."""

from dataclasses import replace

from torchid.design.columns import Columns
from torchid.design.repeats import find_repeats
from torchid.effects.phase import JointElasticity
from torchid.gap.data import read
from torchid.gap.describe.model import blocks_of, refitted
from torchid.gap.describe.noise import sliding_only
from torchid.gap.folds import make_folds
from torchid.gap.problem import Problem
from torchid.gap.settings import GapSettings
from torchid.gap.wanted import pushes_alone, start_of, wanted_of
from torchid.identification.knowledge import load_of, whole_arm
from torchid.log.model import Log
from torchid.robot.model import Robot


def pose(
    robot: Robot, log: Log, held_out: Log | None, settings: GapSettings, force: bool = False
) -> Problem:
    """The gap of a robot's model on a log.

    Raises:
        LogError: logs that do not fit the robot or cannot be used.
    """
    load, robot = load_of(robot), whole_arm(robot)
    # Trajectories, what they repeat, and which of them are held out together.
    data, judged = read(robot, log, held_out, settings, force)
    repeats = find_repeats(data.segments)
    folds = make_folds(data.samples, settings.folds, repeats.groups(len(data.segments)))
    # What is looked for, and the model whose gap is to be explained.
    wanted = wanted_of(robot, settings)
    given = Columns(start_of(robot), data.samples)
    if data.stands:
        wanted = pushes_alone(wanted)
        if not wanted.names:
            data.require_motion()
    else:
        data = data.without_silent(given, folds.parts)
    if robot.parameters is None:
        given = given.at(refitted(given, data, wanted).model)
    # Where repeats tell the noise, only samples of sliding joints can be held against it.
    apart = tuple(repeats.segments(data.segments, given.gaps))
    data = replace(data, keep=sliding_only(given, data.keep, data.band, apart))
    elastic = JointElasticity.name
    if elastic in wanted.names:
        data = data.with_swings(given)
    block, fitted_first = blocks_of(data, given), robot.parameters is None
    return Problem(
        given, data, judged, folds, block, repeats, apart, wanted, settings, fitted_first, load=load
    )
