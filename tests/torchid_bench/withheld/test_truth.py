"""How far a corrected model really closes the gap, against models whose share is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.torchid_bench.withheld.fakes import Spec, arm, simulate_case
from torchid.log.columns import log_from_columns
from torchid_bench.benchmarks import withheld_score as references
from torchid_bench.withheld.case_set import keys_beside, make, read_keys

true_share, true_shares = references.true_share, references.true_shares

TRUE = 2.0
"""Coulomb friction of joint 2 [N m]."""


def corrected(strength, joint=2):
    effects = [{"effect": "coulomb_friction", "joint": joint, "Fc": strength}] if strength else []
    return {"effects": effects, "pi": arm().require_parameters("a test").pi.tolist()}


def share(model, spec=Spec(1, 0)):  # noqa: B008
    logs = [
        log_from_columns(simulate_case(spec, ideal=True, bare=bare).columns, "ideal.parquet")
        for bare in (False, True)
    ]
    noise = torch.tensor([0.05, 0.05], dtype=torch.float64)
    return true_share(arm(), *logs, model, noise, 20.0)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (corrected(TRUE), 1.0),
        (corrected(0.0), 0.0),
        (corrected(0.5 * TRUE), 0.5),
        (corrected(2 * TRUE), 0.0),
        (corrected(TRUE, joint=1), 1 - 2**0.5),
    ],
)
def test_the_share_is_that_of_errors(model, expected):
    assert share(model) == pytest.approx(expected, abs=0.03)


def test_what_is_left_of_a_right_model_is_no_gap():
    """Torque that no model foretells, with and without the effect."""
    extra = {"tau1": 0.3 * np.sin(np.arange(3003)), "tau2": 0.5 * np.cos(np.arange(3003))}
    logs = []
    for bare in (False, True):
        columns = simulate_case(Spec(1, 0), ideal=True, bare=bare).columns
        added = {name: columns[name] + x[: len(columns[name])] for name, x in extra.items()}
        logs.append(log_from_columns(columns | added, "ideal.parquet"))
    noise = torch.tensor([0.05, 0.05], dtype=torch.float64)
    for strength, expected in ((TRUE, 1.0), (0.5 * TRUE, 0.5)):
        found = true_share(arm(), *logs, corrected(strength), noise, 20.0)
        assert found == pytest.approx(expected, abs=0.03)


def answered(made, case, strength):
    """An answer with a corrected model and an interval."""
    said = {
        "status": "explained",
        "which": [],
        "noise_floor": {"source": "repeats"},
        "band_hz": 20.0,
        "corrected": corrected(strength),
        "how_far": {"closed": 0.9, "closed_ci95": [0.8, 1.0]},
    }
    made.answer(case).write_text(json.dumps(said))
    return said


def test_cases_with_an_interval_are_simulated_again(plant, tmp_path):
    made = make(tmp_path / "set", 3, seed=7)
    keys = read_keys(made, keys_beside(made.folder))
    answers = {
        "case-0001": answered(made, "case-0001", TRUE),
        "case-0002": answered(made, "case-0002", 0.5 * TRUE),
        "case-0003": {"status": "no_gap", "how_far": {"closed_ci95": None}},
    }
    found = true_shares(made, keys, answers, 1)
    assert found == pytest.approx({"case-0001": 1.0, "case-0002": 0.5}, abs=0.03)
    keys[0]["effects"][0]["name"] = "contact"  # it happened once: no model predicts it
    assert set(true_shares(made, keys, answers, 1)) == {"case-0002"}


def test_another_simulator_is_not_taken_for_the_truth(plant, tmp_path):
    made = make(tmp_path / "set", 1, seed=7)
    keys = read_keys(made, keys_beside(made.folder))
    answers = {"case-0001": answered(made, "case-0001", TRUE)}
    assert true_shares(replace(made, seed=7), keys, answers, 1)

    def other(spec, **how):
        found = simulate_case(spec, **how)
        return replace(found, urdf=found.urdf.replace("0.", "0.1", 1))

    plant.simulate_case = other
    (tmp_path / "set.truth" / "case-0001.json").unlink()
    assert true_shares(made, keys, answers, 1) == {}
    said = json.loads((tmp_path / "set.truth" / "case-0001.json").read_text())
    assert "simulated differently now" in said["error"]
