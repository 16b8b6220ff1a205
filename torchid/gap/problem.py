"""What a diagnosis has to explain, and what it is judged by."""

from dataclasses import dataclass
from functools import cached_property

from torchid.design.columns import Columns
from torchid.design.repeats import Repeats
from torchid.design.segments import Segment
from torchid.gap.data import Data
from torchid.gap.folds import Folds
from torchid.gap.settings import GapSettings
from torchid.gap.wanted import Wanted
from torchid.results.cause import JudgedOn
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.model import Robot
from torchid.statistics.bagging import Draws
from torchid.typing import Bool, Int, Tensor


@dataclass(frozen=True, eq=False)
class Problem:
    """The gap between a model and a log.

    Attributes:
        given: columns at the model as given.
        data: of the log that is searched.
        judged: of the log that is held out; None without one.
        folds: of the samples, each left out in turn.
        block: (N,) block of every sample, several times as long as the gap is correlated.
        repeats: among the trajectories.
        apart: what the gap of the model as given differs by between them, stretch by stretch.
        wanted: what is looked for.
        settings: the user's.
        fitted_first: whether the model as given was fitted, because the robot has no parameters.
        asked: (N,) samples of the log whose gap is asked for, where data, folds, blocks and repeats
            are those of an earlier log as well; None where there is none.
        load: ten parameters of the load that the robot's file has, which the robot as given has in
            its last link; zeros where it has none.
    """

    given: Columns
    data: Data
    judged: Data | None
    folds: Folds
    block: Int[Tensor, " N"]
    repeats: Repeats
    apart: tuple[Segment, ...]
    wanted: Wanted
    settings: GapSettings
    fitted_first: bool
    asked: Bool[Tensor, " N"] | None = None
    load: tuple[float, ...] = (0.0,) * PARAMETERS_PER_LINK

    @property
    def robot(self) -> Robot:
        """The robot as given."""
        return self.given.model.robot

    @property
    def as_cad(self) -> bool:
        """Whether parameters were given that nobody vouches for."""
        unknown = self.wanted.knowledge is None and self.settings.parameters == "auto"
        return unknown and not self.fitted_first

    @property
    def left_out(self) -> JudgedOn:
        """The log that is searched, each part of it in its turn: data that decide."""
        return JudgedOn.by_names((s.name for s in self.data.segments), "left out in turn")

    @property
    def judged_on(self) -> JudgedOn:
        """The data that errors are told of: logs that were held out, or each log in its turn."""
        if self.judged is None:
            return self.left_out
        names = [s.name for s in self.judged.segments]
        if self.settings.held_out_fraction > 0:
            names = [f"the end of {name}" for name in names]
        return JudgedOn.by_names(names, "held out")

    @cached_property
    def draws(self) -> Draws:
        """Logs that might have been."""
        return Draws.of(self.block, self.settings.seed)
