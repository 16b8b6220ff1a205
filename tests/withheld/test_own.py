"""An accepted effect is found again."""

import json
from dataclasses import replace

import pytest

from tests.gap.test_diagnose import FC, QUICK, REAL, ROBOT, logged
from torchid.json_data import plain
from torchid.withheld import own
from torchid.withheld.own import withheld_own

pytestmark = pytest.mark.usefixtures("types_unchecked")

ONE = ("coulomb_friction", (1,))


@pytest.fixture(scope="module")
def found():
    """Friction of joint 2, withheld on other runs; the library is small, to be quick."""
    settings = replace(QUICK, effects=("coulomb_friction", "viscous_friction", "torque_offset"))
    runs = logged(REAL, (3, 4, 3), 5)
    return withheld_own(ROBOT, logged(REAL), untouched=runs, settings=settings)


@pytest.mark.nightly
def test_what_was_accepted_is_found_again_and_closes_as_much(found):
    assert [(w.effect, w.joints) for w in found.withheld] == [ONE]
    (friction,) = found.withheld
    assert friction.named
    assert friction.in_set
    assert friction.as_much
    assert friction.known == pytest.approx(1.0, abs=0.1)
    assert ONE in [(f.effect, f.joints) for f in friction.found]
    assert found.whole


@pytest.mark.nightly
def test_without_the_right_name_nothing_is_found_again(found):
    """The corrected model knows the friction; searched over others, another name is none."""
    settings = replace(QUICK, effects=("torque_offset",))
    bed = own.Bed(found.first.corrected, logged(REAL, (3, 4, 3), 5), settings)
    (finding,) = found.first.findings
    assert len(own._without(bed.robot, finding).effects) == 0
    missed = own._withheld(bed, finding)
    assert not missed.named
    assert not missed.in_set
    assert missed.as_much is False


@pytest.mark.nightly
def test_the_record_is_json_with_joints_from_one(found):
    data = found.plain()
    assert json.loads(json.dumps(data)) == data
    assert data["withheld"][0]["joints"] == [2]
    assert data["diagnosis"]["schema"] == "torchid.gap/1"
    value = data["diagnosis"]["which"][0]["parameters"]
    assert plain(value)["Fc"] == pytest.approx(FC, rel=0.1)
