"""The USD layer: usd-core opens it over a stage, and its attributes are the joints'."""

import json
import math
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from tests.arms import arm
from tests.export.targets import python_of
from tests.simulators.test_mujoco import FIELDS
from torchid.export.export import export_dynamics
from torchid.export.results import servo_dynamics
from torchid.position.model import ServoArm

READ = """
import json, sys
from pxr import Sdf, Usd, UsdPhysics
base, layer, name, *joints = sys.argv[1:]
arm = Usd.Stage.CreateNew(base)
for joint in joints:
    prim = UsdPhysics.RevoluteJoint.Define(arm, f"/{name}/joints/{joint}").GetPrim()
    prim.CreateAttribute("mjc:damping", Sdf.ValueTypeNames.Double).Set(77.0)
arm.Save()
stage = Usd.Stage.CreateInMemory()
stage.GetRootLayer().subLayerPaths = [layer, base]
prims = [stage.GetPrimAtPath(f"/{name}/joints/{joint}") for joint in joints]
drives = [UsdPhysics.DriveAPI.Get(prim, "angular") for prim in prims]
print(json.dumps({
    "kinds": [prim.GetTypeName() for prim in prims],
    "kp": [drive.GetStiffnessAttr().Get() if drive else None for drive in drives],
    "most": [drive.GetMaxForceAttr().Get() if drive else None for drive in drives],
    "values": [{a.GetName(): a.Get() for a in prim.GetAuthoredAttributes()} for prim in prims],
}, default=str))
"""


@pytest.mark.slow
@pytest.mark.parametrize("servos", [False, True])
def test_usd_core_reads_what_was_written(servos: bool, tmp_path: Path) -> None:
    python = python_of("usd")
    robot = replace(arm("3r"), effects=FIELDS)
    what = ServoArm.of(robot, kp=40.0, kd=1.5, clip=3.0, damping=[0.4, 0.8, 1.2], armature=0.1)
    written = servo_dynamics(what) if servos else robot
    done = export_dynamics(written, "usd", tmp_path, "arm", nominal=arm("3r"), geometry="none")
    assert [file.name for file in done.files] == ["arm_joints.usda"]
    asked = [tmp_path / "base.usda", done.files[0], f"_{robot.name}", *robot.joint_names]
    run = subprocess.run(
        [python, "-c", READ, *map(str, asked)], capture_output=True, text=True, check=True
    )
    read = json.loads(run.stdout)
    assert read["kinds"] == ["PhysicsRevoluteJoint"] * 3
    degree = math.pi / 180
    assert read["kp"] == pytest.approx([40 * degree] * 3) if servos else read["kp"] == [None] * 3
    assert read["most"] == ([3.0] * 3 if servos else [None] * 3)
    for j, values in enumerate(read["values"]):
        on_axis = "physxJointAxis:angular"
        assert values["mjc:damping"] == pytest.approx(0.4 * (j + 1))
        viscous = values[f"{on_axis}:viscousFrictionCoefficient"]
        assert viscous == pytest.approx(0.4 * (j + 1) * degree)
        assert values[f"{on_axis}:armature"] == pytest.approx(0.1)
        friction = values[f"{on_axis}:dynamicFrictionEffort"]
        assert friction == values["mjc:frictionloss"] == (0.0 if servos else 0.5)


def test_what_a_layer_has_no_field_for_is_said(tmp_path: Path) -> None:
    robot = arm("3r")
    what = servo_dynamics(ServoArm.of(robot, kp=40.0, delay=0.01, armature=0.1))
    done = export_dynamics(what, "usd", tmp_path, "arm", nominal=robot, geometry="none")
    (note,) = done.notes
    assert note.startswith("of the servos delay are not in it")
