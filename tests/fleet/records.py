"""Identifications as files: a 3R whose least squares is made here, not by torchid's fit."""

from pathlib import Path

import torch

from torchid.effects.registry import on_every_joint
from torchid.excitation.design import base_regressor
from torchid.identification.base_parameters import base_parameters, nominal_values, random_states
from torchid.identification.record import (
    Errors,
    Grouping,
    IdentificationRecord,
    SettingsRecord,
    StatisticsRecord,
)
from torchid.identification.settings import Settings
from torchid.robot.library import load_robot

EFFECTS = ("viscous_friction", "coulomb_friction")


def identification(
    path: Path,
    seed: int,
    *,
    robot=None,
    effects=EFFECTS,
    change=None,
    claimed: float = 1.0,
    model: bool = True,
    blocks: int = 60,
) -> Path:
    """Least squares on 200 random states with white noise of 0.1 N m.

    `change`: dict of base parameter to a difference of its true value, in standard deviations.
    `claimed`: what the standard deviations in the file are of the true ones. The covariance is a
    Wishart sample of `blocks` - 1 degrees of freedom, as a jackknife's is.
    """
    robot = robot or load_robot("3r_friction")
    kinds = on_every_joint(effects, robot.n)
    base = base_parameters(robot, kinds)
    truth = nominal_values(robot, base)
    generator = torch.Generator().manual_seed(1000 + seed)
    y = base_regressor(robot, base, random_states(robot, seed, 200), effects=kinds) / 0.1
    r = torch.linalg.qr(y, mode="r").R
    root = torch.linalg.inv(r)
    for name, steps in (change or {}).items():
        k = base.names.index(name)
        truth[k] += steps * root[k].norm()
    noise = torch.randn(len(base), generator=generator, dtype=torch.float64)
    values = truth + root @ noise
    sample = root @ torch.randn(len(base), blocks - 1, generator=generator, dtype=torch.float64)
    covariance = claimed**2 * sample @ sample.T / (blocks - 1)
    factor = torch.zeros(len(base) + 1, len(base) + 1, dtype=torch.float64)
    factor[:-1, :-1] = r
    errors = [torch.zeros(robot.n, dtype=torch.float64)] * 6
    IdentificationRecord(
        robot=robot.name, n_base=base.n_rigid, basis=base.basis, parameters=(), effects=(),
        combined=(), condition_number=1.0, scaled_condition_number=1.0, cutoff=None,
        cutoff_choice=None, reversal=torch.zeros(robot.n, dtype=torch.float64),
        fit=Errors((f"run {seed}",), *errors), held_out=None, bounded=(), wrong_sign=(),
        undetermined=(), dropped=(), absorbed=(), rank_gap=base.rank_gap,
        grouping=Grouping(parameter_names=base.parameter_names, grouping=base.grouping),
        base_names=base.names, values=values, covariance=covariance, factor=factor,
        statistics=StatisticsRecord(
            method="", blocks=blocks, block_seconds=1.0, correlation_seconds=0.1, quantile95=2.0
        ),
        settings=SettingsRecord.of(Settings(effects=tuple(effects))), warnings=(),
        model=robot if model else None,
    ).save(path)  # fmt: skip
    return path


def several(folder: Path, count: int, **arguments) -> list[Path]:
    """Files a.json, b.json, ... of independent runs."""
    return [
        identification(folder / f"{chr(97 + k)}.json", seed=arguments.get("first", 0) + k,
                       **{key: v for key, v in arguments.items() if key != "first"})
        for k in range(count)
    ]  # fmt: skip
