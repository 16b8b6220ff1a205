"""The rate of a log is no reason for another answer."""

from functools import cache

import pytest
import torch

from tests.position.planted import COUNT, commands, robot, true_servos
from torchid.log.model import Log
from torchid.position.data import RATE, WINDOW_S, prepare
from torchid.position.diagnose import diagnose_positions
from torchid.position.judge import alike_rows, equations
from torchid.position.search import plain
from torchid.position.servo_model import Motions
from torchid.simulation.replay import replayed
from torchid.simulation.servo_loop import Tracks, windows_of
from torchid.statistics.criteria import UNSURE_SCALE

FINE, KNOTS = 1000, 25
"""Rates of the simulation, and of the knots that commands go straight between [Hz]."""


@cache
def simulated(motions: int = 2, seconds: float = 6.0, kd: float = 0.0, offset: float = 0.0):
    """The same motion at any rate: a function of it [Hz]."""
    base = commands(3, motions, seconds, seed=4)
    each = len(base.u) // motions
    parts = []
    for m in range(motions):
        knots = base.u[m * each : (m + 1) * each : 2]
        t = torch.arange((len(knots) - 1) * FINE // KNOTS + 1) * KNOTS / FINE
        low = t.floor().long().clamp(max=len(knots) - 2)
        parts.append(knots[low] + (t - low)[:, None] * (knots[low + 1] - knots[low]))
    u, size = torch.cat(parts), len(parts[0])
    first = size * torch.arange(motions)
    tracks = Tracks(u, first, first + size - 1, 1 / FINE)
    servos = true_servos(3, kd=(2, kd))
    servos.of("delay")[:] = 0.06
    servos.of("offset")[0] = offset  # of the joint that no load anchors
    start = u[first]
    q = replayed(robot(), servos, tracks, windows_of(tracks, None), start, torch.zeros_like(start))
    q = (q / COUNT).round() * COUNT

    def log(rate: int) -> Log:
        rows = torch.arange(0, size, FINE // rate)
        at = torch.cat([rows + k for k in first])
        return Log(
            t=(rows.double() / FINE).repeat(motions), q=q[at], u=u[at],
            trajectory=torch.arange(motions).repeat_interleave(len(rows)), source="planted",
        )  # fmt: skip

    return log


@pytest.mark.nightly
def test_what_is_known_is_known_at_every_rate():
    """Deviations at 25, 50, 200 and 500 Hz: of a fast log they are those at 50 Hz, of a slow one
    nearly so, for rows are as good as one as long as their errors are alike. Of a joint that no
    load anchors the scale of torques hardly shows, and hangs on when it sticks."""
    log, std, alike = simulated(motions=6, seconds=8.0, offset=0.5), {}, {}
    for rate in (25, 50, 200, 500):
        data = prepare(robot(), log(rate))
        windows = windows_of(data.tracks, WINDOW_S)
        found = plain(Motions(data, windows))
        known = equations(data, found.servos, found.free, windows)
        std[rate], alike[rate] = known.deviations(), known.alike * data.tracks.dt
    anchored = std[50][:, list(found.free).index("kp")] < UNSURE_SCALE
    assert anchored.tolist() == [False, True, True]
    for rate in (200, 500):
        assert torch.allclose(std[rate][anchored], std[50][anchored], rtol=0.25)
    # 48 s of errors that are alike for a quarter of a second say so to a third (Sokal 1997).
    assert torch.allclose(alike[25], alike[50], rtol=0.3)
    assert float((std[25] / std[50]).median()) == pytest.approx(1.0, abs=0.15)


@pytest.mark.nightly
def test_the_same_is_named_at_every_rate():
    log, named = simulated(motions=4, seconds=12.0, kd=25.0), []
    for rate in (25, 50, 200, 500):
        found = diagnose_positions(robot(), log(rate))
        # A delay of no more than a slow log's sample has no name there.
        late = {f.joint for f in found.findings if f.effect == "command_delay"}
        assert len(late) == (0 if rate == 25 else 3)
        of = {(f.effect, f.joint) for f in found.findings if f.effect != "command_delay"}
        named.append(of)
        kp = float(found.servos.of("kp")[1])
        assert kp == pytest.approx(260.0, rel=0.15)
    assert all(names == named[0] for names in named)
    assert ("derivative_gain", 2) in named[0]


@pytest.mark.slow
def test_a_fast_log_is_thinned_and_a_slow_one_stays():
    log = simulated()(FINE)
    data = prepare(robot(), log)
    assert 1 / data.tracks.dt == pytest.approx(RATE)
    assert data.held == pytest.approx(1 / FINE)
    assert torch.equal(data.q, log.q[torch.cat([r + torch.arange(0, 5961, 10) for r in (0, 5961)])])
    assert len(prepare(robot(), log, all_rows=True).q) == log.samples
    slow = simulated()(25)
    assert len(prepare(robot(), slow).q) == slow.samples


@pytest.mark.slow
def test_alike_for_as_long_as_errors_are():
    """An AR(1) of 8 rows' correlation time, in windows of two lengths."""
    g = torch.Generator().manual_seed(0)
    keep = (8 - 1) / (8 + 1)
    x = torch.randn(100, 300, 1, generator=g, dtype=torch.float64)
    for k in range(1, len(x)):
        x[k] = keep * x[k - 1] + (1 - keep**2) ** 0.5 * x[k]
    data = prepare(robot(), simulated()(50))
    windows = windows_of(data.tracks, WINDOW_S).some(torch.zeros(300, dtype=torch.long))
    windows.length[100:] = 60
    assert float(alike_rows(x, windows)) == pytest.approx(8.0, rel=0.2)
