"""Coupled wrist motors, by virtual work of the motor's own torque."""

import pytest
import torch

from tests.arms import arm, states
from torchid.effects.base import Motion
from torchid.effects.coupling import GearCoupling
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.inertia import RotorInertia

VALUES = [0.7, 0.2, 1.3]
"""Fvm, Iam, Fcm."""


def motion() -> Motion:
    return Motion(*states(arm("panda"), 40))


@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.25])
def test_with_the_joints_own_terms_it_is_the_motors_virtual_work(ratio: float) -> None:
    """tau = (dw/d dq)' (Ia dw/dt + Fv w + Fc sign w) for the motor's speed w."""
    m, j, i = motion(), 5, 4
    fv, ia, fc = VALUES
    w, dw = (x[:, j] + ratio * x[:, i] for x in (m.dq, m.ddq))
    torque = ia * dw + fv * w + fc * torch.sign(w)
    expected = torch.zeros_like(m.q)
    expected[:, j], expected[:, i] = torque, ratio * torque
    found = GearCoupling(j, i, ratio).all_torques(m, VALUES)
    for joint, share in ((j, 1.0), (i, ratio**2)):
        found[:, joint] += share * ViscousFriction(joint).torque(m, [fv])
        found[:, joint] += share * RotorInertia(joint).torque(m, [ia])
    found[:, j] += CoulombFriction(j).torque(m, [fc])
    torch.testing.assert_close(found, expected)


def test_literatures_form_for_joints_5_and_6() -> None:
    m = motion()
    columns = GearCoupling(5, 4).torque_columns(m)
    both = torch.sign(m.dq[:, 4] + m.dq[:, 5])
    on_5 = torch.stack([m.dq[:, 5], m.ddq[:, 5], both], -1)
    on_6 = torch.stack([m.dq[:, 4], m.ddq[:, 4], both - torch.sign(m.dq[:, 5])], -1)
    torch.testing.assert_close(columns[:, 4], on_5)
    torch.testing.assert_close(columns[:, 5], on_6)
    assert not columns[:, [0, 1, 2, 3, 6]].any()


def test_the_other_joint_at_rest_leaves_the_joints_own_friction_alone() -> None:
    m = motion()
    dq, ddq = m.dq.clone(), m.ddq.clone()
    dq[:, 4], ddq[:, 4] = 0.0, 0.0
    columns = GearCoupling(5, 4).torque_columns(Motion(m.q, dq, ddq))
    assert not columns[:, 5].any()


def test_neighbours_of_the_same_kind_either_way_and_both_senses() -> None:
    found = GearCoupling.candidates(arm("panda"))
    assert len(found) == 24
    assert all(abs(e.joint - e.source_joint) == 1 for e in found)
    assert {e.ratio for e in found} == {1.0, -1.0}
    # R P R R P R: only joints 3 and 4 are neighbours of one kind.
    assert {e.joints for e in GearCoupling.candidates(arm("mixed"))} == {(2, 3), (3, 2)}
    with pytest.raises(ValueError, match="must differ"):
        GearCoupling(3, 3)
