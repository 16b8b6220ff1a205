"""Sessions add up: what is known of a model counts in its next identification."""

import math
from dataclasses import replace

import pytest
import torch
from scipy.integrate import solve_ivp
from torch.testing import assert_close

import torchid
from tests.marks import quick_first
from torchid.effects.registry import on_every_joint
from torchid.errors import IdentificationError, TorchidError
from torchid.export.dynamics import of_base
from torchid.identification.base_parameters import base_parameters, nominal_values
from torchid.identification.identify import identify
from torchid.identification.knowledge import (
    between_sessions,
    fit_root,
    of_base_parameters,
    over_parameters,
    pooled,
    robust_root,
)
from torchid.identification.payload import payload, with_payload
from torchid.identification.result import Identification
from torchid.identification.settings import Settings
from torchid.identification.values import identified_base, nominal_base
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.yaml_file import from_mapping

ROBOT = load_robot("3r")
EFFECTS = ("viscous_friction", "coulomb_friction")
SETTINGS = Settings(effects=EFFECTS, cutoff=8.0, method="ols")


def session(seed: int, seconds: float = 20.0, noise: float = 0.05, robot: Robot = ROBOT) -> Log:
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(int(100 * seconds), dtype=torch.float64) / 100
    w = 0.8 + 3 * torch.rand(3, generator=g, dtype=torch.float64)
    phase = 6 * torch.rand(3, generator=g, dtype=torch.float64)
    angle = t[:, None] * w + phase
    q, dq, ddq = angle.sin(), w * angle.cos(), -w * w * angle.sin()
    tau = torchid.inverse_dynamics(robot, q, dq, ddq) + 0.5 * dq + 0.3 * torch.sign(dq)
    return Log(t, q, dq=dq, tau=tau + noise * torch.randn(tau.shape, generator=g).double())


def known_after(found: Identification) -> Robot:
    """The robot that an identification is written as."""
    return of_base(ROBOT, identified_base(found)).robot


def test_knowledge_of_links_and_of_base_parameters_are_each_others_inverse() -> None:
    effects = on_every_joint(EFFECTS, 3)
    base = base_parameters(ROBOT, effects, basis="conditioned")
    root = torch.randn(30, len(base), generator=torch.Generator().manual_seed(0)).double()
    known = over_parameters(root, base, effects, "run")
    again = of_base_parameters(known, base, effects)
    assert_close(again.T @ again, root.T @ root, rtol=1e-8, atol=1e-8)


def test_sessions_one_by_one_give_what_all_at_once_give() -> None:
    """Least squares of three sessions: rows all at once, or each session on what was known."""
    g = torch.Generator().manual_seed(1)
    truth = torch.randn(9, generator=g, dtype=torch.float64)
    tables = [torch.randn(40, 9, generator=g, dtype=torch.float64) for _ in range(3)]
    tables[0][:, 4] = 0.0  # the first session does not show the fifth
    targets = [a @ truth + torch.randn(40, generator=g, dtype=torch.float64) for a in tables]
    root, x = tables[0].new_zeros(0, 9), truth.new_zeros(9)
    for a, y in zip(tables, targets, strict=True):
        own = torch.linalg.lstsq(a, y, driver="gelsd").solution
        x, covariance, determined = pooled(root, x, torch.linalg.qr(a, mode="r").R, own)
        root = torch.cat([root, a])
    every = torch.cat(tables)
    assert bool(determined.all())
    assert_close(x, torch.linalg.lstsq(every, torch.cat(targets)).solution, rtol=1e-8, atol=1e-8)
    assert_close(covariance, torch.linalg.inv(every.T @ every), rtol=1e-8, atol=1e-10)


def test_what_no_session_shows_stays_unknown() -> None:
    a = torch.randn(40, 5, generator=torch.Generator().manual_seed(2)).double()
    a[:, 3] = a[:, 2]
    x, covariance, determined = pooled(a[:0], a[0], a, torch.ones(5).double())
    assert determined.tolist() == [True, True, False, False, True]
    assert float(x[2]) == 0.0
    assert float(covariance[3, 3]) == 0.0


def test_a_second_session_knows_more_and_lies_between() -> None:
    first = identify(ROBOT, session(1), settings=SETTINGS)
    alone = identify(ROBOT, session(2), settings=SETTINGS)
    both = identify(known_after(first), session(2), settings=SETTINGS)
    rigid = slice(0, first.base.n_rigid)
    # Surer than either, as far as their own standard deviations are known; and near the truth.
    ratio = (both.std / torch.minimum(first.std, alone.std))[rigid]
    assert float(ratio.min()) < 0.5
    assert float(ratio.max()) < 1.3
    truth = nominal_values(ROBOT, both.base)[rigid]
    off = (both.values[rigid] - truth).abs() / both.std[rigid].clamp(min=1e-12)
    assert float(off.max()) < 4
    assert both.knowledge is not None
    assert len(both.knowledge.sources) == 2


@pytest.mark.slow
def test_results_that_share_a_session_are_said_to(tmp_path) -> None:
    first = identify(ROBOT, session(1), settings=SETTINGS)
    both = identify(known_after(first), session(2), settings=SETTINGS)
    notes = torchid.compare_results([first, both]).notes
    assert any("holds what was known before its log" in note for note in notes)
    assert not any("known before" in n for n in torchid.compare_results([first, first]).notes)


def test_friction_may_change_between_sessions() -> None:
    found = known_after(identify(ROBOT, session(1), settings=SETTINGS))
    assert found.knowledge is not None
    aged = found.knowledge.aged(between_sessions(found, 0.1))
    assert aged.std("viscous_friction Fv1") == pytest.approx(0.05, rel=0.1)
    assert between_sessions(ROBOT) == {}


@pytest.mark.slow
def test_what_is_known_is_written_and_read(tmp_path) -> None:
    found = identify(ROBOT, session(1), settings=SETTINGS)
    found.save(tmp_path / "identification.json")
    torchid.export_dynamics(found, "yaml", tmp_path, nominal=ROBOT)
    robot = load_robot(next(tmp_path.glob("*.yaml")))
    assert robot.knowledge is not None
    assert found.knowledge is not None
    assert_close(robot.knowledge.information, found.knowledge.information)
    read = torchid.load(tmp_path / "identification.json")
    assert read.knowledge.sources == found.knowledge.sources


def test_base_parameters_of_a_model_that_knows_are_as_sure_as_it_is() -> None:
    found = identify(ROBOT, session(1), settings=replace(SETTINGS, basis="report"))
    model = known_after(found)
    own = nominal_base(replace(model, basis="report"))
    assert own.base.names == found.base.names
    assert_close(own.values, found.values, rtol=1e-6, atol=1e-8)
    assert own.covariance is not None
    assert own.factor is not None
    ratio = own.covariance.diagonal().sqrt() / found.std
    assert float(ratio.min()) > 0.9  # fewer blocks than independent samples are never surer
    # The factor is the distance from what is known, which is zero there.
    b = len(own.base)
    left = own.factor[:b, :b] @ own.values - own.factor[:b, b]
    assert float(left.norm()) < 1e-6 * float(own.factor[:b, b].norm())
    assert nominal_base(ROBOT).covariance is None
    problem, _ = torchid.problem_of(
        replace(model, basis="report"), own, loss="one-step", bounds="none"
    )
    assert problem.size > 0


BOX = torch.tensor([1.5, 0.06, 0.0, 0.03, 0.01, 0.0, 0.0, 0.012, 0.0, 0.011], dtype=torch.float64)


@pytest.mark.parametrize("with_empty", quick_first([False, True], 1))
def test_a_payload_is_what_a_known_arm_has_more(with_empty: bool) -> None:
    """What is known is of the arm without payload, and never of that with it."""
    known = known_after(identify(ROBOT, session(1, 40.0), settings=SETTINGS))
    loaded = session(2, 40.0, robot=with_payload(ROBOT, BOX))
    empty = session(3, 40.0) if with_empty else None
    found = payload(known, empty, loaded, settings=SETTINGS)
    mass = found.link.mass
    assert float(mass.low) < 1.5 < float(mass.high)
    assert 3 * float(mass.std) < 1.5
    assert not found.unexplained
    with pytest.raises(TorchidError, match="without payload is not known"):
        payload(ROBOT, None, loaded, settings=SETTINGS)


def test_blocks_that_agree_by_chance_know_no_more_than_independent_samples() -> None:
    g = torch.Generator().manual_seed(3)
    table = torch.randn(400, 4, generator=g, dtype=torch.float64)
    block = torch.arange(400) // 100
    root = robust_root(table, torch.zeros(400, dtype=torch.float64), block)
    assert_close(root.T @ root, table.T @ table, rtol=1e-8, atol=1e-8)
    # Noise that is alike within a block tells less.
    slow = torch.randn(4, generator=g, dtype=torch.float64)[block]
    table[:, 0] = 1.0
    root = robust_root(table, slow, block)
    assert float((root.T @ root)[0, 0]) < 0.2 * 400


def test_a_fit_that_few_blocks_tell_of_is_wider() -> None:
    a = torch.randn(100, 3, generator=torch.Generator().manual_seed(4)).double()
    factor = torch.linalg.qr(torch.cat([a, a[:, :1]], 1), mode="r").R
    white = torch.linalg.inv(a.T @ a)
    factor[-1, -1] = 97.0**0.5  # rows of unit variance
    narrow, wide = (fit_root(white, factor, 100.0, 1.0, w) for w in (1.0, 2.0))
    assert_close(narrow.T @ narrow, a.T @ a, rtol=1e-6, atol=1e-6)
    assert_close(wide.T @ wide, a.T @ a / 4, rtol=1e-6, atol=1e-6)


def standing(seed: int = 0) -> Log:
    """The 3R at rest, but for three seconds in which two joints move by some centimetres."""
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(4000, dtype=torch.float64) / 100
    q = torch.tensor([0.1, 0.4, -0.9], dtype=torch.float64).repeat(4000, 1)
    moves = ((t > 10) & (t < 13)).double()
    q[:, 2] += 0.05 * torch.sin(3 * (t - 10)) * moves
    q = q + 1e-5 * torch.randn(q.shape, generator=g, dtype=torch.float64)
    tau = torchid.inverse_dynamics(ROBOT, q, 0 * q, 0 * q)
    return Log(t, q, tau=tau + 0.05 * torch.randn(q.shape, generator=g, dtype=torch.float64))


@pytest.mark.nightly
def test_a_model_that_is_worse_than_none_is_refused() -> None:
    with pytest.raises(IdentificationError, match="worse than zero") as refused:
        identify(ROBOT, standing())
    assert "joints 1, 2 hardly move" in str(refused.value)
    shown = identify(ROBOT, standing(), settings=replace(Settings(), force=True))
    assert float(shown.fit.relative_percent.max()) > 100


def test_a_free_swing_has_numbers_and_how_little_they_are_known() -> None:
    """Of noise beside gravity and inertia, which cancel: no refusal, for an interval says it."""
    inertia, moment = 0.2, 0.4
    robot = from_mapping(
        {
            "name": "swing",
            "dh": {"convention": "modified", "joints": [{"a": 0.0, "alpha": 0.0, "d": 0.0}]},
            "gravity": [9.81, 0, 0],
        },
        "swing.yaml",
    )
    t = torch.arange(2000, dtype=torch.float64) / 200
    swing = solve_ivp(
        lambda _, y: (y[1], -moment * 9.81 / inertia * math.sin(y[0])),
        (0, 10), (2.0, 0.0), t_eval=t.numpy(), rtol=1e-9,
    )  # fmt: skip
    q, dq = torch.from_numpy(swing.y).unsqueeze(-1)
    noise = torch.randn(2, len(t), 1, generator=torch.Generator().manual_seed(5)).double()
    log = Log(t, q + 1e-3 * noise[0], dq=dq, tau=0.05 * noise[1])
    found = identify(robot, log, settings=replace(SETTINGS, cutoff="auto"))
    true = torch.tensor([moment, 0.0, inertia, 0.0, 0.0], dtype=torch.float64)
    assert bool(((found.values - true).abs() < 3 * found.std).all())
    assert float(found.values[0]) < 2 * float(found.std[0])
    assert any("free swing" in w for w in found.warnings)
