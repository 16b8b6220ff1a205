"""A friction law in words, and as one entry of an answer."""

import math

import msgspec
import pytest
from msgspec import UNSET

from tests.causes import errors, numbers
from torchid.results.answer import Answer, JointError
from torchid.results.cause import Cause, Size
from torchid.results.friction import FrictionAt, FrictionDetail, FrictionLaw


def law(joint: int = 0, **other: object) -> FrictionLaw:
    torques = ((0.1, 1.2), (0.5, 1.9), (2.0, 3.4))
    details = (("dry", ("coulomb_friction",), 0.999), ("viscous", ("viscous_friction",), 0.93))
    return FrictionLaw(
        **{
            "joint": joint, "how_sure": 0.995, "share": 0.5, "removes": (1.0,), "unit": "N m",
            "speed_unit": "rad/s",
            "details": [FrictionDetail(detail=d, effects=e, how_sure=p) for d, e, p in details],
            "at": [FrictionAt(v, x, 0.1, -x, 0.1) for v, x in torques], **other,
        }
    )  # fmt: skip


def answer(*causes: Cause, laws: tuple[FrictionLaw, ...], n: int = 3) -> Answer:
    joints = [
        JointError(joint=j, name=f"j{j}", before=5.0, after=1.0, noise=(0.1, 0.2)) for j in range(n)
    ]
    return Answer(
        status="explained", error="the gap", unit="N m", **errors(9.0, 2.0), noise=(0.1, 0.2),
        closed=0.9, joints=joints, causes=causes, friction=laws,
    )  # fmt: skip


def cause(effect: str, *joints: int, share: float = 0.1) -> Cause:
    size = Size(name="c", unit="N m", value=1.5, std=0.1)
    return Cause(effect=effect, joints=joints, how_sure=0.9, share=share, **numbers(size))


def test_three_speeds_or_the_middle_one():
    assert law().words() == "1.2, 1.9, 3.4 N m at 0.1, 0.5, 2 rad/s"
    assert law().words(every=False) == "1.9 N m at 0.5 rad/s"
    assert [d.words for d in law().details] == ["dry > 99 %", "viscous 93 %"]


def test_directions_are_averaged_and_one_alone_is_enough():
    assert FrictionAt(1.0, 2.0, 0.1, -4.0, 0.1).size == 3.0
    assert FrictionAt(1.0, math.nan, math.nan, -4.0, 0.1).size == 4.0
    assert law(at=[FrictionAt(1.0, *[math.nan] * 4)]).words() == ""


def test_several_terms_of_a_joint_are_one_entry():
    every = [cause(name, j) for j in range(3) for name in ("coulomb_friction", "viscous_friction")]
    gain = cause("torque_gain", share=0.05)
    said = answer(*every, gain, laws=tuple(map(law, range(3))))
    assert [c.law is UNSET for c in said.entries] == [False] * 3 + [True]
    assert [c.share for c in said.entries[:3]] == pytest.approx([0.2] * 3)
    assert said.causes == (*every, gain)
    # Not one row of all joints.
    assert said.shared() == [(gain,)]
    assert all([c.name for c in row.causes] == ["friction"] for row in said.joint_rows())
    assert "friction 1.2, 1.9, 3.4 N m at 0.1, 0.5, 2 rad/s" in str(said)


def test_one_term_keeps_its_name_and_so_does_what_is_elsewhere():
    one, other, arm = (
        cause("coulomb_friction", 0), cause("viscous_friction", 1), cause("viscous_friction"),
    )  # fmt: skip
    said = answer(one, other, arm, laws=(law(0), law(1)))
    assert said.entries == said.causes == (one, other, arm)


@pytest.mark.parametrize(("unnamed", "as_law"), [(0.1, True), (0.0, False), (-0.1, False)])
def test_one_sure_term_is_a_law_where_others_remove_some_of_the_error_too(unnamed, as_law):
    one = cause("presliding_hysteresis", 0)
    details = [FrictionDetail(detail="loop", effects=("presliding_hysteresis",), how_sure=0.99)]
    said = answer(one, laws=(law(0, details=details, unnamed=unnamed),))
    assert [c.law is not UNSET for c in said.entries] == [as_law]
    assert "unnamed" not in msgspec.structs.replace(said, unnamed=-0.1).headline
    assert ", 10 % unnamed" in msgspec.structs.replace(said, unnamed=0.1).headline
