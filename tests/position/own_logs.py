"""Twenty MJCF arms with servos, MuJoCo's own log of each, and of the same with one number changed.

Twelve have every way to say a servo's damping with every way to limit its force, at 1, 2 or 5 ms
with Euler or implicitfast; each other one has something that no servo of torchid has a number for,
or has in another form.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import torchid

COUNT = 2 * math.pi / 4096
SECONDS, REST_S = 16.0, 1.0
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1")


@dataclass(frozen=True)
class Arm:
    """One file, and its twin.

    Attributes:
        damping: of the servo: none, kv, dampratio or biasprm.
        limit: of its force: none, forcerange or actuatorfrcrange.
        joints: how many.
        ms: timestep [ms].
        integrator: Euler or implicitfast.
        twin: what the other log has otherwise: kp, clip, delay or friction.
        rate: of the log [Hz].
        friction: frictionloss of every joint beside its load, or 0.
        special: what else the file has.
    """

    damping: str
    limit: str
    joints: int
    ms: int
    integrator: str
    twin: str
    rate: int = 50
    friction: float = 0.0
    special: str = ""

    @property
    def changed(self) -> int:
        """The joint of which a number is another: one that bears load."""
        return 1

    @property
    def xml(self) -> str:
        """The file."""
        n, bodies, servos = self.joints, "", ""
        for j in range(n):
            size = (n - j) ** 1.3
            kp, mass, length = 8.0 * size, 0.7 * 0.8**j, 0.2 * 0.9**j
            kv, clip, inertia = 0.04 * kp, 0.45 * kp, 5e-4 + 0.08 * mass * length**2
            own = kv if self.damping == "none" else 0.05 * kv
            joint = f'damping="{own:.3g}" armature="{0.004 * size:.3g}"'
            if friction := self.friction or 0.03 * (self.damping in ("kv", "biasprm")):
                joint += f' frictionloss="{friction * size:.3g}"'
            if self.limit == "actuatorfrcrange":
                joint += f' actuatorfrcrange="{-clip:.3g} {clip:.3g}"'
            if self.special == "ref":
                joint += f' ref="{0.3 - 0.2 * j:.3g}"'
            if self.special == "stiffness":
                joint += f' stiffness="{0.3 * kp:.3g}" springref="0.2"'
            carried = ' gravcomp="1"' if self.special == "gravcomp" else ""
            tip = ""
            if self.special == "plane" and j == n - 1:
                tip = f'<geom type="sphere" size=".02" pos="{length:.3g} 0 0" mass="0"/>'
            place = f'pos="{0.2 * 0.9 ** (j - 1):.3g} 0 0"' if j else 'pos="0 0 .3"'
            bodies += f"""<body name="b{j}" {place}{carried}>
              <joint name="j{j}" axis="{AXES[j]}" {joint}/>
              <inertial pos="{length / 2:.3g} .004 .006" mass="{mass:.3g}"
                diaginertia=".0008 {inertia:.3g} {inertia:.3g}"/>
              {tip}"""
            more = f' forcerange="{-clip:.3g} {clip:.3g}"' if self.limit == "forcerange" else ""
            if self.special == "ctrlrange":
                more += ' ctrlrange="-.5 .45"'
            if self.special == "timeconst":
                more += ' timeconst=".06"'
            if self.damping == "biasprm" or self.special == "gainprm":
                gain = 0.85 * kp if self.special == "gainprm" else kp
                servos += (
                    f'<general joint="j{j}" gainprm="{gain:.4g}" biastype="affine" '
                    f'biasprm="{0.02 * kp:.3g} {-kp:.4g} {-kv:.3g}"{more}/>'
                )
                continue
            said = {"none": "", "kv": f'kv="{kv:.3g}"', "dampratio": 'dampratio="1"'}
            servos += f'<position joint="j{j}" kp="{kp:.4g}" {said[self.damping]}{more}/>'
        floor = '<geom type="plane" size="2 2 .1"/>' if self.special == "plane" else ""
        return f"""<mujoco model="own"><compiler angle="radian" autolimits="true"/>
          <option timestep="{self.ms / 1000}" integrator="{self.integrator}"/>
          <worldbody>{floor}{bodies}{"</body>" * n}</worldbody>
          <actuator>{servos}</actuator></mujoco>"""

    def write(self, folder: Path) -> Path:
        """The file, on disk."""
        path = folder / "own.xml"
        path.write_text(self.xml)
        return path

    def log(self, twin: bool = False, seed: int = 0) -> torchid.Log:
        """MuJoCo's own log of the file, or of its twin: commands that are held from row to row, and
        positions in counts of 4096 a turn."""
        model = mujoco.MjModel.from_xml_string(self.xml)
        late = 0.0
        if twin:
            late = 0.008 * (self.twin == "delay")
            CHANGES[self.twin](model, self.changed)
        u = self._commands(np.random.default_rng([seed, self.joints]))
        data, steps = mujoco.MjData(model), round(1000 / self.rate / self.ms)
        behind = round(late / model.opt.timestep)
        data.qpos[:], data.ctrl[:] = u[0], u[0]
        mujoco.mj_step(model, data, round(2 * REST_S / model.opt.timestep))
        held = np.repeat(u, steps, 0)
        held = np.concatenate([np.repeat(u[:1], behind, 0), held])
        q = np.empty_like(u)
        for k in range(len(u) * steps):
            if k % steps == 0:
                q[k // steps] = data.qpos
            data.ctrl[:] = held[k]
            mujoco.mj_step(model, data)
        t = np.arange(len(u)) / self.rate
        return torchid.Log(t, np.round(q / COUNT) * COUNT, u=u)

    def _commands(self, random: np.random.Generator) -> np.ndarray:
        """Steps at times of each joint's own, and sines, after a rest."""
        t = np.arange(round(SECONDS * self.rate)) / self.rate
        out = np.empty((len(t), self.joints))
        for j in range(self.joints):
            jumps = REST_S + np.cumsum(random.uniform(0.5, 1.3, 60))
            held = np.append(0.2, 0.7 * random.uniform(-1, 1, 60))[np.searchsorted(jumps, t)]
            w = 2 * np.pi * random.uniform(0.3, 1.2)
            out[:, j] = held + 0.15 * np.sin(w * (t - REST_S)) * (t > REST_S)
        if self.special == "plane":  # the second joint lowers the arm onto it
            out[:, 1] += 0.35
        return out


def _kp(model: mujoco.MjModel, j: int) -> None:
    model.actuator_gainprm[j, 0] *= 0.8
    model.actuator_biasprm[j, 1] *= 0.8


def _clip(model: mujoco.MjModel, j: int) -> None:
    model.actuator_forcerange[j] *= 0.5
    model.jnt_actfrcrange[j] *= 0.5


def _friction(model: mujoco.MjModel, j: int) -> None:
    model.dof_frictionloss[j] *= 1.5


CHANGES: dict[str, Callable[[mujoco.MjModel, int], None]] = {
    "kp": _kp,
    "clip": _clip,
    "friction": _friction,
    "delay": lambda model, j: None,
}
EFFECT = {
    "kp": "proportional_gain",
    "clip": "saturation",
    "friction": "coulomb_friction",
    "delay": "command_delay",
}
"""What the answer calls each change."""
FAST, SLOW = "implicitfast", "Euler"
ARMS = {
    "none": Arm("none", "none", 2, 1, FAST, "kp"),
    "none-forcerange": Arm("none", "forcerange", 3, 2, SLOW, "clip"),
    "none-actuatorfrcrange": Arm("none", "actuatorfrcrange", 2, 5, FAST, "clip"),
    "kv": Arm("kv", "none", 4, 2, FAST, "delay", 100),
    "kv-forcerange": Arm("kv", "forcerange", 3, 1, FAST, "kp"),
    "kv-actuatorfrcrange": Arm("kv", "actuatorfrcrange", 2, 5, SLOW, "clip"),
    "dampratio": Arm("dampratio", "none", 5, 5, FAST, "kp"),
    "dampratio-forcerange": Arm("dampratio", "forcerange", 3, 2, FAST, "clip"),
    "dampratio-actuatorfrcrange": Arm("dampratio", "actuatorfrcrange", 2, 1, SLOW, "delay", 100),
    "biasprm": Arm("biasprm", "none", 4, 1, SLOW, "delay", 100),
    "biasprm-forcerange": Arm("biasprm", "forcerange", 3, 5, SLOW, "friction", friction=0.15),
    "biasprm-actuatorfrcrange": Arm("biasprm", "actuatorfrcrange", 6, 2, FAST, "kp"),
    "ref": Arm("kv", "none", 2, 2, FAST, "kp", special="ref"),
    "gainprm": Arm("biasprm", "none", 2, 1, FAST, "delay", 100, special="gainprm"),
    "timeconst": Arm("kv", "none", 3, 2, FAST, "kp", special="timeconst"),
    "frictionloss": Arm("kv", "none", 2, 1, SLOW, "friction", friction=0.25),
    "gravcomp": Arm("kv", "none", 3, 2, FAST, "kp", special="gravcomp"),
    "ctrlrange": Arm("kv", "none", 2, 5, FAST, "delay", 100, special="ctrlrange"),
    "stiffness": Arm("kv", "none", 2, 2, SLOW, "kp", special="stiffness"),
    "plane": Arm("kv", "none", 3, 1, FAST, "kp", special="plane"),
}  # fmt: skip
