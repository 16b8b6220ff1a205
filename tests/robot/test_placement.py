import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.robot.placement import (
    align_z,
    dh_classical,
    dh_modified,
    exact,
    pose,
    quaternion,
    roll_pitch_yaw,
    rotation_x,
    rotation_y,
    rotation_z,
)

EXACT = 1e-12
angles = st.floats(-10, 10)
lengths = st.floats(-3, 3)
quick = settings(max_examples=60)


def is_rotation(matrix: torch.Tensor) -> bool:
    eye = torch.eye(3, dtype=torch.float64)
    return bool(
        (matrix @ matrix.T - eye).abs().max() < EXACT and abs(torch.linalg.det(matrix) - 1) < EXACT
    )


@quick
@given(st.tuples(lengths, lengths, lengths).filter(lambda v: np.linalg.norm(v) > 1e-6))
def test_align_z_takes_z_to_the_axis(axis):
    turn = align_z(axis)
    assert is_rotation(turn)
    expected = np.array(axis) / np.linalg.norm(axis)
    assert np.abs(turn[:, 2].numpy() - expected).max() < EXACT


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_align_z_permutes_exactly_for_a_coordinate_axis(index, sign):
    axis = [0.0, 0.0, 0.0]
    axis[index] = sign
    turn = align_z(axis)
    assert is_rotation(turn)
    assert turn[:, 2].tolist() == axis
    assert turn.abs().sum(0).tolist() == turn.abs().sum(1).tolist() == [1.0, 1.0, 1.0]
    assert set(turn.abs().flatten().tolist()) == {0.0, 1.0}


def test_align_z_leaves_z_alone():
    assert align_z([0, 0, 1]).equal(torch.eye(3, dtype=torch.float64))


@pytest.mark.parametrize("tilt", [1e-15, 1e-9, 1e-5])
def test_align_z_near_an_axis(tilt):
    for axis in ([tilt, 0, 1], [1, tilt, 0], [0, -1, tilt], [tilt, tilt, -1]):
        assert is_rotation(align_z(axis))
        assert (align_z(axis)[:, 2] @ torch.tensor(axis, dtype=torch.float64)) > 1 - EXACT


@quick
@given(angles, angles, angles)
def test_roll_pitch_yaw_equals_pinocchios(roll, pitch, yaw):
    pin = pytest.importorskip("pinocchio")
    expected = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    assert np.abs(roll_pitch_yaw([roll, pitch, yaw]).numpy() - expected).max() < EXACT


def test_rotations_turn_the_right_way():
    x, y, z = torch.eye(3, dtype=torch.float64)
    assert (rotation_x(math.pi / 2) @ y).equal(z)
    assert (rotation_y(math.pi / 2) @ z).equal(x)
    assert (rotation_z(math.pi / 2) @ x).equal(y)


@quick
@given(st.tuples(lengths, lengths, lengths, lengths).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_quaternion_equals_pinocchios(wxyz):
    pin = pytest.importorskip("pinocchio")
    unit = np.array(wxyz) / np.linalg.norm(wxyz)
    expected = pin.Quaternion(*unit).toRotationMatrix()
    assert np.abs(quaternion(wxyz).numpy() - expected).max() < EXACT


def test_right_angles_are_exact():
    entries = roll_pitch_yaw([math.pi / 2, -math.pi / 2, math.pi]).abs().unique().tolist()
    assert entries == [0.0, 1.0]
    kept = torch.tensor([1e-14, 1 - 1e-14, 2.0, -3.0], dtype=torch.float64)
    assert exact(kept).equal(kept)


def test_pose():
    assert pose().equal(torch.eye(4, dtype=torch.float64))
    placed = pose(rotation_z(math.pi), (1, 2, 3))
    assert placed.tolist() == [[-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]


@quick
@given(lengths, angles, lengths, angles)
def test_dh_rows_equal_the_textbooks_matrices(a, alpha, d, theta):
    ca, sa, ct, st_ = math.cos(alpha), math.sin(alpha), math.cos(theta), math.sin(theta)
    classical = [
        [ct, -st_ * ca, st_ * sa, a * ct],
        [st_, ct * ca, -ct * sa, a * st_],
        [0, sa, ca, d],
        [0, 0, 0, 1],
    ]
    got = dh_classical(a, alpha, d, theta)
    assert np.abs(got.numpy() - np.array(classical)).max() < EXACT
    modified = [
        [ct, -st_, 0, a],
        [st_ * ca, ct * ca, -sa, -d * sa],
        [st_ * sa, ct * sa, ca, d * ca],
        [0, 0, 0, 1],
    ]
    got = dh_modified(a, alpha) @ pose(rotation_z(theta), (0, 0, d))
    assert np.abs(got.numpy() - np.array(modified)).max() < EXACT
