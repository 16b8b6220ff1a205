"""Diagnoses of servos side by side: numbers whose spread is what they state, or is not."""

import json
import math
from dataclasses import replace

import pytest
import torch

import torchid
from tests.position.diagnosed import diagnosis, finding
from tests.position.planted import planted, robot, true_servos
from torchid.effects.servo import INDEX, PARAMETERS
from torchid.errors import TorchidError
from torchid.fleet.compare import compare_results
from torchid.position.record import KnownRecord
from torchid.report.compare import report_of_comparison, verdict
from torchid.robot.library import load_robot
from torchid.simulation.servo import Servos

NAMES = ("kp", "damping", "armature", "delay", "offset")
STD = torch.tensor([0.2, 0.05, 0.1, 0.002, 0.1], dtype=torch.float64)
"""Of logarithms, of the first three."""


@pytest.fixture(scope="module")
def base():
    return diagnosis(
        finding("set_point_profile", 1, 14.0, 8.0, acceleration=40.0),
        finding("command_delay", 2, 12.0, 8.0, delay=0.02),
    )


def run(base, seed: int, claimed: float = 1.0, **change: float):
    """Servos whose numbers vary by what they state, all torques of a joint by one factor, too.

    Args:
        base: a diagnosis.
        seed: of the numbers.
        claimed: deviations that are stated over the true ones.
        change: steps of numbers of joint 2, in their deviations.
    """
    g = torch.Generator().manual_seed(seed)
    joint, known = true_servos(3).joint.clone(), []
    logs = torch.tensor([PARAMETERS[INDEX[name]].kind == "log" for name in NAMES])
    root = STD.diag()
    root[[1, 2], 0] = STD[0]  # damping and armature follow the gain
    for j in range(2):
        step = root @ torch.randn(len(NAMES), generator=g, dtype=torch.float64)
        step = step + (j == 1) * STD * torch.tensor([change.get(name, 0.0) for name in NAMES])
        at = [INDEX[name] for name in NAMES]
        joint[j, at] = torch.where(logs, joint[j, at] * step.exp(), joint[j, at] + step)
        covariance = claimed**2 * root @ root.T
        known.append(KnownRecord(joint=j, names=NAMES, covariance=covariance))
    return replace(base, servos=Servos(joint, base.servos.plane), known=tuple(known))


def test_honest_servos_agree_and_causes_are_the_same(base):
    found = compare_results([run(base, k) for k in range(4)])
    assert found.kind == "position diagnoses"
    assert not found.having("differ")
    assert {c.label for c in found.causes} == {
        "set_point_profile of joint 1", "command_delay of joint 2",
    }  # fmt: skip
    assert all(set(c.states) == {"named"} for c in found.causes)
    said = verdict(found)
    assert said.startswith("4 position diagnoses of 3r. All name")
    assert "0 differ" in said
    by_name = {p.name: p for p in found.parameters}
    # No load anchors joint 1 (`ratio_only`): its gain is no number, and torques are shares of it.
    assert set(by_name) == {
        *(f"{name}/kp 1" for name in ("damping", "armature", "offset")), "delay 1",
        *(f"{name} 2" for name in NAMES),
    }  # fmt: skip
    assert by_name["damping/kp 1"].unit == "s"
    share = by_name["damping/kp 1"]
    assert torch.allclose(share.own_std, 0.05 * share.own, rtol=1e-6)
    assert by_name["delay 2"].cause == "command_delay of joint 2"
    assert by_name["kp 2"].own_std == pytest.approx((0.2 * by_name["kp 2"].own).tolist(), rel=1e-6)
    assert any("shares of kp" in note for note in found.notes)


def test_a_number_that_changed_differs_and_no_other(base):
    found = compare_results([run(base, k, damping=12.0 * k) for k in range(3)])
    assert {p.name for p in found.having("differ")} == {"damping 2"}
    (changed,) = found.having("differ")
    # Its size is told in its own unit, though it is judged as a logarithm.
    assert changed.unit == "N m s/rad"
    assert changed.own.min() < changed.mean < changed.own.max()
    assert changed.between / changed.mean == pytest.approx(float(changed.own.log().std()), rel=0.1)


def test_deviations_that_are_too_small_are_said(base):
    found = compare_results([run(base, k, claimed=0.2) for k in range(6)])
    said = " ".join(verdict(found).split())
    ratio = float(said.partition("values spread ")[2].partition(" times")[0])
    assert 3.5 < ratio < 7
    assert "the standard deviations of single results are too small" in said


def test_what_a_result_does_not_have_is_left_open(base, tmp_path):
    """A file of an older version without deviations: values, and nothing is tested of two."""
    run(base, 0).save(tmp_path / "new.json")
    data = json.loads((tmp_path / "new.json").read_text())
    del data["known"]
    (tmp_path / "old.json").write_text(json.dumps(data))
    found = compare_results([tmp_path / "new.json", tmp_path / "old.json"])
    assert {p.verdict for p in found.parameters} == {"not_compared"}
    assert all(math.isnan(float(p.own_std[1])) for p in found.parameters)
    assert any("old of an older version" in note for note in found.notes)
    # Only names that some log told are in the table; a limit that none has is not.
    assert not any(p.name.startswith("speed") for p in found.parameters)


def test_along_a_log_the_nearest_is_told(base, tmp_path):
    """Of two, the one whose servos are those that made the log."""
    true = replace(run(base, 0), servos=true_servos(3))
    log = planted(true_servos(3), motions=2, seconds=6.0, seed=5)
    files = [tmp_path / "off.json", tmp_path / "true.json"]
    run(base, 3, damping=20.0).save(files[0])
    true.save(files[1])
    found = compare_results(files, robot=robot(), on=log)
    whole = found.positions.whole
    assert whole.shape == (2, 3)
    assert bool((whole[1, :2] < 1.5).all())  # counts of an encoder, and joints at rest
    assert bool((whole[0, :2] > whole[1, :2]).all())
    assert bool(whole[:, 2].isnan().all())  # it never moves there
    assert "true is the closest" in verdict(found)
    titles = [part.title for part in report_of_comparison(found).parts if part is not None]
    assert any(title.startswith("position errors on the motion of") for title in titles)
    found.save(tmp_path / "compare.json")
    assert torchid.load(tmp_path / "compare.json").plain() == found.plain()
    with pytest.raises(TorchidError, match="a replay needs the robot"):
        compare_results(files, on=log)


def test_other_arms_are_refused(base):
    one = run(base, 0)
    data = replace(one.data, robot=replace(one.data.robot, joint_names=("a", "b", "c")))
    with pytest.raises(TorchidError, match="of other arms"):
        compare_results([one, replace(one, data=data)])
    assert load_robot("3r").joint_names != ("a", "b", "c")
