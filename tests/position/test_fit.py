"""Servos are found again from what they commanded and where the arm went."""

import math
from dataclasses import replace

import pytest
import torch

from tests.marks import quick_first
from tests.position.planted import DT, planted, robot, true_servos
from torchid.effects.servo import INDEX, PARAMETERS
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.position.data import prepare
from torchid.position.equal import pooled
from torchid.position.file_servos import changes_of
from torchid.position.fit import (
    bounded_step,
    errors,
    fit,
    giving_way,
    loss,
    moved,
    searched,
    sensitivities,
)
from torchid.position.judge import equations, value_interval
from torchid.position.model import ServoArm
from torchid.position.search import plain
from torchid.position.servo_model import Motions
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of


@pytest.fixture(scope="module")
def found():
    servos = true_servos(3)
    data = prepare(robot(), planted(servos))
    windows = windows_of(data.tracks, 2.0)
    return servos, data, windows, plain(Motions(data, windows))


def test_a_plain_servo_is_found_again(found):
    servos, data, windows, model = found
    # Joint 2 carries the arm: gravity tells its torques. Of the others ratios are told.
    assert float(model.servos.of("kp")[1]) == pytest.approx(260.0, rel=0.05)
    for name, share in (("damping", 0.1), ("coulomb", 0.2)):
        got, true = (s.of(name) / s.of("kp") for s in (model.servos, servos))
        assert torch.allclose(got, true, rtol=share), name
    assert torch.allclose(model.servos.of("delay"), servos.of("delay"), atol=DT / 4)
    # What is left is an encoder's count.
    one = Servos(model.servos.joint[None], model.servos.plane[None])
    error = errors(data, one, windows)[..., 0]
    assert float(error.square().mean().sqrt()) < 1e-3


def test_the_truth_is_within_the_intervals(found):
    servos, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    deviation = known.deviations()
    inside = 0
    for k, name in enumerate(known.names):
        for j in range(3):
            value = float(model.servos.of(name)[j])
            low, high = value_interval(name, value, 2 * float(deviation[j, k]))
            inside += low <= float(servos.of(name)[j]) <= high
    assert inside >= 12


def test_covariances_are_of_the_deviations(found):
    _, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    covariances, deviations = known.covariances(), known.deviations()
    assert torch.allclose(covariances.diagonal(dim1=1, dim2=2).sqrt(), deviations)
    unit = 1 / deviations
    correlations = covariances * unit[:, None] * unit[:, :, None]
    assert float(torch.linalg.eigvalsh(correlations).min()) > -1e-9
    # Gain and inertia are told by the same torques.
    k, i = known.names.index("kp"), known.names.index("armature")
    assert float(correlations[:, k, i].min()) > 0.3


def test_what_was_expected_is_left_of_what_motions_do_not_tell(found):
    """Numbers that motions tell are as unsure by it as without; of others as much is left as was
    expected, and how far they are from that."""
    _, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    own, without = (
        x.diagonal(dim1=1, dim2=2).sqrt() for x in (known.expected(), known.covariances())
    )
    k, d = known.names.index("kp"), known.names.index("delay")
    assert torch.allclose(own[:, d], without[:, d], rtol=0.05)
    silent = replace(known, gram=1e-9 * known.gram, pull=1e-9 * known.pull)
    away = silent.away[:, k]
    start = PARAMETERS[INDEX["kp"]].start * data.strength
    assert torch.allclose(away, (model.servos.of("kp") / start).log())
    spread = silent.expected()[:, k, k].sqrt()
    assert torch.allclose(spread, away.hypot(torch.tensor(0.5).double()), rtol=0.02)


def test_shares_of_kp_are_known_where_torques_are_not(found):
    """Of joint 1, that no load anchors: damping over kp, and not the two of them."""
    _, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    k = known.names.index("damping")
    shares = torch.tensor([True, False, False])
    torque, share = known.deviations()[:, k], known.deviations(shares)[:, k]
    assert float(share[0]) < 0.3 * float(torque[0])
    assert torch.allclose(share[1:], torque[1:], rtol=0.05)
    true = math.log(22.0 / 260.0)
    said = math.log(float(model.servos.of("damping")[0] / model.servos.of("kp")[0]))
    assert abs(said - true) < 2.5 * float(share[0])


def test_servos_of_one_type_tell_each_other(found):
    """The joint that no load anchors has the gain of the two that carry the arm; a joint at rest
    and one of another type have their own."""
    _, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    k = known.names.index("kp")
    drawn = pooled(known, ["M1"] * 3, torch.ones(3, dtype=torch.bool))
    kp, was = drawn.servos.of("kp"), model.servos.of("kp")
    # The farthest from the truth is nearer; one that no load anchors may have been near by chance.
    assert float((kp - 260).abs().max()) < 0.5 * float((was - 260).abs().max())
    assert bool((drawn.deviations()[:, k] <= known.deviations()[:, k] + 1e-12).all())
    low, high = value_interval("kp", float(kp[0]), float(drawn.deviations()[0, k]))
    assert low < 260 < high
    # What the motions tell, the share of damping, stays.
    share = drawn.servos.of("damping")[0] / kp[0]
    assert float(share) == pytest.approx(float(model.servos.of("damping")[0] / was[0]), rel=0.1)
    for types, moves in ((["", "M1", "M2"], [1, 1, 1]), (["M1"] * 3, [0, 1, 0])):
        same = pooled(known, types, torch.tensor(moves, dtype=torch.bool)).servos
        assert torch.allclose(same.joint, model.servos.joint)


def test_what_is_new_changed_and_as_known(found):
    """Servos of a file with another gain on joint 2, a clip that is not found, and no delay."""
    servos, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    joint = servos.joint.clone()
    joint[1, INDEX["kp"]], joint[1, INDEX["clip"]], joint[1, INDEX["delay"]] = 130.0, 40.0, 0.0
    start = ServoArm(robot(), Servos(joint, servos.plane), torch.ones(3).double())
    shares = torch.tensor([True, False, False])
    gains, still = start.servos.of("kp"), torch.tensor([False, False, True])
    changes = changes_of(start, gains, known, shares, still)
    states = {(c.joint, c.parameter): c.state for c in changes}
    assert states[1, "kp"] == "changed"
    assert states[1, "clip"] == "open"  # a limit that the log may not have reached
    assert states[1, "delay"] == "new"
    # Inertia of the links tells the scale of the torques of a joint that carries nothing.
    assert states[1, "armature"] == states[0, "damping/kp"] == states[0, "kp"] == "as known"
    assert {j for j, _ in states} == {0, 1}


def test_a_limit_that_the_file_leaves_at_infinity_is_new(found, monkeypatch):
    servos, data, windows, model = found
    joint = model.servos.joint.clone()
    joint[1, INDEX["clip"]] = 6.0
    clipped = torch.tensor([False, True, False])
    limited = replace(model.servos, joint=joint)
    known = equations(data, limited, {**model.free, "clip": clipped}, windows)
    sure = 0.05 * torch.ones_like(known.deviations())  # as of a log that reached it
    monkeypatch.setattr(type(known), "deviations", lambda *_: sure)
    start = ServoArm(robot(), servos, torch.ones(3).double())
    none = torch.tensor([False] * 3)
    assert math.isinf(float(servos.joint[1, INDEX["clip"]]))
    (change,) = [
        c for c in changes_of(start, servos.of("kp"), known, none, none) if c.parameter == "clip"
    ]
    assert (change.joint, change.state, change.now) == (1, "new", 6.0)
    assert math.isnan(change.was)


def test_torques_are_as_sure_as_the_masses(found):
    """Of a joint that carries one link 30 %, of one that carries three less; at shares none."""
    _, data, windows, model = found
    assert float(data.torque_std[2]) == pytest.approx(0.3)
    assert 0.15 < float(data.torque_std[1]) < 0.3
    trusted, file = (
        equations(data, model.servos, model.free, windows, trusted=on) for on in (True, False)
    )
    k = trusted.names.index("kp")
    more = file.deviations()[:, k].square() - trusted.deviations()[:, k].square()
    assert torch.allclose(more, data.torque_std.square())
    shares, d = torch.ones(3, dtype=torch.bool), trusted.names.index("damping")
    both = [one.deviations(shares)[:, d] for one in (trusted, file)]
    assert torch.allclose(*both)


def test_a_slope_is_the_change_of_a_simulation(found):
    """Half the step gives the same slope, for what is smooth."""
    _, data, windows, model = found
    s = sensitivities(data, model.servos, ("kp", "damping"), windows)
    there = searched(model.servos)[None].repeat(2, 1, 1)
    there[1, :, INDEX["kp"]] += 0.01
    error = errors(data, moved(model.servos, there), windows)
    half = (error[..., 1] - error[..., 0]) / 0.01
    assert float((half - s.slope[..., 0]).norm() / half.norm()) < 0.2


def test_losses_of_motions_add_up(found):
    _, data, windows, model = found
    one = Servos(model.servos.joint[None], model.servos.plane[None])
    error = errors(data, one, windows)[..., 0]
    motions = Motions(data, windows)
    parts = motions.each(motions.losses(model.servos))
    assert parts.shape == (6, 3)
    assert torch.allclose(parts.sum(0), error.square().sum((0, 1)), rtol=1e-9)


def test_what_gives_way_makes_up_for_a_number_that_moves(found):
    """A filter on the commands is made up for by less delay, with slopes of where none is."""
    _, data, windows, model = found
    sizes, free = torch.tensor([0.0, 0.01, 0.02], dtype=torch.float64), {**model.free}
    joint = model.servos.joint.repeat(len(sizes), 1, 1)
    joint[:, :, INDEX["lag"]] = sizes[:, None]
    sets = replace(model.servos, joint=joint, plane=model.servos.plane.repeat(len(sizes), 1))
    ways, losses = giving_way(data, model.servos, sets, free, windows)
    assert ways.joint.shape == (9, *model.servos.joint.shape)
    assert torch.equal(ways.joint[:3], joint)
    assert torch.equal(ways.joint[:, :, INDEX["lag"]], sizes.repeat(3)[:, None].expand(-1, 3))
    assert torch.allclose(losses, loss(errors(data, ways, windows), windows))
    held, once, twice = losses.view(3, 3, 3).unbind(1)
    assert bool((once[:, 1:] < 0.5 * held[:, 1:]).all())
    assert bool((twice[:, 1:] < 1.01 * once[:, 1:]).all())
    delay = ways.joint[6:, :, INDEX["delay"]]
    assert bool((delay.diff(dim=0) < 0).all())


def test_a_fit_moves_only_what_is_free(found):
    _, data, windows, model = found
    free = {"kp": torch.tensor([True, False, True])}
    there = searched(model.servos)
    there[:, INDEX["kp"]] += 0.1  # the logarithm; all torques follow
    there[1, INDEX["kp"]] -= 0.1
    off = moved(model.servos, there)
    after = fit(data, off, free, windows, iterations=3)
    assert float(after.of("kp")[1]) == pytest.approx(float(off.of("kp")[1]))
    # Without a load the motions hardly tell kp, but they are followed as well again.
    left = [
        loss(errors(data, Servos(s.joint[None], s.plane[None]), windows), windows)[::2, 0]
        for s in (model.servos, off, after)
    ]
    assert bool((left[1] > left[2]).all()), left
    assert bool((left[2] < 1.01 * left[0]).all()), left
    # Torques keep their shares of kp, all else stays as it is.
    others = [INDEX[name] for name in ("damping", "delay", "coulomb", "offset")]
    a, b = (searched(s)[:, others] for s in (after, off))
    assert torch.allclose(a, b, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda log: log.replace(u=None), "no commands"),
        (lambda log: log.replace(t=log.t + 0.015 * (torch.arange(len(log.t)) % 2)), "evenly"),
        (lambda log: log.select(slice(0, 200)), "too short"),
        (lambda log: log.replace(q=log.q[:, :2], u=log.u[:, :2]), "number of joints"),
        (lambda log: log.replace(u=log.u * torch.tensor(float("nan"))), "begins without commands"),
    ],
)
def test_a_log_that_tells_nothing_is_refused(change, words):
    log = planted(true_servos(3), motions=1, seconds=12.0)
    with pytest.raises(LogError, match=words):
        prepare(robot(), change(log))


@pytest.mark.slow
def test_a_joint_in_another_unit_is_seen():
    """Measured velocities in rad/s tell that a position is a fraction of its range."""
    log = planted(true_servos(3), motions=2)
    dq = torch.zeros_like(log.q)
    dq[1:-1] = (log.q[2:] - log.q[:-2]) / (2 * DT)
    share = torch.tensor([1.0, 1.0, 0.4], dtype=torch.float64)
    data = prepare(robot(), log.replace(q=log.q * share, u=log.u * share, dq=dq))
    assert data.scale[:2].tolist() == [1.0, 1.0]
    assert float(data.scale[2]) == pytest.approx(2.5, rel=0.02)


@pytest.mark.slow
def test_a_joint_at_rest_leaves_the_others_to_be_found():
    log = planted(true_servos(3), motions=2, seconds=6.0)
    q, u = log.q.clone(), log.u.clone()
    q[:, 1] = u[:, 1] = 0.3
    data = prepare(robot(), log.replace(q=q, u=u, dq=None))
    free = {"kp": torch.ones(3, dtype=torch.bool)}
    stuck = true_servos(3, coulomb=(2, 500.0))
    servos = fit(data, stuck, free, windows_of(data.tracks, 2.0), iterations=1)
    assert torch.isfinite(servos.joint[:, INDEX["kp"]]).all()


MOTIONS = [(str(k), 16.0) for k in range(6)]


def test_motions_of_one_servo_agree(found):
    _, data, windows, model = found
    known = equations(data, model.servos, model.free, windows)
    again = known.replication("kp", 1, MOTIONS)
    assert (again.repeats, again.asked) == (6, 6)
    assert again.spread < 0.05


@pytest.mark.nightly
def test_every_motion_wants_what_moved_it():
    """Another offset in every second motion: by the motions' factors each of them has its own."""
    both = [planted(true_servos(3, offset=(2, value))) for value in (2.0, 4.0)]
    log = Log.concatenate([list(both[k % 2].trajectories())[k] for k in range(6)])
    data = prepare(robot(), log)
    windows = windows_of(data.tracks, 2.0)
    model = plain(Motions(data, windows))
    known = equations(data, model.servos, model.free, windows)
    again = known.replication("offset", 1, MOTIONS)
    fitted = float(model.servos.of("offset")[1])
    wanted, std = (
        fitted * torch.tensor([getattr(m, name) for m in again.motions])
        for name in ("scale", "std")
    )
    # Each as near as it is said to be known, and those of 2.0 below those of 4.0 about them.
    assert bool(((wanted - torch.tensor([2.0, 4.0] * 3)).abs() < std).all())
    assert wanted.mean() == pytest.approx(3.0, rel=0.1)
    low, high = wanted[::2], wanted[1::2]
    assert float(low.max()) < 0.85 * float(high.min())
    # Motions disagree on other numbers, too, so that each could be wrong by as much.
    assert known.beyond_noise > 1
    assert all(m.std > 0.2 for m in again.motions)


@pytest.mark.parametrize(
    ("delay", "kd"), quick_first([(0.05, 40.0), (0.08, 25.0)], 1, several=True)
)
def test_a_derivative_gain_is_found_beside_a_delay(delay, kd):
    """From servos without it, of which it makes up for the delay."""
    servos = true_servos(3, kd=(2, kd))
    servos.joint[1, INDEX["delay"]] = delay
    data = prepare(robot(), planted(servos, motions=3, seconds=10.0))
    windows = windows_of(data.tracks, 2.0)
    begun = plain(Motions(data, windows))
    on = torch.tensor([False, True, False])
    joint = begun.servos.joint.clone()
    joint[1, INDEX["kd"]] = 0.05 * joint[1, INDEX["kp"]]
    got = fit(
        data, Servos(joint, begun.servos.plane), {**begun.free, "kd": on}, windows, iterations=20
    )
    assert float(got.of("kd")[1]) == pytest.approx(kd, rel=0.02)
    assert float(got.of("delay")[1]) == pytest.approx(delay, abs=0.002)


def test_a_step_ends_at_the_end_of_a_range():
    """As the bounded least squares of SciPy has it."""
    from scipy.optimize import lsq_linear

    g = torch.Generator().manual_seed(0)
    positive = torch.tensor([False, True, False, True])
    for _ in range(20):
        a = torch.randn(1, 12, 4, generator=g, dtype=torch.float64)
        b = torch.randn(1, 12, generator=g, dtype=torch.float64)
        here = torch.rand(1, 4, generator=g, dtype=torch.float64) * positive
        pull = (a * b[..., None]).sum(1)
        step = bounded_step(a.mT @ a, pull, here, positive)
        low = torch.where(positive, -here, -torch.inf)[0]
        best = lsq_linear(a[0].numpy(), -b[0].numpy(), (low.numpy(), torch.inf)).x
        free = -torch.linalg.solve(a.mT @ a, pull)
        if int((positive & (here + free < 0)).sum()) <= 1:
            assert torch.allclose(step[0], torch.from_numpy(best), atol=1e-6)
        assert bool((here + step >= -1e-12)[..., positive].all())
