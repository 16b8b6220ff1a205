"""A diagnosis of commands and positions without the search: what pages and tables are tested on."""

import torch

from tests.position.planted import planted, robot, true_servos
from torchid.position.data import prepare
from torchid.position.diagnosis import Number, PositionDiagnosis, finding_of
from torchid.position.effects import BY_NAME
from torchid.position.nominal import read_servos
from torchid.position.record import Accuracy, PositionFinding
from torchid.position.repeats import no_noise


def finding(name: str, joint: int | None, without: float, with_it: float, **size: float):
    """On a joint from 1."""
    sizes = [Number(k, "rad/s^2", v, (0.9 * v, 1.1 * v)) for k, v in size.items()]
    place = None if joint is None else joint - 1
    return finding_of(BY_NAME[name], place, sizes, (without, with_it))


def diagnosis(*findings: PositionFinding, servo: str | None = None) -> PositionDiagnosis:
    """Of three joints, the second the worst, at reversals; the third never moves."""
    servos = true_servos(3)
    log = planted(servos, motions=2, seconds=12.0)
    g = torch.Generator().manual_seed(3)
    plain = 1e-3 * torch.randn(log.q.shape, generator=g, dtype=torch.float64)
    plain[400:600, 1] += 0.03
    ways = [
        Accuracy.of_joints(torch.tensor(x).double(), torch.tensor(x).double() / 2)
        for x in ((30.0, 40.0, torch.nan), (9.0, 14.0, torch.nan), (4.0, 6.0, torch.nan))
    ]
    regimes = {
        "holding": (torch.tensor([3.0, 4.0, torch.nan]), torch.tensor([1.0, 1.5, torch.nan])),
        "reversal": (torch.tensor([8.0, 21.0, 2.0]), torch.tensor([3.0, 7.0, 2.0])),
    }
    return PositionDiagnosis(
        data=prepare(robot(), log),
        servos=servos,
        findings=findings,
        gains=(
            torch.tensor([260.0, 260.0, torch.nan]).double(),
            torch.tensor([[250.0, 270.0]] * 2 + [[torch.nan] * 2]).double(),
        ),
        ratio_only=torch.tensor([True, False, False]),
        commanded=ways[0],
        plain_servo=ways[1],
        answered=ways[2],
        regimes=regimes,
        motions=(log.names, torch.tensor([[4.0, 6.0, 2.0], [4.0, 5.0, 3.0]]).double()),
        errors=(plain, 0.3 * plain),
        still=torch.tensor([False, False, True]),
        warnings=("something to bear in mind",),
        seconds=1.0,
        noise=no_noise(3),
        nominal=() if servo is None else read_servos(servo, 3),
    )
