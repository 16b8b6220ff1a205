"""The JSON contract torchid.identification/1 of the design, key by key."""

import json
from functools import lru_cache
from typing import Any

import pytest
import torch

from tests.identification.test_rows import a_log
from torchid.excitation.synthetic import HonestNoise
from torchid.identification.identify import Identification, Settings, identify
from torchid.robot.library import load_robot

NOISE = HonestNoise(1e-5, 0.02)
QUICK = Settings(cutoff=5.0, reversal=0.0, held_out_fraction=0.3)


@lru_cache
def result(name: str = "3r_friction", kind: str = "plain") -> Identification:
    robot = load_robot(name)
    log = a_log(robot, rates=(100.0,), noise=NOISE)
    settings = QUICK
    if kind == "auto":
        settings = Settings(cutoff="auto", reversal=0.0)
    elif kind == "auto without noise":
        log, settings = a_log(robot, rates=(100.0,)), Settings(reversal=0.0, method="ols")
    elif kind == "essential":
        settings = Settings(cutoff=5.0, reversal=0.0, essential=True)
    elif kind == "rigid":
        settings = Settings(cutoff=5.0, effects=())
    elif kind == "joint 2 never moves":
        q = log.q.clone()
        q[:, 1] = 0.3
        log = log.replace(q=q)
    elif kind == "joint 3 has no torque":
        log = log.replace(tau=log.tau * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64))
    return identify(robot, log, settings=settings)


KINDS = (
    "plain", "auto", "auto without noise", "essential", "rigid", "joint 2 never moves",
    "joint 3 has no torque",
)  # fmt: skip


def strict(data: Any) -> Any:
    """Through JSON that knows no NaN."""
    return json.loads(json.dumps(data, allow_nan=False))


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_strict_json(kind):
    data = result(kind=kind).plain()
    assert strict(data) == data


def numbers(values: list, count: int) -> bool:
    return len(values) == count and all(v is None or isinstance(v, float) for v in values)


ERRORS = {
    "rmse", "relative_error_percent", "relative_error_percent_moving",
    "relative_error_percent_raw", "standstill_fraction", "standstill_error_share",
}  # fmt: skip


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction"])
def test_the_contract_key_by_key(name):
    found = result(name)
    data = strict(found.plain())
    n = found.robot.n
    assert data["schema"] == "torchid.identification/1" == "torchid.identification/1"
    assert data["robot"] == name
    assert data["n_base"] == {3: 15, 7: 43}[n] == len(data["parameters"])
    for k, entry in enumerate(data["parameters"]):
        assert set(entry) >= {"name", "value", "std", "relative_std_percent"}
        assert entry["name"] == found.base.names[k]
        assert entry["value"] == float(found.values[k])
        assert entry["std"] == float(found.std[k])
        expected = 100 * entry["std"] / abs(entry["value"])
        assert entry["relative_std_percent"] == pytest.approx(expected)
        low, high = entry["ci95"]
        assert low < entry["value"] < high
    assert data["condition_number"] > data["scaled_condition_number"] > 1
    assert data["cutoff_hz"] == 5.0
    assert data["cutoff_choice"] is None
    for part in ("fit", "held_out"):
        assert set(data[part]) == ERRORS | {"trajectories"}
        assert all(numbers(data[part][key], n) for key in ERRORS)
        assert data[part]["trajectories"] == list(found.fit.trajectories)
    assert data["held_out"]["rmse"] == found.held_out.rmse.tolist()
    assert data["held_out"]["rmse"] != data["fit"]["rmse"]


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction"])
def test_effects_are_told_joint_by_joint_from_1(name):
    found = result(name)
    data = strict(found.plain())
    n = found.robot.n
    names = {"viscous_friction": "Fv", "coulomb_friction": "Fc", "torque_offset": "F0",
             "rotor_inertia": "Ia"}  # fmt: skip
    assert [entry["effect"] for entry in data["effects"]] == list(names)
    for entry in data["effects"]:
        assert set(entry) == {"effect", "joints", "parameters", "std"}
        label = names[entry["effect"]]
        absorbed = [int(a[2:]) for a in data["absorbed"] if a.startswith(label)]
        assert entry["joints"] == [j for j in range(1, n + 1) if j not in absorbed]
        assert list(entry["parameters"]) == list(entry["std"]) == [label]
        for j, value, std in zip(
            entry["joints"], entry["parameters"][label], entry["std"][label], strict=True
        ):
            k = next(i for i, b in enumerate(found.base.names) if b.split()[0] == f"{label}{j}")
            assert value == float(found.values[k])
            assert std == (float(found.std[k]) if bool(found.free[k]) else None)
    assert data["absorbed"] == ["Ia1", "Ia2"]


def test_what_was_not_estimated_has_no_standard_deviation():
    found = result(kind="joint 2 never moves")
    data = strict(found.plain())
    assert {"Fv2", "Fc2"} <= set(data["undetermined"])
    (viscous,) = (e for e in data["effects"] if e["effect"] == "viscous_friction")
    assert viscous["parameters"]["Fv"][1] == 0.0
    assert viscous["std"]["Fv"][1] is None
    for entry in data["parameters"]:
        assert entry["estimated"] == (entry["name"] not in data["undetermined"])
        assert (entry["std"] is None) == (not entry["estimated"])
    assert data["fit"]["relative_error_percent_moving"][1] is None


def test_the_choice_of_the_cutoff_is_told():
    data = strict(result(kind="auto").plain())
    choice = data["cutoff_choice"]
    assert data["cutoff_hz"] in choice["candidates_hz"]
    assert len(choice["candidates_hz"]) == len(choice["cross_validated_error_percent"])
    none = strict(result(kind="auto without noise").plain())
    assert none["cutoff_hz"] is None
    assert none["cutoff_choice"]["candidates_hz"][-1] is None


def test_grouping_and_covariance_can_be_used():
    found = result()
    data = strict(found.plain())
    grouping = torch.tensor(data["grouping"]["matrix"], dtype=torch.float64)
    assert torch.equal(grouping, found.base.grouping)
    assert data["grouping"]["parameters"] == list(found.base.parameter_names)
    covariance = torch.tensor(data["covariance"], dtype=torch.float64)
    assert covariance.shape == (len(found.base), len(found.base))
    statistics = data["statistics"]
    assert statistics["blocks"] > 10
    entry = data["parameters"][0]
    half = statistics["quantile95"] * entry["std"]
    assert entry["ci95"] == pytest.approx([entry["value"] - half, entry["value"] + half])


def test_settings_and_warnings_are_kept():
    found = result(kind="joint 2 never moves")
    data = strict(found.plain())
    assert data["settings"]["effects"] == list(found.settings.effects)
    assert set(data["settings"]) >= {"cutoff", "rows", "method", "signs", "held_out_fraction"}
    assert data["warnings"] == list(found.warnings)
    assert any("does not determine" in w for w in data["warnings"])
