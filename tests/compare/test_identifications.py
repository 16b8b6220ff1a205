"""Whole comparisons: level, power, and what is said of standard deviations that are too small."""

import json
from dataclasses import replace as with_fields

import pytest
import torch
from msgspec.structs import replace

from tests.compare.records import EFFECTS, identification, several
from torchid.compare.identifications import compare_identifications
from torchid.compare.reading import read_identification, read_results
from torchid.compare.scatter import whole
from torchid.compare.torque import random_motion
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.registry import on_every_joint
from torchid.identification.base_parameters import base_parameters
from torchid.report.compare import verdict
from torchid.robot.library import load_robot


def compared(paths, **arguments):
    results = [read_identification(r) for r in read_results(paths)]
    return compare_identifications(results, **arguments)


def test_honest_results_agree(tmp_path):
    found = compared(several(tmp_path, 3))
    assert not found.having("drift", "differ")
    low, _, high = found.birge.pooled_expected
    assert low < found.birge.pooled < high
    assert found.whole.p > 0.05
    assert "can be trusted" in verdict(found)
    # The same figures, of results that share their motion, or that agree too well.
    assert "can be trusted" not in verdict(replace(found, same_motion=True))
    close = replace(found.birge, pooled=0.5 * low)
    assert "better than chance" in verdict(replace(found, birge=close))


def test_results_of_one_trajectory_do_not_vouch_for_each_other(tmp_path):
    def rename(path):
        data = json.loads(path.read_text())
        data["fit"]["trajectories"] = ["run"]
        path.write_text(json.dumps(data))
        return path

    found = compared([rename(p) for p in several(tmp_path, 3)])
    assert found.same_motion
    assert "can be trusted" not in verdict(found)


def test_results_in_different_bases_are_compared_in_one(tmp_path):
    """The same estimate, written once in each basis, differs by nothing."""
    report = load_robot("3r_friction")
    conditioned = with_fields(report, basis="conditioned")
    paths = [
        identification(tmp_path / f"{robot.basis}.json", 4, robot=robot)
        for robot in (report, conditioned)
    ]
    one, two = (read_identification(r) for r in read_results(paths))
    assert one.base.names != two.base.names
    assert two.base.independent == base_parameters(conditioned, two.effects).independent
    # The truth in the second's basis, and the first's estimate brought there.
    same = one.base.grouping[:, list(two.base.independent)]
    data = json.loads(paths[1].read_text())
    back = torch.linalg.inv(same)
    data["base_values"] = (back @ one.values).tolist()
    data["covariance"] = (back @ one.covariance @ back.T).tolist()
    paths[1].write_text(json.dumps(data))
    found = compared(paths)
    for parameter in found.parameters:
        first, second = parameter.values.tolist()
        assert first == pytest.approx(second, rel=1e-9, abs=1e-12)
        assert float(parameter.std[0]) == pytest.approx(float(parameter.std[1]), rel=1e-9)


def test_too_small_claims_are_said_with_their_factor(tmp_path):
    found = compared(several(tmp_path, 4, claimed=1 / 3))
    assert found.birge.pooled == pytest.approx(3, rel=0.25)
    assert found.birge.typical == pytest.approx(3, rel=0.3)
    assert found.whole.p < 0.01
    assert "too small by a factor" in verdict(found)


def test_a_drifting_parameter_is_named_and_no_other(tmp_path):
    paths = [
        several(tmp_path, 1, first=k, change={"Fv2": 12.0 * k})[0].rename(tmp_path / f"{k}.json")
        for k in range(3)
    ]
    found = compared(paths)
    assert [p.name for p in found.having("drift")] == ["Fv2"]
    assert not found.having("differ")
    text = verdict(found)
    assert "1 drifts in the order given" in text
    assert "Fv2" in text
    back = compared([paths[0], paths[2], paths[1]])
    assert [p.name for p in back.having("differ")] == ["Fv2"]


def test_torque_differences_are_those_of_the_models(tmp_path):
    """Two results with the same friction: torque by Newton-Euler from full parameters."""
    found = compared(several(tmp_path, 2))
    robot = load_robot("3r_friction")
    results = [read_identification(r) for r in read_results(several(tmp_path, 2))]
    motion = random_motion(robot)
    tau = []
    for r in results:
        from torchid.identification.model import model_torque

        tau.append(
            torch.cat([model_torque(robot, r.base, r.effects, r.values, m) for m in motion.motions])
        )
    expected = (tau[0] - tau[1]).square().mean(0).sqrt()
    torch.testing.assert_close(found.torque.pairs[0, 1], expected)
    torch.testing.assert_close(found.torque.spread, expected / 2**0.5)
    nominal = torch.cat([inverse_dynamics(robot, *m.state) for m in motion.motions])
    assert bool((found.torque.size > 0.5 * nominal.square().mean(0).sqrt()).all())
    ratio = float(found.torque.spread.norm() / found.torque.claimed.norm())
    assert 0.3 < ratio < 3


def test_the_whole_keeps_its_level_where_covariances_are_singular():
    """Twenty parameters, fifteen degrees of freedom, strong correlations: p-values are uniform."""
    g = torch.Generator().manual_seed(0)
    d, nu, m = 20, 15, 2
    mix = torch.randn(d, d, generator=g, dtype=torch.float64)
    root = torch.linalg.cholesky(mix @ mix.T / d + 0.05 * torch.eye(d, dtype=torch.float64))
    true = root @ root.T
    size = true.diagonal().sqrt()
    white = (true / size / size.unsqueeze(1)).expand(m, d, d)
    p = []
    for k in range(60):
        x = (root @ torch.randn(m, d, 1, generator=g, dtype=torch.float64)).squeeze(-1)
        sample = root @ torch.randn(m, d, nu, generator=g, dtype=torch.float64)
        c = sample @ sample.transpose(1, 2) / nu
        p.append(
            whole(x, c, white, torch.full((m,), float(nu), dtype=torch.float64), seed=k, draws=60)[
                0
            ].p
        )
    p = torch.tensor(p, dtype=torch.float64)
    assert 0.35 < float(p.mean()) < 0.65
    assert float((p < 0.1).double().mean()) < 0.25


def test_the_whole_sees_what_no_single_parameter_shows():
    """A shift along the direction that is known best, of half a standard deviation of each."""
    d, nu = 10, 60
    c = 0.02 * torch.eye(d, dtype=torch.float64) + 0.98 * torch.ones(d, d, dtype=torch.float64)
    away = torch.tensor([0.5, -0.5] * (d // 2), dtype=torch.float64)
    x = torch.stack([torch.zeros(d, dtype=torch.float64), away])
    found, scatter = whole(
        x, c.expand(2, d, d), c.expand(2, d, d), torch.full((2,), float(nu), dtype=torch.float64)
    )
    assert scatter.pooled < 0.5
    assert found.p < 0.01


def test_the_record_is_json_and_says_the_same(tmp_path):
    found = compared(several(tmp_path, 3))
    data = json.loads(json.dumps(found.plain(), allow_nan=False))
    assert data["schema"] == "torchid.compare/1"
    assert data["results"] == ["a", "b", "c"]
    assert len(data["parameters"]) == len(found.parameters)
    assert sum(data["counts"].values()) == len(found.parameters)
    assert data["birge"]["pooled"] == pytest.approx(found.birge.pooled)
    assert data["parameters"][0]["consensus"] == pytest.approx(found.parameters[0].consensus)


def test_without_the_robot_there_is_no_torque(tmp_path):
    found = compared(several(tmp_path, 2, model=False))
    assert found.torque is None
    assert any("`robot=" in note for note in found.notes)
    assert compared(several(tmp_path, 2, model=False), robot=load_robot("3r_friction")).torque


@pytest.mark.slow
def test_robots_with_rounded_angles_can_be_compared(tmp_path):
    """1.5708 for pi / 2, as URDFs have it: columns that are dependent to 1e-6 lean on ones further
    right."""
    robot = load_robot("kuka_lwr4_friction")
    angle = torch.tensor(1.5708 - torch.pi / 2, dtype=torch.float64)
    tilt = torch.eye(4, dtype=torch.float64)
    tilt[1:3, 1:3] = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()]).view(2, 2)
    rounded = with_fields(robot, before=robot.before @ tilt)
    base = base_parameters(rounded, on_every_joint(EFFECTS, rounded.n))
    first = [int(row.nonzero()[0, 0]) for row in base.grouping]
    assert first != list(base.independent)
    results = read_results(several(tmp_path, 2, robot=rounded))
    assert [read_identification(r).base.independent for r in results] == [base.independent] * 2
    assert compared([r.path for r in results]).parameters
