"""The recursive dynamics of a tree of links, written once on components.

Two passes, as in Newton-Euler (eqs. 2.12, 2.13): `kinematics` goes from the base to the tips and
knows no inertial parameters; `forces` goes back and is linear in them. With

    S = [wd]x + [w]x [w]x        (3x3, in the link frame)

every point r of a link accelerates by a + S r, so a link of mass m, first moment h and inertia J
about the frame's origin needs the force f = m a + S h and the moment n = h x a + J wd + w x J w.

Quantities of link i are in the axes of link frame i, about its origin. Gravity enters as the
acceleration -g of the base. What is not on a link's way to the base does not move it and is
nowhere computed. A joint that mimics another moves by ratio * q + offset of that one's coordinate,
and its own torque times the ratio is part of that one's (virtual work).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from torchid.dynamics.scalars import (
    ZERO,
    Scalar,
    Vec3,
    add,
    add3,
    add_cross,
    add_scaled,
    cross,
    dot,
    fma,
    mul,
)
from torchid.robot.model import JointType, Robot

Matrix = tuple[Vec3, Vec3, Vec3]
"""Rows of a 3x3 matrix."""


@dataclass(frozen=True)
class JointGeometry:
    """Constants of one joint, as Python floats.

    Attributes:
        parent: link that carries the joint, -1 for the base.
        coordinate, ratio, offset: the joint's position is ratio * q + offset of that coordinate.
        revolute: or prismatic.
        constant, cosine, sine: (3, 3) each; the rotation from link to parent link axes is
            constant + cosine cos q + sine sin q.
        previous_offset: joint frame's origin in the parent link frame [m].
        link_offset: link frame's origin from the joint frame's, in link axes [m] (q = 0).
        axis: unit vector along the joint, in link axes.
    """

    parent: int
    coordinate: int
    ratio: float
    offset: float
    revolute: bool
    constant: tuple[tuple[float, ...], ...]
    cosine: tuple[tuple[float, ...], ...]
    sine: tuple[tuple[float, ...], ...]
    previous_offset: Vec3
    link_offset: Vec3
    axis: Vec3

    def position(self, q: Sequence[Tensor]) -> Tensor:
        """Position of the joint [rad or m], from those of the coordinates."""
        own = q[self.coordinate]
        return own if self.ratio == 1.0 and self.offset == 0.0 else own * self.ratio + self.offset

    def rate(self, rates: Sequence[Scalar]) -> Scalar:
        """Velocity or acceleration of the joint, from those of the coordinates."""
        return mul(rates[self.coordinate], self.ratio)


@dataclass(frozen=True)
class ChainGeometry:
    """Constants of the whole tree, made once per robot.

    Attributes:
        joints: one a link, each behind the one that carries it.
        gravity: in the base frame [m/s^2].
        moved: for each coordinate the links that it moves, in order.
        frames: links that are no bodies, which have no columns.
    """

    joints: tuple[JointGeometry, ...]
    gravity: Vec3
    moved: tuple[tuple[int, ...], ...]
    frames: frozenset[int] = frozenset()


class Link(NamedTuple):
    """Motion of one link, and how to come back from it.

    Attributes:
        w, wd: angular velocity and acceleration.
        a: acceleration of the link frame's origin, gravity included.
        s: S = [wd]x + [w]x [w]x.
        rotation: link axes to parent link axes.
        offset: link frame's origin from the joint frame's, in link axes.
    """

    w: Vec3
    wd: Vec3
    a: Vec3
    s: Matrix
    rotation: Matrix
    offset: Vec3


@lru_cache(maxsize=64)
def chain_geometry(robot: Robot) -> ChainGeometry:
    """The robot's geometry as floats; entries of the rotations within 1e-15 of 0 are 0."""
    joints = []
    for i, drive in enumerate(robot.drives):
        before, after = robot.before[i].double().cpu(), robot.after[i].double().cpu()
        b, a = before[:3, :3], after[:3, :3]
        # R = B Rz(q) A, expanded in 1, cos q, sin q.
        constant = b[:, 2:3] @ a[2:3, :]
        cosine = b[:, 0:1] @ a[0:1, :] + b[:, 1:2] @ a[1:2, :]
        sine = b[:, 1:2] @ a[0:1, :] - b[:, 0:1] @ a[1:2, :]
        revolute = drive.joint_type is JointType.REVOLUTE
        if not revolute:
            constant, cosine, sine = constant + cosine, 0 * cosine, 0 * sine
        joints.append(
            JointGeometry(
                robot.parents[i],
                drive.coordinate,
                drive.ratio,
                drive.offset,
                revolute,
                _rows(constant),
                _rows(cosine),
                _rows(sine),
                Vec3(*before[:3, 3].tolist()),
                Vec3(*(a.T @ after[:3, 3]).tolist()),
                Vec3(*_clean(a[2]).tolist()),
            )
        )
    moved = tuple(robot.moved_by(j) for j in range(robot.n))
    frames = frozenset(range(robot.n_links)) - set(robot.bodies)
    return ChainGeometry(tuple(joints), Vec3(*robot.gravity.double().tolist()), moved, frames)


def _clean(x: Tensor) -> Tensor:
    return torch.where(x.abs() < 1e-15, torch.zeros_like(x), x)


def _rows(x: Tensor) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in _clean(x).tolist())


def kinematics(
    geometry: ChainGeometry, q: Sequence[Tensor], dq: Sequence[Scalar], ddq: Sequence[Scalar]
) -> list[Link]:
    """Forward pass (eq. 2.12): motion of every link, from the base to the tips.

    Args:
        geometry: of the robot.
        q, dq, ddq: n tensors of one shape [rad, rad/s, rad/s^2 or m, ...]; dq and ddq may be 0.0.
    """
    still: Matrix = (ZERO, ZERO, ZERO)
    lifted = Vec3(-geometry.gravity.x, -geometry.gravity.y, -geometry.gravity.z)
    base = Link(ZERO, ZERO, lifted, still, still, ZERO)
    links: list[Link] = []
    for joint in geometry.joints:
        qi, dqi, ddqi = joint.position(q), joint.rate(dq), joint.rate(ddq)
        w, wd, a, s, *_ = links[joint.parent] if joint.parent >= 0 else base
        rotation = _rotation(joint, qi)
        a = add3(a, _apply(s, joint.previous_offset))
        w, wd, a = (_transposed(rotation, v) for v in (w, wd, a))
        offset = joint.link_offset
        turned = cross(w, joint.axis)
        if joint.revolute:
            wd = add_scaled(add_scaled(wd, joint.axis, ddqi), turned, dqi)
            w = add_scaled(w, joint.axis, dqi)
        else:
            a = add_scaled(add_scaled(a, joint.axis, ddqi), turned, dqi, 2.0)
            offset = add_scaled(offset, joint.axis, qi)
        s = _spin(w, wd)
        a = add3(a, _apply(s, offset))
        links.append(Link(w, wd, a, s, rotation, offset))
    return links


def forces(
    geometry: ChainGeometry, links: Sequence[Link], pi: Sequence[Sequence[Scalar]]
) -> tuple[list[Scalar], list[tuple[Vec3, Vec3]]]:
    """Backward pass (eqs. 2.13, 2.14): joint torques, and the wrench each joint transmits.

    Args:
        geometry: of the robot.
        links: from `kinematics`.
        pi: for each link its ten parameters, tensors or floats, in torchid's order.

    Returns:
        torques: n scalars.
        wrenches: for each link the force and the moment about its joint frame's origin that the
            link that carries it exerts on it, in axes of its frame.
    """
    torques: list[Scalar] = [0.0] * len(geometry.moved)
    # At first what each link must give to those that it carries, then what it is given.
    wrenches: list[tuple[Vec3, Vec3]] = [(ZERO, ZERO)] * len(links)
    for i in reversed(range(len(links))):
        link, joint = links[i], geometry.joints[i]
        own_force, own_moment = _newton_euler(link, pi[i])
        force, moment = add3(wrenches[i][0], own_force), add3(wrenches[i][1], own_moment)
        moment = add_cross(moment, link.offset, force)
        torque = dot(joint.axis, moment if joint.revolute else force)
        torques[joint.coordinate] = fma(torques[joint.coordinate], torque, joint.ratio)
        wrenches[i] = (force, moment)
        if joint.parent >= 0:
            force, moment = _turned(link.rotation, force), _turned(link.rotation, moment)
            moment = add_cross(moment, joint.previous_offset, force)
            others = wrenches[joint.parent]
            wrenches[joint.parent] = (add3(others[0], force), add3(others[1], moment))
    return torques, wrenches


def _newton_euler(link: Link, pi: Sequence[Scalar]) -> tuple[Vec3, Vec3]:
    """Force and moment (about the link frame's origin) that one link needs to move so.

    The moment of the inertia uses the second-moment matrix P = tr(J)/2 E - J: J wd + w x J w is
    the axial vector of S P - (S P)', six products fewer than the textbook form.
    """
    m, hx, hy, hz, jxx, jxy, jxz, jyy, jyz, jzz = pi
    h = Vec3(hx, hy, hz)
    force = Vec3(*(fma(dot(row, h), m, ak) for row, ak in zip(link.s, link.a, strict=True)))
    pxx = _half_sum(jyy, jzz, jxx)
    pyy = _half_sum(jxx, jzz, jyy)
    pzz = _half_sum(jxx, jyy, jzz)
    sx, sy, sz = link.s
    # P's off-diagonal entries are -Jxy, -Jxz, -Jyz: their signs are in the -1 below.
    moment = cross(h, link.a)
    x = fma(fma(moment.x, sz.y, pyy), sy.z, pzz, -1.0)
    x = fma(fma(x, sz.x, jxy, -1.0), sy.x, jxz)
    x = fma(fma(x, sz.z, jyz, -1.0), sy.y, jyz)
    y = fma(fma(moment.y, sx.z, pzz), sz.x, pxx, -1.0)
    y = fma(fma(y, sx.y, jyz, -1.0), sz.y, jxy)
    y = fma(fma(y, sx.x, jxz, -1.0), sz.z, jxz)
    z = fma(fma(moment.z, sy.x, pxx), sx.y, pyy, -1.0)
    z = fma(fma(z, sy.z, jxz, -1.0), sx.z, jyz)
    z = fma(fma(z, sy.y, jxy, -1.0), sx.x, jxy)
    return force, Vec3(x, y, z)


def _half_sum(a: Scalar, b: Scalar, minus: Scalar) -> Scalar:
    return mul(fma(add(a, b), minus, -1.0), 0.5)


def regressor_rows(
    geometry: ChainGeometry, links: Sequence[Link]
) -> list[dict[int, tuple[Scalar, ...]]]:
    """Closed form of the regressor: for every torque i, for every link that it moves, ten entries.

    Torque i feels a link by virtual work: a unit rate of coordinate i gives the link the angular
    velocity w and its frame's origin the velocity v, and the torque is v . f + w . n. Links that do
    not move with the coordinate, on the way to the base or in other branches, are left out.

    Args:
        geometry: of the robot.
        links: from `kinematics`.

    Returns:
        rows[i][l][k]: derivative of torque i with respect to parameter k of link l, in torchid's
        order; a float where it does not depend on the motion (mostly 0.0).
    """
    rows = []
    for i, moved in enumerate(geometry.moved):
        screws: dict[int, tuple[Vec3, Vec3]] = {}
        row = {}
        for link in moved:
            joint = geometry.joints[link]
            above = screws.get(joint.parent)
            carried = None if above is None else _carried(joint, links[link], *above)
            own = _own_screw(joint, links[link]) if joint.coordinate == i else None
            screws[link] = _together(carried, own)
            if link not in geometry.frames:
                row[link] = _parameter_columns(links[link], *screws[link])
        rows.append(row)
    return rows


def _together(*screws: tuple[Vec3, Vec3] | None) -> tuple[Vec3, Vec3]:
    """Sum of those that are there."""
    there = [screw for screw in screws if screw is not None]
    if len(there) == 1:
        return there[0]
    (v, w), (other_v, other_w) = there
    return add3(v, other_v), add3(w, other_w)


def _own_screw(joint: JointGeometry, link: Link) -> tuple[Vec3, Vec3]:
    """(v, w) of the link that a unit rate of its own joint's coordinate gives."""
    axis = joint.axis
    if joint.ratio != 1.0:
        axis = add_scaled(ZERO, axis, joint.ratio)
    return (cross(axis, link.offset), axis) if joint.revolute else (axis, ZERO)


def _carried(joint: JointGeometry, link: Link, v: Vec3, w: Vec3) -> tuple[Vec3, Vec3]:
    """(v, w) of a link from those of the link that carries it, its own joint at rest."""
    v = _transposed(link.rotation, add_cross(v, w, joint.previous_offset))
    w = _transposed(link.rotation, w)
    return add_cross(v, w, link.offset), w


def _parameter_columns(link: Link, v: Vec3, w: Vec3) -> tuple[Scalar, ...]:
    """v . f + w . n of the link for unit values of its ten parameters."""
    mass = dot(v, link.a)
    moment = add_cross(_transposed(link.s, v), link.a, w)
    d = cross(w, link.w)
    inertia = [
        fma(mul(w[i], link.wd[i]), link.w[i], d[i])
        if i == j
        else fma(
            fma(fma(mul(w[i], link.wd[j]), w[j], link.wd[i]), link.w[j], d[i]), link.w[i], d[j]
        )
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    ]
    return (mass, *moment, *inertia)


def _rotation(joint: JointGeometry, q: Tensor) -> Matrix:
    c, s = (torch.cos(q), torch.sin(q)) if joint.revolute else (0.0, 0.0)
    return tuple(  # type: ignore[return-value]
        Vec3(
            *(
                fma(fma(joint.constant[i][j], c, joint.cosine[i][j]), s, joint.sine[i][j])
                for j in range(3)
            )
        )
        for i in range(3)
    )


def _spin(w: Vec3, wd: Vec3) -> Matrix:
    """[wd]x + [w]x [w]x."""
    xx, yy, zz = mul(w.x, w.x), mul(w.y, w.y), mul(w.z, w.z)
    xy, xz, yz = mul(w.x, w.y), mul(w.x, w.z), mul(w.y, w.z)
    return (
        Vec3(fma(mul(yy, -1.0), zz, -1.0), fma(xy, wd.z, -1.0), add(xz, wd.y)),
        Vec3(add(xy, wd.z), fma(mul(xx, -1.0), zz, -1.0), fma(yz, wd.x, -1.0)),
        Vec3(fma(xz, wd.y, -1.0), add(yz, wd.x), fma(mul(xx, -1.0), yy, -1.0)),
    )


def _apply(m: Matrix, v: Vec3) -> Vec3:
    return Vec3(dot(m[0], v), dot(m[1], v), dot(m[2], v))


_turned = _apply


def _transposed(m: Matrix, v: Vec3) -> Vec3:
    """m' v."""
    return Vec3(*(fma(fma(mul(m[0][j], v.x), m[1][j], v.y), m[2][j], v.z) for j in range(3)))
