"""What an answer states is what its errors say."""

import json
import math
from pathlib import Path

import msgspec
import pytest

from tests.causes import errors, numbers
from torchid.report.page.answer import cause_line
from torchid.results.answer import Answer, JointError, cause_cells
from torchid.results.cause import Cause, Size, Window, cut_line
from torchid.results.friction import FrictionDetail, FrictionLaw

GOLDEN = Path(__file__).parents[1] / "golden" / "answers"


STORED = {file.stem: json.loads(file.read_text()) for file in sorted(GOLDEN.glob("*.json"))}
ANSWERS = {name: stored["answer"] for name, stored in STORED.items() if stored.get("answer")}


@pytest.mark.parametrize("answer", ANSWERS.values(), ids=ANSWERS)
def test_no_share_is_above_what_the_errors_say(answer):
    """By more than the noise that is taken out of both: where repeats measured it, at most that."""
    before, after = (answer[key]["value"] for key in ("before", "after"))
    low, high = answer["noise"]
    noise = min(high if answer.get("noise_measured") else low, after)
    left = ((after**2 - noise**2) / (before**2 - noise**2)) ** 0.5 if before > noise else 0.0
    if answer["closed"] is not None:
        assert answer["closed"] <= 1 - left + 1e-9
    if answer["unit"] != "mrad":  # of positions each cause is judged on its own joint
        assert sum(c["share"] for c in answer["causes"]) <= 1 - after / before + 1e-9


def answer(**other):
    joints = (JointError(joint=0, name="j", before=10.0, after=8.0, noise=(0.1, 8.0)),)
    cause = Cause(effect="torque_offset", joints=(0,), share=0.2)
    return Answer(
        **{
            "status": "explained", "error": "the gap", "unit": "N m", **errors(10.0, 8.0),
            "noise": (0.1, 8.0), "closed": 1.0, "joints": joints, "causes": (cause,), **other,
        }
    )  # fmt: skip


@pytest.mark.parametrize("measured", [False, True])
def test_all_of_an_error_needs_a_measured_noise(measured):
    said = answer(noise_measured=measured).headline
    assert "error 10 -> 8 N m on motions left out (20 % less" in said
    assert ("to the noise" in said) == measured
    assert " all" not in said


@pytest.mark.parametrize("status", ["detected_unexplained", "not_testable", "no_gap"])
def test_a_headline_without_a_cause_says_the_likeliest(status):
    suspect = Cause(
        effect="viscous_friction", joints=(2,), how_sure=0.82, remedy="move faster",
        **numbers(Size(name="Fv", unit="N m s/rad", value=5.6, std=0.7)),
    )  # fmt: skip
    said = answer(status=status, causes=(), suspects=(suspect,), closed=None).headline
    likely = "Most likely: viscous friction on joint 3 (5.6 ± 0.7 N m s/rad, 82 %)."
    assert said.endswith(likely) == (status != "no_gap")
    assert answer(suspects=(suspect,)).suspect_lines == [
        "viscous friction on joint 3 (5.6 ± 0.7 N m s/rad, 82 %): move faster"
    ]


def test_rivals_of_one_joint_are_no_rivals_of_others():
    causes = [
        Cause(
            effect="torque_gain", joints=(j,), share=0.1, how_sure=0.99 - 0.4 * (j == 2),
            ambiguous_with=("filter_lag",) if j == 2 else (),
            **numbers(Size(name="gain", unit="1", value=0.3, std=0.01)),
        )
        for j in range(3)
    ]  # fmt: skip
    said = answer(causes=tuple(causes)).headline
    assert said.startswith(
        "Torque gain on joints 1 and 2 (gain = 0.3, 0.3) and torque gain on joint 3 (gain = 0.3): "
    )


@pytest.mark.parametrize("value", [-1e-3, -1e-5, 0.0])
def test_nothing_has_no_sign(value):
    assert "-0 %" not in answer(unnamed=value).headline


def spring(joint: int, k: float, c0: float) -> Cause:
    """A counterbalance, most of whose torque is that at q = 0."""
    sizes = (
        Size(name="c0", unit="N m", value=c0, std=0.4), Size(name="k", unit="N m/rad", value=k),
    )  # fmt: skip
    return Cause(
        effect="joint_spring", joints=(joint,), how_sure=0.97, share=abs(c0) / 20, **numbers(*sizes)
    )


def test_short_of_room_a_cause_shows_what_makes_its_torque():
    cause = spring(1, k=-0.8, c0=8.9)
    assert cause.values() == "c0 = 8.9 ± 0.4 N m, k = -0.8 N m/rad"
    assert cause.values(std=False) == "c0 = 8.9 N m"
    assert answer(suspects=(cause,)).suspect_lines == [
        "joint spring on joint 2 (c0 = 8.9 ± 0.4 N m, 97 %): "
    ]


def test_a_number_that_joints_share_a_row_for_is_one_number():
    """That of the largest cause; a cause whose own largest is another shows it as well."""
    small = spring(0, k=2.0, c0=0.5)
    small = msgspec.structs.replace(small, main="k")
    text, *_ = cause_cells((small, spring(1, k=-0.8, c0=8.9)))
    assert text == "joint spring c0 = 0.5, 8.9 N m"


def test_printed_it_is_the_headline_and_its_table():
    headline, blank, title, head, row = str(answer()).split("\n")
    assert (headline, blank, title) == (answer().headline, "", answer().title)
    assert head.index("before") == row.index("10")


@pytest.mark.parametrize(("high", "joint"), [(9.9, 2), (float("nan"), 1)])
def test_a_gap_is_largest_where_it_is_most_beyond_noise(high, joint):
    joints = (
        JointError(joint=0, name="a", before=10.0, after=10.0, noise=(5.0, high)),
        JointError(joint=1, name="b", before=3.0, after=3.0, noise=(0.1, 0.2)),
        JointError(joint=2, name="c", before=float("nan"), after=float("nan"), noise=(0.0, 0.0)),
    )
    said = answer(status="detected_unexplained", causes=(), joints=joints).headline
    assert said.endswith(f"It is largest on joint {joint}.")


@pytest.mark.parametrize("measured", [False, True])
def test_what_is_unexplained_is_said_with_its_size_and_what_to_record(measured):
    said = answer(
        status="detected_unexplained", causes=(), noise_measured=measured, noise=(0.04, math.nan),
        unexplained="1.09 N m on joint 3, 25 times the least noise",
    ).headline  # fmt: skip
    end = "." if measured else "; record one motion twice."
    assert said == (f"No known effect explains 1.09 N m on joint 3, 25 times the least noise{end}")


@pytest.mark.parametrize(
    ("status", "more", "words"),
    [
        ("no_gap", {}, "that this log can tell from noise"),
        ("negligible", {}, "that matters"),
        ("negligible", {"since": "a.csv"}, "that is new"),
    ],
)
def test_what_is_small_is_not_called_noise(status, more, words):
    said = answer(
        status=status, causes=(), noise=(0.04, math.nan), reason="At most 1 N m.", **more
    ).headline
    assert said == f"No gap {words}: 10 N m (noise >= 0.04). At most 1 N m."


def test_a_change_of_a_link_of_which_the_kind_alone_is_sure_has_the_kinds_name():
    cause = Cause(effect="link_inertia", joints=(2,), share=0.2, branch="inertia")
    said = answer(causes=(cause,)).headline
    assert said.startswith(f"{cause.kind[:1].upper()}{cause.kind[1:]} on link 3 (")
    plain = answer(causes=(msgspec.structs.replace(cause, branch=""),)).headline
    assert plain.startswith("Inertia of link 3 (")


@pytest.mark.parametrize(("unnamed", "words"), [(0.0, "smaller"), (0.18, "more")])
def test_beside_what_is_unsure_and_larger_the_others_are_more(unnamed, words):
    effects = ("torque_offset", "viscous_friction", "joint_spring", "torque_ripple", "filter_lag")
    causes = tuple(Cause(effect=e, joints=(0,), share=0.01) for e in effects)
    suspect = Cause(effect="backlash", joints=(0,), share=0.15, how_sure=0.4)
    said = answer(causes=causes, suspects=(suspect,), unnamed=unnamed).headline
    assert f" {words}: error" in said
    assert said.startswith("Perhaps backlash on joint 1") == (unnamed > 0)


@pytest.mark.parametrize(
    ("own", "name", "rivals"),
    [
        (0.4, "friction (likely Coulomb friction)", ", or viscous friction or Stribeck friction"),
        (
            0.26,
            "friction (one of viscous friction, Stribeck friction or Coulomb friction)",
            "",
        ),
    ],
)
def test_likely_is_said_of_the_likeliest_alone(own, name, rivals):
    others = {"stribeck_friction": 0.35, "viscous_friction": 0.37}
    cause = Cause(
        effect="coulomb_friction", branch="friction", joints=(1,),
        probabilities={"coulomb_friction": own, **others},
        ambiguous_with=("viscous_friction", "stribeck_friction"),
    )  # fmt: skip
    assert (cause.name, cause.rivals) == (name, rivals)


@pytest.mark.parametrize(
    ("own", "other", "name", "words"),
    [
        (0.62, 0.31, "torque gain", "torque gain on joint 1 (gain = 0.02)"),
        (
            0.48,
            0.45,
            "one of torque gain or torque offset",
            "one of torque gain or torque offset on joint 1 (gain",
        ),
        (
            0.31,
            0.33,
            "one of torque offset or torque gain",
            "one of torque offset or torque gain on joint 1 (2 N m)",
        ),
    ],
)
def test_a_set_has_the_name_that_the_set_is_sure_of(own, other, name, words):
    """No number, and no probability, stands beside what it is not of."""
    cause = Cause(
        effect="torque_gain", joints=(0,), share=0.2, how_sure=max(own, own + other - 0.31),
        probabilities={"torque_gain": own, "torque_offset": other},
        ambiguous_with=("torque_offset",), parameters={"gain": 0.02}, std={"gain": 0.001},
        unit={"gain": "1"}, main="gain",
    )  # fmt: skip
    assert cause.name == name
    said = answer(causes=(cause,)).headline
    assert said.startswith(words[:1].upper() + words[1:])
    assert (cause.rivals == "") == (own < 0.5)
    assert bool(cause.known) == (own > other)
    assert cause_line(cause)[3] == ("could also be torque offset" if own > 0.5 else "")


def test_a_part_of_a_curve_is_not_as_sure_as_the_curve():
    """A law of position that no term of the library is: its probability is that of all of them."""
    cause = Cause(
        effect="cogging", joints=(0,), how_sure=0.8, ambiguous_with=("torque_ripple",),
        probabilities={"cogging": 0.0},
    )  # fmt: skip
    assert cause.name == "one of cogging or torque ripple"


WAS, NEW = ({"when": when} for when in ("in both", "new"))


@pytest.mark.parametrize(
    ("whens", "said"),
    [
        ((NEW, WAS), "New since may: 3 N m {0}. Lacking already in may: 4 N m {1}."),
        ((WAS, NEW), "New since may: 4 N m {1}. Lacking already in may: 3 N m {0}."),
        ((WAS, WAS), "Nothing is new since may. Lacking already in may: 4 N m {1} and 3 N m {0}."),
        ((NEW, NEW), "New since may: 4 N m {1} and 3 N m {0}."),
        (
            ({}, WAS),
            "Nothing is surely new since may. New or lacking already in may: 3 N m {0}. "
            "Lacking already in may: 4 N m {1}.",
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("confirmed", [True, False])
def test_what_is_new_and_what_was_lacking_share_no_sentence(whens, said, confirmed):
    effects = {"coulomb_friction": 3.0, "torque_offset": 4.0}
    causes = tuple(
        Cause(
            effect=effect, joints=(k,), share=size / 20, **when,
            **numbers(Size(name="F", unit="N m", value=size)),
        )
        for k, ((effect, size), when) in enumerate(zip(effects.items(), whens, strict=True))
    )  # fmt: skip
    of = answer(causes=causes, since="may", **({} if confirmed else {"closed": None}))
    said = said.format("Coulomb friction on joint 1", "torque offset on joint 2")
    if not confirmed:
        said = said.replace("may:", "may, not confirmed:")
    assert of.headline.startswith(f"{said} Error 10 -> 8 N m on motions left out")
    legend = of.legend(of.headline)
    assert ("not there in that log" in legend) == ("ew since" in said)
    assert ("there in that log as well" in legend) == ("acking already" in said)
    cells = [cause_cells((c,))[0] for c in causes]
    ends = {"new": ", new", "in both": ", lacking already"}
    assert all(
        c.endswith(ends.get(w.get("when"), "N m")) for c, w in zip(cells, whens, strict=True)
    )


def test_what_unexplained_says_stands_beside_it():
    of = answer(status="detected_unexplained")
    assert "; rest unexplained" in of.headline
    assert of.legend(of.headline).startswith("Unexplained: more than noise may be")
    assert answer().legend(answer().headline) == ""


def test_short_of_room_causes_of_each_kind_are_counted():
    effects = ("torque_offset", "viscous_friction", "joint_spring", "torque_ripple", "filter_lag")
    causes = tuple(
        Cause(effect=e, joints=(0,), share=0.01, when="new" if k < 2 else "in both")
        for k, e in enumerate(effects)
    )
    said = answer(causes=causes, since="a_log_with_a_name_that_is_long_enough").headline
    new, lacking, *_ = said.split(". ")
    assert " and 1 more" in new
    assert lacking.endswith(": 3 causes")


def test_a_law_is_told_apart_from_what_is_new_in_it():
    effects = ("viscous_friction", "coulomb_friction")
    law = FrictionLaw(
        joint=0, how_sure=0.9, share=0.3, unnamed=0.1, removes=(3.0,), unit="N m",
        speed_unit="rad/s", at=(),
        details=(FrictionDetail(detail="", effects=effects, how_sure=0.9),),
    )  # fmt: skip
    new, was = (
        Cause(effect=effect, joints=(0,), share=0.1, when=when)
        for effect, when in [("viscous_friction", "new"), ("coulomb_friction", "in both")]
    )
    entries = answer(causes=(new, was), friction=(law,), since="may").entries
    # The law's numbers are of both together, and stand beside neither.
    assert entries == (new, was)


@pytest.mark.parametrize("share", [0.1, 0.0, -0.1, math.nan])
def test_what_takes_nothing_away_says_so(share):
    """A cause has its name all the same: it is there, and others do more without it."""
    size = Size(name="F", unit="N m", value=2.0, std=0.1)
    cause = Cause(effect="torque_offset", joints=(0,), share=share, **numbers(size))
    assert ("takes no error away" in cause.values()) == (share <= 0)
    assert answer().takes(cause) >= 0


def test_a_line_that_cuts_events_has_the_brackets_that_it_needs():
    windows = [Window(trajectory="run1", from_s=k, to_s=k + 0.5) for k in (1.0, 3.0)]
    causes = [Cause(effect="contact", joints=(0,), window=w) for w in windows]
    assert cut_line(causes[:1]) == (
        "in Python, of run1: `log = log.select((log.t < 1.0) | (log.t > 1.5))`"
    )
    assert cut_line(causes).endswith(
        "select(((log.t < 1.0) | (log.t > 1.5)) & ((log.t < 3.0) | (log.t > 3.5)))`"
    )


def test_of_causes_without_numbers_so_far_joints_and_names_are_said():
    """One name on two joints: a search knows its numbers at its end."""
    causes = [Cause(effect="command_delay", joints=(j,)) for j in (1, 2)]
    joints = [(f"j{k}", 3.0, 1.0) for k in range(1, 4)]
    text = str(Answer.so_far("error", "mrad", (3.0, 1.0), joints, causes))
    assert "joints 2 and 3  " in text
    assert "command delay" in text


@pytest.mark.parametrize(("was", "determined"), [(None, False), (0.5, True), (0.005, False)])
def test_what_is_gone_is_determined_by_what_the_file_has(was, determined):
    size = Size(name="m", unit="kg", value=0.001, std=0.01, was=was)
    assert size.determined == determined
