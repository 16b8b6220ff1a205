"""A whole case: what the diagnosis may see, and its key."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.marks import some
from tests.torchid_bench.withheld.plant.conftest import SHORT, quiet, short
from torchid.errors import TorchidError
from torchid_bench.withheld.plant.case import draw_case, simulate_case

KEYS = {
    "kind", "arm", "rate_hz", "colour_hz", "repeats", "level", "effects", "background",
    "noise_std", "controller", "encoder_bits", "true_gap_rms",
}  # fmt: skip


def viscous(level=5.0):
    spec = draw_case(1, 2, effects=["viscous_friction"], arm="3r", level=level)
    return replace(spec, motion=SHORT)


@pytest.fixture(scope="module")
def case():
    return simulate_case(viscous())


def test_the_key_says_what_was_planted(case):
    assert set(case.key) >= KEYS
    json.dumps(case.key)
    (effect,) = case.key["effects"]
    joint = effect["joints"][0]
    assert (effect["name"], effect["family"]) == ("viscous_friction", "speed")
    assert effect["felt_by"] == [joint]
    assert effect["size"] == pytest.approx(5.0, rel=0.2)
    gap, noise = case.key["true_gap_rms"], case.key["noise_std"]
    assert gap[joint - 1] / noise[joint - 1] == pytest.approx(effect["size"], rel=1e-6)


def test_the_robot_does_not_tell(case):
    none = simulate_case(replace(viscous(), kind="none", effects=(), level=None))
    assert none.urdf == case.urdf
    assert none.key["effects"] == []
    assert max(np.array(none.key["true_gap_rms"]) / none.key["noise_std"]) < 0.1


@pytest.mark.slow
def test_a_larger_level_is_a_larger_effect(case):
    more = simulate_case(viscous(level=10.0)).key["effects"][0]
    less = case.key["effects"][0]
    assert more["parameters"]["Fv"] / less["parameters"]["Fv"] == pytest.approx(2.0, rel=0.2)


@pytest.mark.slow
def test_a_poor_motion_has_the_effect_of_a_rich_one(case):
    spec = replace(viscous(), poor=replace(SHORT, levels=(0.05, 0.05)), excitation="slow")
    poor = simulate_case(spec).key
    fv = [key["effects"][0]["parameters"]["Fv"] for key in (poor, case.key)]
    assert fv[0] == pytest.approx(fv[1], rel=1e-9)
    assert poor["effects"][0]["size"] < 1.0
    assert poor["noise_std"] == case.key["noise_std"]


@pytest.mark.slow
def test_several_effects_have_a_size_each():
    names = ["torque_offset", "torque_gain"]
    spec = replace(draw_case(1, 2, effects=names, arm="3r"), motion=SHORT)
    key = simulate_case(spec).key
    assert [e["name"] for e in key["effects"]] == names
    assert [e["size"] for e in key["effects"]] == pytest.approx([5.0, 5.0], rel=0.2)
    assert len({e["joints"][0] for e in key["effects"]}) == 2


def test_what_diverges_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo may write its own warning
    spec = replace(quiet(), damping_ratio=-1.0)
    with pytest.raises(TorchidError, match="diverged"):
        simulate_case(spec)


@pytest.mark.parametrize("number", some(range(20), 1))
def test_whole_cases(number):
    spec = draw_case(9, number)
    case = simulate_case(spec)
    assert all(np.isfinite(x).all() for x in case.columns.values())
    for effect in case.key["effects"]:
        assert effect["size"] < 1.3 * spec.level or spec.kind == "poor"
    if not spec.effects:
        assert max(np.array(case.key["true_gap_rms"]) / case.key["noise_std"]) < 0.1
    assert short(spec).motion.shapes == (0, 1)
