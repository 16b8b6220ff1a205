"""The studies, small: what they promise whatever the search finds."""

from dataclasses import replace
from functools import lru_cache

import pytest
import torch
from msgspec import structs

from torchid.errors import TorchidError
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.robot.config_files import config_folder
from torchid.robot.library import load_robot
from torchid.wrenches.regressor import internal_wrenches
from torchid_study.result import Study
from torchid_study.settings import load_study, study_names
from torchid_study.study import new_motion, run_study

NAMES = ("3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction")
IDS = {
    "3r": "p_1 p_4 p_5 p_8 p_9 p_12",
    "3r_friction": "p_13 p_16 p_17 p_20 p_21 p_24",
    "kuka_lwr4": "p_25 p_28 p_29 p_32 p_33 p_36",
    "kuka_lwr4_friction": "p_37 p_40 p_41 p_44 p_45 p_48",
}


@lru_cache
def tiny(name: str) -> Study:
    settings = load_study(name)
    search = replace(settings.search, runs=3, stages=3, generations=5)
    return run_study(structs.replace(settings, search=search))


def test_the_reports_four_studies_in_its_order():
    assert tuple(study_names()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_settings_are_the_reports(name):
    settings = load_study(name)
    assert " ".join(s.id for s in settings.scenarios) == IDS[name]
    runs = (30, 25) if name.startswith("3r") else (50, 35)
    assert (settings.search.runs, settings.search.stages) == runs
    assert {(s.bounds, s.penalty) for s in settings.scenarios} == {
        (bounds, penalty)
        for bounds in ("normal", "tight", "loose")
        for penalty in ("partial", "full")
    }


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name", ["3r", pytest.param("kuka_lwr4_friction", marks=pytest.mark.nightly)]
)
def test_a_whole_study(name):
    study = tiny(name)
    model = study.record.identification
    assert float((model.values - model.true).abs().max()) == model.largest_error < 1e-12
    for scenario, found in zip(study.record.sets, study.extractions, strict=True):
        low, high = found.problem.box.unbind(-1)
        p = found.sets.search_vector
        slack = 1e-9 * (high - low)
        assert bool(((p >= low - slack) & (p <= high + slack)).all())
        proof = study.record.certificate[scenario.bounds]
        feasible = feasibility(found.sets, found.problem.conditions).feasible
        assert bool((found.phi[feasible] >= proof.phi_min * (1 - 1e-6)).all())
        assert scenario.feasible == (not scenario.reasons)
    assert not [w for w in study.record.warnings if "below phi_min" in w]
    assert study.best.ids == tuple(IDS[name].split())
    assert study.every.ids[3] == f"{study.best.ids[1]}/run_1"


def test_force_errors_are_those_of_the_best_sets():
    """Norms of the forces along the motion, from the sets that are written."""
    study, robot = tiny("3r"), load_robot("3r")
    plan = new_motion(robot, load_study("3r").wrench_motion)
    real, best = (
        internal_wrenches(robot, plan.q, plan.dq, plan.ddq, sets.parameters)[..., :3].norm(dim=-1)
        for sets in (nominal_set(robot), study.best)
    )
    expected = (best - real).square().mean(1).sqrt()
    found = torch.stack([one.force_norm_difference_rms for one in study.record.sets])
    assert float(expected.max()) > 1
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-9)


def test_the_normal_full_set_of_the_3r_is_feasible_and_has_the_torque():
    best = {s.id: s for s in tiny("3r").record.sets}["p_4"]
    assert best.feasible
    assert best.gamma == 0
    assert best.phi < 1e-18
    assert float(best.torque_rms.max()) < 1e-9


def test_payload_is_found_within_its_interval():
    payload = tiny("3r").record.payload
    mass = payload.tool.mass
    assert float(payload.true[0]) == 0.5
    assert float(mass.low) <= 0.5 <= float(mass.high)


def test_record_follows_the_contract():
    data = tiny("3r").record.plain()
    assert data["schema"] == "torchid.study/1"
    assert [s["id"] for s in data["sets"]] == IDS["3r"].split()
    for entry in data["sets"]:
        assert {"bounds", "loss", "phi", "gamma", "feasible", "reasons"} <= set(entry)
    assert set(data["certificate"]) == {"normal", "tight", "loose"}
    assert all("phi_min" in c for c in data["certificate"].values())


@pytest.mark.parametrize(
    ("line", "instead", "said"),
    [
        ("id: p_4", "id: p_1", "p_1"),
        ("duration: 10", "duration: long", "duration"),
        ("rate: 100,", "rate: 0,", "rate"),
        ("rate: 100,", "rate: 100, noise_dB: 3,", "noise_dB"),
        ("source: table_5_1", "source: table_5_2", "table_5_2"),
        ("runs: 30", "runs: 2.5", "runs"),
        ("runs: 30", "runs: 30, rounds: 2", "rounds"),
        ("mass: 0.5", "mass: 0.5, weight: 5", "weight"),
        ("com: [0.02, -0.01, 0.04]", "com: [0.02]", "com"),
        ("mass: 0.5", "mass: -1", "mass"),
    ],
)
def test_values_that_make_no_study(tmp_path, line, instead, said):
    text = (config_folder("studies") / "3r.yaml").read_text()
    assert line in text
    path = tmp_path / "x.yaml"
    path.write_text(text.replace(line, instead))
    with pytest.raises(TorchidError, match="not a study") as caught:
        load_study(str(path))
    assert said in str(caught.value)


def test_a_study_without_scenarios(tmp_path):
    text = (config_folder("studies") / "3r.yaml").read_text()
    start, end = text.index("scenarios:"), text.index("# A block")
    path = tmp_path / "x.yaml"
    path.write_text(f"{text[:start]}scenarios: []\n{text[end:]}")
    with pytest.raises(TorchidError, match=r"length >= 1 - at `\$.scenarios`"):
        load_study(str(path))


def test_unknown_and_broken_studies(tmp_path):
    with pytest.raises(TorchidError, match="no study"):
        load_study("4r")
    path = tmp_path / "x.yaml"
    path.write_text("title: x\n")
    with pytest.raises(TorchidError, match="missing required field `robot`"):
        load_study(str(path))
    path.write_text("[: x\n")
    with pytest.raises(TorchidError, match="yaml"):
        load_study(str(path))
