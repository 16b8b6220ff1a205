"""The record is the contract torchid.gap/2: its keys, joints from 1, numbers or null."""

import json
import math
from dataclasses import replace

import msgspec
import pytest
import torch

import torchid
from tests.arms import mixed_arm
from tests.gap.diagnoses import FRICTION, OFFSET, VISCOUS, diagnosis, floor
from torchid.design.columns import Model
from torchid.effects.friction import ViscousFriction
from torchid.effects.registry import effect_from_record
from torchid.gap.cause_records import body_cause, effect_cause, valued
from torchid.gap.record import RegimeGap


def test_settings_of_a_file_are_not_judged_again(tmp_path):
    """They may name effects that are no more."""
    data = diagnosis().plain()
    data["settings"] |= {"effects": ["no_more"]}
    (tmp_path / "gap.json").write_text(json.dumps(data))
    assert torchid.load(tmp_path / "gap.json").settings.effects == ("no_more",)


def test_joints_count_from_one():
    data = diagnosis(causes=(VISCOUS, FRICTION, OFFSET)).plain()
    assert [x["joint"] for x in data["where"]["joints"]] == [1, 2, 3]
    assert data["where"]["regimes"][0]["joint"] == 2
    assert [x["joints"] for x in data["which"]] == [[2], [1], [3]]  # the largest share first
    assert [x["joint"] for x in data["not_testable"]] == [1, 3]


def test_an_effect_can_be_read_back():
    d = diagnosis()
    entry = d.plain()["which"][0]
    written = {"effect": entry["effect"], "joint": entry["joints"][0], **entry["parameters"]}
    assert effect_from_record(written, d.robot) == valued(FRICTION, d.robot)
    assert entry["std"] == {"Fc": 0.02}
    assert entry["unit"] == {"Fc": "N m"}
    assert entry["family"] == "sign"
    assert entry["meaning"]
    assert entry["remedy"]


def test_what_is_no_number_is_null():
    d = diagnosis(causes=(OFFSET,))
    d = replace(d, regimes=(RegimeGap(0, "slow", math.nan, (-math.inf, 0.1), 1.0),))
    data = d.plain()
    assert data["which"][0]["std"] == {"F0": None}
    assert data["where"]["regimes"][0]["excess"] is None
    assert data["where"]["regimes"][0]["ci95"] == [None, 0.1]


def test_inertial_parameters():
    changed = (
        body_cause((2,), share=0.5, ambiguous_with=("payload",)), body_cause((), share=0.3),
    )  # fmt: skip
    data = diagnosis(causes=changed).plain()
    (link,) = data["which"]  # all base parameters are no effect of one link
    assert (link["effect"], link["family"], link["joints"]) == ("link_inertia", "inertia", [3])
    assert link["ambiguous_with"] == ["payload"]
    assert [x["joints"] for x in data["answer"]["causes"]] == [[3], []]


def test_rms_over_all_joints_is_the_root_of_the_sum_of_squares():
    far = diagnosis().plain()["how_far"]
    each = torch.tensor([x["before"] for x in far["per_joint"]])
    assert far["rms_before"] == pytest.approx(float(each.square().sum().sqrt()))


def test_units_of_prismatic_joints():
    robot = mixed_arm("RPR")
    given = Model(robot, ())
    slide = effect_cause((ViscousFriction(1), [0.2]), [0.1], given, given, 0)
    entry = diagnosis(robot=robot, causes=(slide,)).plain()["which"][0]
    assert entry["unit"] == {"Fv": "N s/m"}


@pytest.mark.parametrize("source", ["repeats", "bracket"])
def test_only_repeats_bound_the_noise_above(source):
    noise = msgspec.structs.replace(floor(), source=source)
    told = replace(diagnosis(), floor=noise)
    said = told.plain()
    far = said["how_far"]
    ends = [j["noise_floor_rms"] for j in (far, *far["per_joint"])]
    ends += [told.answer.plain()["noise"]] if hasattr(told.answer, "plain") else []
    assert all((high is None) == (source == "bracket") for _, high in ends)
    assert all(low is not None for low, _ in ends)
    assert (">=" in str(told.answer)) == (source == "bracket")
