"""What a torque is: measured at the joint, without gravity, or without the model, as nominal
parameters tell over the whole arm."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.doctor.check import Check, worded_check
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.robot.model import joint_list
from torchid.statistics.criteria import HOLDS, HOLDS_NONE, UNEXPLAINED
from torchid.statistics.jackknife import fit_statistics


@dataclass(frozen=True)
class Shares:
    """How much of the nominal torque's parts a measured torque holds, with 95 % intervals.

    Attributes:
        gravity: (3,) gravity that the nominal masses show, over the robot's own size.
        gravity_half: (3,) half of its interval.
        inertial: accelerations, Coriolis and centrifugal torques.
        inertial_half: half of its interval.
        joints: from 0, those whose nominal gravity torque varies.
        explained: spread of what these parts explain over the torque's, the median of all joints.
    """

    gravity: np.ndarray
    gravity_half: np.ndarray
    inertial: float
    inertial_half: float
    joints: tuple[int, ...]
    explained: float

    @property
    def weightless(self) -> bool:
        """Whether no direction of gravity shows, each clearly."""
        return bool((np.abs(self.gravity) + self.gravity_half < HOLDS_NONE).all())

    @property
    def inert(self) -> bool | None:
        """Whether it holds no inertial torque; None where that is not clear."""
        if abs(self.inertial) + self.inertial_half < HOLDS_NONE:
            return True
        return False if self.inertial - self.inertial_half > HOLDS else None


def shares_of(judge: Judge, hypothesis: Hypothesis) -> Shares | None:
    """The shares, by one regression over all joints with friction, rotor and offset of each; None
    without nominal parameters, without gravity, or where no joint's nominal gravity varies."""
    robot = judge.robot
    size = float(robot.gravity.norm())
    if robot.parameters is None or not robot.parameters.pi.any() or size == 0.0:
        return None
    q = judge.motion(hypothesis)[..., 0]
    zero = torch.zeros_like(q)
    inertial = judge.nominal(hypothesis, torch.zeros(3, dtype=torch.float64))
    axes = torch.eye(3, dtype=torch.float64) * size
    weights = [inverse_dynamics(replace(robot, gravity=g), q, zero, zero) for g in axes]
    parts = torch.stack([*weights, inertial], -1).numpy()
    tau, moving = judge.torque(hypothesis), judge.moving(hypothesis)
    block = judge.samples.block.numpy()
    own = judge.own(hypothesis).numpy()
    rows, targets, owners, weighed = [], [], [], []
    live = judge.live(hypothesis)
    for at, j in enumerate(live):
        use = moving[:, j]
        x = np.zeros((int(use.sum()), 4 + 4 * len(live)))
        x[:, :4] = parts[use, j]
        x[:, 4 + 4 * at : 8 + 4 * at] = own[use, j]
        y = tau[use, j]
        # Each joint counts as its torque's own misfit and the nominal masses' errors let it: a
        # torque of another size in one joint has a misfit of another size.
        columns = np.r_[0:4, 4 + 4 * at : 8 + 4 * at]
        left = y - x[:, columns] @ np.linalg.lstsq(x[:, columns], y, rcond=1e-9)[0]
        nominal = parts[use, j].sum(-1).std()
        # 0.3: errors of nominal masses, as a share of the torque that they make
        scale = max(np.hypot(left.std(), 0.3 * nominal), 0.02 * y.std(), 1e-300)
        rows.append(x / scale)
        targets.append(y / scale)
        owners.append(block[use])
        # 0.2: spread of a joint's nominal part, over that of its nominal torque, from which on it
        # counts
        if parts[use, j, :3].std(0).max() > 0.2 * max(nominal, 1e-300):
            weighed.append(j)
    if not weighed:
        return None
    a, y = np.concatenate(rows), np.concatenate(targets)
    owner = np.unique(np.concatenate(owners), return_inverse=True)[1]
    if owner.max() < 2:
        return None
    norm = np.linalg.norm(a, axis=0)
    norm[norm == 0.0] = 1.0
    # Gravity along an axis that never shows, such as a planar arm's, has no share.
    seen = np.linalg.norm(a[:, :3], axis=0) > 1e-6 * np.linalg.norm(a[:, :3])
    keep = np.r_[seen, np.ones(a.shape[1] - 3, bool)]
    values = np.linalg.lstsq(a[:, keep] / norm[keep], y, rcond=1e-9)[0] / norm[keep]
    left = torch.from_numpy(y - a[:, keep] @ values)
    statistics = fit_statistics(torch.from_numpy(a[:, keep]), left, torch.from_numpy(owner))
    interval = statistics.interval(torch.from_numpy(values)).numpy()
    half = 0.5 * (interval[:, 1] - interval[:, 0])
    count = int(seen.sum())
    gravity, gravity_half = np.zeros(3), np.zeros(3)
    gravity[seen], gravity_half[seen] = values[:count], half[:count]
    explained = [
        float(
            (parts[use, j] @ np.r_[gravity, values[count]]).std() / max(tau[use, j].std(), 1e-300)
        )
        for j in live
        for use in [moving[:, j]]
    ]
    return Shares(
        gravity, gravity_half, float(values[count]), float(half[count]), tuple(weighed),
        float(np.median(explained)),
    )  # fmt: skip


def check_kind(judge: Judge, end: Hypothesis) -> Check | None:
    """A torque that holds no gravity, or no part of the model at all; None where it holds gravity,
    is one of another size, or nothing can be said.

    Args:
        judge: of the log.
        end: what the search ended with; sizes of single joints, with which it makes up for what is
            not there, are left aside.
    """
    signs = tuple(float(np.sign(f)) for f in end.tau.factors)
    shares = shares_of(judge, replace(end, tau=replace(end.tau, factors=signs)))
    if shares is None or not shares.weightless:
        return None
    # 0.5: share of the torque that nominal parts explain, however small they are, from which on it
    # is a torque in another unit, or of the motors' side
    if shares.inert and shares.explained > 0.5:
        return None
    if not shares.inert:
        # Of what no body explains with or without gravity it says nothing that none shows.
        starts = (weightless(h) for h in (end, Hypothesis.literal(judge.robot)))
        left = [np.median(judge.score(h).errors[list(shares.joints)]) for h in starts]
        if min(left) > UNEXPLAINED:
            return None
    gravity = float(np.linalg.norm(shares.gravity))
    most = float(np.linalg.norm(np.abs(shares.gravity) + shares.gravity_half))
    text = (
        f"the torque shows {gravity:.2g} (at most {most:.2g}) of the gravity that the robot's own "
        f"masses make in {joint_list(shares.joints)}"
    )
    inertial = f"{shares.inertial:.2g} (± {shares.inertial_half:.2g})"
    if shares.inert:
        both = gravity, shares.inertial
        known = {"text": text, "inertial": inertial}
        return worded_check("torque kind", "wrong", joints=shares.joints, estimate=both, **known)
    also = ""
    if shares.inert is None:
        also = f"; as good: external torque, without the model ({inertial} of the accelerations')"
    none = (0.0, 0.0, 0.0)
    return worded_check(
        "gravity", "wrong none", joints=shares.joints, estimate=none, text=text + also
    )


def weightless(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis of a torque that holds no gravity."""
    return replace(hypothesis, gravity=(0.0, 0.0, 0.0))


def holds_no_gravity(check: Check) -> bool:
    """Whether a check says so."""
    return check.name == "gravity" and check.verdict == "wrong" and check.estimate == (0.0,) * 3
