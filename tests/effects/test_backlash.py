"""The play operator against a loop, the column against the torque of the lagging arm."""

import pytest
import torch

from tests.arms import arm
from tests.effects.exact_logs import EDGE, smooth_motion
from tests.oracles import PinocchioOracle
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.backlash import CALM, Backlash
from torchid.effects.base import Motion
from torchid.effects.gravity import EncoderOffset
from torchid.effects.instants import derivative
from torchid.log.filtering import ZeroPhaseFilter

T = torch.arange(2000, dtype=torch.float64) / 500


def loaded(torque: torch.Tensor) -> Motion:
    still = torch.zeros(len(torque), 1, dtype=torch.float64)
    return Motion(still, still, still, t=T[: len(torque)], torque=torque.unsqueeze(-1))


def relay(torque: list[float], band: float) -> list[float]:
    """Flank sample by sample."""
    outside = [x for x in torque if abs(x) > band]
    state, out = (1.0 if outside[0] > 0 else -1.0), []
    for x in torque:
        if abs(x) > band:
            state = 1.0 if x > 0 else -1.0
        out.append(state)
    return out


def test_flank_holds_within_the_band_and_flips_beyond() -> None:
    noise = torch.randn(len(T), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    torque = torch.sin(3 * T) + 0.03 * noise
    band = 0.2 * float(torque.abs().quantile(0.99))
    crisp = torch.tensor(relay(torque.tolist(), band), dtype=torch.float64)
    s, _, _ = Backlash(0, band=0.2, crossing=0.03).flank(loaded(torque))
    flips = crisp.diff().nonzero()[:, 0]
    assert len(flips) == 3  # 4 s at 3 rad/s, and no chatter
    near = torch.zeros(len(T), dtype=torch.bool)
    for flip in flips.tolist():
        near[flip - 9 : flip + 11] = True
    torch.testing.assert_close(s[~near], crisp[~near])
    assert s.abs().max() <= 1 + 1e-12
    assert (s[flips] + s[flips + 1]).abs().max() < 1e-12  # centred on the flip


def test_crossing_takes_its_time() -> None:
    motion = loaded(torch.sin(3 * T))
    for crossing in (0.06, 0.2):
        s, rate, _ = Backlash(0, crossing=crossing).flank(motion)
        moving = float((s.abs() < 1 - 1e-9).sum()) / 500
        assert moving == pytest.approx(3 * crossing, rel=0.15)
        # A raised cosine of this duration peaks at twice its mean speed.
        assert float(rate.abs().max()) == pytest.approx(2 * 2 / crossing, rel=0.15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_without_reversal_it_is_half_an_offset(sign: float) -> None:
    robot = arm("panda")
    motion = smooth_motion(robot, 200)._replace(
        torque=sign * torch.ones(200, robot.n, dtype=torch.float64)
    )
    column = Backlash(3, at=1e-5).torque_columns(motion, robot)
    offset = EncoderOffset(3, at=-sign * 5e-6).torque_columns(motion, robot)
    torch.testing.assert_close(column, -sign / 2 * offset, rtol=1e-6, atol=1e-6)


def test_flank_reverses_in_the_log() -> None:
    s, _, _ = Backlash(4).flank(smooth_motion(arm("panda")))
    assert s.min() < -0.99
    assert s.max() > 0.99


@pytest.mark.parametrize("width", [2e-3, 1e-2])
def test_column_is_a_secant_of_pinocchios_torque(width: float) -> None:
    robot = arm("panda")
    motion = smooth_motion(robot, 600)
    lagging = [x.clone() for x in motion.state]
    for x, s in zip(lagging, Backlash(4).flank(motion, CALM), strict=True):
        x[:, 4] -= width / 2 * s
    oracle = PinocchioOracle(robot)
    change = oracle.inverse_dynamics(*lagging) - oracle.inverse_dynamics(*motion.state)
    column = Backlash(4, at=width).torque_columns(motion, robot)[..., 0]
    torch.testing.assert_close(width * column, change, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("joint", "width", "rest"), [(1, 1e-3, 0.2), (3, 1e-3, 0.15), (4, 1e-3, 0.15), (4, 2e-4, 0.15)]
)
def test_models_torque_closes_most_of_the_gap(joint: int, width: float, rest: float) -> None:
    """In the band of a fit; the model's torque has the play's own pulses in it."""
    robot = arm("panda")
    true = smooth_motion(robot, 3000, rate=500.0)
    measured = Backlash(joint).measured(true, [width])
    model = inverse_dynamics(robot, *measured.state)
    assert measured.torque is not None
    gap = measured.torque - model
    effect = Backlash(joint, at=width)
    column = effect.torque_columns(measured._replace(torque=model), robot)[..., 0]
    low = ZeroPhaseFilter(500.0, 8.0)
    before, after = (low.apply(x.T.contiguous())[:, 60:-60] for x in (gap, gap - width * column))
    assert float(after.norm() / before.norm()) < rest


def test_motor_moves_with_its_velocity() -> None:
    robot = arm("panda")
    true = smooth_motion(robot)
    log = Backlash(4).measured(true, [1e-3])
    assert log.t is not None
    assert (log.q - true.q)[:, 4].abs().max() == pytest.approx(5e-4)
    torch.testing.assert_close(
        derivative(log.q, log.t)[EDGE:-EDGE], log.dq[EDGE:-EDGE], rtol=0, atol=1e-6
    )


def test_no_torque_no_flank() -> None:
    s, rate, _ = Backlash(0).flank(loaded(torch.zeros(50, dtype=torch.float64)))
    assert not s.any()
    assert not rate.any()
