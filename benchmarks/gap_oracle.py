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

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from gap_cases import Arm, fresh_scene, true_logs
from gap_plant import on_clock

from torchid.design.columns import Columns, Model
from torchid.effects.registry import EVENTS, KINDS, Valued, effect_from_record, nominal_effects
from torchid.gap.data import prepare
from torchid.gap.diagnosis import Diagnosis
from torchid.gap.noise.floor import stuck
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.gap.validate.traces import traces
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.sensors import sensed_log

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


def oracle(robot: Robot, log: Log, planted: Mapping[str, Any], seed: int) -> Diagnosis:
    """The diagnosis that is told what to fit."""
    body = planted["name"] == "link_inertia"
    places = [joint - 1 for joint in planted["place"]] or [None]
    settings = GapSettings(
        effects=(planted["name"],),
        only=tuple((planted["name"], place) for place in places),
        parameters="auto" if body else "trusted",
        alpha=0.5,
        max_effects=1,
        rollout=False,
        seed=seed,
    )
    return diagnose_torque(robot, log, settings=settings)


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
    """Closed fraction of each corrected model on the fresh log, in the rows that count in a
    diagnosis."""
    given = prepare(arm.scene.robot, _fresh_log(arm, work), None, _clock(arm))
    nominal = Model(arm.scene.robot, tuple(nominal_effects(arm.scene.robot)))
    out = []
    for model in models:
        robot, effects = robot_of(arm.scene.robot, model)
        after = Model(robot, tuple(effects))
        reach = stuck(Columns(after, given.samples), arm.scene.noise)
        shown = traces(given.samples, None, [nominal], [after], band, reach=reach)
        losses = []
        for predicted in ("before", "after"):
            left = [
                (t.measured - getattr(t, predicted))[t.valid] * t.counting[t.valid] for t in shown
            ]
            losses.append(float((torch.cat(left) / arm.scene.noise).square().sum()))
        out.append(1 - losses[1] / losses[0])
    return out


def _clock(arm: Arm) -> float:
    """When the fresh log begins, from the start of the diagnosed one [s]."""
    return fresh_scene(arm).starts[0] - arm.scene.starts[0]


def _fresh_log(arm: Arm, work: Path) -> Log:
    """As sensors without noise see it; velocities only where the diagnosed log has them."""
    own = any("velocity" in KINDS[name].needs for name in arm.case.names)
    parts = []
    for log, start in zip(
        true_logs(arm.case, work, fresh=True), fresh_scene(arm).starts, strict=True
    ):
        seen = sensed_log(arm.scene.robot, log, on_clock(arm.effects, start))
        parts.append(seen.replace(dq=seen.dq if own else None, ddq=None))
    return Log.concatenate(parts)


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
