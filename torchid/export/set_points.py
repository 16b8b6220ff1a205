"""Set points of limited acceleration and speed in plain MJCF: virtual joints that servos follow.

MuJoCo has no field for how fast a servo's set point x may change its speed. A body without shape on
a joint of its own is x. The joint's actuator, which keeps its name and its place, moves it:

    ddx = clip(K (scale u - x) - K g(dx), -a, a)

by the joint's `actuatorfrcrange`. g is the way that braking takes, v |v| / 2a, in straight
pieces: slopes grow with the speed, so what is less than the last slope is an actuator of its own
whose force has a limit. With a limit of speed the first term has one: K g(speed). The servo pulls
at a tendon whose length is q - x, so it answers to the rate of the error:

    force = clip(-kp (q - x) - kd (dq - dx)) + offset

It pulls at x, too, which is too heavy to feel it. Where x goes through a filter first, that is a
second body, light and damped, which a stiff spring ties to x.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from torchid.digits import number
from torchid.export.xml_tree import child_or_new, children, local, new_child, text
from torchid.robot.model import JointType
from torchid.robot.spec import INSIDE, SERVO, SET_POINT
from torchid.simulation.servo import Servos
from torchid.typing import Bool, Float

_HEAVY, _SPRING, _LIGHT = 1e5, 1e5, 2e-4
"""Inertia of a set point [kg m^2; kg], stiffness of a filter's spring [N m/rad; N/m], and inertia
of its body as a share of its damping [s]."""
_FILTER = f"{SET_POINT}filter_"
_WAYS = (0.01, 0.03, 0.1, 0.3, 1.0)
"""That braking takes from the speeds at which straight pieces end [rad; m]."""
_STIFF = 2.0
"""Root of K times the first slope, at which a set point is damped critically near its goal [1]."""
_DYNAMICS = ("dyntype", "dynprm", "actdim", "gaintype", "input")
_NONE = {"dyntype": "none", "gaintype": "fixed", "gear": "1 0 0 0 0 0"}
_FREE = {"free": 7, "ball": 4}
"""Entries in a keyframe's positions of joints that are no hinge or slide."""


def followed(servos: Servos) -> Bool[torch.Tensor, " n"]:
    """Whose set points a file can say: those of limited acceleration."""
    return servos.of("acceleration").isfinite()


def write_set_point(
    root: Any, actuator: Any, values: dict[str, float], own: dict[str, str], kind: JointType,
    step: float,
) -> None:  # fmt: skip
    """Let the actuator of a joint move its set point, and a new one the joint after it.

    Args:
        root: of the file.
        actuator: of the joint, empty but for its name and place.
        values: of the servo.
        own: attributes that the servo's actuator would have without a set point.
        kind: of joint.
        step: of the physics [s].
    """
    joint, a, top = actuator.get("joint"), values["acceleration"], values["speed"]
    name, actuators = f"{SET_POINT}{joint}", actuator.getparent()
    turns = kind is not JointType.PRISMATIC
    most = {"actuatorfrclimited": "true", "actuatorfrcrange": text([-_HEAVY * a, _HEAVY * a])}
    _add_body(root, name, turns, _HEAVY, most)
    follower, lag = name, values["lag"]
    if lag > step:
        follower = f"{_FILTER}{joint}"
        damping = lag * _SPRING
        _add_body(root, follower, turns, _LIGHT * damping, {"damping": number(damping)})
        _add_difference(root, follower, follower, name).set("stiffness", number(_SPRING))
    _add_difference(root, name, joint, follower)
    # The command is late on its way to x, and not behind it.
    late = ("delay", "nsample", "interp")
    behind = own if own["dyntype"] == "pid" else {}
    own = {k: v for k, v in own.items() if k not in _DYNAMICS} | _NONE
    servo = {k: v for k, v in own.items() if k not in late}
    offset, kp, kd = (values[k] for k in ("offset", "kp", "kd"))
    follows = new_child(actuators, "general")
    follows.attrib.update({"name": f"{SERVO}{joint}", "tendon": name} | servo)
    follows.attrib.update(_affine(0.0, offset, -kp, -kd))
    if behind:  # the servo's own command is 0, as its length is that less than the set point
        follows.attrib.update({k: behind[k] for k in _DYNAMICS if k in behind})
        follows.set("gainprm", text([values["integral"], 0.0, 0.0]))
        follows.set("dynprm", text([most_sum(values), 0.0]))
    if inside := values["damping_share"] * values["damping"]:
        # What holds the sum of the two is the joint's.
        follows.set("forcelimited", "false")
        alone = {"name": f"{SERVO}{joint}{INSIDE}", "joint": joint, "forcelimited": "false"}
        new_child(actuators, "general").attrib.update(
            servo | alone | _affine(0.0, 0.0, 0.0, -inside)
        )
    speeds, slopes = _braking(a, top)
    # A step takes half of its speed at most.
    k = _HEAVY * min((_STIFF / slopes[0]) ** 2, 0.5 / (step * slopes[0]))
    push = {key: own[key] for key in own if key in late or not key.startswith("force")}
    drive = _affine(k * values["scale"], 0.0, -k, -k * slopes[-1]) | {"forcelimited": "false"}
    if math.isfinite(top):
        # The pull has a limit, and the brake none.
        pull = k * _way(a, top)
        drive = _affine(k * values["scale"], 0.0, -k, 0.0) | _limit(pull)
        brake = {"name": f"{name}_brake", "joint": name, "forcelimited": "false"}
        brake |= _affine(0.0, 0.0, 0.0, -k * slopes[-1])
        new_child(actuators, "general").attrib.update(servo | brake)
    actuator.attrib.update(push | drive | {"joint": name})
    for i, (less, more) in enumerate(pairwise(slopes)):
        # MuJoCo takes a positive rate beside equal gains for a damping ratio.
        piece = _affine(0.0, 0.0, 1e-9, k * (more - less)) | _limit(k * (more - less) * speeds[i])
        piece |= {"name": f"{name}_{i + 1}", "joint": name}
        new_child(actuators, "general").attrib.update(servo | piece)


def _add_body(root: Any, name: str, turns: bool, inertia: float, own: dict[str, str]) -> None:
    """A body in the world without shape or weight, on a joint with these attributes."""
    body = new_child(children(root, "worldbody")[-1], "body")
    body.attrib.update({"name": name, "gravcomp": "1"})
    new_child(body, "inertial").attrib.update(
        {"pos": "0 0 0", "mass": number(inertia), "diaginertia": text([inertia] * 3)}
    )
    new_child(body, "joint").attrib.update(
        {"name": name, "type": "hinge" if turns else "slide", "axis": "1 0 0", "limited": "false"}
        | dict.fromkeys(("damping", "frictionloss", "armature", "stiffness"), "0") | own
    )  # fmt: skip


def _add_difference(root: Any, name: str, first: str, second: str) -> Any:
    """A tendon whose length is the position of a joint less that of another."""
    tendon = new_child(child_or_new(root, "tendon"), "fixed")
    tendon.set("name", name)
    for joint, coefficient in ((first, "1"), (second, "-1")):
        new_child(tendon, "joint").attrib.update({"joint": joint, "coef": coefficient})
    return tendon


def most_sum(values: dict[str, float]) -> float:
    """Of the error that integral action sums [rad s; m s]; 0 for without a limit."""
    limited = math.isfinite(values["clip"]) and values["integral"] > 0
    return values["clip"] / values["integral"] if limited else 0.0


def _way(a: float, speed: float) -> float:
    """That braking takes from a speed [rad; m]."""
    return speed * speed / (2 * a)


def _braking(a: float, top: float) -> tuple[list[float], list[float]]:
    """Speeds at which straight pieces of the braking way end, and the slope of each [s]."""
    speeds = [math.sqrt(2 * a * way) for way in _WAYS]
    speeds = [v for v in speeds if v < top] + ([top] if math.isfinite(top) else [])
    ways = [0.0, *(_way(a, v) for v in speeds)]
    ends = [0.0, *speeds]
    slopes = [
        (after - before) / (v - u)
        for (u, v), (before, after) in zip(pairwise(ends), pairwise(ways), strict=True)
    ]
    return speeds, slopes


def _affine(gain: float, constant: float, length: float, rate: float) -> dict[str, str]:
    return {"gainprm": text([gain, 0.0, 0.0]), "biasprm": text([constant, length, rate])}


def _limit(most: float) -> dict[str, str]:
    return {"forcelimited": "true", "forcerange": text([-most, most])}


def remove_set_points(root: Any) -> None:
    """Take those of an earlier export out of a file: they are not this arm's."""
    for node in list(root.iter("{*}body", "{*}fixed", "{*}general")):
        name = node.get("name", "")
        if local(node) == "general" and name.startswith(SERVO):
            node.getparent().remove(node)
        elif local(node) == "general" and node.get("joint", "").startswith(SET_POINT):
            node.set("joint", node.get("joint").removeprefix(SET_POINT))
            if name.startswith(SET_POINT):
                node.getparent().remove(node)
        elif name.startswith(SET_POINT):
            node.getparent().remove(node)


def lengthen_keyframes(root: Any, actuators: int) -> None:
    """Let a file's keyframes have set points where the joints are, and no new commands.

    Args:
        root: of the file, with set points.
        actuators: how many there are more.
    """
    places, at = dict[str, int](), 0
    for world in children(root, "worldbody"):
        for node in world.iter("{*}joint", "{*}freejoint"):
            places[node.get("name", "")] = at
            kind = "free" if local(node) == "freejoint" else node.get("type", "hinge")
            at += _FREE.get(kind, 1)
    points = [name for name in places if name.startswith(SET_POINT)]
    own = [places[x.removeprefix(_FILTER).removeprefix(SET_POINT)] for x in points]
    for key in root.iter("{*}key"):
        q = (key.get("qpos") or "").split()
        more = {"qvel": [0.0] * len(points), "ctrl": [0.0] * actuators}
        more["qpos"] = [float(q[k]) for k in own if k < len(q)]
        for name, values in more.items():
            if key.get(name):
                key.set(name, f"{key.get(name)} {text(values)}")


class SetPointsInMujoco:
    """Where a loaded file's set points are.

    Args:
        mujoco: the package.
        model: of a file.
        joints: names of the arm's joints.

    Attributes:
        ids: joint of its set point, by the arm's joint from 0.
        rows: freedoms of set points and their filters.
    """

    def __init__(self, mujoco: Any, model: Any, joints: tuple[str, ...]):
        kind = int(mujoco.mjtObj.mjOBJ_JOINT)
        known = [
            [mujoco.mj_name2id(model, kind, f"{what}{name}") for name in joints]
            for what in (SET_POINT, _FILTER)
        ]
        self.ids = {j: k for j, k in enumerate(known[0]) if k >= 0}
        pairs = [(j, k) for ids in known for j, k in enumerate(ids) if k >= 0]
        self._of, ids = [j for j, _ in pairs], [k for _, k in pairs]
        self.rows, self._places = model.jnt_dofadr[ids].tolist(), model.jnt_qposadr[ids].tolist()

    def begin(self, data: Any, points: Float[np.ndarray, " n"]) -> None:
        """Let them rest at set points of all joints [rad; m]."""
        data.qpos[self._places], data.qvel[self.rows] = points[self._of], 0.0
