"""Columns of candidates against effects filtered by hand, and against the model's own torque."""

import pytest
import torch

from tests.gap.motions import ROBOT, motion_at, passage_of, times
from tests.gap.problems import random
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, Motion
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.registry import KINDS, model_torque
from torchid.effects.transient import Contact
from torchid.gap.bank import composite, rescaled
from torchid.gap.candidates import Evaluator, all_banks, best_windows
from torchid.gap.passages import Rows
from torchid.log.filtering import ZeroPhaseFilter
from torchid.typing import Tensor

CUTOFF = 8.0
SCALE = torch.tensor([0.5, 2.0, 7.0], dtype=torch.float64)
MODEL = [(ViscousFriction(0), [0.3]), (CoulombFriction(2), [0.2])]


def evaluator_of(lengths: tuple[float, ...]) -> Evaluator:
    """Of passages of the 3R with friction."""
    parts = []
    for k, seconds in enumerate(lengths):
        m = motion_at(times(seconds), seed=k)
        age = 0.01 * (random(*m.q.shape, seed=k) > 1.5)
        m = m._replace(t=m.t + 20 * k, age=age.double())
        parts.append(passage_of(m, model_torque(ROBOT, MODEL, m), f"run{k}"))
    return Evaluator(ROBOT, MODEL, Rows(parts, CUTOFF), lambda x, j: x * SCALE[j])


@pytest.fixture(scope="module")
def evaluator() -> Evaluator:
    return evaluator_of((8.0, 8.0))


def by_hand(evaluator: Evaluator, effect: Effect) -> Tensor:
    """(C, n, N): torque of the one effect, taken to rows like any signal, divided by noise."""
    rows = evaluator.rows
    signals = []
    for p in rows.passages:
        motion = p.motion._replace(torque=model_torque(ROBOT, MODEL, p.motion))
        low = ZeroPhaseFilter(p.rate, CUTOFF)
        if effect.smooth:
            smooth = {k: low.apply(getattr(motion, k).T).T for k in ("q", "dq", "ddq", "torque")}
            motion = motion._replace(**smooth)
        signals.append(effect.torque_columns(motion, ROBOT).permute(2, 1, 0).contiguous())
    return rows.apply(signals) * SCALE.unsqueeze(-1)


def test_rows_are_filtered_and_decimated_signals(evaluator):
    """A signal of which the filter leaves nothing beyond half the rows' rate; to a thousandth, as
    the ends of the record ring."""
    rows = evaluator.rows
    signals = [p.motion.q.T for p in rows.passages]
    low = ZeroPhaseFilter(rows.rate, CUTOFF)
    expected = [low.apply(x)[:, rows.edge : x.shape[1] - rows.edge : rows.step] for x in signals]
    found = rows.apply(signals)
    assert found.shape == (ROBOT.n, len(rows))
    assert torch.allclose(found, torch.cat(expected, -1), atol=2e-3 * float(found.abs().max()))
    picked = rows.pick([p.motion.q for p in rows.passages])
    assert torch.allclose(picked.T, found, atol=1e-2 * float(found.abs().max()))


def stacked(columns: Tensor, place: int | None) -> Tensor:
    """(C, n, N) with the rows of other joints at zero."""
    if place is None:
        return columns.reshape(len(columns), ROBOT.n, -1)
    out = torch.zeros(len(columns), ROBOT.n, columns.shape[-1], dtype=torch.float64)
    out[:, place] = columns
    return out


def close(a: Tensor, b: Tensor) -> bool:
    return torch.allclose(a, b, rtol=1e-6, atol=1e-9 * max(1e-6, float(b.abs().max())))


@pytest.mark.parametrize("name", KINDS)
def test_columns_are_the_filtered_torque_of_the_effect(evaluator, name):
    """Every place and some shapes of every effect: as a member of its bank, and on its own."""
    if name == "contact":
        banks = [evaluator.contact_bank(evaluator.residual())]
    else:
        banks = list(all_banks(evaluator, [name], own_velocity=True, age=True))
    assert banks
    for bank in banks:
        shared = len(bank.members[0]) > 1
        for k in range(0, len(bank.members), max(1, len(bank.members) // 3)):
            expected = sum(by_hand(evaluator, e) for e in bank.members[k])
            assert close(stacked(bank.columns[k], bank.place), expected), (name, k)
        if not shared:
            place, columns = evaluator.columns(bank.members[-1][0])
            assert close(stacked(columns, place), by_hand(evaluator, bank.members[-1][0]))
        again = evaluator.renewed(bank) if name != "contact" else bank
        assert torch.allclose(again.columns, bank.columns, atol=1e-12)
        assert len(bank.coefficients) == bank.columns.shape[1] == bank.size
        assert len(bank.members) == bank.columns.shape[0]


@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize("name", ["coulomb_friction", "base_tilt", "backlash", "cogging"])
def test_passages_may_differ_in_length(name):
    uneven = evaluator_of((9.0, 5.0))
    assert len(uneven.rows) == uneven.rows.bounds[-1].stop
    for bank in all_banks(uneven, [name], own_velocity=True, age=True):
        expected = by_hand(uneven, bank.members[0][0])
        assert close(stacked(bank.columns[0], bank.place), expected)


def test_effects_that_the_log_cannot_show_are_left_out(evaluator):
    for name in KINDS:
        missing = KINDS[name].needs & {"velocity", "age"}
        if missing:
            assert not list(all_banks(evaluator, [name], own_velocity=False, age=False))


def test_the_residual_is_the_torque_that_the_model_lacks(evaluator):
    assert float(evaluator.residual().abs().max()) < 1e-10
    bare = evaluator.with_model(ROBOT, ())
    expected = sum(v[0] * by_hand(evaluator, e)[0] for e, v in MODEL)
    assert close(bare.residual(), expected)


def test_rigid_columns_times_parameters_are_the_rigid_torque(evaluator):
    pi = ROBOT.require_parameters("a test").pi
    bank = evaluator.rigid_bank("all", (), range(30))
    torque = evaluator.on_all(
        [inverse_dynamics(ROBOT, *p.motion.state).T for p in evaluator.rows.passages]
    )
    assert close(pi.flatten() @ bank.columns[0], torque.flatten())
    link = evaluator.rigid_bank("link", (), range(10, 20))
    assert torch.equal(link.columns[0], bank.columns[0, 10:20])


def test_the_regressor_of_another_model_is_its_own(evaluator):
    """It may be shared only where it is the same: not where gravity is another."""
    from dataclasses import replace

    tilted = replace(ROBOT, gravity=torch.tensor([1.0, 0.0, -9.7]))
    one = evaluator.with_model(tilted, ()).rigid_bank("all", (), range(30))
    two = Evaluator(tilted, (), evaluator.rows, evaluator.whiten).rigid_bank("all", (), range(30))
    assert torch.equal(one.columns, two.columns)
    assert not torch.allclose(one.columns, evaluator.rigid_bank("all", (), range(30)).columns)


def test_rescaled_rows_are_those_of_other_noise(evaluator):
    factor = torch.tensor([2.0, 0.1, 5.0])
    other = evaluator.with_whitener(lambda x, j: x * SCALE[j] * factor[j])
    for name in ("coulomb_friction", "base_tilt", "cogging"):
        both = [
            list(all_banks(e, [name], own_velocity=False, age=False)) for e in (evaluator, other)
        ]
        for bank, expected in zip(*both, strict=True):
            assert torch.allclose(rescaled(bank, factor).columns, expected.columns, rtol=1e-12)
    rigid = rescaled(evaluator.rigid_bank("all", (), range(30)), factor)
    assert torch.allclose(rigid.columns, other.rigid_bank("all", (), range(30)).columns)


def test_a_composite_holds_its_parts(evaluator):
    names = ["coulomb_friction", "viscous_friction"]
    parts = [b for b in all_banks(evaluator, names, own_velocity=False, age=False) if b.place == 1]
    both = composite("both", parts)
    assert torch.equal(both.columns, torch.cat([b.columns for b in parts], 1))
    assert [e.name for e in both.members[0]] == names
    assert both.size == 2


@pytest.mark.parametrize(("first", "last"), [(40, 64), (250, 262), (300, 348)])
def test_the_window_that_was_planted_is_found(first, last):
    """Overlapping half of its length at least, within its own trajectory."""
    bounds = (slice(0, 230), slice(230, 500))
    columns = random(3, ROBOT.n, 500, seed=0)
    r = random(ROBOT.n, 500, seed=1)
    r[:, first:last] += torch.einsum("c,cnt->nt", torch.tensor([2.0, -1.0, 3.0]), columns)[
        :, first:last
    ]
    windows = best_windows(columns, r, bounds)
    a, b = windows[0]
    assert min(b, last) - max(a, first) >= 0.5 * max(b - a, last - first)
    own = next(s for s in bounds if s.start <= first < s.stop)
    assert own.start <= a < b <= own.stop
    assert all(any(s.start <= a < b <= s.stop for s in bounds) for a, b in windows)


def test_contact_windows_close_in_on_the_contact():
    """A force at the tool in one second of twenty; the best of the bank, then of finer ones."""
    m = motion_at(times(20.0), seed=3)
    truth = Contact(9.3, 10.4)
    force = truth.torque_columns(m, ROBOT) @ torch.tensor([4.0, -3.0, 5.0])
    m = m._replace(t=m.t)
    rows = Rows([passage_of(m, inverse_dynamics(ROBOT, *m.state) + force)], CUTOFF)
    evaluator = Evaluator(ROBOT, (), rows, lambda x, j: 100 * x)
    r = evaluator.residual().flatten()

    def best(bank):
        left = [
            float(
                (r - torch.linalg.lstsq(c.T, r[:, None], driver="gelsd").solution[:, 0] @ c)
                .square()
                .sum()
            )
            for c in bank.columns
        ]
        k = min(range(len(left)), key=left.__getitem__)
        return bank.members[k][0], left[k]

    found, first = best(evaluator.contact_bank(evaluator.residual()))
    for level in range(5):
        found, left = best(evaluator.around(found, level))
    assert left < 0.3 * first
    assert found.start == pytest.approx(9.3, abs=0.25)
    assert found.stop == pytest.approx(10.4, abs=0.25)


def test_grids_are_in_units_of_the_motion(evaluator):
    kind = KINDS["stribeck_friction"]
    for joint in range(ROBOT.n):
        speed = torch.cat([p.motion.dq[:, joint] for p in evaluator.rows.passages]).abs()
        fast = float(speed.quantile(0.99))
        grid = evaluator.grid(kind, joint)
        column = [s.name for s in kind.shapes].index("vs")
        shape = kind.shapes[column]
        assert shape.scale == "speed"
        expected = torch.tensor(sorted({v * fast for v in shape.grid}))
        assert torch.allclose(grid[:, column].unique(), expected, rtol=0.02)


def test_a_joint_that_never_moves_has_no_ripple():
    m = motion_at(times(8.0), seed=0)
    still = torch.tensor([1.0, 0.0, 1.0])
    m = Motion(m.q * still, m.dq * still, m.ddq * still, t=m.t)
    evaluator = Evaluator(ROBOT, (), Rows([passage_of(m)], CUTOFF), lambda x, j: x)
    banks = list(all_banks(evaluator, ["cogging"], own_velocity=False, age=False))
    assert [b.place for b in banks] == [0, 2]
