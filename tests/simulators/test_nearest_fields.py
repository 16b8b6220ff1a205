"""Fields in the place of effects that a file has none for: what they are, and what they lose."""

from dataclasses import replace

import pytest
import torch

from tests.arms import arm
from tests.gap.diagnoses import motion_of
from torchid.design.columns import Columns, Model
from torchid.design.segments import Samples, Segment, moving_samples
from torchid.export.dynamics import records
from torchid.report.exported import simulator_block
from torchid.robot.model import Robot
from torchid.simulators.joint_dynamics import kinds_in, split
from torchid.simulators.nearest_fields import nearest_fields

HELD = (
    {"effect": "viscous_friction", "joint": 1, "Fv": 2.0},
    {"effect": "coulomb_friction", "joint": 2, "Fc": 0.5},
    {"effect": "viscous_friction", "joint": 3, "Fv": 0.5},
)
WITHOUT = (
    {"effect": "presliding_hysteresis", "joint": 1, "Fh": 4.0, "length": 0.01},
    {"effect": "load_dependent_friction", "joint": 2, "mu": 0.1},
    {"effect": "torque_offset", "joint": 3, "F0": -2.0},
    {"effect": "time_delay", "joint": 3, "delay": 0.004},
)
RATE, BAND = 100.0, 12.0


def columns_of(robot: Robot, truth: Robot | None = None) -> Columns:
    """Columns of a robot along the motion and torque of another one, or its own."""
    motion = motion_of(3, 20.0, RATE, 3)
    bare = Segment("run", RATE, BAND, motion, torch.zeros_like(motion.q), own_velocity=False)
    tau = Model.of(robot if truth is None else truth).torque(bare, Samples([bare], BAND))
    return Columns(Model.of(robot), Samples([replace(bare, tau=tau)], BAND))


def as_in_file(robot: Robot, rows, to) -> Robot:  # type: ignore[no-untyped-def]
    """The robot that a file holds, whose fields are those of the joints and these rows."""
    joints = list(split(robot, to)[0])
    for row in rows:
        joints[row.joint] = replace(joints[row.joint], **row.fields)
    pairs = [
        (kind(j), [getattr(own, name) for name in names])
        for j, own in enumerate(joints)
        for kind, names in kinds_in(to).items()
    ]
    return replace(robot, effects=records(pairs))


@pytest.mark.parametrize("to", ["mjcf", "urdf"])
def test_a_file_with_the_nearest_fields_is_nearer_and_loses_what_it_says(to) -> None:
    truth = replace(arm("3r"), effects=(*HELD, *WITHOUT[:3]))
    rows = nearest_fields(columns_of(truth), to)
    effects = [(row.joint, *row.effects) for row in rows]
    assert effects == [(j, one["effect"]) for j, one in enumerate(WITHOUT[:2])]
    errors = []
    for some in ((), rows):
        columns = columns_of(as_in_file(truth, some, to), truth)
        keep = moving_samples(columns.samples)
        errors.append([float(columns.gap[j, keep[j]].square().mean().sqrt()) for j in range(2)])
    assert [row.made for row in rows] == pytest.approx(errors[0], rel=1e-6)
    assert [row.lost for row in rows] == pytest.approx(errors[1], rel=1e-6)
    assert all(row.lost < 0.5 * row.made for row in rows if row.fields)
    hysteresis, load = rows
    assert hysteresis.fields.keys() == {"friction"}
    assert 3.0 < hysteresis.fields["friction"] < 4.0, "less than it reaches, for it comes late"
    assert load.fields["friction"] > 0.5


def test_friction_that_thins_is_damping_over_speed_that_resists_at_any() -> None:
    thinning = {"effect": "power_law_friction", "joint": 1, "F2": -0.9, "a": 1.5}
    robot = replace(arm("3r"), effects=(*HELD, thinning))
    (row,) = nearest_fields(columns_of(robot), "mjcf")
    assert row.lost < 0.1 * row.made
    damper = replace(split(robot, "mjcf")[0][0], **row.fields)
    assert damper.quadratic < 0
    assert damper.resists
    assert f'damping="{damper.damping:.6g} {damper.quadratic:.6g} {damper.cubic:.6g}"' in (
        simulator_block(robot, [row])
    )
    (straight,) = nearest_fields(columns_of(robot), "urdf")
    assert straight.fields.keys() <= {"damping", "friction"}
    assert row.lost < 0.5 * straight.lost


def test_no_field_takes_a_sign_that_simulators_refuse() -> None:
    driving = {"effect": "power_law_friction", "joint": 3, "F2": -3.0, "a": 1.5}
    robot = replace(arm("3r"), effects=(*HELD, driving))
    (row,) = nearest_fields(columns_of(robot), "urdf")
    assert row.fields["damping"] == 0.0
    assert 0.5 * row.made < row.lost < row.made


def test_errors_of_the_sensors_are_in_no_field() -> None:
    robot = replace(arm("3r"), effects=(*HELD, WITHOUT[0], WITHOUT[3]))
    rows = nearest_fields(columns_of(robot), "mjcf")
    assert [row.effects for row in rows] == [("presliding_hysteresis",)]
    mjcf, urdf = simulator_block(robot, rows).split("<!-- URDF")
    assert "no field for" not in mjcf
    assert "correct the log, not the simulator: time delay of joint 3: Shift the torque's" in urdf
    assert f"the nearest is frictionloss {rows[0].fields['friction']:.3g} instead of 0;" in mjcf
    assert f'frictionloss="{rows[0].fields["friction"]:.6g}"' in mjcf
    assert f"{rows[0].lost:.2g} of {rows[0].made:.2g} N m RMS are lost" in mjcf
    # Those of one format are no other's.
    assert "no field for: presliding_hysteresis -->" in urdf


def test_an_offset_of_a_sensor_is_no_friction_where_the_joint_moves_one_way_alone() -> None:
    robot = replace(arm("3r"), effects=(*HELD, {**WITHOUT[2], "joint": 2}))
    columns = columns_of(robot)
    (segment,) = columns.samples.segments
    one_way = replace(segment, motion=segment.motion._replace(dq=segment.motion.dq.abs() + 0.1))
    rows = nearest_fields(Columns(columns.model, Samples([one_way], BAND)), "mjcf")
    assert rows == ()
    joint = simulator_block(robot, rows).splitlines()[2]
    assert joint == '<joint name="joint_2" frictionloss="0.5"/>'
    assert "correct the log, not the simulator: torque offset of joint 2: Subtract F0" in (
        simulator_block(robot, rows)
    )
