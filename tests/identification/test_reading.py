"""Identifications read back from their files; damaged ones are refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.arms import arm
from tests.fleet.records import identification
from torchid.errors import TorchidError
from torchid.identification.base_parameters import base_parameters, nominal_values
from torchid.identification.values import read_base


def written(folder: Path, change: Callable[[dict[str, Any]], object] = lambda data: None) -> Path:
    robot = arm("3r")
    path = identification(folder / "identification.json", 0, robot=robot, effects=())
    data = json.loads(path.read_text())
    base = base_parameters(robot, ())
    data |= {"base_values": nominal_values(robot, base).tolist(), "undetermined": [base.names[1]]}
    change(data)
    path.write_text(json.dumps(data))
    return path


def test_values_come_back(tmp_path: Path) -> None:
    robot = arm("3r")
    found = read_base(written(tmp_path), robot)
    assert torch.equal(found.values, nominal_values(robot, found.base))
    assert (~found.known).nonzero().flatten().tolist() == [1]


def test_a_result_without_its_basis_is_of_the_reports(tmp_path: Path) -> None:
    """Of an older torchid, and whatever the robot's own basis is now."""
    robot = replace(arm("3r"), basis="conditioned")
    found = read_base(written(tmp_path, lambda data: data.pop("basis")), robot)
    assert found.base.basis == "report"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["settings"].update(effects=None), "`$.settings.effects`"),
        (lambda d: d.update(undetermined="m1"), "undetermined"),
        (lambda d: d.update(undetermined=["m99"]), "m99"),
        (lambda d: d["covariance"][1].__setitem__(0, "x"), "entry [1][0] - at `$.covariance`"),
        (lambda d: d["model"].pop("gravity") and d["model"].pop("name"), "`$.model`"),
        (lambda d: d["base_values"].__setitem__(0, None), "base_values"),
        (lambda d: d.update(covariance=[[0.0]]), "covariance"),
        (lambda d: d.pop("factor"), "factor"),
        (lambda d: d["base_names"].__setitem__(0, "m77"), "m77"),
        (lambda d: d.update(basis="khalil"), "basis"),
        (lambda d: d.update(basis="conditioned"), "another robot"),
    ],
)
def test_damaged_files_are_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    path = written(tmp_path, change)
    with pytest.raises(TorchidError) as caught:
        read_base(path, arm("3r"))
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
