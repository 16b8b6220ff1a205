"""Three runs, of which one may have other friction: what each wants, and which differs."""

import pytest

import torchid
from tests.gap.small_logs import ROBOT, Recording, arm, friction, logged
from torchid.log.model import Log
from torchid.report.diagnosis import report_of_diagnosis

pytestmark = pytest.mark.slow
ONLY = ("coulomb_friction", "viscous_friction", "torque_offset")


def found_of(*planted: float):
    """The diagnosis of runs with these Fc [N m] on joint 2, and viscous friction on joint 1."""
    logs = [
        logged(
            arm(friction(2, Fc=fc), friction(1, Fv=0.5)), Recording(runs=(k,), seed=k)
        ).replace(names=(f"run{k + 1}",))
        for k, fc in enumerate(planted)
    ]  # fmt: skip
    settings = torchid.GapSettings(effects=ONLY)
    return torchid.diagnose(ROBOT, Log.concatenate(logs), settings=settings)


@pytest.mark.parametrize(
    ("planted", "odd"),
    [((0.61, 0.61, 0.61), []), ((0.61, 0.61, 0.9), ["run3"]), ((0.3, 0.61, 0.61), ["run1"])],
)
def test_each_run_has_its_value_and_the_odd_one_is_named(planted, odd, tmp_path):
    found = found_of(*planted)
    dry = [r for r in found.agreement if r.effect == "coulomb_friction"]
    assert [r.run for r in dry] == ["run1", "run2", "run3"]
    assert [r.value for r in dry] == pytest.approx(planted, rel=0.03)
    assert all(r.std < 0.05 for r in dry)
    viscous = [r for r in found.agreement if r.effect == "viscous_friction"]
    assert [r.value for r in viscous] == pytest.approx([0.5] * 3, rel=0.03)
    differs = [r.run for r in found.agreement if r.verdict == "differs"]
    assert differs == odd
    # The first screen cautions, where one contradicts the others.
    cautions = [
        w
        for w in report_of_diagnosis(found).warnings
        if " wants Coulomb friction on joint 2 of " in w
    ]
    assert [w.split()[1] for w in cautions] == odd
    found.save(tmp_path / "gap.json")
    again = torchid.load(tmp_path / "gap.json")
    assert list(again.agreement.to_frame().run) == [r.run for r in found.agreement]


@pytest.mark.parametrize(
    ("fc", "more", "odd"), [(0.6, 0, ["run3"]), (0.4, 2, ["run3"]), (0.0, 0, [])]
)
def test_what_one_run_alone_has_is_named_though_it_is_no_law_of_all(fc, more, odd):
    """A mean of all runs is unlikely there, and in no other run it is."""
    found = found_of(0.0, 0.0, fc, *[0.0] * more)
    wants = [r for r in found.agreement if r.verdict == "differs"]
    assert [r.run for r in wants] == odd
    assert [r.effect for r in wants] == ["coulomb_friction"] * len(odd)
    assert [r.value for r in wants] == pytest.approx([fc] * len(odd), rel=0.03)
    assert all(s.how_sure < 0.5 for s in found.suspects)
