"""Traces and diagnoses made by hand, from a seed."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from tests.arms import arm
from tests.causes import numbers
from torchid.effects.base import Effect, Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.gap.cause_records import body_cause, unit_of
from torchid.gap.diagnosis import HowFar, TorqueDiagnosis, Trace
from torchid.gap.record import (
    Budget,
    Experiment,
    Informative,
    JointGap,
    NoiseFloor,
    RegimeGap,
    Status,
)
from torchid.gap.settings import GapSettings
from torchid.log.filtering import ZeroPhaseFilter
from torchid.results.answer import NotTestable
from torchid.results.cause import Cause, Size

BAND = 20.0
NOISE = 0.05

Gap = Callable[[Motion, Tensor], Tensor]
"""(motion, model torque) -> (T, n) torque the model lacks."""


def motion_of(n: int, seconds: float, rate: float, seed: int) -> Motion:
    """Sums of five sines that do not repeat."""
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(0, seconds, 1 / rate, dtype=torch.float64)
    w = 2 * math.pi * (0.05 + 0.45 * torch.rand(5, n, generator=g, dtype=torch.float64))
    amplitude = (0.5 + torch.rand(5, n, generator=g, dtype=torch.float64)) * 0.4 / w.sqrt()
    phase = 2 * math.pi * torch.rand(5, n, generator=g, dtype=torch.float64)
    angle = w * t[:, None, None] + phase
    return Motion(
        q=(amplitude * angle.sin()).sum(1),
        dq=(amplitude * w * angle.cos()).sum(1),
        ddq=-(amplitude * w**2 * angle.sin()).sum(1),
        t=t,
    )


def banded(x: Tensor, rate: float) -> Tensor:
    """(T, n) in the band of the report."""
    return ZeroPhaseFilter(rate, BAND).apply(x.T).T


def coloured(t: int, n: int, seed: int, correlation: float) -> Tensor:
    """Gaussian AR(1) of variance 1, its correlation from sample to sample."""
    g = torch.Generator().manual_seed(seed)
    x = torch.randn(t, n, generator=g, dtype=torch.float64)
    # By its transfer function, on a circle: stationary from the first sample on.
    w = 2 * math.pi * torch.fft.rfftfreq(t, dtype=torch.float64)
    response = math.sqrt(1 - correlation**2) / (1 - correlation * torch.exp(-1j * w))
    return torch.fft.irfft(torch.fft.rfft(x, dim=0) * response[:, None], n=t, dim=0)


def trace(
    gap: Gap | None = None,
    left: Gap | None = None,
    *,
    n: int = 3,
    seconds: float = 60.0,
    rate: float = 250.0,
    seed: int = 0,
    correlation: float = 0.0,
    noise: float = NOISE,
    name: str = "run",
) -> Trace:
    """A trajectory whose gap is `gap` before, `left` after, and noise."""
    motion = motion_of(n, seconds, rate, seed)
    model = 3 * motion.q.sin() + 0.3 * motion.ddq
    noisy = banded(coloured(len(model), n, seed + 1000, correlation), rate)
    noisy = noise * noisy / noisy.square().mean().sqrt()
    lacking = torch.zeros_like(model) if gap is None else gap(motion, model)
    remains = torch.zeros_like(model) if left is None else left(motion, model)
    valid = torch.ones(len(model), dtype=torch.bool)
    valid[:25], valid[-25:] = False, False
    measured = banded(model + lacking, rate) + noisy
    return Trace(
        name=name, rate=rate, motion=motion, measured=measured, before=banded(model, rate),
        after=measured - noisy - banded(remains, rate), valid=valid,
    )  # fmt: skip


def floor(n: int = 3, noise: float = NOISE) -> NoiseFloor:
    """A bracket of 20 % about the noise."""
    level = torch.full((n,), noise, dtype=torch.float64)
    return NoiseFloor(0.8 * level, 1.2 * level, "bracket", ("no repeats of a trajectory",))


def coulomb(motion: Motion, model: Tensor) -> Tensor:
    """0.61 N m of friction on joint 2, nothing elsewhere."""
    out = torch.zeros_like(motion.q)
    out[:, 1] = 0.61 * motion.dq[:, 1].sign()
    return out


def some_left(motion: Motion, model: Tensor) -> Tensor:
    """A little of it."""
    return 0.05 * coulomb(motion, model)


def cause(effect: Effect, value: float, std: float | None, **more: Any) -> Cause:
    """An effect with its first coefficient."""
    first = effect.coefficients[0]
    size = Size(first.name, unit_of(first.unit, effect.joints, arm("3r")), value, std)
    return Cause(
        **numbers(size), **{
            "effect": effect.name, "family": effect.family, "joints": effect.joints,
            "meaning": effect.meaning, "remedy": effect.remedy, "removes": (0.1, 0.2), **more,
        },
    )  # fmt: skip


FRICTION = cause(
    CoulombFriction(1), 0.61, 0.02, how_sure=0.999, share=0.9, alone=0.92,
    notes=("its value rises with the cut-off",),
)  # fmt: skip
VISCOUS = cause(
    ViscousFriction(0), 0.2, 0.1, how_sure=0.4, share=0.05, alone=0.06,
    ambiguous_with=("power_law_friction", "time_delay"),
)  # fmt: skip
OFFSET = cause(TorqueOffset(2), -0.13, None, how_sure=0.999, share=0.02, alone=0.03)


def diagnosis(status: Status = "explained", **changes: object) -> TorqueDiagnosis:
    """A diagnosis of the 3R that any status could have."""
    robot = arm("3r")
    before = torch.tensor([0.08, 0.61, 0.05], dtype=torch.float64)
    after = torch.tensor([0.06, 0.07, 0.05], dtype=torch.float64)
    gaps = [
        JointGap(0, 0.08, (0.04, 0.06), 0.02),
        JointGap(1, 0.61, (0.04, 0.06), 0.98),
        JointGap(2, 0.05, (0.04, 0.06), 0.0),
    ]
    regimes = [
        RegimeGap(1, "reversal", 0.64, (0.55, 0.71), 0.002),
        RegimeGap(1, "slow", 0.2, (0.02, 0.35), 0.03),
        RegimeGap(2, "rest", 0.4, (0.1, 0.6), 0.01),
        RegimeGap(0, "fast", 0.1, (-0.1, 0.3), 0.02),
    ]
    made = TorqueDiagnosis(
        robot=robot,
        corrected=robot,
        status=status,
        joints=tuple(gaps),
        regimes=tuple(regimes),
        causes=(FRICTION,),
        how_far=HowFar(before, after, 0.93, (0.9, 0.95)),
        budget=Budget(0.02, 0.93, 0.05),
        floor=floor(),
        not_testable=(
            NotTestable("rotor_inertia", (0,), None, "kg m^2", "exactly a sum of base parameters"),
            NotTestable("torque_offset", (2,), 0.4, "N m", "too small beside the noise"),
        ),
        next_experiment=Experiment(
            separates=("coulomb_friction", "viscous_friction"),
            joint=1,
            do="Move slow and fast.",
            most_informative=Informative(trajectory="run1", from_s=1.0, to_s=2.0, share=0.1),
            seconds_of_the_same_motion=30.0,
        ),
        traces=(trace(coulomb, some_left),),
        band=BAND,
        cutoff=8.0,
        settings=GapSettings(),
        refitted=False,
        warnings=("the log is short",),
    )
    empty = {"causes": ()}
    by_status: dict[str, dict[str, object]] = {
        "no_gap": empty | {"how_far": HowFar(after, after, None, None)},
        "parametric_only": {"causes": (body_cause((2,), share=0.8),)},
        "not_testable": empty,
    }
    changes = by_status.get(status, {}) | changes
    changes["causes"] = tuple(sorted(changes.get("causes", made.causes), key=lambda c: -c.share))
    return replace(made, **changes)  # type: ignore[arg-type]
