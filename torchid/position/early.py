"""A first answer while the search goes on."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchid.position.data import PositionData
from torchid.position.record import error_words
from torchid.results.answer import Answer, Cause, JointError
from torchid.simulation.servo_loop import Windows
from torchid.statistics.criteria import WORTHWHILE


class EarlyAnswer:
    """What is known while the search goes on: the errors of the file's servos, or of plain ones, in
    some windows, and of the effects that were tried the one that removes most of each joint's."""

    def __init__(
        self,
        watch: Callable[[Answer], None],
        data: PositionData,
        first: Tensor,
        windows: Windows,
        of_file: bool,
    ) -> None:
        self.error = error_words(of_file)
        self.watch, self.names, self.scale = watch, data.robot.joint_names, data.scale
        self.rows = windows.rows
        self.before = self.after = self._errors(first)
        self.best = [""] * len(self.names)
        self._show()

    def _errors(self, losses: Tensor) -> Tensor:
        return 1e3 * (losses / self.rows).sqrt() / self.scale

    def __call__(self, effect: str, losses: Tensor) -> None:
        """An effect beside the plain servos, and the losses that it leaves."""
        errors = self._errors(losses)
        for j in torch.nonzero(errors < (1 - WORTHWHILE) * self.after).flatten().tolist():
            self.best[j] = effect
        self.after = torch.minimum(self.after, errors)
        self._show()

    def _show(self) -> None:
        levels = zip(self.names, self.before.tolist(), self.after.tolist(), strict=True)
        nothing = (math.nan, math.nan)
        self.watch(
            Answer(
                status="searching",
                error=self.error,
                unit="mrad",
                before=float(self.before.mean()),
                after=float(self.after.mean()),
                noise=nothing,
                closed=None,
                joints=tuple(
                    JointError(joint=j, name=name, before=b, after=a, noise=nothing)
                    for j, (name, b, a) in enumerate(levels)
                ),
                causes=tuple(
                    Cause(effect=name, joints=(j,)) for j, name in enumerate(self.best) if name
                ),
            )
        )
