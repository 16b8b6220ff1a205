"""What the log can show: which joints are excited, and on which side of the gear torque is."""

from dataclasses import replace

import numpy as np

from torchid.doctor.check import Check
from torchid.doctor.cone import OWN
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.search import Search
from torchid.log.model import Log
from torchid.robot.model import joint_list

CONDITION = 300.0
"""Of a joint's own columns, each scaled to one, from which they cannot be told apart."""
SMALL = 0.1
"""Range of a position that excites too little [rad or m]."""
MOTOR_FRICTION, LINK_FRICTION = 0.4, 0.15
"""Coulomb friction over the torque's spread (median of the joints): above the first there is a gear
in the torque, below the second, with no rotor's inertia either, there is none. Motor currents of UR
arms and the EMPS have 0.42 to 0.63, joint torque sensors of a Panda and an xMate 0.09 to 0.13."""


def check_excitation(judge: Judge, hypothesis: Hypothesis, log: Log) -> Check:
    """Condition of each joint's own columns: speed, direction, acceleration, offset, gravity."""
    live = judge.live(hypothesis)
    extent = (log.q.amax(0) - log.q.amin(0)).tolist()
    conditions = {k: _condition(judge, hypothesis, k) for k in live}
    weak = [k for k in range(judge.robot.n) if k not in live or extent[k] < SMALL]
    alike = [k for k, c in conditions.items() if c > CONDITION and k not in weak]
    worst = max(conditions.values(), default=np.inf)
    if not weak and not alike:
        return Check(
            "excitation",
            "fine",
            f"own columns have condition numbers up to {worst:.0f}, ranges from {min(extent):.2g}",
            estimate=worst,
        )
    said = []
    if weak:
        said.append(
            f"{joint_list(weak)} hardly move"
            + ("s" if len(weak) == 1 else "")
            + " ("
            + ", ".join(f"{extent[k]:.2g}" for k in weak)
            + " rad or m, or never with a varying torque)"
        )
    if alike:
        said.append(
            f"speed, direction, acceleration and gravity of {joint_list(alike)} vary together "
            "(condition " + ", ".join(f"{conditions[k]:.0f}" for k in alike) + ")"
        )
    joints = tuple(sorted({*weak, *alike}))
    return Check(
        "excitation",
        "doubtful",
        "; ".join(said),
        joints=joints,
        estimate=tuple(conditions.get(k, float("inf")) for k in joints),
        fix="add a log that moves them more; `torchid excite` designs one",
    )


def _condition(judge: Judge, hypothesis: Hypothesis, joint: int) -> float:
    """Of dq, direction, ddq and one in the joint's own torque."""
    n = judge.robot.n
    own = np.arange(OWN) + 10 * n + OWN * joint
    gram = judge.normal(hypothesis).gram.sum(0)[joint][np.ix_(own, own)]
    size = np.sqrt(np.diagonal(gram))
    if (size == 0).any():
        return float("inf")
    values = np.linalg.eigvalsh(gram / np.outer(size, size))
    return float(np.sqrt(values[-1] / max(values[0], 1e-300)))


def check_side(judge: Judge, result: Search) -> Check:
    """Motor side or link side, by the friction and the rotor inertia that torque contains."""
    end = result.final.hypothesis
    normal = judge.normal(end)
    live = judge.live(end)
    if not live:
        return Check("torque side", "cannot tell", "nothing moves with a torque")
    n = judge.robot.n
    own = result.final.fit.x[10 * n :].reshape(n, OWN)
    spread = np.sqrt(np.where(normal.spread > 0, normal.spread, 1.0))
    friction = (np.abs(own[:, 1]) / spread)[live]
    rotor = own[live, 2]
    middle = float(np.median(friction))
    share = int((rotor > 0).sum())
    some = share > len(live) / 4
    text = (
        f"Coulomb friction is {100 * middle:.2g} % of the torque's spread (median of the joints), "
        f"{share} of {len(live)} joints show a rotor's inertia"
    )
    base = Check(
        "torque side",
        "cannot tell",
        text,
        joints=tuple(live),
        estimate=tuple(friction.tolist()),
        unit="share",
    )
    if middle > MOTOR_FRICTION:
        text = f"{text}: motor side, gear friction included"
        return replace(base, verdict="fine", evidence=text)
    if middle < LINK_FRICTION and not some:
        return replace(base, verdict="fine", evidence=f"{text}: link side, behind the gear")
    return base
