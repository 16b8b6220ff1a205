"""A serial arm with everything a URDF reader must get right, written by the tests themselves."""

from pathlib import Path

import pytest
import torch

ARM = """<?xml version="1.0" encoding="utf-8"?>
<!-- a comment -->
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="world"/>
  <link name="base">
    <inertial><mass value="9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="mount" type="fixed">
    <origin xyz="0.1 -0.2 0.3" rpy="0.2 0.1 -0.4"/><parent link="world"/><child link="base"/>
  </joint>
  <link name="l1"><inertial>
    <origin xyz="0.01 -0.02 0.11" rpy="0.3 -0.2 0.5"/><mass value="4.0"/>
    <inertia ixx="0.05" ixy="0.002" ixz="-0.003" iyy="0.04" iyz="0.001" izz="0.03"/>
  </inertial><visual><geometry><mesh filename="package://none.stl"/></geometry></visual></link>
  <joint name="j1" type="revolute">
    <origin xyz="0 0 0.3" rpy="0 0 0.7"/><parent link="base"/><child link="l1"/>
    <axis xyz="0 0 1"/><limit lower="-2.9" upper="2.5" velocity="2" effort="80"/>
    <dynamics damping="0.7" friction="0.25"/>
  </joint>
  <link name="l2"><inertial>
    <origin xyz="0.2 0 0.03"/><mass value="3.0"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.055"/>
  </inertial></link>
  <joint name="j2" type="continuous">
    <origin xyz="0.05 0.1 0.02" rpy="1.5707963267948966 0 0"/>
    <parent link="l1"/><child link="l2"/>
    <axis xyz="0 -2 0"/><limit velocity="1.5" effort="60"/>
  </joint>
  <link name="elbow"><inertial>
    <origin xyz="0.01 0.02 0.03" rpy="0 0 1"/><mass value="0.5"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0015"/>
  </inertial></link>
  <joint name="elbow_mount" type="fixed">
    <origin xyz="0.4 0.01 -0.02" rpy="-0.1 0.6 0.2"/><parent link="l2"/><child link="elbow"/>
  </joint>
  <link name="l3"><inertial>
    <origin xyz="0 0.03 0.1" rpy="1.2 0.1 -0.7"/><mass value="1.5"/>
    <inertia ixx="0.011" ixy="0.0002" ixz="0.0001" iyy="0.012" iyz="-0.0003" izz="0.004"/>
  </inertial></link>
  <joint name="j3" type="prismatic">
    <origin xyz="0 0 0.1" rpy="0.4 0 0"/><parent link="elbow"/><child link="l3"/>
    <axis xyz="1 2 -2"/><limit lower="0" upper="0.4" velocity="0.5" effort="100"/>
    <dynamics damping="12"/>
  </joint>
  <link name="camera"><inertial>
    <origin xyz="0 0 0.01"/><mass value="0.3"/>
    <inertia ixx="0.0002" ixy="0" ixz="0" iyy="0.0002" iyz="0" izz="0.0001"/>
  </inertial></link>
  <joint name="camera_arm" type="fixed">
    <origin xyz="0.1 0 0.05" rpy="0 0.3 0"/><parent link="l3"/><child link="camera_holder"/>
  </joint>
  <link name="camera_holder"/>
  <joint name="camera_mount" type="fixed">
    <origin xyz="0 0.1 0" rpy="0.5 0 0"/><parent link="camera_holder"/><child link="camera"/>
  </joint>
  <link name="l4"><inertial>
    <origin xyz="0.02 0 0.05" rpy="0 0 0.3"/><mass value="1.0"/>
    <inertia ixx="0.003" ixy="0" ixz="0" iyy="0.003" iyz="0" izz="0.001"/>
  </inertial></link>
  <joint name="j4" type="revolute">
    <origin xyz="0 0.2 0.15" rpy="0 -1.1 0.3"/><parent link="l3"/><child link="l4"/>
    <limit lower="-1" upper="1" velocity="3" effort="20"/>
  </joint>
  <link name="l5"><inertial>
    <origin xyz="0 0 0.04"/><mass value="0.8"/>
    <inertia ixx="0.002" ixy="0" ixz="0.0001" iyy="0.002" iyz="0" izz="0.001"/>
  </inertial></link>
  <joint name="j5" type="revolute">
    <origin xyz="0 0 0.2"/><parent link="l4"/><child link="l5"/>
    <axis xyz="0 0 -1"/><limit lower="-3" upper="3" velocity="3" effort="20"/>
  </joint>
  <link name="l6"><inertial>
    <origin xyz="0 0.01 0.02"/><mass value="0.4"/>
    <inertia ixx="0.0005" ixy="0" ixz="0" iyy="0.0006" iyz="0" izz="0.0004"/>
  </inertial></link>
  <joint name="j6" type="revolute">
    <origin xyz="0.03 0 0.1" rpy="1 2 3"/><parent link="l5"/><child link="l6"/>
    <axis xyz="0.3 -0.4 0.5"/><limit lower="-3" upper="3" velocity="4" effort="10"/>
    <dynamics damping="0.1" friction="0.05"/>
  </joint>
  <link name="flange"/>
  <joint name="flange_mount" type="fixed">
    <origin xyz="0 0 0.07" rpy="0 0 0.5"/><parent link="l6"/><child link="flange"/>
  </joint>
  <link name="tcp"><inertial>
    <origin xyz="0 0 0.03"/><mass value="0.25"/>
    <inertia ixx="0.0003" ixy="0" ixz="0" iyy="0.0003" iyz="0" izz="0.0002"/>
  </inertial></link>
  <joint name="tcp_mount" type="fixed">
    <origin xyz="0.01 0.02 0.1" rpy="0.3 -0.2 0.1"/><parent link="flange"/><child link="tcp"/>
  </joint>
  <transmission name="t"><joint name="j1"/></transmission>
  <gazebo reference="l1"><link name="not_a_link"/></gazebo>
</robot>
"""


@pytest.fixture
def arm_urdf(tmp_path: Path) -> Path:
    """The arm's URDF: joints R, R (continuous), P, R, R, R."""
    path = tmp_path / "arm.urdf"
    path.write_bytes(ARM.encode())
    return path


@pytest.fixture
def configurations() -> torch.Tensor:
    """(20, 6) seeded joint positions."""
    generator = torch.Generator().manual_seed(3)
    return torch.rand(20, 6, generator=generator, dtype=torch.float64) * 4 - 2
