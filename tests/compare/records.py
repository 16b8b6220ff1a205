"""Identifications as files: a 3R whose least squares is made here, not by torchid's fit."""

import json
from pathlib import Path

import torch

from torchid.effects.registry import on_every_joint
from torchid.excitation.design import base_regressor
from torchid.identification.base_parameters import base_parameters, nominal_values, random_states
from torchid.robot.library import load_robot
from torchid.robot.record import robot_record

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
    data = {
        "schema": "torchid.identification/1",
        "robot": robot.name,
        "grouping": {"parameters": list(base.parameter_names), "matrix": base.grouping.tolist()},
        "base_names": list(base.names),
        "base_values": values.tolist(),
        "covariance": covariance.tolist(),
        "factor": factor.tolist(),
        "rank_gap": list(base.rank_gap),
        "undetermined": [],
        "bounded": [],
        "dropped": [],
        "statistics": {"blocks": blocks, "quantile95": 2.0},
        "cutoff_hz": None,
        "reversal_speed": [0.0] * robot.n,
        "settings": {"effects": list(effects)},
        "fit": {"trajectories": [f"run {seed}"]},
    }
    if model:
        data["model"] = robot_record(robot)
    path.write_text(json.dumps(data))
    return path


def several(folder: Path, count: int, **arguments) -> list[Path]:
    """Files a.json, b.json, ... of independent runs."""
    return [
        identification(folder / f"{chr(97 + k)}.json", seed=arguments.get("first", 0) + k,
                       **{key: v for key, v in arguments.items() if key != "first"})
        for k in range(count)
    ]  # fmt: skip
