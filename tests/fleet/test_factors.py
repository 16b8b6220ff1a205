"""Factors say the same as all rows, in any order and however they are put together."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fleet.simulated import Plan, make
from torchid.design.motion import measurements
from torchid.fleet.factors import (
    combined,
    estimate,
    in_stretches,
    reduce_log,
    solved,
    tree,
)
from torchid.fleet.model import FleetModel
from torchid.fleet.reading import stretches
from torchid.fleet.settings import FleetSettings
from torchid.identification.identify import identify
from torchid.identification.least_squares import combined_factor
from torchid.identification.logs import prepared
from torchid.identification.rows import RowSource
from torchid.identification.settings import Settings
from torchid.log.readers import read_log
from torchid.log.table import Request
from torchid.robot.library import load_robot

EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")


@pytest.fixture(scope="module")
def model() -> FleetModel:
    return FleetModel(load_robot("3r_friction"), FleetSettings(effects=EFFECTS))


@pytest.fixture(scope="module")
def logs(model, tmp_path_factory):
    place = tmp_path_factory.mktemp("fleet")
    return [log.path for log in make(model.robot, Plan(units=3, sessions=1), place)]


@pytest.fixture(scope="module")
def reduced(model, logs):
    return [reduce_log(model, stretches(path, Request())) for path in paths(logs)]


def paths(logs):
    from pathlib import Path

    return [Path(log) for log in logs]


def rows_of(model, paths):
    """All kept rows (R, B + 1) of [columns | torque] per joint, in the layout's order."""
    out = [[] for _ in range(model.robot.n)]
    for path in paths:
        even, _ = prepared(read_log(path), model.robot)
        speed = torch.full((model.robot.n,), model.settings.reversal, dtype=torch.float64)
        measured = measurements(even, model.settings.cutoff, speed)
        for block in RowSource(measured, model.layout, moving_only=True):
            for i, (a, c) in enumerate(zip(block.augmented, model.layout.columns, strict=True)):
                dense = a.new_zeros(len(a), model.layout.size + 1)
                dense[:, [*c, model.layout.size]] = a
                out[i].append(dense[block.keep[:, i]])
    return [torch.cat(part) for part in out]


def positive(r):
    return r * torch.where(r.diagonal() < 0, -1.0, 1.0).to(r).unsqueeze(-1)


def distance(a, b):
    """Of two factors, as of their normal equations with columns of length one: a joint's own rows
    do not tell all columns apart, and its factor is not unique then."""
    size = torch.linalg.vector_norm(b, dim=0)
    size = torch.where(size > 0, size, 1.0)
    return float(((a / size).T @ (a / size) - (b / size).T @ (b / size)).abs().max())


def test_the_factor_of_a_fleet_is_that_of_all_its_rows(model, logs, reduced) -> None:
    whole = tree([r.factors.whole for r in reduced], combined)
    rows = rows_of(model, paths(logs))
    assert whole.rows[0].tolist() == [len(r) for r in rows]
    # All joints together tell all columns apart, and R is unique.
    c, size = model.layout.columns, model.layout.size
    own = combined_factor([r[0] for r in whole.blocks], c, size)
    dense = positive(torch.linalg.qr(torch.cat(rows), mode="r").R)
    assert float((own - dense).abs().max() / dense.abs().max()) < 1e-12
    found = solved(whole, model.layout)
    stacked = torch.cat([r / s for r, s in zip(rows, found.noise.tolist(), strict=True)])
    x = torch.linalg.lstsq(stacked[:, :-1], stacked[:, -1:]).solution[:, 0]
    # The weights are those of the round before.
    assert float((found.x - x).norm() / x.norm()) < 1e-3


def test_the_factor_agrees_with_dask(model, logs, reduced) -> None:
    array = pytest.importorskip("dask.array")
    whole = tree([r.factors.whole for r in reduced], combined)
    for i, rows in enumerate(rows_of(model, paths(logs))):
        own = [*model.layout.columns[i], model.layout.size]
        _, r = array.linalg.tsqr(array.from_array(rows[:, own].numpy(), chunks=(400, len(own))))
        r = torch.from_numpy(r.compute(scheduler="synchronous"))
        assert distance(whole.blocks[i][0], r) < 1e-12


def test_an_order_of_the_number_alone() -> None:
    def pair(a, b):
        return f"({a}{b})"

    assert tree("a", pair) == "a"
    assert tree("abcd", pair) == "((ab)(cd))"
    assert tree(iter("abcdefg"), pair) == "(((ab)(cd))((ef)g))"


def test_a_session_is_fitted_as_identify_fits_it(model, logs) -> None:
    model = FleetModel(model.robot, FleetSettings(effects=EFFECTS, reversal=0.0))
    found = estimate(reduce_log(model, stretches(paths(logs)[0], Request())).factors, model)
    settings = Settings(effects=EFFECTS, cutoff=10.0, reversal=0.0, method="wls", signs="free")
    ours = identify(model.robot, read_log(logs[0]), settings=settings)
    assert found.values.isfinite().all()
    scale = ours.std
    assert float(((found.values - ours.values) / scale).abs().max()) < 0.2
    # Other blocks, so other standard deviations, of the same size.
    assert 0.7 < float((found.std / ours.std).median()) < 1.4


def test_fewer_blocks_hold_the_same_rows(model, reduced) -> None:
    factors = reduced[0].factors
    few = factors.fewer(7)
    assert len(few.rows) == 7
    assert torch.equal(few.rows.sum(0), factors.rows.sum(0))
    a, b = solved(few, model.layout).x, solved(factors, model.layout).x
    assert torch.allclose(a, b, rtol=1e-9)


def test_kept_factors_have_the_same_bits_in_half_the_room(reduced) -> None:
    factors = reduced[0].factors
    kept = pickle.dumps(factors)
    again = pickle.loads(kept)
    assert len(kept) < 0.7 * 8 * sum(r.numel() for r in factors.blocks)
    assert torch.equal(again.rows, factors.rows)
    assert all(map(torch.equal, again.blocks, factors.blocks))


def test_a_joint_at_rest_is_left_out_and_said(model, logs) -> None:
    """Without motion of joint 3 nothing tells its friction, nor what only shows there."""
    log = read_log(logs[0])
    q = log.q.clone()
    q[:, 2] = 0.3
    assert log.tau is not None
    found = reduce_log(model, in_stretches(replace(log, q=q, dq=None)))
    got = estimate(found.factors, model)
    names = model.layout.base.names
    assert bool(got.values[names.index("Fv3")].isnan())
    assert bool(got.values[names.index("Fv1")].isfinite())
    assert bool(got.noise[2].isnan())


def test_a_long_file_comes_in_parts(model, logs, tmp_path, monkeypatch) -> None:
    """Row groups of a file that is longer than a part are read one after another."""
    whole = read_log(logs[0])
    monkeypatch.setattr("torchid.fleet.reading.PART", 400)
    parts = list(stretches(paths(logs)[0], Request()))
    assert len(parts) == round(whole.samples / 400)
    assert torch.equal(torch.cat([p.q for p in parts]), whole.q)
    assert max(p.samples for p in parts) - min(p.samples for p in parts) <= len(parts)
    apart = reduce_log(model, iter(parts))
    together = reduce_log(model, in_stretches(whole))
    a, b = (estimate(r.factors, model) for r in (apart, together))
    assert float(((a.values - b.values) / b.std).abs().max()) < 2
    assert np.isclose(apart.seconds, together.seconds)
