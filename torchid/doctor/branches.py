"""Are two branches that are built alike, such as left and right legs, exchanged in the log?

Bodies that are free fit either way: what the left leg's columns say is a possible right leg. So
the robot's own parameters decide, whose centres of mass are mirrored from branch to branch.
"""

from itertools import combinations

import numpy as np

from torchid.doctor.check import Check
from torchid.doctor.hypothesis import FEWEST, Hypothesis, Judge
from torchid.doctor.repair import MOTION, TORQUE, Reorder, within
from torchid.doctor.samples import BLOCKS
from torchid.doctor.search import AGREE, CLEAR
from torchid.robot.model import Robot, joint_list

ALIKE = 0.5
"""Share of its torque that a joint's model may leave, either way, for it to be asked [1]."""


def alike(robot: Robot) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Pairs of branches of one link with joints of the same kinds in the same tree: coordinates."""
    place = {link: k for k, link in enumerate(robot.own_links)}

    def branch(link: int) -> tuple[tuple[int, ...], tuple]:
        links = robot.descendants(link)
        index = {k: i for i, k in enumerate(links)}
        shape = tuple(
            (index.get(robot.parents[k], -1), robot.drives[k].joint_type, k in place) for k in links
        )
        return tuple(place[k] for k in links if k in place), shape

    firsts: dict[int, list[int]] = {}
    for link, parent in enumerate(robot.parents):
        firsts.setdefault(parent, []).append(link)
    found = []
    for group in firsts.values():
        for (a, one), (b, other) in combinations([branch(link) for link in group], 2):
            if one == other and a:
                found.append((a, b))
    return found


def check_branches(judge: Judge, now: Hypothesis) -> list[Check]:
    """A check of the two branches whose exchange explains the torque clearly better, if there are
    any, by the robot's own parameters beside friction, rotor and offset of each joint."""
    robot = judge.robot
    pairs = [] if robot.parameters is None else alike(robot)
    best: tuple[float, tuple[int, ...], np.ndarray, np.ndarray, int] | None = None
    before = _left(judge, now) if pairs else np.zeros(0)
    for a, b in pairs:
        image = dict(zip((*a, *b), (*b, *a), strict=True))
        order = tuple(image.get(k, k) for k in range(robot.n))
        after = _left(judge, now.reordered(order, q=True, tau=True))
        both = [*a, *b]
        gains = np.log(before[:, both]) - np.log(after[:, both])
        by_block = np.nansum(gains, 1)
        gain, agreeing = float(by_block.mean()), int((by_block > 0).sum())
        fits = float(np.nanmedian(after[:, both])) < ALIKE
        clear = gain > CLEAR and agreeing >= AGREE * len(by_block) and fits
        if clear and (best is None or gain > best[0]):
            best = gain, order, before[:, both], after[:, both], agreeing
    if best is None:
        return []
    _, order, lit, swapped, agreeing = best
    joints = tuple(k for k, j in enumerate(order) if j != k)
    repair = within(Reorder((*MOTION, *TORQUE), order), judge.samples.signals)
    text = (
        f"the columns of {joint_list(joints)} fit the model's other branch better: it leaves "
        f"{100 * np.nanmedian(swapped):.2g} % of their torque, their own "
        f"{100 * np.nanmedian(lit):.2g} % (median), better in {agreeing} of {len(lit)} blocks"
    )
    return [Check("branches exchanged", "wrong", text, joints).mended_by(repair)]


def _left(judge: Judge, hypothesis: Hypothesis) -> np.ndarray:
    """(B, n) what nominal torque, friction, rotor and offset leave of each joint's torque, as a
    share of its spread, in each block; NaN where it does not move."""
    nominal = judge.nominal(hypothesis, judge.robot.gravity).numpy()
    columns = judge.own(hypothesis).numpy()
    tau, moving = judge.torque(hypothesis), judge.moving(hypothesis)
    block = judge.samples.block.numpy()
    out = np.full((BLOCKS, judge.robot.n), np.nan)
    for j in judge.live(hypothesis):
        rows = moving[:, j]
        own = columns[rows, j]
        gap = (tau - nominal)[rows, j]
        left = gap - own @ np.linalg.lstsq(own, gap, rcond=None)[0]
        spread = tau[rows, j].std()
        for b in range(BLOCKS):
            part = left[block[rows] == b]
            if len(part) >= FEWEST:
                out[b, j] = max(float(np.sqrt((part**2).mean())) / spread, 1e-3)
    return out
