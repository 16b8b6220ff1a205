"""What a user must know beside the findings."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.gap.case import Case
from torchid.gap.diagnosis import Trace
from torchid.gap.findings import Findings
from torchid.gap.folds import Folds
from torchid.gap.settings import GapSettings
from torchid.gap.solve import Solution, solve
from torchid.robot.model import Robot
from torchid.typing import Tensor


def remarks(
    case: Case, folds: Folds | None, found: Findings, whole: Solution, settings: GapSettings
) -> list[str]:
    """Warnings of a diagnosis, as sentences."""
    checked = () if case.checked is None else case.checked.warnings
    out = [*case.given.warnings, *checked, *case.noise.notes]
    if not case.noise.repeated:
        out.append(
            "no motion is repeated, so the noise is known only between bounds: drive one "
            "trajectory twice to know it"
        )
    if len(whole.terms) >= settings.max_effects:
        out.append(f"the search ended at {settings.max_effects} effects: --max-effects")
    events = sorted({e.name for e, _ in whole.effects if e.event})
    if events:
        out.append(f"of this log alone, not part of the corrected model: {', '.join(events)}")
    changed = bool(found.parametric) or case.task.free
    if changed and bool((_margins(whole.robot) < 0).any()):
        out.append(
            "the corrected inertial parameters give the right torque but belong to no body: "
            "`torchid check corrected.yaml --nearest near.json` finds feasible ones near in torque"
        )
    if case.fitted:
        out.append(
            "the robot has no inertial parameters: base parameters were fitted first, so the gap "
            "is what even the best rigid body leaves"
        )
    if folds is not None and not folds.whole:
        out.append(
            "fewer than three different trajectories: held-out data are stretches of the same "
            "trajectories, and intervals are wider than they look"
        )
    if settings.parameters == "auto" and not case.task.free:
        out += _modes(case, whole)
    return out


def unrelated(traces: Sequence[Trace]) -> list[str]:
    """A sentence where the model as given says nothing of most joints' torque: squares it leaves
    are larger than those of the torque about its mean."""
    torque = torch.cat([t.measured[t.valid] for t in traces])
    gap = torch.cat([(t.measured - t.before)[t.valid] for t in traces])
    useless = gap.square().mean(0) > (torque - torque.mean(0)).square().mean(0)
    if 2 * int(useless.sum()) <= len(useless):
        return []
    joints = ", ".join(str(j + 1) for j in useless.nonzero().flatten().tolist())
    return [
        f"the model explains nothing of the torque of joints {joints}: is the log of this robot, "
        "its joints in this order, in these units? `torchid log doctor ROBOT LOG` looks"
    ]


def _margins(robot: Robot) -> Tensor:
    return robot.require_parameters("a check").consistency_margin()


def _modes(case: Case, whole: Solution) -> list[str]:
    """Whether the diagnosis with base parameters always refitted names other effects."""
    if not whole.terms:
        return []
    task = replace(case.task, free=True)
    free = solve(case.evaluator, case.plain, case.keep, task, case.banks)
    names = [
        {(t.name, t.effects[0].joints) for t in s.terms if t.effects and not t.is_inertial}
        for s in (whole, free)
    ]
    lost = sorted(f"{n} of joint {j[0] + 1}" if j else n for n, j in names[0] - names[1])
    if not lost:
        return []
    return [
        "with base parameters refitted these effects are not needed, so they hold only if the "
        f"robot's parameters are right: {', '.join(lost)}"
    ]
