"""Cases are functions of seed and number; every effect has its turn."""

from collections import Counter

import pytest

from torchid.errors import TorchidError
from torchid_bench.withheld.plant.arms import arm_named
from torchid_bench.withheld.plant.catalogue import FOREIGN, LIBRARY, REDRAWN
from torchid_bench.withheld.plant.draw import EXCLUSIVE, MIXES, draw_case
from torchid_bench.withheld.plant.settings import DRAWS


def test_a_case_depends_on_seed_and_number_alone():
    later = draw_case(3, 17)
    assert later == draw_case(3, 17)
    assert later != draw_case(4, 17)
    assert draw_case(3, 16) != later


def test_every_kind_has_its_share():
    kinds = Counter(draw_case(8, k).kind for k in range(200))
    block = MIXES["mixed"].block
    assert set(kinds) == set(block)
    assert kinds["none"] == 40
    assert all(kinds[k] == 10 * block.count(k) for k in block)
    first = [draw_case(8, k).kind for k in range(20)]
    second = [draw_case(8, k).kind for k in range(20, 40)]
    assert first != second


def test_every_effect_has_its_turn_before_any_comes_twice():
    cases = [draw_case(8, k) for k in range(100)]
    singles = [c.effects[0].name for c in cases if c.kind == "single"]
    assert set(singles[: len(LIBRARY)]) == set(LIBRARY)
    outside = [c.effects[0].name for c in cases if c.kind == "outside"]
    assert set(outside[: len(FOREIGN)]) == set(FOREIGN)
    levels = [c.level for c in cases if c.kind == "severity"]
    assert set(levels[: len(DRAWS.levels)]) == set(DRAWS.levels)


def test_arms_do_not_matter_to_what_is_planted_elsewhere():
    for k in range(60):
        case = draw_case(2, k)
        n = arm_named(case.arm).n
        assert all(0 <= j < n for e in case.effects for j in e.joints)
        assert (case.level is None) == (not case.effects)
        assert (case.poor is not None) == (case.kind == "poor") == (case.excitation != "rich")
        alone = [j for e in case.effects if e.name in EXCLUSIVE for j in e.joints]
        assert len(alone) == len(set(alone))


def test_what_is_given_is_not_drawn():
    case = draw_case(6, 3, effects=["payload"], level=2.0, arm="6r")
    assert (case.kind, case.level, case.arm) == ("single", 2.0, "6r")
    assert [e.name for e in case.effects] == ["payload"]
    assert draw_case(6, 3, effects=["backlash", "cogging"], arm="7r").kind == "several"
    # Noise, motion and logger are those of the number, whatever is planted.
    assert case.motion.seed == draw_case(6, 3, kind="none", arm="6r").motion.seed


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "easy"}, "unknown kind"),
        ({"effects": ["magic"]}, "no effect 'magic'"),
        ({"arm": "9r"}, "unknown withheld robot"),
        ({"effects": ["backlash", "joint_elasticity", "gear_coupling"], "arm": "3r"}, "joints of"),
    ],
)
def test_what_does_not_exist_is_refused(given, message):
    with pytest.raises(TorchidError, match=message):
        draw_case(0, 0, **given)


def test_a_release_has_other_shares_other_physics_and_other_noise():
    cases = [draw_case(8, k, mix="release") for k in range(190)]
    kinds = Counter(c.kind for c in cases)
    assert kinds == {"none": 40, "single": 80, "outside": 40, "several": 30}
    assert {c.effects[0].name for c in cases if c.kind == "outside"} == set(REDRAWN)
    quiet = [c.logger for c in cases if c.kind == "none"]
    assert sum(x.colour_hz is not None for x in quiet) == sum(x.grows > 0 for x in quiet) == 10
    assert all(min(c.viscous) > 0 for c in cases if c.kind == "several")
    assert draw_case(8, 3) == draw_case(8, 3, mix="mixed")
    with pytest.raises(TorchidError, match="unknown mix"):
        draw_case(8, 3, mix="martini")
