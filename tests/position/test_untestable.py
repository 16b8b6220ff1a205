"""What motions would not have shown, and how far the closed share holds."""

import pytest
import torch

from tests.position.planted import COUNT, planted, robot, true_servos
from torchid.effects.servo import INDEX, PARAMETERS, ServoMotion
from torchid.position.checked import closed_interval
from torchid.position.data import PositionData, prepare
from torchid.position.effects import CORE
from torchid.position.fit import errors_of_one
from torchid.position.judge import equations
from torchid.position.servo_model import Motions
from torchid.position.untestable import USUAL, not_testable
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of

MOVES = torch.ones(3, dtype=torch.bool)
NONE = torch.zeros(3, dtype=torch.float64)


def unseen(servos: Servos, data: PositionData) -> dict[tuple[str, int], float | None]:
    free = dict.fromkeys(CORE, MOVES)
    windows = windows_of(data.tracks, 2.0)
    known = equations(data, servos, free, windows)
    found = not_testable(Motions(data, windows), known, MOVES)
    return {(x.effect, x.joints[0]): x.smallest_detectable for x in found}


def test_slow_motion_shows_less() -> None:
    servos = true_servos(3)
    lively, slow = (
        unseen(servos, prepare(robot(), planted(servos, motions=m, seconds=12.0, seed=4)))
        for m in (3, 1)
    )
    assert ("command_gain", 0) not in lively
    assert len(slow) > len(lively)
    # Each size that either would show is smaller where motion is fast.
    filters = [(slow[place], lively[place]) for place in lively if place[0] == "command_filter"]
    assert filters
    assert all(a is None or (b is not None and b < a) for a, b in filters)


def test_smallest_sizes_scale_with_what_calls_for_a_cause() -> None:
    servos = true_servos(3)
    data = prepare(robot(), planted(servos, motions=2, seconds=10.0, seed=4))
    windows = windows_of(data.tracks, 2.0)
    for (effect, joint), size in unseen(servos, data).items():
        name = {"dead_zone": "dead_zone", "load_dependent_friction": "load_share"}.get(effect)
        if name is None or size is None:
            continue
        assert size > USUAL[name]
        more = servos.joint.clone()
        more[joint, INDEX[name]] += USUAL[name]
        with_it = errors_of_one(data, Servos(more, servos.plane, servos.link), windows)
        change = (with_it - errors_of_one(data, servos, windows))[:, :, joint]
        # Others make up for a part of what it does.
        rows = float(windows.length.sum())
        seen = float((change.square().sum() / rows).sqrt())
        assert USUAL[name] / size <= 1.05 * seen / float(data.slight[joint])


@pytest.mark.slow
def test_positions_at_a_soft_stop_are_near_it() -> None:
    servos = true_servos(3, stop_high=(3, 0.25))
    data = prepare(robot(), planted(servos, motions=6, seconds=16.0, seed=4))
    sizes = PARAMETERS[INDEX["stop_high"]].sizes
    assert sizes is not None
    held = sizes(ServoMotion(data.tracks.u, data.q, data.dq, servos.of("kp")))[-2:]
    # Where the command is farthest beyond: a spring of ten times the servo's gain gives way.
    assert 0.25 < float(held[0, 2]) < float(held[1, 2]) < 0.35


def test_the_interval_of_the_closed_share_holds_what_other_motions_close() -> None:
    """Errors of motions whose shares vary by .05: the mean of many others is in the interval."""
    data = prepare(robot(), planted(true_servos(3), motions=8, seconds=8.0, seed=4))
    g = torch.Generator().manual_seed(2)
    inside = 0
    for _ in range(20):
        before = 10 * COUNT * torch.randn(data.q.shape, generator=g, dtype=torch.float64)
        after = before.clone()
        for a, b in zip(data.tracks.first.tolist(), data.tracks.last.tolist(), strict=True):
            after[a : b + 1] *= 0.4 + 0.05 * float(torch.randn(1, generator=g))
        low, high = closed_interval(data, before, after, MOVES, NONE)
        assert high - low < 0.2
        inside += low <= 0.6 <= high
    assert inside >= 16
    assert closed_interval(data, before, before, MOVES, NONE) == pytest.approx((0.0, 0.0))
