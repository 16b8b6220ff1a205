"""A stand-in for the simulator of `plant`: fast, and with answers that tests know."""

import sys
import tempfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.gap.diagnoses import motion_of
from torchid.effects.friction import CoulombFriction
from torchid.effects.registry import model_torque
from torchid.robot.model import Robot
from torchid.robot.urdf import read_urdf

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="a"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="b"><inertial><origin xyz="0.15 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="3" effort="50"/></joint>
  <joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="50"/></joint>
</robot>
"""


@cache
def arm() -> Robot:
    """The nominal model."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(URDF)
        return read_urdf(path)


KINDS = ("none", "single", "outside")


@dataclass(frozen=True)
class Spec:
    """What the generator draws: kinds take turns."""

    seed: int
    number: int

    @property
    def kind(self) -> str:
        return KINDS[(self.seed + self.number) % len(KINDS)]

    @property
    def effects(self) -> tuple[Any, ...]:
        names = {"none": (), "single": ("coulomb_friction",), "outside": ("air_drag",)}
        return tuple(Effect(name) for name in names[self.kind])


@dataclass(frozen=True)
class Effect:
    name: str


@dataclass(frozen=True)
class Simulated:
    urdf: str
    columns: dict[str, np.ndarray]
    key: dict[str, Any] = field(default_factory=dict)
    rotors: tuple[float, ...] = ()
    more: tuple[dict[str, np.ndarray], ...] = ()
    earlier: dict[str, np.ndarray] | None = None


def draw_case(seed: int, number: int, *, mix: str = "mixed") -> Spec:
    return Spec(seed, number)


def simulate_case(spec: Spec, *, ideal: bool = False) -> Simulated:
    """Two trajectories, one of them twice, at 100 Hz."""
    rng = np.random.default_rng([spec.seed, spec.number])
    robot = arm()
    strength = 0.0 if spec.kind == "none" else 2.0
    parts = []
    for k, shape in enumerate((0, 1, 0)):
        motion = motion_of(robot.n, 10.0, 100.0, seed=shape)
        tau = model_torque(robot, [(CoulombFriction(1), [strength])], motion).numpy()
        noisy = tau + (0.0 if ideal else 0.05) * rng.standard_normal(tau.shape)
        t = np.arange(len(tau)) / 100.0 + 12.0 * k
        parts.append((t, motion.q.numpy(), noisy, np.full(len(tau), k)))
    t, q, tau, traj = (np.concatenate(x) for x in zip(*parts, strict=True))
    columns = {"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}
    return Simulated(URDF, columns | {"traj": traj}, key_of(spec))


def key_of(spec: Spec) -> dict[str, Any]:
    families = {"coulomb_friction": "sign"}
    effects = [
        {"name": e.name, "family": families.get(e.name, "outside"), "joints": [2], "felt_by": [2],
         "parameters": {"Fc": 2.0}, "size": 5.0}
        for e in spec.effects
    ]  # fmt: skip
    return {
        "id": "whatever", "kind": spec.kind, "arm": "2r", "rate_hz": 100.0, "colour_hz": None,
        "repeats": True, "level": None, "effects": effects, "noise_std": [0.05, 0.05],
    }  # fmt: skip


@pytest.fixture
def plant(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """In place of `torchid_bench.withheld.plant.case`."""
    module = ModuleType("torchid_bench.withheld.plant.case")
    module.draw_case = draw_case  # type: ignore[attr-defined]
    module.simulate_case = simulate_case  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torchid_bench.withheld.plant.case", module)
    return module


def answer(status: str, *found: dict[str, Any], **more: Any) -> dict[str, Any]:
    """What a diagnosis could have said."""
    return {"status": status, "which": list(found), "not_testable": []} | more


def entry(
    effect: str, family: str, *joints: int, ambiguous: tuple[str, ...] = (), share: float = 0.9
) -> dict[str, Any]:
    """An entry of `which`."""
    return {
        "effect": effect, "family": family, "joints": list(joints), "places": [],
        "common": False, "ambiguous_with": list(ambiguous), "share": share, "shape": [],
        "parameters": {}, "std": {},
    }  # fmt: skip
