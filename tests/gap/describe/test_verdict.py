"""What is left is noise, small, or unexplained: held against noise that repeats bound, and against
the least that it can be."""

from dataclasses import replace

import pytest
import torch

from tests.gap.diagnoses import NOISE, coulomb, trace
from tests.gap.motions import noise
from tests.gap.problems import base_of_3r
from tests.gap.small_logs import ONCE, RATE, Recording, true_motion
from tests.gap.small_logs import ROBOT as ARM
from torchid.excitation.synthetic import synthetic_log
from torchid.gap.describe.checked import Checked
from torchid.gap.describe.closing import closing
from torchid.gap.describe.findings import Findings
from torchid.gap.describe.noise import Noise
from torchid.gap.describe.verdict import Left, status_of
from torchid.gap.diagnose import diagnose
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import NoiseFloor
from torchid.gap.settings import GapSettings
from torchid.identification.knowledge import over_parameters
from torchid.log.model import Log
from torchid.typing import Tensor

NOTHING = torch.zeros(3, dtype=torch.float64)


def checked(times: float, source: str = "bracket", structure: float = 0.0) -> Checked:
    """Of a model that leaves 0.61 N m on joint 2, so many times the noise's bound there, beside a
    torque of 2.2 N m, and noise on the others."""
    traces = [trace(coulomb, coulomb, seconds=20.0)]
    level = torch.full((3,), NOISE, dtype=torch.float64)
    level[1] = 0.61 / times
    # Repeats say what the noise is at most, the bracket what it is at least.
    high = level if source == "repeats" else torch.full_like(level, 0.61)
    floor = NoiseFloor(level, high, source)
    found = torch.tensor([0.0, structure, 0.0], dtype=torch.float64)
    noise = Noise(floor, found, high, None, torch.zeros(3, dtype=torch.bool))
    far = closing(traces, floor, 0, high)
    return Checked(traces, traces, noise, far, far)


def status(of: Checked, left: Left) -> str:
    return status_of(Findings((), ()), of, of, left, NOTHING, NOTHING, poor=False, shown=False)


@pytest.mark.parametrize(
    ("times", "torque", "source", "structure", "said"),
    [
        (10.0, 1.0, "bracket", 0.0, "detected_unexplained"),
        (2.5, 1.0, "bracket", 0.0, "no_gap"),  # it may be noise
        (2.5, 1.0, "bracket", 0.5, "detected_unexplained"),  # but for what is foreseen
        (10.0, 40.0, "bracket", 0.0, "negligible"),  # less than 3 % of the torque
        (10.0, 40.0, "bracket", 0.5, "negligible"),
        (10.0, 40.0, "repeats", 0.0, "detected_unexplained"),
        (1.3, 1.0, "repeats", 0.0, "no_gap"),
        (1.3, 1.0, "repeats", 0.1, "detected_unexplained"),
    ],
)
def test_noise_small_and_unexplained_are_told_apart(times, torque, source, structure, said):
    of = checked(times, source, structure)
    more = [replace(t, measured=torque * t.measured) for t in of.shown]
    of = replace(of, shown=[replace(t, before=t.measured) for t in more])
    left = Left.of(of, NOTHING)
    assert status(of, left) == said
    words = left.words(ARM)
    assert words.endswith("noise") == (said == "detected_unexplained")
    assert words.endswith(" N m on joint 2, 2 % of its torque") == (said == "negligible")
    assert bool(words) == (said != "no_gap")


def test_as_much_as_the_model_left_before_is_unexplained_no_more():
    """What a saved model left on its own log has been told then."""
    of = checked(10.0)
    left = Left.of(of, of.far.rms_after)
    assert status(of, left) == "negligible"
    assert "left on its own log" not in left.words(ARM)
    known = over_parameters(
        torch.eye(len(base_of_3r().by_link), dtype=torch.float64), base_of_3r(), (), "monday"
    )
    saved = replace(ARM, knowledge=replace(known, left=torch.ones(3)))
    assert left.words(saved).endswith("as much as the model left on its own log")


def spring(motion: Log) -> Tensor:
    """Between two joints, with play; no effect of the library."""
    stretched = motion.q[:, 1] + motion.q[:, 2]
    return stretched.sign() * (stretched.abs() - 0.3).clamp(min=0)


def bursts(motion: Log) -> Tensor:
    """Comes and goes at random, so that nothing foresees it."""
    seconds = (motion.t - motion.t[0]).floor().long()
    generator = torch.Generator().manual_seed(5)
    return torch.randn(int(seconds.max()) + 1, generator=generator, dtype=torch.float64)[seconds]


def of_log(
    extra: object, size: float, colour_hz: float, sigma: float, seed: int
) -> TorqueDiagnosis:
    """Three motions, none repeated, with a torque on joint 3, and noise on all, as shares of their
    own."""
    true = synthetic_log(ARM, true_motion(Recording(ONCE)))
    tau = true.tau.clone()
    rms = tau.square().mean(0).sqrt()
    if extra is not None:
        law = extra(true)
        tau[:, 2] += size * rms[2] * law / law.square().mean().sqrt()
    generator = torch.Generator().manual_seed(seed)
    tau += sigma * rms * noise(*tau.shape, generator, colour_hz, RATE)
    settings = GapSettings(effects=("viscous_friction", "coulomb_friction"))
    return diagnose(ARM, true.replace(tau=tau, dq=None, ddq=None), settings=settings)


@pytest.mark.parametrize("extra", [spring, bursts])
def test_an_effect_of_no_library_is_unexplained_without_repeats(extra):
    found = of_log(extra, 0.14, 5.0, 0.01, seed=0)
    assert found.status == "detected_unexplained"
    assert " N m on joint 3, " in found.answer.headline
    assert found.answer.headline.endswith(" times the least noise; record one motion twice.")


@pytest.mark.parametrize("colour_hz", [1.0, 5.0])
def test_coloured_noise_is_not_unexplained(colour_hz):
    """Three times its lower bound is usual."""
    found = of_log(None, 0.0, colour_hz, 0.015, seed=1)
    assert found.status in ("no_gap", "negligible")
    assert bool((found.how_far.rms_after > 2 * found.floor.low).any())
