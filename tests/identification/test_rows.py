"""The rows of the least-squares problem against a dense regressor and scipy's filter."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.signal import butter, sosfiltfilt

from tests.excitation.test_excitation import random_arm
from torchid.design.motion import Measurement, direction, measurements
from torchid.dynamics.regressor import regressor
from torchid.effects.motion import Motion
from torchid.effects.registry import on_every_joint
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification import rows as rows_module
from torchid.identification.base_parameters import base_parameters, stacked_regressor
from torchid.identification.rows import Layout, RowSource, at_ease, layout
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot

EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


def arm(name: str):
    if name != "RPRP":
        return load_robot(name)
    generator = torch.Generator().manual_seed(0)
    pi = torch.rand((4, 10), generator=generator, dtype=torch.float64)
    return random_arm(5, name).with_parameters(InertialParameters(pi))


def a_log(robot, *, rates=(100.0,), durations=(20.0,), noise=None) -> Log:
    parts = []
    for k, (rate, duration) in enumerate(zip(rates, durations, strict=True)):
        plan = random_trajectory(robot, k, fill=True, duration=duration)
        parts.append(synthetic_log(robot, trajectory_log(plan, rate), noise, seed=k))
    return Log.concatenate(parts)


def layout_of(robot, effects=EFFECTS) -> Layout:
    kinds = on_every_joint(effects, robot.n)
    return layout(robot, base_parameters(robot, kinds), kinds)


def dense_rows(m: Measurement, columns: Layout) -> tuple[torch.Tensor, torch.Tensor]:
    """Brute force: [A] (I, n, B) in the layout's order and tau (I, n), filtered by scipy."""
    robot, base = columns.robot, columns.base
    smooth = regressor(robot, *m.motion.state)
    jumping = at_ease(m).motion.direction
    own = []
    for effect in columns.effects:
        wide = torch.zeros(m.samples, robot.n, dtype=torch.float64)
        wide[:, effect.joint] = {
            "viscous_friction": m.motion.dq,
            "coulomb_friction": jumping,
            "torque_offset": torch.ones_like(jumping),
            "rotor_inertia": m.motion.ddq,
        }[effect.name][:, effect.joint]
        own.append(wide.unsqueeze(-1))
    full = torch.cat([smooth, *own], -1)[..., list(base.independent)]
    full = full[..., list(columns.order)]
    stack = torch.cat([full, m.tau.unsqueeze(-1)], -1)
    if m.cutoff is None:
        return stack[..., :-1], stack[..., -1]
    sos = butter(4, m.cutoff, fs=m.rate, output="sos")
    pad = min(round(8 * m.rate / m.cutoff), m.samples - 1)
    filtered = sosfiltfilt(sos, stack.numpy(), axis=0, padlen=pad)
    step = max(1, int(m.rate / (10 * m.cutoff) + 1e-6))
    out = torch.from_numpy(filtered[m.edge : m.samples - m.edge : step].copy())
    return out[..., :-1], out[..., -1]


def collected(source: RowSource) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """A (I, n, B), tau (I, n), keep (I, n) and the instants of all blocks."""
    wide = []
    for block in source:
        a = torch.zeros(*block.tau.shape, source.layout.size, dtype=torch.float64)
        for i, (matrix, c) in enumerate(zip(block.matrices, source.layout.columns, strict=True)):
            a[:, i, list(c)] = matrix
        wide.append((a, block.tau, block.keep, block.instant))
    return tuple(torch.cat(part) for part in zip(*wide, strict=True))


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a - b).abs().max() / b.abs().max())


@pytest.mark.parametrize("cutoff", [None, 0.7, 3.0, 8.0])
@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction", "RPRP"])
def test_rows_are_those_of_brute_force(name, cutoff):
    robot = arm(name)
    columns = layout_of(robot)
    log = a_log(robot, rates=(100.0,))
    found = measurements(log, cutoff, torch.full((robot.n,), 0.01, dtype=torch.float64))
    a, tau, keep, _ = collected(RowSource(found, columns))
    dense, dense_tau = dense_rows(found[0], columns)
    assert a.shape == dense.shape
    assert relative(a, dense) < 1e-5
    assert relative(tau, dense_tau) < 1e-5
    assert bool(keep.all())


def test_several_trajectories_of_other_length_and_rate():
    robot = load_robot("3r_friction")
    columns = layout_of(robot)
    log = a_log(robot, rates=(100.0, 250.0, 1000.0), durations=(20.0, 12.0, 5.0))
    assert log.rates == pytest.approx([100.0, 250.0, 1000.0])
    found = measurements(log, 5.0)
    source = RowSource(found, columns)
    a, tau, _, instant = collected(source)
    parts = [dense_rows(m, columns) for m in found]
    assert torch.equal(instant, torch.arange(source.instants))
    edges = source.boundaries
    assert edges == [0, *np.cumsum([len(p[1]) for p in parts]).tolist()]
    assert edges[-1] == source.instants == len(tau)
    for (dense, dense_tau), first, last in zip(parts, edges, edges[1:], strict=False):
        assert relative(a[first:last], dense) < 1e-5
        assert relative(tau[first:last], dense_tau) < 1e-5
    assert source.interval == pytest.approx([0.02, 5 / 250, 20 / 1000])


@pytest.mark.parametrize("piece", [37, 100, 512])
@pytest.mark.parametrize("cutoff", [None, 2.0, 20.0])
def test_the_size_of_a_piece_does_not_matter(monkeypatch, piece, cutoff):
    robot = load_robot("3r_friction")
    log = a_log(robot, rates=(200.0, 100.0), durations=(8.0, 6.0))
    columns = layout_of(robot)
    found = measurements(log, cutoff)
    whole = collected(RowSource(found, columns, moving_only=True))
    monkeypatch.setattr(rows_module, "PIECE", piece)
    calls = []
    source = RowSource(found, columns, moving_only=True, progress=lambda *done: calls.append(done))
    pieces = collected(source)
    for a, b in zip(pieces, whole, strict=True):
        assert a.shape == b.shape
        assert torch.allclose(a.double(), b.double(), atol=1e-6 * float(b.double().abs().max()))
    assert len(calls) > 2
    assert calls == [(k + 1, len(calls)) for k in range(len(calls))]


def test_rows_that_are_not_kept_are_made_again(monkeypatch):
    robot = load_robot("3r_friction")
    found = measurements(a_log(robot), 5.0)
    columns = layout_of(robot)
    kept = RowSource(found, columns)
    first, second = list(kept), list(kept)
    assert all(a is b for a, b in zip(first, second, strict=True))
    monkeypatch.setattr(rows_module, "MEMORY", 0.0)
    fresh = RowSource(found, columns)
    once, again = list(fresh), list(fresh)
    assert all(a is not b for a, b in zip(once, again, strict=True))
    for one, two in zip(once + again, first + second, strict=True):
        torch.testing.assert_close(one.tau, two.tau, rtol=1e-12, atol=1e-12)
        assert all(torch.equal(a, b) for a, b in zip(one.matrices, two.matrices, strict=True))


def test_a_pass_that_is_broken_off_leaves_nothing_behind(monkeypatch):
    monkeypatch.setattr(rows_module, "PIECE", 100)
    robot = load_robot("3r_friction")
    source = RowSource(measurements(a_log(robot), 5.0), layout_of(robot))
    next(iter(source))
    assert len(collected(source)[1]) == source.instants


def test_moving_rows_only():
    robot = load_robot("3r_friction")
    log = a_log(robot, rates=(200.0,))
    (m,) = measurements(log, 4.0)
    keep = collected(RowSource([m], layout_of(robot), moving_only=True))[2]
    expected = (m.motion.dq.abs() > 0.02)[m.edge : m.samples - m.edge : 5]
    assert torch.equal(keep, expected)
    assert 0 < int(keep.sum()) < keep.numel()


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction"])
def test_every_joints_columns_are_there(name):
    """The last joint's effects too (FIGAROH 1.0.2 loses its acceleration), each only in its row."""
    robot = load_robot(name)
    columns = layout_of(robot)
    base = columns.base
    (m,) = measurements(a_log(robot), None)
    (block,) = RowSource([m], columns)
    for j in range(robot.n):
        for label, signal in (
            (f"Fv{j + 1}", m.motion.dq),
            (f"Fc{j + 1}", torch.sign(m.motion.dq)),
            (f"F0{j + 1}", torch.ones_like(m.motion.dq)),
            (f"Ia{j + 1}", m.motion.ddq),
        ):
            k = base.parameter_names.index(label)
            if k in base.dependent:
                continue
            column = columns.order.index(base.independent.index(k))
            holders = [i for i, c in enumerate(columns.columns) if column in c]
            assert holders == [j]
            got = block.matrices[j][:, columns.columns[j].index(column)]
            assert torch.allclose(got, signal[:, j]), label
    last = [base.names[columns.order[c]] for c in columns.columns[-1]]
    n = robot.n
    assert {f"Fv{n}", f"Fc{n}", f"F0{n}", f"Ia{n}"} <= set(last)
    assert any(f"J{n}zz" in name for name in last)


def test_joints_and_samples_are_not_mixed_up():
    """Each instant's rows belong to the same state: torque is predicted joint by joint."""
    robot = load_robot("kuka_lwr4_friction")
    columns = layout_of(robot)
    log = a_log(robot)
    (m,) = measurements(log, None)
    source = RowSource([m], columns)
    base = columns.base
    generator = torch.Generator().manual_seed(2)
    full = torch.randn(len(base.parameter_names), generator=generator, dtype=torch.float64)
    x = base.project(full)[list(columns.order)]
    (block,) = source
    fitted = block.tau - block.residual(columns, x)
    expected = (stacked_regressor(robot, columns.effects, m.motion) @ full).reshape(-1, robot.n)
    still = m.motion.dq == 0
    expected[still] = fitted[still]  # sharp sign against the held direction
    assert relative(fitted, expected) < 1e-10


def test_links_before_a_joint_do_not_enter_its_row():
    columns = layout_of(load_robot("kuka_lwr4"))
    sizes = [len(c) for c in columns.columns]
    assert sorted(columns.order) == list(range(columns.size))
    assert sizes[0] < columns.size
    for i, pairs in enumerate(columns.rigid):
        assert all(link >= i for link, _ in pairs)
    assert sorted(set().union(*columns.columns)) == list(range(columns.size))


def test_a_layout_without_effects_and_noise_that_is_not_filtered_away():
    robot = load_robot("3r")
    columns = layout_of(robot, ())
    (m,) = measurements(a_log(robot, noise=HonestNoise(torque_relative=0.2)), 4.0)
    a, tau, _, _ = collected(RowSource([m], columns))
    dense, dense_tau = dense_rows(m, columns)
    assert relative(a, dense) < 1e-5
    assert relative(tau, dense_tau) < 1e-5
    assert all(own == () for own in columns.own)


def test_the_shortest_usable_trajectory():
    robot = load_robot("3r_friction")
    (m,) = measurements(a_log(robot).select(slice(300, 300 + 2 * 20 + 10)), 5.0)
    columns = layout_of(robot)
    source = RowSource([m], columns)
    a, _, _, _ = collected(source)
    assert len(a) == source.instants == 5
    assert relative(a, dense_rows(m, columns)[0]) < 3e-3


def test_smooth_columns_at_fewer_samples_are_those_at_all(monkeypatch):
    robot = load_robot("kuka_lwr4_friction")
    columns = layout_of(robot)
    found = measurements(a_log(robot, rates=(1000.0,), durations=(6.0,)), 10.0)
    assert {every for _, _, every in rows_module._pieces(found[0])} == {1, 5}
    thin = collected(RowSource(found, columns))
    monkeypatch.setattr(rows_module, "SMOOTH", float("inf"))
    full = collected(RowSource(found, columns))
    assert {every for _, _, every in rows_module._pieces(found[0])} == {1}
    for a, b in zip(thin, full, strict=True):
        assert a.shape == b.shape
        size = b.double().abs().amax(0)
        assert bool(((a.double() - b.double()).abs() <= 1e-7 * size + 1e-12).all())


def moving_at(*dq: torch.Tensor) -> Measurement:
    """A trajectory of joints of these velocities, with the sign of the last one that was not 0."""
    rates = torch.stack(dq, 1)
    motion = Motion(0 * rates, rates, 0 * rates, direction=direction(rates, torch.zeros(len(dq))))
    t = torch.arange(len(rates), dtype=torch.float64) / 1000
    return Measurement("drawn", 1000.0, None, t, motion, 0 * rates)


@pytest.mark.parametrize("acceleration", [0.02, 0.5, 30.0])
def test_a_joint_that_turns_keeps_its_direction(acceleration):
    """However slowly: only its speed's course tells a turn from a rest."""
    turning = moving_at(acceleration * torch.linspace(-1.0, 1.0, 4001, dtype=torch.float64))
    assert torch.equal(at_ease(turning).motion.direction, turning.motion.sign)


def test_a_joint_that_stops_has_half_the_direction_from_which_it_came():
    """It stands still, runs, stops beside a joint that does not, and runs on, with noise of
    velocity; and the same the other way."""
    t = torch.arange(6000, dtype=torch.float64) / 1000
    runs = 0.2 * ((t > 1) & (t < 2)) + 0.1 * (t > 4)
    noise = 1e-3 * torch.randn(6000, generator=torch.Generator().manual_seed(0)).double()
    for way in (1.0, -1.0):
        before = moving_at(way * (runs + noise), torch.cos(t))
        after = at_ease(before).motion.direction
        expected = torch.where(runs > 0, 1.0, 0.5 * (t > 1)) * way
        assert torch.equal(after[:, 0], expected)
        assert torch.equal(after[:, 1], before.motion.sign[:, 1])
        assert torch.equal(at_ease(at_ease(before)).motion.direction, after)


def test_without_a_direction_the_log_is_taken_at_its_word():
    still = moving_at(torch.zeros(5, dtype=torch.float64))
    still = replace(still, motion=still.motion._replace(direction=None))
    assert at_ease(still) is still
