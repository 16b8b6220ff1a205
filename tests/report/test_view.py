"""A diagnosis over time: files read back by other programs' readers, sums, and known torques."""

import json
from dataclasses import replace

import pytest
import torch

from torchid.errors import MissingExtraError, TorchidError
from torchid.excitation.synthetic import simulate
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.describe.where import regime_instants
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.report.view import joint_views, require_viewer, write_view
from torchid.robot.library import load_robot

FRICTION = (
    {"effect": "viscous_friction", "joint": 2, "Fv": 0.5},
    {"effect": "coulomb_friction", "joint": 3, "Fc": 0.2},
)
LATER = 100.0
"""When the log begins [s]."""


@pytest.fixture(scope="module")
def found():
    """Two trajectories of the 3R with friction that the model lacks."""
    robot = load_robot("3r")
    motion = trajectory_log(random_trajectory(robot, 3, count=2, duration=10.0, fill=True), 200.0)
    real = simulate(robot, replace(motion, t=motion.t + LATER), effects=FRICTION, seed=1)
    names = tuple(str(f["effect"]) for f in FRICTION)
    return diagnose_torque(robot, real, settings=GapSettings(effects=names))


@pytest.mark.nightly
def test_parts_add_up_and_are_the_planted_ones(found):
    views = joint_views(found)
    assert len(views) == 2 * 3
    assert {v.joint for v in views} == set(found.robot.joint_names)
    for view in views:
        total = view.predicted + sum(view.effects.values()) + view.residual
        torch.testing.assert_close(total, view.measured, rtol=0, atol=1e-12)
        assert view.unit == "N m"
        assert bool((view.t.diff() > 0).all())
        assert float(view.t[0]) > LATER
        # All but the effects is small: the model's other parameters were right.
        size = view.measured.std()
        assert float(view.effects.get("refit", torch.zeros(1)).abs().max()) < 0.02 * size
        assert float(view.residual.std()) < 0.05 * size
        assert "parameters" not in view.effects
    for view in views[1::3]:
        torch.testing.assert_close(
            view.effects["viscous_friction"], 0.5 * view.dq, rtol=0.05, atol=0.02
        )
    for view in views[2::3]:
        # Between reversals the low-passed sign is the sign.
        sliding = view.dq.abs() > 0.5 * view.dq.abs().max()
        expected = 0.2 * view.dq.sign()
        error = (view.effects["coulomb_friction"] - expected)[sliding]
        assert float(error.abs().median()) < 0.01
    clear = {r.regime for r in found.regimes if r.p < 0.05 and r.excess > 0}
    # Periods and bands of frequency are no parts of the time.
    clear -= {"position_periodic", "high_frequency", "slow_drift"}
    assert {name for view in views for name in view.regimes} == clear
    for view in views:
        for mask in view.regimes.values():
            assert mask.dtype == torch.bool


@pytest.mark.slow
def test_regimes_are_where_the_motion_says(found):
    """Low speed: below 15 % of the speed that 1 % of all instants exceed."""
    speed = torch.cat([t.motion.dq[t.valid] for t in found.traces]).abs()
    low = 0.15 * speed.quantile(0.99, 0)
    for trace, regimes in zip(found.traces, regime_instants(found.traces, found.band), strict=True):
        mask = regimes["slow"]
        assert not bool(mask[~trace.valid][0].any())
        own = trace.motion.dq.abs() < low
        assert float((mask == own)[trace.valid].double().mean()) > 0.97


@pytest.mark.slow
def test_an_mcap_is_read_back_by_its_own_reader(found, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "gap.mcap"
    write_view(found, path)
    views = joint_views(found)
    told: dict[str, list] = {}
    with path.open("rb") as stream:
        opened = reader.make_reader(stream, validate_crcs=True)
        for schema, channel, message in opened.iter_messages(log_time_order=False):
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            told.setdefault(channel.topic, []).append((message, json.loads(schema.data)))
    assert len(told) == len(views)
    for view, (topic, messages) in zip(views, told.items(), strict=True):
        assert topic.endswith(f"/{view.joint}")
        assert len(messages) == len(view.t)
        for k, (message, schema) in enumerate(messages):
            data = json.loads(message.data)
            assert message.log_time == round(1e9 * float(view.t[k]))
            parts = data["predicted"] + sum(data["effects"].values()) + data["residual"]
            assert parts == pytest.approx(data["measured"], abs=1e-12)
            assert data["measured"] == float(view.measured[k])
            assert data["regimes"] == {name: bool(x[k]) for name, x in view.regimes.items()}
            if k == 0:
                assert set(schema["properties"]) == set(data)
                told_of = schema["properties"]["effects"]["properties"]
                assert told_of.keys() == data["effects"].keys()


@pytest.mark.slow
def test_other_files_and_missing_packages(found, tmp_path, monkeypatch):
    with pytest.raises(TorchidError, match=r"FILE\.mcap"):
        write_view(found, tmp_path / "gap.bag")
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    with pytest.raises(MissingExtraError, match=r"torchid\[view\]"):
        require_viewer(tmp_path / "gap.mcap")
    assert list(tmp_path.iterdir()) == []
