"""A diagnosis of an arm whose file has a usual mistake: named as such, not as effects of joints."""

import pytest

from tests.arms import arm
from tests.effects.test_file_mistakes import mistaken
from tests.marks import some
from torchid.excitation.design import excite
from torchid.excitation.synthetic import simulate
from torchid.gap.torque import diagnose_torque

EVERY = slice(None)
CASES = (
    ("3r", "point", EVERY),
    ("3r", "unit", 1),
    ("kuka_lwr4", "point", EVERY),
    ("kuka_lwr4", "mirror", 1),
)
NAMES = {"point": "inertia_reference_point", "unit": "inertia_scale", "mirror": "mirrored_link"}


@pytest.mark.parametrize(("name", "kind", "link"), some(CASES, slow=2, several=True))
def test_a_mistake_is_named(name, kind, link):
    """Of one link, or of all, beside dry friction that the file lacks."""
    robot = arm(name)
    motion = excite(robot, duration=15.0, restarts=1, iterations=0).log()
    friction = {"effect": "coulomb_friction", "joint": 2, "Fc": 1.0}
    log = simulate(robot, motion, effects=[friction])
    found = diagnose_torque(mistaken(robot, kind, link), log)
    named = {(f.effect, f.at) for f in found.which}
    place = () if link == EVERY else (link,)
    assert named == {(NAMES[kind], place), ("coulomb_friction", (1,))}
    assert all(f.how_sure > 0.9 for f in found.which)
    truth = robot.require_parameters("a test").pi
    corrected = found.corrected.require_parameters("a test").pi
    assert float((corrected - truth).norm()) < 0.05 * float(truth.norm())
