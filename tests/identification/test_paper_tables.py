"""The report's tables A.1-A.4: which coefficients there are, their values, and their recovery."""

import re
from decimal import Decimal

import pytest
import torch

from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects, on_every_joint
from torchid.excitation.synthetic import PaperNoise, synthetic_log
from torchid.excitation.trajectories import paper_trajectories_3r, random_trajectory, trajectory_log
from torchid.identification.base_parameters import base_parameters, stacked_regressor
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")

# Columns 'Coefficient' and 'Real', as printed but for what NOTES.md lists as misprints.
TABLE_A1 = """
44.44*J3zz - 20.66*J2zz + m2 : 0.9235
m3 - 44.44*J3zz : 0.7995
4.545*J2zz + m2*c2x : -0.00949
m2*c2y : 0.0008
6.667*J3xz - 4.545*J2xz + m2*c2z : 0.00296
6.667*J3zz + m3*c3x : -0.0119
m3*c3y : 0.0024
m3*c3z - 6.667*J3xz : 0.00108
J1yy + J2yy + J3yy - J2zz - J3zz : 0.02631
J2xx - J2yy + J2zz : 0.000498
J2xy : 0.000127
J2yz : -3.2e-06
J3xx - J3yy + J3zz : 0.000561
J3xy : 0.000252
J3yz : -1.44e-05
"""

# Row 1 and 2: 6.5746 for the printed 0.6575; row 1: 5.2103 for the printed 5.2102.
TABLE_A3 = """
6.25*J2yy - 6.5746*J4yy + 6.25*J3zz - 6.5746*J5zz + m3 + m4 - 5*m3*c3y - 5.1282*m5*c5y : 5.2103
6.5746*J4yy + 6.5746*J5zz + m5 + m6 + m7 + 5.1282*m5*c5y : 3.0671
m2*c2x : 0.003618
m2*c2z - 2.5*J3zz - 2.5*J2yy + m3*c3y : 0.2890
m3*c3x : -0.003618
m3*c3z + m4*c4y : 0
m4*c4x : -0.003618
m4*c4z - 2.5641*J5zz - 2.5641*J4yy - m5*c5y : 0.2550
m5*c5x : -0.00168
m5*c5z - m6*c6y : -0.0362
m6*c6x : -0.0004144
m6*c6z + m7*c7z : 0.01037
m7*c7x : 0
m7*c7y : 0
J1yy + J2zz : 0.013774
J2xx - J2yy - J2zz : -0.004867
J2xy : 9.415e-05
J2xz : -0.0003145
J2yz : 0.009747
J3xx - J3zz + J4zz : -0.023226
J3xy : 0.0003145
J3xz : -9.5572e-05
J3yy + J4zz : 0.0137742
J3yz : 0.002681
J4xx - J4yy - J4zz : -0.006887
J4xy : 9.415e-05
J4xz : 0.00031455
J4yz : 0.009747
J5xx - J5zz + J6zz : 0.00547
J5xy : -0.0001898
J5xz : -4.474e-05
J5yy + J6zz : 0.008415
J5yz : -0.002023
J6xx + J7yy - J6zz : 0.000822
J6xy : -2.463e-06
J6xz : -2.323e-06
J6yy + J7yy : 0.00436
J6yz : -7.008e-05
J7xx - J7yy : 0.002178
J7xy : 0
J7xz : 0
J7yz : 0
J7zz : 0.0001584
"""

TABLE_A2 = {
    "Fv": ["0.0665", "0.1987", "0.0399"],
    "Fc": ["0.2450", "0.1523", "0.1827"],
    "F0": ["-0.1073", "-0.1566", "-0.0686"],
}
TABLE_A4 = {
    "Fv": ["0.0665", "0.1987", "0.0399", "0.2257", "0.1023", "-0.0132", "0.0638"],
    "Fc": ["0.245", "0.1523", "0.1827", "0.3591", "0.2669", "0.1658", "0.2109"],
    "F0": ["-0.1073", "-0.1566", "-0.0686", "-0.2522", "0.0045", "0.0910", "-0.0127"],
}

SIZES = {"3r": 15, "3r_friction": 24, "kuka_lwr4": 43, "kuka_lwr4_friction": 64}


def coefficients(text: str) -> dict[str, float]:
    """`44.44*J3zz - m2*c2x` and `44.444 J3zz - m2c2x` as {J3zz: 44.44, m2c2x: -1}."""
    found: dict[str, float] = {}
    for sign, term in re.findall(r"([+-]?)\s*([^+-]+)", text.replace(" ", "").replace("*", " ")):
        size, symbol = re.fullmatch(r"([\d.]+(?= ?[A-Za-z]))? ?(.+)", term).groups()
        found[symbol.replace(" ", "")] = float(size or 1) * (-1 if sign == "-" else 1)
    return found


def rows(table: str) -> list[tuple[dict[str, float], str]]:
    pairs = (line.split(" : ") for line in table.strip().splitlines())
    return [(coefficients(name), value) for name, value in pairs]


def last_digit(printed: str) -> float:
    """One unit of the last printed digit: the report rounds here and cuts off there."""
    return float(10 ** Decimal(printed).as_tuple().exponent) if float(printed) else 1e-12


def effects_of(robot: Robot) -> list:
    return on_every_joint(FRICTION, robot.n) if robot.effects else []


def true_parameters(robot: Robot) -> torch.Tensor:
    """All parameters in the order of the columns: the rigid body's, then the effects'."""
    nominal = dict(nominal_effects(robot))
    values = [v for effect in effects_of(robot) for v in nominal[effect]]
    rigid = robot.parameters.to_paper_order()
    return torch.cat([rigid, torch.tensor(values, dtype=torch.float64)])


def test_names_are_parsed():
    assert coefficients("44.44*J3zz - 20.66*J2zz + m2*c2x") == {
        "J3zz": 44.44,
        "J2zz": -20.66,
        "m2c2x": 1.0,
    }
    assert coefficients("-5 m3c3y + m4") == {"m3c3y": -5.0, "m4": 1.0}


@pytest.mark.parametrize(("name", "table"), [("3r", TABLE_A1), ("kuka_lwr4", TABLE_A3)])
def test_coefficients_and_values_of_tables_a1_and_a3(name, table):
    robot = load_robot(name)
    base = base_parameters(robot)
    printed = rows(table)
    assert len(base) == len(printed) == SIZES[name]
    values = base.project(true_parameters(robot)).tolist()
    for text, value, (expected, real) in zip(base.names, values, printed, strict=True):
        got = coefficients(text)
        assert got.keys() == expected.keys()
        assert all(got[k] == pytest.approx(expected[k], rel=2e-4) for k in got), text
        assert abs(value - float(real)) <= last_digit(real) * (1 + 1e-6), text


@pytest.mark.parametrize(
    ("name", "table"), [("3r_friction", TABLE_A2), ("kuka_lwr4_friction", TABLE_A4)]
)
def test_friction_of_tables_a2_and_a4(name, table):
    robot = load_robot(name)
    base = base_parameters(robot, effects_of(robot))
    plain = base_parameters(load_robot(name.removesuffix("_friction")))
    assert len(base) == SIZES[name]
    assert base.names[: base.n_rigid] == plain.names
    expected = [(f"{key}{j}", v) for key in table for j, v in enumerate(table[key], 1)]
    assert list(base.names[base.n_rigid :]) == [label for label, _ in expected]
    values = base.project(true_parameters(robot)).tolist()[base.n_rigid :]
    for value, (label, real) in zip(values, expected, strict=True):
        assert abs(value - float(real)) <= last_digit(real) * (1 + 1e-6), label


def plan(robot: Robot):
    """The report's: three trajectories of 2001 instants (3R), three or two of 588 (7R)."""
    if robot.n == 3:
        return trajectory_log(paper_trajectories_3r(), 100.0)
    count = 2 if robot.effects else 3
    return trajectory_log(random_trajectory(robot, 0, count=count), 1 / 0.034)


@pytest.mark.parametrize("noise", [None, PaperNoise(30.0)], ids=["noise-free", "paper noise"])
@pytest.mark.parametrize("name", SIZES)
def test_the_coefficients_are_recovered_to_rounding(name, noise):
    robot = load_robot(name)
    effects = effects_of(robot)
    log = synthetic_log(robot, plan(robot), noise, seed=0)
    base = base_parameters(robot, effects)
    y = stacked_regressor(robot, effects, Motion(log.q, log.dq, log.ddq))
    found = torch.linalg.lstsq(y[:, list(base.independent)], log.tau.reshape(-1)).solution
    error = (found - base.project(true_parameters(robot))).abs().max()
    assert error <= 1e-11
