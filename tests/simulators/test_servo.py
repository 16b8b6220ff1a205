"""Set-points and efforts at run time are those of the simulation of servos."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.marks import quick_first
from tests.oracles import MujocoOracle
from torchid.effects.servo import INDEX, NAMES
from torchid.errors import TorchidError
from torchid.simulation.replay import replayed
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import PROFILE, Tracks, set_points, windows_of
from torchid.simulators.servo import ServoTorque, SetPoints, drawn_servos

DT = 0.02


def commands(samples: int, seed: int, *, repeated: bool) -> np.ndarray:
    """(T, 3) steps and slopes, some of them sent again."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0, 0.03, (samples, 3)), 0) + 0.5 * (rng.random((samples, 3)) < 0.05)
    if repeated:
        for k in range(1, samples):
            u[k] = np.where(rng.random(3) < 0.5, u[k - 1], u[k])
    return u


@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_limited_set_points_are_those_of_the_simulation(seed, repeated):
    servos = Servos.neutral(3, kp=10.0, kd=0.0, scale=1.1)
    servos.joint[0, INDEX["acceleration"]] = 8.0
    servos.joint[1, INDEX["acceleration"]] = 8.0
    servos.joint[1, INDEX["speed"]] = 0.6
    servos = Servos(servos.joint, servos.plane, repeated=repeated)
    u = commands(120, seed, repeated=repeated)
    ends = torch.tensor([0]), torch.tensor([119])
    tracks = Tracks(torch.from_numpy(u), *ends, DT)
    expected = set_points(
        servos.joint[None][..., [INDEX[name] for name in PROFILE]], tracks, repeated=repeated
    )[:, 0].T.numpy()
    points = SetPoints(servos, DT)
    fed = np.array([points.feed(row, 4) for row in u])
    # From one sample's set-point to the next in a line; what is not limited holds.
    assert np.allclose(1.1 * fed[:, 0, :2], expected[:, :2], atol=1e-12)
    middle = (expected[:-1] + expected[1:]) / 2
    assert np.allclose(1.1 * fed[:-1, 2, :2], middle[:, :2], atol=1e-12)
    assert np.allclose(fed[:, :, 2], u[:, None, 2])
    assert points.late.tolist() == [0.0, 0.0, DT / 2]


def test_the_rate_is_fed_forwards():
    """kp (x + kd / kp dx - q) is what answers to both errors."""
    servos = Servos.neutral(2, kp=20.0, kd=1.5)
    servos.joint[0, INDEX["speed"]] = 1.0
    points = SetPoints(servos, DT)
    assert np.allclose(points.feed([0.2, 0.2], 2), 0.2)
    ctrl = points.feed([0.3, 0.3], 2)
    assert np.allclose(ctrl[0], 0.2 + 1.5 / 20 * np.array([1.0, 0.1 / DT]), atol=1e-3)
    assert np.allclose(ctrl[1] - ctrl[0], np.array([1.0, 0.1 / DT]) * DT / 2, atol=1e-3)
    assert points.late.tolist() == [0.0, DT]


def test_environments_are_apart_and_begin_anew():
    servos = Servos.neutral(3, kp=10.0, acceleration=5.0)
    u = np.stack([commands(30, seed, repeated=False) for seed in (1, 2)], 1)
    both, single = SetPoints(servos, DT), SetPoints(servos, DT)
    for row in u:
        assert np.allclose(both.feed(row, 3)[:, 1], single.feed(row[1], 3))
    both.reset([0])
    single.reset()
    assert np.allclose(both.feed(u[0], 1)[0, 0], u[0, 0])
    assert not np.allclose(both.feed(u[0], 1)[0, 1], u[0, 1])
    assert np.allclose(single.feed(u[0, 1], 1), u[0, 1])


@pytest.mark.parametrize("dt", [0.0, -1.0, math.nan, math.inf])
def test_a_time_that_is_none(dt):
    with pytest.raises(TorchidError, match="expected: dt > 0 s"):
        SetPoints(Servos.neutral(2, kp=1.0), dt)


def in_mujoco(robot, servos: Servos, u: np.ndarray, step: float) -> np.ndarray:
    """(T, n) positions where MuJoCo is given the effort of `ServoTorque`, at rest at first."""
    import mujoco

    model = MujocoOracle(robot).model
    model.opt.timestep = step
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_armature[:], model.dof_damping[:] = servos.of("armature"), servos.of("damping")
    model.dof_frictionloss[:] = servos.of("coulomb")
    model.dof_solimp[:, :2], model.dof_solref[:] = 0.9999, [2.1 * step, 1.0]
    data = mujoco.MjData(model)
    data.qpos[:] = u[0]
    steps = round(DT / step)
    drives = ServoTorque(robot, servos, dtype=torch.float64, dt=step, steps=steps)
    out = [u[0]]
    for row in u[:-1]:
        for _ in range(steps):
            now = (torch.tensor(x)[None] for x in (row, data.qpos, data.qvel))
            data.qfrc_applied[:] = drives.torque(*now)[0]
            mujoco.mj_step(model, data)
        out.append(data.qpos.copy())
    return np.array(out)


LATE = {"kd": 0.5, "delay": 0.043}
"""With a delay of more than a sample, a line through commands is no later than it should be."""


@pytest.mark.parametrize(
    ("values", "bound"),
    quick_first(
        [
            (LATE | {"lag": 0.05, "offset": 1.0, "coulomb": 0.8, "scale": 1.1}, 1e-3),
            ({"acceleration": 8.0, "speed": 0.7, "delay": 0.013, "kd": 2.0}, 1e-3),
            (LATE | {"clip": 60.0, "dead_zone": 0.01}, 1e-3),
            (LATE | {"integral": 200.0}, 1e-3),
            (LATE | {"stiction": 5.0, "stribeck_speed": 0.1, "motor_share": 0.1}, 4e-3),
            (LATE | {"load_share": 0.2, "offset": 1.0}, 1e-3),
            (LATE | {"load_share": 0.1, "motor_share": 0.2, "stiction_share": 0.1}, 1e-3),
            (LATE | {"stiction_share": 0.2, "stribeck_speed": 0.5, "stribeck_exponent": 2}, 1e-3),
            (LATE | {"acceleration": 8.0, "stiction": 5.0, "stribeck_speed": 0.1}, 4e-3),
            (LATE | {"supply": 200.0, "clip": 60.0}, 1e-3),
            # Steps of held commands against lines through them.
            ({"delay": 0.02}, 2e-3),
            (LATE, 1e-3),
        ],
        2,
        several=True,
    ),
)
def test_efforts_move_an_arm_as_the_simulation_of_servos_does(values, bound):
    robot = arm("3r")
    servos = Servos.neutral(3, **{"kp": 300.0, "damping": 14.0, "armature": 0.3} | values)
    rng = np.random.default_rng(3)
    t = DT * np.arange(60)[:, None]
    u = rng.uniform(-1, 1, 3) + 0.2 * (1 - np.cos(2 * np.pi * rng.uniform(0.3, 1.0, 3) * t))
    tracks = Tracks(torch.from_numpy(u), torch.tensor([0]), torch.tensor([59]), DT)
    batch = Servos(servos.joint[None, None], servos.plane[None, None])
    begun = tracks.u[:1], torch.zeros(1, 3).double()
    ours = replayed(robot, batch, tracks, windows_of(tracks, None), *begun, longest_step=1e-3)
    theirs = in_mujoco(robot, servos, u, 1e-3)
    assert np.abs(ours.numpy() - theirs).max() < bound
    if len(values) > 2:  # what is tested is there
        plain = Servos.neutral(3, **{"kp": 300.0, "damping": 14.0, "armature": 0.3} | LATE)
        assert np.abs(in_mujoco(robot, plain, u, 1e-3) - theirs).max() > 3 * bound


def test_efforts_of_environments_are_apart_and_begin_anew():
    robot = arm("3r")
    servos = Servos.neutral(3, kp=50.0, kd=2.0, delay=0.03, lag=0.02, speed=0.5, integral=20.0)
    both = ServoTorque(robot, servos, ["b/joint_3", "joint_1"], 2, dt=0.005, steps=4)
    one = ServoTorque(robot, servos, ["joint_3", "joint_1"], 1, dt=0.005, steps=4)
    u = torch.from_numpy(commands(12, 5, repeated=False)[:, :2]).float()
    still = torch.zeros(2, 2)

    def sample(row: int) -> torch.Tensor:
        rows = torch.stack([u[(row + 3) % 12], u[row]])
        together = torch.stack([both.torque(rows, still, still) for _ in range(4)])
        alone = torch.stack([one.torque(u[row, None], still[:1], still[:1]) for _ in range(4)])
        torch.testing.assert_close(together[:, 1:], alone)
        return together

    for row in range(8):
        sample(row)
    both.reset(torch.tensor([0]))
    sample(8)
    begun = sample(9)[:, 0]
    # As an arm does that begins there.
    one.reset()
    for k in (8, 9):
        rows = u[(k + 3) % 12, None]
        alone = torch.stack([one.torque(rows, still[:1], still[:1])[0] for _ in range(4)])
    torch.testing.assert_close(begun, alone)


def test_environments_have_servos_of_their_own(tmp_path):
    """Drawn ones, in turn, as each of them does alone."""
    robot, draw = arm("3r"), torch.Generator().manual_seed(4)
    centre = Servos.neutral(3, kp=50.0, kd=2.0, delay=0.03, lag=0.02, speed=0.5, dead_zone=0.01)
    spread = 1 + 0.5 * torch.rand(2, *centre.joint.shape, generator=draw, dtype=torch.float64)
    values = (centre.joint * spread).nan_to_num(nan=0.0)
    path = tmp_path / "draws.npz"
    np.savez(path, parameters=np.array(NAMES), values=values.numpy())
    drawn = drawn_servos(path, centre)
    assert torch.equal(drawn.joint, values)
    dt, dtype = {"dt": 0.005, "steps": 4}, torch.float64
    every = ServoTorque(robot, drawn, None, 3, dtype=dtype, **dt)
    single = [
        ServoTorque(robot, replace(centre, joint=v), None, 1, dtype=dtype, **dt) for v in values
    ]
    for row in torch.from_numpy(commands(10, 5, repeated=False)):
        given = row.repeat(3, 1), 0.1 * row.repeat(3, 1), -row.repeat(3, 1)
        for _ in range(4):
            together = every.torque(*given)
            alone = torch.cat([one.torque(*(x[:1] for x in given)) for one in single])
            torch.testing.assert_close(together[:2], alone)
            torch.testing.assert_close(together[2], together[0], rtol=1e-12, atol=1e-12)
    with pytest.raises(TorchidError, match="draws of other servos"):
        drawn_servos(path, Servos.neutral(2))
    path.write_text("no archive")
    with pytest.raises(TorchidError, match="holds no draws"):
        drawn_servos(path, centre)


def test_what_an_effort_does_not_hold_is_said():
    robot = arm("3r")
    servos = Servos.neutral(3, kp=50.0, damping=2.0, stop_high=1.0, coulomb=0.4)
    assert ServoTorque(robot, servos, dt=0.005).ignored == ("stop_high",)
    servos.joint[:, INDEX["load_share"]] = 0.1
    # Without the other joints nobody knows the load.
    drives = ServoTorque(robot, servos, ["joint_3", "joint_1"], dt=0.005)
    assert drives.ignored == ("load_share", "stop_high")
    servos.joint[:, INDEX["stiction_share"]] = 0.1
    drives = ServoTorque(robot, servos, ["joint_3", "joint_1"], dt=0.005)
    assert drives.ignored == ("load_share", "stiction_share", "stop_high")
    servos.joint[:, [INDEX["load_share"], INDEX["stiction_share"]]] = 0.0
    servos.joint[:, INDEX["supply"]] = 100.0
    drives = ServoTorque(robot, servos, ["joint_3", "joint_1"], dt=0.005)
    assert drives.ignored == ("supply", "stop_high")
    servos.joint[:, INDEX["supply"]] = torch.inf
    drives = ServoTorque(robot, servos, dt=0.005)
    x, still, quick = torch.zeros(1, 3), torch.zeros(1, 3), torch.ones(1, 3)
    assert float(drives.torque(x, still, quick).abs().max()) == 0
    added = ServoTorque(robot, servos, dt=0.005, fields=True).torque(x, still, quick)
    torch.testing.assert_close(added, torch.full((1, 3), -2.4))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"dt": 0.0}, "steps from one command"),
        ({"dt": 0.01, "steps": 0}, "steps from one command"),
        ({"dt": 0.01, "names": ["elbow"]}, "no such joint"),
    ],
)
def test_actuators_that_are_none(more, said):
    with pytest.raises(TorchidError, match=said):
        ServoTorque(arm("3r"), Servos.neutral(3, kp=1.0), **more)
