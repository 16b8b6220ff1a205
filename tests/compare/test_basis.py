"""Identifications that group parameters differently, brought to one basis."""

import json
from dataclasses import replace

import pytest
import torch

from tests.compare.records import EFFECTS, identification, several
from torchid.compare.basis import common_basis
from torchid.compare.reading import read_identification, read_results
from torchid.errors import TorchidError
from torchid.robot.library import load_robot


def read(paths):
    return [read_identification(r) for r in read_results(paths)]


def regrouped(path, into):
    """The same result with its columns taken from right to left: other independent parameters."""
    data = json.loads(path.read_text())
    g = torch.tensor(data["grouping"]["matrix"], dtype=torch.float64)
    rigid = sum(not n.startswith("F") for n in data["grouping"]["parameters"])
    flipped = torch.cat([g[:, :rigid].flip(1), g[:, rigid:]], 1)
    pivots, rows = [], flipped.clone()
    for k in range(len(rows)):  # reduced echelon form of the flipped columns
        ahead = [c for c in range(rows.shape[1]) if rows[k:, c].abs().max() > 1e-9]
        pivot = ahead[0]
        best = k + int(rows[k:, pivot].abs().argmax())
        rows[[k, best]] = rows[[best, k]]
        rows[k] = rows[k] / rows[k, pivot]
        for other in range(len(rows)):
            if other != k:
                rows[other] = rows[other] - rows[other, pivot] * rows[k]
        pivots.append(pivot)
    place = [rigid - 1 - c if c < rigid else c for c in pivots]
    new = torch.cat([rows[:, :rigid].flip(1), rows[:, rigid:]], 1)
    turn = new[:, [int((row != 0).nonzero()[0, 0]) for row in g]]
    return new, turn, place


def test_the_same_grouping_stays_as_it_is(tmp_path):
    results = read(several(tmp_path, 2))
    common = common_basis(results)
    assert common.names == results[0].base.names
    for k, r in enumerate(results):
        torch.testing.assert_close(common.values[k], r.values)
        torch.testing.assert_close(common.covariance[k], r.covariance)
    assert bool(common.estimated.all())


def test_another_grouping_gives_the_same_values(tmp_path):
    """A result in other independent parameters is the same result, once in the common basis."""
    results = read(several(tmp_path, 2))
    new, turn, place = regrouped(tmp_path / "b.json", None)
    b = results[1]
    assert not torch.allclose(new, b.base.grouping)
    other = replace(
        b,
        base=replace(
            b.base,
            grouping=new,
            independent=tuple(place),
            names=tuple(f"x{k}" for k in range(len(new))),
        ),
        values=turn @ b.values,
        covariance=turn @ b.covariance @ turn.T,
    )
    plain, mixed = common_basis(results), common_basis([results[0], other])
    assert mixed.names == plain.names
    torch.testing.assert_close(mixed.values, plain.values)
    torch.testing.assert_close(mixed.covariance, plain.covariance, rtol=1e-6, atol=1e-12)


def test_an_effect_that_one_result_lacks(tmp_path):
    """Rotor inertias: of joint 1 exactly part of J1zz, so both determine the same sum; of joint 3
    a parameter of its own, that one result has alone."""
    a = identification(tmp_path / "a.json", 0, effects=(*EFFECTS, "rotor_inertia"))
    b = identification(tmp_path / "b.json", 1)
    common = common_basis(read([a, b]))
    first = next(
        k for k, name in enumerate(common.names) if "Ia1" in name or name.startswith("J1zz")
    )
    assert bool(common.estimated[:, first].all())
    alone = common.names.index("Ia3")
    assert common.estimated[:, alone].tolist() == [True, False]
    assert any("without rotor_inertia" in note for note in common.notes)


def test_what_was_held_or_not_determined_is_no_estimate(tmp_path):
    a, b = several(tmp_path, 2)
    data = json.loads(b.read_text())
    data["undetermined"], data["bounded"] = ["Fv1"], ["Fc2"]
    for row in data["factor"]:
        row[data["base_names"].index("Fv1")] = 0.0
    b.write_text(json.dumps(data))
    common = common_basis(read([a, b]))
    for name, held in (("Fv1", False), ("Fc2", True)):
        k = common.names.index(name)
        assert common.estimated[:, k].tolist() == [True, False]
        assert common.held[:, k].tolist() == [False, held]


def test_estimates_that_hold_an_undetermined_parameter_are_none(tmp_path):
    """A log that only shows Fv1 + 2 Fv2 determines neither."""
    a, b = several(tmp_path, 2)
    data = json.loads(b.read_text())
    one, two = (data["base_names"].index(n) for n in ("Fv1", "Fv2"))
    for row in data["factor"]:
        row[two] = 2 * row[one]
    data["undetermined"] = ["Fv2"]
    b.write_text(json.dumps(data))
    common = common_basis(read([a, b]))
    assert not bool(common.estimated[1, common.names.index("Fv1")])
    assert bool(common.estimated[1, common.names.index("Fv3")])


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
        common_basis(read(paths))


def test_a_calibration_of_a_millimetre_is_the_same_arm(tmp_path):
    robot = load_robot("3r_friction")
    after = robot.after.clone()
    after[1, 0, 3] += 0.0005
    paths = [
        identification(tmp_path / "a.json", 0),
        identification(tmp_path / "b.json", 1, robot=replace(robot, after=after)),
    ]
    assert bool(common_basis(read(paths)).estimated.all())


def test_other_arms_are_refused(tmp_path):
    a = identification(tmp_path / "a.json", 0)
    b = identification(tmp_path / "b.json", 1, robot=load_robot("kuka_lwr4_friction"))
    with pytest.raises(TorchidError, match="numbers of joints"):
        common_basis(read([a, b]))


def test_one_log_in_two_results_is_said(tmp_path):
    a = identification(tmp_path / "a.json", 0)
    b = identification(tmp_path / "b.json", 0)
    assert any("'run 0'" in note for note in common_basis(read([a, b])).notes)
