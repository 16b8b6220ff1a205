"""How far a diagnosis closes a gap, measured: against one that is told the effect, and on fresh logs.

- The oracle is the same diagnosis, folds and shape refinement included, that has one candidate: the
  planted effect on the planted joint, accepted at any level. The ratio is that of the closed
  fractions, each judged on its own held-out folds.
- On a fresh log (four later trajectories of the same arm) signals are those of ideal sensors: the
  effects in the sensors act, but nothing is rounded and there is no noise. So the noise's part in
  (L0 - L*) / (L0 - Ln) is zero, and closed = 1 - L*/L0 with L the mean square of the gap below the
  report's band, joints weighted by their true noise, models fitted on the whole diagnosed log.
- Coverage: whether closed_ci95 holds the fresh closed fraction, and whether value +- 1.96 std holds
  the planted coefficient, for effects found by name and place that have no shape and no free body.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from gap_cases import Arm, fresh_scene, place_of, true_logs
from gap_plant import on_clock

import torchid.gap.diagnose as procedure
from torchid.effects.base import Motion
from torchid.effects.registry import Valued, effect_from_record, model_torque, nominal_effects
from torchid.gap.candidates import Bank
from torchid.gap.diagnosis import Diagnosis
from torchid.gap.settings import GapSettings
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.log.sampling import sampling_rate
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.sensors import sensed_log

EVENTS = ("contact", "dropped_samples")
"""They happened in one log; a fresh one cannot be predicted with them."""

WELL_DEFINED = (
    "viscous_friction",
    "coulomb_friction",
    "load_dependent_friction",
    "torque_offset",
    "rotor_inertia",
    "base_tilt",
    "torque_gain",
    "torque_crosstalk",
    "encoder_offset",
    "time_delay",
    "filter_lag",
    "joint_elasticity",
)
"""Effects whose coefficients mean the same whatever shape was found."""


@contextmanager
def told(name: str, place: Sequence[int]) -> Iterator[None]:
    """Diagnoses within have one candidate: an effect at a place (joints from 1)."""
    every = procedure.banks_of

    def one(*args: Any) -> list[Bank]:
        return [bank for bank in every(*args) if _is(bank, name, place)]

    with mock.patch.object(procedure, "banks_of", one):
        yield


def _is(bank: Bank, name: str, place: Sequence[int]) -> bool:
    if bank.name != name:
        return False
    effects = bank.members[0]
    return len(effects) == 1 and place_of(effects[0]) == list(place)


def oracle(robot: Robot, log: Log, planted: Mapping[str, Any], seed: int) -> Diagnosis:
    """The diagnosis that is told what to fit."""
    body = planted["name"] == "link_inertia"
    settings = GapSettings(
        effects=(planted["name"],),
        parameters="auto" if body else "trusted",
        alpha=0.5,
        max_effects=1,
        rollout=False,
        seed=seed,
    )
    with told(planted["name"], planted["place"]):
        return procedure.diagnose(robot, log, settings=settings)


def model_of(diagnosed: Diagnosis) -> dict[str, Any]:
    """The corrected model, for a file."""
    robot = diagnosed.corrected
    return {
        "effects": [dict(record) for record in robot.effects],
        "pi": robot.require_parameters("a file").pi.tolist(),
    }


def robot_of(nominal: Robot, model: Mapping[str, Any]) -> tuple[Robot, list[Valued]]:
    """The corrected model from a file, without what happened in one log."""
    pi = torch.tensor(model["pi"], dtype=torch.float64)
    robot = nominal.with_parameters(InertialParameters(pi))
    kept = [record for record in model["effects"] if record["effect"] not in EVENTS]
    return robot, [effect_from_record(record, robot) for record in kept]


def fresh_closed(
    arm: Arm, models: Sequence[Mapping[str, Any]], work: Path, band: float
) -> list[float]:
    """Closed fraction of each corrected model on the fresh log."""
    place = fresh_scene(arm)
    nominal = arm.scene.robot
    logs = true_logs(arm.case, work, fresh=True)
    both = [(nominal, nominal_effects(nominal)), *(robot_of(nominal, m) for m in models)]
    loss = torch.zeros(len(both), dtype=torch.float64)
    for log, start in zip(logs, place.starts, strict=True):
        seen = sensed_log(log, on_clock(arm.effects, start))
        assert seen.dq is not None
        assert seen.ddq is not None
        assert seen.tau is not None
        motion = Motion(seen.q, seen.dq, seen.ddq, t=seen.t - arm.scene.starts[0])
        low = ZeroPhaseFilter(sampling_rate(seen)[0], band)
        edge = low.tail
        for k, (robot, effects) in enumerate(both):
            left = low.apply((seen.tau - model_torque(robot, effects, motion)).T)
            left = left[:, edge:-edge] / arm.scene.noise.unsqueeze(1)
            loss[k] += left.square().sum()
    return (1 - loss[1:] / loss[0]).tolist()


def coverage(row: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Planted coefficients and what was found for them, of a row with one effect."""
    planted = row["truth"][0]
    if planted["name"] not in WELL_DEFINED:
        return []
    same = [
        f
        for f in row["findings"]
        if f["name"] == planted["name"] and f["place"] == planted["place"]
    ]
    if len(same) != 1:
        return []
    found = same[0]
    out = []
    for name, value, std in zip(found["coefficients"], found["values"], found["std"], strict=True):
        true = planted["record"][name]
        out.append({"coefficient": name, "true": true, "value": value, "std": std})
    return out
