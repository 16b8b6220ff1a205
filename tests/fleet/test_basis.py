"""Identifications that group parameters differently, brought to one basis."""

import json
from dataclasses import replace

import pytest
import torch

from tests.fleet.records import EFFECTS, identification, several
from torchid.effects.registry import on_every_joint
from torchid.errors import TorchidError
from torchid.fleet.basis import common_basis, refuse_other_kinematics
from torchid.fleet.compare import compare_results, read_results
from torchid.identification.base_parameters import base_parameters
from torchid.robot.library import load_robot


def read(paths):
    return {r.label: r.record for r in read_results(paths)}


def estimates(results):
    """Names, values and standard deviations."""
    named, values, std = common_basis(results)
    return [name for name, _ in named], values, std


def test_the_same_grouping_stays_as_it_is(tmp_path):
    results = read(several(tmp_path, 2))
    names, values, std = estimates(results)
    for k, r in enumerate(results.values()):
        assert names == list(r.base_names)
        torch.testing.assert_close(values[:, k], r.values)
        torch.testing.assert_close(std[:, k], r.covariance.diagonal().sqrt())


def test_the_same_estimate_in_another_basis_differs_by_nothing(tmp_path):
    report = load_robot("3r_friction")
    conditioned = replace(report, basis="conditioned")
    paths = [
        identification(tmp_path / f"{robot.basis}.json", 4, robot=robot)
        for robot in (report, conditioned)
    ]
    one, two = read(paths).values()
    assert one.base_names != two.base_names
    assert two.base.independent == base_parameters(conditioned, two.placed).independent
    # The first's estimate in the second's basis.
    back = torch.linalg.inv(one.base.grouping[:, list(two.base.independent)])
    data = json.loads(paths[1].read_text())
    data["base_values"] = (back @ one.values).tolist()
    data["covariance"] = (back @ one.covariance @ back.T).tolist()
    paths[1].write_text(json.dumps(data))
    for both in estimates(read(paths))[1:]:
        torch.testing.assert_close(both[:, 0], both[:, 1], rtol=1e-9, atol=1e-12)


def test_an_effect_that_one_result_lacks(tmp_path):
    """Rotor inertias: of joint 1 exactly part of J1zz, so both determine the same sum; of joint 3
    a parameter of its own, that one result has alone."""
    a = identification(tmp_path / "a.json", 0, effects=(*EFFECTS, "rotor_inertia"))
    b = identification(tmp_path / "b.json", 1)
    names, values, std = estimates(read([a, b]))
    first = next(k for k, name in enumerate(names) if "Ia1" in name or name.startswith("J1zz"))
    assert bool(std[first].isfinite().all())
    alone = names.index("Ia3")
    assert std[alone].isnan().tolist() == [False, True]
    assert values[alone].isnan().tolist() == [False, True]


def test_what_was_held_or_not_determined_is_no_estimate(tmp_path):
    a, b = several(tmp_path, 2)
    data = json.loads(b.read_text())
    data["undetermined"], data["bounded"] = ["Fv1"], ["Fc2"]
    for row in data["factor"]:
        row[data["base_names"].index("Fv1")] = 0.0
    b.write_text(json.dumps(data))
    names, values, std = estimates(read([a, b]))
    for name, held in (("Fv1", False), ("Fc2", True)):
        k = names.index(name)
        assert std[k].isnan().tolist() == [False, True]
        assert values[k].isnan().tolist() == [False, not held]


def test_estimates_that_hold_an_undetermined_parameter_are_none(tmp_path):
    """A log that only shows Fv1 + 2 Fv2 determines neither."""
    a, b = several(tmp_path, 2)
    data = json.loads(b.read_text())
    one, two = (data["base_names"].index(n) for n in ("Fv1", "Fv2"))
    for row in data["factor"]:
        row[two] = 2 * row[one]
    data["undetermined"] = ["Fv2"]
    b.write_text(json.dumps(data))
    names, _, std = estimates(read([a, b]))
    assert bool(std[names.index("Fv1"), 1].isnan())
    assert bool(std[names.index("Fv3"), 1].isfinite())


@pytest.mark.parametrize("model", [True, False])
def test_other_kinematics_are_refused(tmp_path, model):
    robot = load_robot("3r_friction")
    after = robot.after.clone()
    after[1, 0, 3] += 0.05
    paths = [
        identification(tmp_path / "a.json", 0, model=model),
        identification(tmp_path / "b.json", 1, model=model, robot=replace(robot, after=after)),
    ]
    with pytest.raises(TorchidError, match="different kinematics"):
        compare_results(paths)


def test_a_calibration_of_a_millimetre_is_the_same_arm(tmp_path):
    robot = load_robot("3r_friction")
    after = robot.after.clone()
    after[1, 0, 3] += 0.0005
    paths = [
        identification(tmp_path / "a.json", 0),
        identification(tmp_path / "b.json", 1, robot=replace(robot, after=after)),
    ]
    results = read(paths)
    refuse_other_kinematics({label: r.model for label, r in results.items()})
    assert bool(estimates(results)[2].isfinite().all())


@pytest.mark.slow
def test_robots_with_rounded_angles_can_be_compared(tmp_path):
    """1.5708 for pi / 2, as URDFs have it: columns that are dependent to 1e-6 lean on ones further
    right."""
    robot = load_robot("kuka_lwr4_friction")
    angle = torch.tensor(1.5708 - torch.pi / 2, dtype=torch.float64)
    tilt = torch.eye(4, dtype=torch.float64)
    tilt[1:3, 1:3] = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()]).view(2, 2)
    rounded = replace(robot, before=robot.before @ tilt)
    base = base_parameters(rounded, on_every_joint(EFFECTS, rounded.n))
    first = [int(row.nonzero()[0, 0]) for row in base.grouping]
    assert first != list(base.independent)
    results = read(several(tmp_path, 2, robot=rounded))
    assert [r.base.independent for r in results.values()] == [base.independent] * 2
    assert bool(estimates(results)[2].isfinite().all())
