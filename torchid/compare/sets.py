"""Several extractions of one robot: which physical parameters their sets agree on."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.compare.reading import Compared
from torchid.compare.record import Range, SetComparison, Verdict
from torchid.compare.scatter import monotone
from torchid.compare.torque import common_motion, described_model, torque_spread
from torchid.errors import TorchidError
from torchid.feasibility.sets import SetsRecord, read_other_effects, read_sets
from torchid.identification.base_parameters import base_parameters
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters, parameter_names, parameter_units
from torchid.robot.library import named_robot
from torchid.robot.model import Robot
from torchid.robot.tree import Choice
from torchid.typing import Float, Tensor

UNKNOWN = 0.5
"""Half of a range, relative to its middle, from which a parameter is called undetermined."""

SAME = 1e-6
"""Relative difference of single values that counts as none."""


def robot_of(results: Sequence[Compared[SetsRecord]], choice: Choice | None = None) -> Robot:
    """The robot that files of sets name.

    Raises:
        TorchidError: files of different robots, or of one that is not where it was.
    """
    names = list(dict.fromkeys(str(r.record.robot) for r in results))
    if len(names) > 1:
        raise TorchidError("the sets are of different robots.", got=", ".join(names))
    return named_robot(results[0].path, results[0].record.named, choice)


def compare_sets(
    results: Sequence[Compared[SetsRecord]], robot: Robot, *, on: Log | None = None, seed: int = 0
) -> SetComparison:
    """Compare two or more files of sets of one robot.

    Raises:
        TorchidError: files that do not fit the robot, or have different effects.
    """
    sets = [read_sets(r.path, robot) for r in results]
    if any(s.effects != sets[0].effects for s in sets):
        raise TorchidError(
            "the sets have different effects.",
            got="; ".join(
                f"{r.label}: {', '.join(s.coefficient_names()) or 'none'}"
                for r, s in zip(results, sets, strict=True)
            ),
            expected="the same in all files",
        )
    units = [c.unit for e in sets[0].effects for c in e.coefficients]
    base = base_parameters(robot, sets[0].effects)
    vectors = [s.vector.double() for s in sets]
    models = []
    for s, r in zip(sets, results, strict=True):
        mean = robot.with_parameters(InertialParameters(s.parameters.pi.mean(0)))
        values = iter(s.coefficients.mean(0).tolist())
        records = [effect.record(own) for effect, own in read_other_effects(r.path, robot)]
        records += [e.record([next(values) for _ in e.coefficients]) for e in s.effects]
        models.append(described_model(replace(mean, effects=tuple(records))))
    motion = common_motion(robot, on, seed)
    return SetComparison(
        labels=tuple(r.label for r in results),
        counts=tuple(len(s) for s in sets),
        robot=robot.name,
        physical=_ranges(
            vectors,
            [*parameter_names(robot.n_links), *sets[0].coefficient_names()],
            [*parameter_units(robot.n_links), *units],
        ),
        base=_ranges([base.project(v) for v in vectors], base.names, base.units),
        torque=torque_spread(models, motion),
        notes=tuple(
            f"{r.label} says that its sets are of '{r.record.robot}'"
            for r in results
            if r.record.robot not in (None, robot.name)
        ),
    )


def _ranges(
    vectors: Sequence[Float[Tensor, "K P"]], names: Sequence[str], units: Sequence[str]
) -> tuple[Range, ...]:
    low, high = (torch.stack([getattr(v, f)(0) for v in vectors]) for f in ("amin", "amax"))
    out = []
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        bottom, top = low[:, k], high[:, k]
        middle, half = (bottom + top) / 2, (top - bottom) / 2
        slack = SAME * float(torch.maximum(bottom.abs(), top.abs()).max())
        verdict: Verdict = "agree"
        if float(bottom.max()) > float(top.min()) + slack:
            verdict = "drift" if monotone(middle) else "differ"
        elif bool((half > UNKNOWN * middle.abs()).all()):
            verdict = "never_determined"
        out.append(Range(name, unit, verdict, bottom, top))
    return tuple(out)
