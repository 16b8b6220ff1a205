"""Gap diagnoses compared: the same cause under other names, sizes, what could not be tested."""

import io
import json

import pytest
from rich.console import Console

from tests.gap_files import found as found_effect
from tests.gap_files import gap
from tests.gap_files import hidden as untested
from torchid.compare.diagnoses import compare_diagnoses
from torchid.compare.reading import read_results
from torchid.errors import TorchidError
from torchid.report.compare import gap_tables, gap_verdict
from torchid.results.record import robot_record
from torchid.robot.library import load_robot


def named(effect="coulomb_friction", joint=2, also=(), **values):
    values = values or {"Fc": 0.5}
    return found_effect(
        effect, joint, ambiguous_with=list(also), parameters={**values, "smoothing": 0.0},
        std=dict.fromkeys(values, 0.02), unit=dict.fromkeys(values, "N m"),
    )  # fmt: skip


def diagnosis(path, *which, hidden=(), robot="3r", effects=()):
    arm = load_robot(robot)
    corrected = {**robot_record(arm), "effects": list(effects)}
    data = gap(arm, which=list(which), not_testable=list(hidden), corrected=corrected)
    path.write_text(json.dumps(data))
    return path


def compared(*paths):
    return compare_diagnoses(read_results(paths))


def test_the_same_effect_with_another_size(tmp_path):
    found = compared(
        diagnosis(tmp_path / "a.json", named(Fc=0.5), named("torque_offset", 1, F0=1.0)),
        diagnosis(tmp_path / "b.json", named(Fc=0.8), named("torque_offset", 1, F0=1.01)),
    )
    assert all(s.everywhere for s in found.shared)
    p = {s.effects[0]: s.coefficients[0].p_holm for s in found.shared}
    assert p["coulomb_friction"] < 1e-4
    assert p["torque_offset"] > 0.5
    assert "1 agree, 1 do not" in gap_verdict(found)


def test_another_name_that_cannot_be_told_apart_is_the_same_cause(tmp_path):
    found = compared(
        diagnosis(tmp_path / "a.json", named("stribeck_friction", 2, ["coulomb_friction"], Fs=0.4)),
        diagnosis(tmp_path / "b.json", named()),
        diagnosis(tmp_path / "c.json", named()),
    )
    assert len(found.shared) == 1
    assert found.shared[0].effects == ("coulomb_friction", "stribeck_friction")
    assert found.shared[0].everywhere
    assert [v is None for v in found.shared[0].coefficients[0].values] == [True, False, False]


@pytest.mark.parametrize("other", [named(joint=3), named("viscous_friction", 2, Fv=0.4)])
def test_another_joint_or_an_unrelated_effect_is_another_cause(tmp_path, other):
    found = compared(diagnosis(tmp_path / "a.json", named()), diagnosis(tmp_path / "b.json", other))
    assert len(found.shared) == 2
    assert not any(s.everywhere for s in found.shared)
    assert "no effect is named in all" in gap_verdict(found)


def test_what_could_not_be_tested_is_not_missing(tmp_path):
    hidden = untested("coulomb_friction", 2, 0.9)
    found = compared(
        diagnosis(tmp_path / "a.json", named()), diagnosis(tmp_path / "b.json", hidden=[hidden])
    )
    assert found.shared[0].states == ("named", "not_testable")
    assert found.shared[0].smallest == (None, 0.9)
    assert "could not test it" in gap_verdict(found)
    assert gap_tables(found)


def test_sizes_are_shown_of_what_only_one_names(tmp_path):
    a = diagnosis(tmp_path / "a.json", named(Fc=0.4321))
    b = diagnosis(tmp_path / "b.json", named("viscous_friction", joint=3, Fv=1.25))
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(*gap_tables(compared(a, b)))
    text = console.export_text()
    assert "0.4321 ± 0.02 N m" in text
    assert "1.25 ± 0.02 N m" in text


def test_torque_of_corrected_models(tmp_path):
    """They differ by exactly the friction that one of them has."""
    friction = {"effect": "coulomb_friction", "joint": 2, "Fc": 0.6}
    found = compared(
        diagnosis(tmp_path / "a.json", named(), effects=[friction]),
        diagnosis(tmp_path / "b.json"),
    )
    pair = found.torque.pairs[0, 1].tolist()
    assert pair[0] == pair[2] == 0
    assert pair[1] == pytest.approx(0.6, rel=0.01)  # at rest, at both ends, there is none
    data = json.loads(json.dumps(found.plain(), allow_nan=False))
    assert data["effects"][0]["states"] == ["named", "not_found"]


def test_another_arm_and_an_incomplete_file_are_refused(tmp_path):
    a = diagnosis(tmp_path / "a.json", named())
    with pytest.raises(TorchidError, match="different kinematics"):
        compared(a, diagnosis(tmp_path / "b.json", named(), robot="kuka_lwr4"))
    broken = {**json.loads(a.read_text())}
    del broken["which"]
    (tmp_path / "c.json").write_text(json.dumps(broken))
    with pytest.raises(TorchidError, match="missing required field `which`"):
        compared(a, tmp_path / "c.json")
