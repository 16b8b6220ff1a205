"""Files and results that the tests of the export start from."""

from dataclasses import replace
from pathlib import Path

from tests.arms import consistent_parameters
from tests.robot.conftest import ARM
from torchid.export.dynamics import Dynamics
from torchid.export.export import Export, Format, export_dynamics
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

FRICTION = (
    {"effect": "viscous_friction", "joint": 1, "Fv": 0.123456789012345},
    {"effect": "coulomb_friction", "joint": 1, "Fc": 1 / 3},
    {"effect": "rotor_inertia", "joint": 2, "Ia": 0.0123456789},
    {"effect": "torque_offset", "joint": 2, "F0": -0.7},
    {"effect": "joint_spring", "joint": 2, "k": 3.3, "c0": -0.4},
    {"effect": "stribeck_friction", "joint": 1, "Fs": 0.21, "vs": 0.13, "d": 2.0},
)

TETRAHEDRON = b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"

INCLUDED = """<mujocoinclude>
  <!-- the last two links -->
  <body name="fore" pos="0.3 0 0.1" euler="0 30 20">
    <joint name="slide" type="slide" axis="1 2 -2" pos="0.01 0 0" range="-0.2 0.3"/>
    <geom type="capsule" size="0.03 0.1" mass="1.2"/>
    <frame pos="0 0.1 0">
      <body name="housing"><geom size="0.04" mass="0.7"/></body>
    </frame>
    <body name="hand" pos="0.1 0.05 0.2">
      <inertial pos="0.01 0 0.03" mass="0.5" fullinertia="0.002 0.003 0.004 1e-4 -2e-4 3e-4"/>
      <joint name="wrist" axis="0 -1 0" ref="15" class="small"/>
      <site name="tcp" pos="0 0 0.1"/>
    </body>
  </body>
</mujocoinclude>
"""

MJCF = """<?xml version="1.0" encoding="utf-8"?>
<!-- my robot, tuned by hand -->
<mujoco model="classy">
  <compiler angle="degree" meshdir="meshes" boundmass="0.9" inertiafromgeom="true"/>
  <option gravity="0 0.5 -9.7"/>
  <default>
    <joint armature="0.3" damping="2" frictionloss="0.5"/>
    <default class="big"><joint armature="0.7" stiffness="5" springref="10"/></default>
    <default class="small"><joint damping="0.01"/></default>
  </default>
  <asset><mesh name="shell" file="shell.obj"/></asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="stand">
      <geom type="box" size="0.1 0.1 0.1" mass="9"/>
      <!-- the arm proper -->
      <body name="upper" pos="0 0 0.4" childclass="big">
        <inertial pos="0.02 0.01 0.1" mass="3" diaginertia="0.03 0.04 0.02" euler="10 20 30"/>
        <joint name="yaw" axis="0.1 0.2 1" pos="0 0.02 0"/>
        <geom type="mesh" mesh="shell"/>
        <body name="motor" pos="0.05 0 0.1"><!-- bolted on -->
          <inertial pos="0 0 0" mass="0.8" diaginertia="1e-3 1e-3 2e-3"/>
        </body>
        <include file="fore.xml"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="p" joint="yaw" kp="50"/></actuator>
</mujoco>
"""


def write_urdf(folder: Path) -> Path:
    """The arm of the URDF reader's tests: fixed joints, oblique axes, a prismatic joint."""
    path = folder / "arm.urdf"
    path.write_bytes(ARM.encode())
    return path


def write_mjcf(folder: Path) -> Path:
    """An arm with classes of defaults, an included file, a mesh, and inertias in every form."""
    (folder / "meshes").mkdir()
    (folder / "meshes" / "shell.obj").write_bytes(TETRAHEDRON)
    (folder / "fore.xml").write_text(INCLUDED)
    path = folder / "classy.xml"
    path.write_text(MJCF)
    return path


def with_other(robot: Robot, seed: int = 5, effects: tuple = FRICTION) -> Robot:  # type: ignore[type-arg]
    """The robot with other consistent parameters and these effects."""
    parameters = consistent_parameters(robot.n, seed)
    return replace(robot.with_parameters(parameters), effects=effects)


def exported(
    robot: Robot, to: Format, folder: Path, original: Path | None = None, tip: str | None = None
) -> Export:
    """An export of a robot's own dynamics, checked by physics alone."""
    found = None if original is None else load_robot(original, tip=tip)
    dynamics = Dynamics(robot, "robot", "the parameters of a test")
    return export_dynamics(
        dynamics, to, folder, "out", nominal=robot, original=found, geometry="none"
    )
