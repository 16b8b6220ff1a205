"""What a search has for candidates."""

from dataclasses import replace

from tests.gap.problems import Case
from torchid.gap.task import banks_of


def test_a_search_that_is_told_has_those_candidates_alone():
    case = Case([], ("coulomb_friction", "base_tilt", "time_delay", "link_inertia"))

    def told(*only):
        task = replace(case.task, only=only)
        return [(b.name, b.place, len(b.members[0])) for b in banks_of(case.evaluator, task)]

    assert told(("coulomb_friction", 1)) == [("coulomb_friction", 1, 1)]
    assert [name for name, _, _ in told(("base_tilt", None))] == ["base_tilt"]
    # On one joint, not the one that is common to all.
    assert [count for _, _, count in told(("time_delay", 1))] == [1]
    assert len(told(("time_delay", None))) == case.robot.n + 1
    assert [name for name, _, _ in told(("link_inertia", 2))] == ["link_inertia"]
    assert told(("coulomb_friction", 0), ("link_inertia", 2))[1][0] == "link_inertia"
    assert len(told()) == 0
