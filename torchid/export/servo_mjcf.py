"""Position servos as actuators of an MJCF, which say part of what servos are, and what MuJoCo makes
of them: their force, and where the arm goes with a log's commands.

    force = kp (scale u - q) - kd dq, clipped, + offset; u late by a delay and through a filter

Damping, dry friction and armature are the joint's. Commands hold until the next one, as simulators
do it, so what is held is part of a servo's delay. What a servo makes of its commands before it
controls are virtual joints (`torchid.export.set_points`), or is added at run time
(`torchid.simulators.servo.SetPoints`). What a point of the arm may touch is a
plane, with which that point alone collides.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.digits import number
from torchid.dynamics.forward import mass_matrix
from torchid.effects.servo import INDEX, PARAMETERS
from torchid.errors import TorchidError
from torchid.export.checks import EXACT, Comparison, relative_difference
from torchid.export.engines import LoadedInMujoco, without_warnings
from torchid.export.mjcf import Bodies
from torchid.export.releases import has_field
from torchid.export.set_points import (
    SetPointsInMujoco,
    followed,
    lengthen_keyframes,
    most_sum,
    remove_set_points,
    write_set_point,
)
from torchid.export.xml_tree import (
    XmlFile,
    child,
    child_or_new,
    children,
    comment,
    local,
    new_child,
    replace,
    text,
)
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import JointType, Robot, Tip
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import CONTACT_DAMPING, Tracks, Windows, upwards
from torchid.simulators.servo import AT_RUN_TIME, SetPoints
from torchid.typing import Float

JOINTS = ("damping", "coulomb", "armature", "damping_share")
"""Parameters of servos that are a joint's."""
STOPS = ("stop_low", "stop_high")
PLANE = "plane"
SAID = ("kp", *JOINTS, "offset", "delay", "scale", "lag", "clip", *STOPS, PLANE)
"""Parameters of servos that an MJCF says. It says kd of the joint's rate, and of the command's with
set points alone, with which it says `AT_RUN_TIME`, too."""
RATIOS_ALONE = (
    "Nothing anchors this joint's torques: kp, damping, friction and armature are right in their "
    "ratios to each other alone."
)
ANCHOR = "record the joint while it holds a load against gravity, or with a known mass in the hand"
"""What makes a number of a ratio."""
_HELD = 1e9
"""Armature of joints that the robot does not have [kg m^2; kg]: gravity does not move them."""
FAR = 1e3
"""Where a joint without a limit has one [rad; m]."""
STEP = 0.002
"""MuJoCo's own where a file says none [s]."""
_TOUCHED, _POINT, _RADIUS = "torchid_plane", "torchid_point", 1e-3
"""Names of a plane and of the arm's point that touches it, and the radius of that [m]."""
_SOFT = 0.01
"""Impedance of that contact [1]: so little of the arm's mass moves with what gives way."""
_STIFF = {"solreflimit": "0.004 1", "solimplimit": "0.9999 0.9999 0.001"}
"""Of an end stop: MuJoCo's own gives way by degrees where a servo presses on."""


def said_in_mjcf(servos: Servos, *, set_points: bool = False) -> Servos:
    """Servos without what an MJCF does not say, by the fields that the installed MuJoCo has.

    Args:
        servos: one set.
        set_points: as in `write_servos`.
    """
    joint = servos.joint.clone()
    pointed = followed(servos) & set_points
    # One actuator has a filter, or what <pid> has; behind a set point there is no filter in it.
    pid = (pointed | (servos.of("lag") == 0)) & has_field("pid")
    alone = pid & servos.of("acceleration").isinf()
    said = dict.fromkeys(AT_RUN_TIME, pointed)
    said |= {"integral": pid, "speed": pointed | (alone & set_points)}
    for k, p in enumerate(PARAMETERS):
        if p.name not in SAID:
            joint[~said.get(p.name, torch.zeros_like(pid)), k] = p.neutral
    return dataclasses.replace(servos, joint=joint)


def unsaid_parameters(servos: Servos, said: Servos) -> dict[str, tuple[int, ...]]:
    """What of servos is not in those that a file says: names, with joints from 0."""
    out = {}
    for p in PARAMETERS:
        joints = (servos.of(p.name) != said.of(p.name)).nonzero().flatten().tolist()
        if joints:
            out[p.name] = tuple(joints)
    if float(servos.plane[4]) > 0 and not float(said.plane[4]) > 0:
        out[PLANE] = ()
    return out


def write_servos(
    file: XmlFile,
    robot: Robot,
    servos: Servos,
    source: str,
    late: Float[torch.Tensor, " n"] | None = None,
    ratios: Mapping[int, float] | None = None,
    set_points: bool = False,
) -> None:
    """Put a <general> for every servo into a file, in the place of the joint's actuators.

    Args:
        file: with all joints of the robot, by name.
        robot: the chain.
        servos: of which `SAID` is written; damping, dry friction and armature are the joints'.
        source: what the file is called in errors.
        late: by how much commands are late by being held [s]; None for not at all.
        ratios: of joints (from 0) whose torques nothing anchors: kp over that of the file before,
            which a comment says; NaN where the file had none.
        set_points: whether limits of set points are in the file, those of acceleration as joints of
            it, or left to run time.

    Raises:
        TorchidError: a joint of the robot has no name in the file.
    """
    root = file.root
    remove_set_points(root)
    before = _count(root)
    nodes = {n.get("name"): n for n in root.iter() if local(n) == "joint" and n.get("name")}
    unnamed = [name for name in robot.joint_names if name not in nodes]
    if unnamed:
        raise TorchidError(
            f"{source}: actuators go by names of joints, and some have none.",
            got=", ".join(unnamed),
            hint='give every <joint> of the arm a `name="..."`',
        )
    angles = [c.get("angle") for c in children(root, "compiler") if c.get("angle")]
    degrees = not angles or angles[-1] == "degree"
    option = child(root, "option")
    step = STEP if option is None else float(option.get("timestep", STEP))
    # All of them first, so that controls of joints come before those that nobody gives.
    actuators = [_actuator(root, name) for name in robot.joint_names]
    moving = followed(servos).nonzero().flatten().tolist() if set_points else []
    written = said_in_mjcf(servos, set_points=set_points)
    # Of the joint's own rate kd is in the file in any case.
    written.joint[:, INDEX["kd"]] = servos.of("kd")
    for j, name in enumerate(robot.joint_names):
        values = dict(zip(INDEX, written.joint[j].tolist(), strict=True))
        held = 0.0 if late is None else float(late[j])
        values["delay"] = max(values["delay"] - held, 0.0)
        node, own = actuators[j], _general(values, step)
        if j in moving:
            # A filter and a limit of speed are the set point's.
            own = _general(values | {"lag": 0.0, "speed": math.inf}, step)
            write_set_point(root, node, values, own, robot.joint_types[j], step)
        else:
            node.attrib.update(own)
        if ratios and j in ratios:
            words = f"kp: {ratios[j]:.3g} x the file's. {RATIOS_ALONE}"
            if math.isnan(ratios[j]):
                words = f"kp: a ratio. {RATIOS_ALONE} To anchor them {ANCHOR}."
            node.addprevious(said := comment(f"{name}: {words}"))
            said.tail = node.getparent().text
        # What the servo can is fitted; a limit of the nominal robot would come before it.
        nodes[name].attrib.pop("actuatorfrcrange", None)
        nodes[name].attrib.update({"actuatorfrclimited": "false", "actuatorgravcomp": "false"})
        if j in moving and "forcerange" in own and values["damping_share"] * values["damping"]:
            whole = {"actuatorfrclimited": "true", "actuatorfrcrange": own["forcerange"]}
            nodes[name].attrib.update(whole)
        ends = [values[stop] for stop in STOPS]
        if any(map(math.isfinite, ends)):
            turn = robot.joint_types[j] is JointType.REVOLUTE and degrees
            known = robot.limits.position
            given = [-FAR, FAR] if known is None else known[j].tolist()
            both = [e if math.isfinite(e) else g for e, g in zip(ends, given, strict=True)]
            span = " ".join(number(math.degrees(x) if turn else x) for x in both)
            nodes[name].attrib.update({"range": span, "limited": "true"} | _STIFF)
    if moving:
        lengthen_keyframes(root, _count(root) - before)
    # Those of an earlier export are not this arm's.
    ours = (_TOUCHED, _POINT)
    for node in [n for n in root.iter("{*}geom", "{*}pair") if n.get("name") in ours]:
        node.getparent().remove(node)
    if float(servos.plane[4]) > 0:
        _write_plane(root, robot, servos, source)


def _count(root: Any) -> int:
    """Actuators of a file."""
    return sum(len([n for n in a if local(n)]) for a in children(root, "actuator"))


def _write_plane(root: Any, robot: Robot, servos: Servos, source: str) -> None:
    """A plane, a point of a link, and the contact of these two alone, whose force is `stiffness`
    times the depth, and `CONTACT_DAMPING` times the speed into the plane."""
    *place, level, stiffness = servos.plane.tolist()
    link = servos.link % robot.n_links
    body = Bodies(root, source).find(robot.link_names[link])
    up = upwards(robot)
    shape = {"contype": "0", "conaffinity": "0", "group": "3", "mass": "0"}
    new_child(child_or_new(root, "worldbody"), "geom").attrib.update(
        {"name": _TOUCHED, "type": "plane", "size": "1 1 0.1", "zaxis": text(up)}
        | {"pos": text(up * (level - _RADIUS))} | shape
    )  # fmt: skip
    new_child(body, "geom").attrib.update(
        {"name": _POINT, "type": "sphere", "size": number(_RADIUS), "pos": text(place)} | shape
    )
    # MuJoCo's force is the reference acceleration over (1 - d) / d times a constant of the bodies.
    given = (1 - _SOFT) * _inverse_mass(robot, servos, link)
    direct = [-stiffness * given, -CONTACT_DAMPING * given]
    new_child(child_or_new(root, "contact"), "pair").attrib.update(
        {"name": _TOUCHED, "geom1": _TOUCHED, "geom2": _POINT, "condim": "1", "margin": "0"}
        | {"gap": "0", "solref": text(direct), "solimp": f"{number(_SOFT)} {number(_SOFT)} 0.001"}
    )


def _inverse_mass(robot: Robot, servos: Servos, link: int) -> float:
    """What a force on the centre of mass of a link accelerates it along its own line, where all
    joints are at 0, and as a mean over three axes [1/kg]: MuJoCo's `body_invweight0`."""
    q = torch.zeros(1, robot.n, dtype=torch.float64)
    centre = torch.eye(4, dtype=torch.float64)
    centre[:3, 3] = robot.require_parameters("a contact").com[link]
    rows = tool_jacobian(robot, q, Tip("centre", link, centre))[0, :3]
    mass = mass_matrix(robot, q)[0] + torch.diag(servos.of("armature"))
    return float((rows @ torch.linalg.solve(mass, rows.T)).trace()) / 3


def _actuator(root: Any, joint: str) -> Any:
    """An empty <general> of a joint, named and placed as its actuator was."""
    actuators = child_or_new(root, "actuator")
    own = [n for a in children(root, "actuator") for n in a if n.get("joint") == joint]
    name = own[0].get("name", joint) if own else joint
    if own:
        node = own[0].makeelement(own[0].tag.replace(local(own[0]), "general"))
        replace(own[0], node)
        for other in own[1:]:
            other.getparent().remove(other)
    else:
        node = new_child(actuators, "general")
    node.attrib.update({"name": name, "joint": joint})
    return node


def _general(values: dict[str, float], step: float) -> dict[str, str]:
    """Attributes of a servo's actuator, none left to a file's defaults."""
    kp, kd, offset, clip = (values[k] for k in ("kp", "kd", "offset", "clip"))
    kd += values["damping_share"] * values["damping"]
    out = {
        "gear": "1 0 0 0 0 0",
        "ctrllimited": "false",
        "actlimited": "false",
        "gaintype": "fixed",
        "gainprm": f"{number(kp * values['scale'])} 0 0",
        "biastype": "affine",
        "biasprm": f"{number(offset)} {number(-kp)} {number(-kd)}",
        "forcelimited": "true" if math.isfinite(clip) else "false",
        "dyntype": "filterexact" if values["lag"] > 0 else "none",
    }
    if math.isfinite(clip):
        # The constant torque is beside the servo's.
        out["forcerange"] = f"{number(offset - clip)} {number(offset + clip)}"
    if values["lag"] > 0:
        out["dynprm"] = number(values["lag"])
    elif values["integral"] > 0 or math.isfinite(values["speed"]):
        out |= _pid(values, kd)
    if values["delay"] > 0:
        held = math.ceil(values["delay"] / step) + 2
        out |= {"delay": number(values["delay"]), "nsample": str(held), "interp": "linear"}
    return out


def _pid(values: dict[str, float], kd: float) -> dict[str, str]:
    """Attributes of an actuator with a limit of speed, or integral action: its error is that of the
    command and of a length, so a gear of one over the scale takes the place of the scale.

    MuJoCo takes the integral gain where others have one on the command.
    """
    scale, kp, offset, clip, sums = (
        values[k] for k in ("scale", "kp", "offset", "clip", "integral")
    )
    speed = values["speed"] / abs(scale) if math.isfinite(values["speed"]) else 0.0
    bias = [offset * scale, -kp * scale**2, -kd * scale**2]
    out = {
        "gear": f"{number(1 / scale)} 0 0 0 0 0",
        "dyntype": "pid",
        "gaintype": "pid",
        "input": "pos",
        "actdim": str(1 + (sums > 0 and speed > 0)),
        "gainprm": f"{number(sums * scale**2)} 0 0",
        "biasprm": text(bias),
        "dynprm": text([most_sum(values) / abs(scale), speed]),
    }
    if math.isfinite(clip):
        ends = sorted(scale * x for x in (offset - clip, offset + clip))
        out["forcerange"] = text(ends)
    return out


class ServosInMujoco(LoadedInMujoco):
    """An MJCF with servos in MuJoCo, without contacts of shapes.

    Args:
        path: the file.
        robot: whose joints are meant.

    Raises:
        TorchidError: MuJoCo refuses the file, or a joint has no actuator there.
    """

    def __init__(self, path: Path, robot: Robot):
        super().__init__(path, robot)
        # Pairs that the file names stay.
        self.model.geom_contype[:] = self.model.geom_conaffinity[:] = 0
        model, on_joint = self.model, int(self.mujoco.mjtTrn.mjTRN_JOINT)
        driven = np.where(
            model.actuator_trntype == on_joint, model.actuator_trnid[:, 0], -1
        ).tolist()
        joints = [int(model.dof_jntid[row]) for row in self.rows]
        self.points = SetPointsInMujoco(self.mujoco, model, robot.joint_names)
        for j, k in self.points.ids.items():
            joints[j] = k
        if not set(joints) <= set(driven):
            raise TorchidError(f"a joint of '{robot.name}' has no actuator in '{path.name}'.")
        self.servos = [driven.index(joint) for joint in joints]
        self.pid = int(getattr(self.mujoco.mjtDyn, "mjDYN_PID", -1))
        # A base that the file lets go was held.
        moved = [*self.rows, *self.points.rows]
        model.dof_armature[np.setdiff1d(np.arange(model.nv), moved)] = _HELD

    def force(self, u: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """(T, n) forces at q, dq [N m; N] with commands u that have stood for long."""
        data, out = self.mujoco.MjData(self.model), np.zeros_like(q)
        for k in range(len(q)):
            self.mujoco.mj_resetData(self.model, data)
            data.qpos[self.places], data.qvel[self.rows] = q[k], dq[k]
            self._begin(data, u[k])
            self.mujoco.mj_forward(self.model, data)
            out[k] = data.qfrc_actuator[self.rows]
        return out

    def moved(
        self, servos: Servos, tracks: Tracks, windows: Windows, q: np.ndarray, dq: np.ndarray
    ) -> Float[torch.Tensor, "T n"]:
        """Positions (T, n) [rad; m] in windows that begin at q, dq (W, n) at their first rows, by
        the file's own integrator and step (made to fit the samples). NaN from where the engine
        gives up.

        Args:
            servos: whose set-points are made at run time where the file has none.
            tracks: the commands.
            windows: of their motions, in order.
            q, dq: states at the windows' beginnings [rad, rad/s; m, m/s].
        """
        mujoco, model, data = self.mujoco, self.model, self.mujoco.MjData(self.model)
        steps = self.fit_step(tracks.dt)
        u, out = tracks.u.numpy(), np.full(tuple(tracks.u.shape), np.nan)
        servos = self._left_to_run_time(servos)
        points = SetPoints(servos, tracks.dt)
        motion = end = -1
        for w, (a, rows) in enumerate(
            zip(windows.start.tolist(), windows.length.tolist(), strict=True)
        ):
            # What servos know of their commands goes on from one window to the next.
            anew = int(windows.motion[w]) != motion or a != end
            if anew:
                motion, points = int(windows.motion[w]), SetPoints(servos, tracks.dt)
                mujoco.mj_resetData(model, data)
            end = a + rows
            data.qpos[self.places], data.qvel[self.rows] = q[w], dq[w]
            out[a] = q[w]
            with without_warnings(mujoco):
                for k in range(a, end):
                    controls = points.feed(u[k], steps)
                    if k == a and anew:
                        self._begin(data, controls[0])
                    for control in controls:
                        data.ctrl[self.servos] = control
                        mujoco.mj_step(model, data)
                    if data.warning.number.any():  # MuJoCo resets an arm that has run away
                        return torch.from_numpy(out)
                    if k + 1 < end:
                        out[k + 1] = data.qpos[self.places]
        return torch.from_numpy(out)

    def _left_to_run_time(self, servos: Servos) -> Servos:
        """Servos without what the file itself makes of commands."""
        model, joint = self.model, servos.joint.clone()
        for j, k in enumerate(self.servos):
            slewed = "speed" if model.actuator_dyntype[k] == self.pid else ""
            for name in AT_RUN_TIME if j in self.points.ids else (slewed,) * bool(slewed):
                joint[j, INDEX[name]] = PARAMETERS[INDEX[name]].neutral
        return dataclasses.replace(servos, joint=joint)

    def _begin(self, data: Any, command: np.ndarray) -> None:
        """As if this command had stood for long: in the servos, their delays and filters."""
        model = self.model
        data.ctrl[self.servos] = command
        for k, value in zip(self.servos, command, strict=True):
            held = int(model.actuator_history[k, 0])
            if held:
                past = model.opt.timestep * (np.arange(held) - held)
                self.mujoco.mj_initCtrlHistory(model, data, k, past, np.full((held, 1), value))
            if model.actuator_actnum[k] and (
                model.actuator_dyntype[k] != self.pid or model.actuator_dynprm[k, 1] > 0
            ):
                data.act[model.actuator_actadr[k]] = value
        scale = -model.actuator_gainprm[self.servos, 0] / model.actuator_biasprm[self.servos, 1]
        self.points.begin(data, scale * command)


def check_servos(path: Path, robot: Robot, servos: Servos) -> Comparison:
    """MuJoCo's force of servos at random commands and positions, against their equation."""
    what = "force of the servos"
    engine = ServosInMujoco(path, robot)
    draw = np.random.default_rng(0)
    u, q, dq = draw.uniform(-0.2, 0.2, (3, 50, robot.n))
    kp, kd, scale, offset, clip = (
        servos.of(k).numpy() for k in ("kp", "kd", "scale", "offset", "clip")
    )
    kd = kd + (servos.of("damping_share") * servos.of("damping")).numpy()
    expected = torch.from_numpy(np.clip(kp * (scale * u - q) - kd * dq, -clip, clip) + offset)
    apart = relative_difference(torch.from_numpy(engine.force(u, q, dq)), expected)
    return Comparison(engine.name, what, len(q), apart, EXACT)
