"""The page of a diagnosis says what the diagnosis holds."""

from dataclasses import replace
from io import StringIO
from typing import get_args

import pytest
from msgspec import structs
from rich.console import Console

from tests.gap.diagnoses import FRICTION, OFFSET, VISCOUS, coulomb, diagnosis, some_left, trace
from tests.marks import quick_first
from tests.report.page.reading import headings, parsed, rows_of, text_of
from torchid.gap.cause_records import body_cause
from torchid.gap.diagnosis import HowFar
from torchid.gap.record import Budget, Status
from torchid.report.brief import Screen
from torchid.report.diagnosis import STATUS, page
from torchid.report.page import document as rendering
from torchid.report.page.document import InputFile, origin, render
from torchid.results.agreement import MotionScale
from torchid.results.replication import replication_of
from torchid.results.words import effect_words

FILES = (InputFile("log", "run <1>.csv", 1234567, "ab" * 32),)


def made(**changes):
    given = {
        "arguments": ["/usr/bin/torchid", "gap", "3r", "run <1>.csv"],
        "started": 0.0,
        "seeds": {"seed": 7},
        "settings": {"cutoff": "auto", "trusted": True, "effects": ("a", "b"), "alpha": 0.01},
        "files": FILES,
    }
    return origin(**(given | changes))


SHORT = {"traces": (trace(coulomb, some_left, seconds=12.0),)}


def page_of(d, origin=None):
    return parsed(render(page(d, origin or made())))


@pytest.fixture
def undrawn(monkeypatch):
    """Pages with empty figures: drawing takes most of the time."""
    empty = '<svg role="img" aria-label="{}"></svg>'
    monkeypatch.setattr(rendering, "inline_svg", lambda p: empty.format(p.alt))


@pytest.mark.parametrize("status", get_args(Status))
def test_verdict_and_status(status, undrawn):
    d = diagnosis(status, **SHORT)
    tree = page_of(d)
    assert text_of(tree, "verdict").replace("\u00a0→\u00a0", " -> ") == d.answer.headline
    assert STATUS[status] in text_of(tree, "facts")
    assert tree.xpath("//header/*[1]")[0].tag == "h1"
    assert tree.xpath("//header/*[2]")[0].get("class") == "verdict"


def test_one_screen_then_sections_that_fold(undrawn):
    tree = page_of(diagnosis())
    assert headings(tree) == [
        "Torque of the joint that errs most, over time and over what it may depend on",
        "Motion of the arm",
        "Where the error lies",
        "The causes in numbers (1 cause)",
        "Errors in numbers",
        "For your simulator",
        "Cautions (4)",
        "What this log could not show",
        "How this was obtained",
    ]
    # The worst joint is seen at once, over time and over its laws; all else below it folds.
    opened = [d.xpath("./summary/h2")[0].text_content() for d in tree.xpath("//details[@open]")]
    assert opened == headings(tree)[:1]
    titles = [h.text_content() for h in tree.xpath("//div[@class='advice']/h2")]
    assert titles == ["What to do first", "Which model to use"]


def test_numbers_are_those_of_the_json(undrawn):
    d = diagnosis(
        causes=(FRICTION, VISCOUS, OFFSET, body_cause((2,), share=0.1)),
    )
    tree, data = page_of(d), d.plain()
    rows = rows_of(tree, "Causes of the error")
    assert len(rows) == len(data["which"]) == 4
    for f in data["which"]:
        row = next((r for r in rows if r[0] == effect_words(f["effect"])), None)
        for name in f["std"]:
            assert row is not None, f["effect"]
            value, _, unit = row[2].removeprefix(f"{name} = ").partition(" ")
            assert float(value) == pytest.approx(f["parameters"][name], rel=1e-2), unit
    joints = rows_of(tree, "RMS of the torque the model lacks [N m], below 20 Hz")
    far, where = data["how_far"], data["where"]["joints"]
    for row, own, gap in zip(joints, far["per_joint"], where, strict=True):
        sizes = [float(cell) for cell in row[1:3]]
        assert sizes == pytest.approx([own["before"], own["after"]], rel=5e-3)
        assert sizes[0] == pytest.approx(gap["gap_rms"], rel=5e-3)


def test_the_answer_has_a_bar_a_joint_the_largest_error_first(undrawn):
    """With what stands below it: one number for one thing."""
    d = diagnosis(
        causes=(FRICTION, VISCOUS, OFFSET, body_cause((2,), share=0.1)),
    )
    rows = page_of(d).xpath("//div[contains(@class, 'bars')]//tbody/tr")
    per_joint = {str(j["joint"]): j for j in d.plain()["how_far"]["per_joint"]}
    longest = max(j["before"] for j in per_joint.values())
    seen = []
    for row in rows:
        joint = per_joint[row.xpath("./th")[0].text_content().split()[0]]
        before, after = row.xpath(".//td[@class='bar']/span")[0].text_content().split(" → ")
        seen.append(float(before))
        assert float(before) == pytest.approx(joint["before"], rel=5e-3)
        assert float(after) == pytest.approx(joint["after"], rel=5e-3)
        # Solid and light add up to the error before, on one scale.
        solid, light = (
            float(i.get("style").removeprefix("width:").removesuffix("%"))
            for i in row.xpath(".//td[@class='bar']//i[starts-with(@style, 'width')]")
        )
        assert solid == pytest.approx(100 * joint["after"] / longest, abs=0.1)
        assert solid + light == pytest.approx(
            100 * max(joint["before"], joint["after"]) / longest, abs=0.11
        )
    assert len(seen) == len(per_joint)
    assert seen == sorted(seen, reverse=True)
    causes = " ".join(row.text_content() for row in rows)
    for name in ("Coulomb friction", "Viscous friction", "Torque offset", "Inertia of link 3"):
        assert name in causes


def test_a_joint_without_a_cause_has_its_suspect(undrawn):
    suspect = structs.replace(VISCOUS, how_sure=0.43, role="suspect", ambiguous_with=("backlash",))
    cells = page_of(diagnosis(suspects=(suspect,))).xpath("//td[@class='causes']")
    said = [" ".join(cell.text_content().split()) for cell in cells]
    likely = "perhaps viscous friction 0.20 ± 0.10 N m s/rad (43 %; could also be backlash)"
    assert [text for text in said if "perhaps" in text] == [likely]
    assert "no cause found; may be noise" in said


def test_a_joint_that_a_push_moves_has_that_cause(undrawn):
    """The screen and the page say the same of joints without a cause of their own."""
    push = structs.replace(VISCOUS, effect="contact", joints=(), located=(), removes=())
    found = diagnosis(causes=(FRICTION, push))
    cells = page_of(found).xpath("//td[@class='causes']")
    said = [" ".join(cell.text_content().split()) for cell in cells]
    assert said[1:3] == ["contact (below)", "no cause found; may be noise"]
    console = Console(width=100, record=True, file=StringIO())
    console.print(Screen(answer=found.answer))
    assert console.export_text().count("contact (below)") == 1


def test_names_of_suspects_are_explained_too(undrawn):
    suspect = structs.replace(VISCOUS, effect="stribeck_friction", how_sure=0.43, role="suspect")
    (bars,) = page_of(diagnosis(suspects=(suspect,))).xpath("//div[contains(@class, 'bars')]")
    notes = " ".join(p.text_content() for p in bars.xpath(".//p[@class='note']"))
    assert "Stribeck friction: " in notes


def test_captions_say_where(undrawn):
    captions = {f.get("id"): f.xpath("./figcaption")[0].text_content()
                for f in page_of(diagnosis()).iter("figure")}  # fmt: skip
    assert (
        "Joint 2 holds 98 % of the error, above all in the columns reversal and slow"
        in (captions["where"])
    )
    assert captions["torque"].startswith("Figure 1. Torque of the arm and of both models")
    assert "RMS 0.61 N m before and 0.07 after" in captions["joint_2"]
    assert list(captions) == ["torque", "joint_2", "motion", "where"]


def test_what_holds_nothing_is_not_drawn(undrawn):
    far = HowFar(*(2 * [diagnosis().how_far.rms_after]), None, None)
    d = diagnosis("no_gap", traces=(), budget=Budget(0, 0, 0), how_far=far, regimes=(), causes=())
    tree = page_of(d)
    assert not list(tree.iter("figure"))
    assert "Where the error lies" not in headings(tree)


@pytest.mark.parametrize("status", quick_first(["explained", "no_gap"], 1))
def test_every_figure_is_drawn(status):
    tree = page_of(diagnosis(status, **SHORT))
    names = [f.get("id") for f in tree.iter("figure")]
    assert names == ["torque", "joint_2", "motion", "where"]
    assert all(len(svg.xpath(".//*")) > 10 for svg in tree.iter("svg"))


def test_cautions_are_few_and_say_one_thing_once(undrawn):
    steps = [f"run{k}: time steps of {8 + k} ms; resampled to 10 ms." for k in range(12)]
    many = [f"Caution of its own kind {'x' * k}." for k in range(20)]
    tree = page_of(replace(diagnosis(), warnings=(*steps, *many)))
    said = [li.text_content() for li in tree.xpath("//details[starts-with(@id, 'cautions')]//li")]
    assert len(said) == 10
    assert said[0] == (
        "12 logs (run0, run1 and 10 more): time steps of 8 to 19 ms; resampled to 10 ms."
    )
    assert "more are in the JSON" in said[-1]


@pytest.mark.parametrize(
    ("status", "said"), [("explained", "--save-model"), ("no_gap", "than the model as given")]
)
def test_which_model_to_use(status, said):
    of_nothing = {"causes": ()} if status == "no_gap" else {}
    (advice,) = (
        x for title, x in page(diagnosis(status, **of_nothing), made()).advice if "model" in title
    )
    assert said in advice[0]
    assert "ROBOT" not in advice[0]


@pytest.mark.slow
def test_hostile_names():
    bad = '<img src="https://example.org/x.png" onerror="alert(1)"> $\\frac{ & \'"'
    d = diagnosis(**SHORT)
    d = replace(
        d,
        robot=replace(d.robot, name=bad),
        traces=tuple(replace(t, name=bad) for t in d.traces),
        warnings=(bad,),
    )
    text = render(page(d, made(arguments=["torchid", "gap", bad], settings={bad: bad})))
    tree = parsed(text)
    assert bad in tree.xpath("//h1")[0].text_content()
    assert not list(tree.iter("img"))
    assert bad in [li.text_content() for li in tree.iter("li")]


@pytest.mark.slow
def test_names_that_are_no_text():
    d = diagnosis(**SHORT)
    bad = "a\x00b\x1b[31m\udcff\uffff"
    d = replace(d, robot=replace(d.robot, name=bad), warnings=(bad,))
    text = render(page(d, made(arguments=["torchid", bad])))
    assert "Sim-to-real gap of a\ufffdb\ufffd[31m\ufffd\ufffd" in text
    parsed(text.encode().decode())


def test_how_it_was_obtained(undrawn):
    tree = page_of(diagnosis())
    assert tree.xpath("//pre")[-1].text_content() == "torchid gap 3r 'run <1>.csv'"
    assert rows_of(tree, "Input files") == [
        ["run <1>.csv", "log", "1\u202f234\u202f567", "ab" * 32]
    ]
    versions = dict(rows_of(tree, "Versions"))
    assert {"torchid", "Python", "torch", "numpy", "system"} <= set(versions)
    settings = dict(rows_of(tree, "Seeds and settings"))
    assert settings == {
        "seed": "7", "cutoff": "auto", "trusted": "yes", "effects": "a, b", "alpha": "0.01",
    }  # fmt: skip


def test_of_the_library_there_is_no_command(undrawn):
    (block,) = page_of(diagnosis(), made(arguments=[])).iter("pre")
    assert "MJCF" in block.text_content()  # what is to be copied


@pytest.mark.parametrize("runs", [1, 3])
def test_the_agreement_of_several_runs_is_a_section_that_folds(runs, undrawn):
    scales = [MotionScale(f"run{k}", 0.0, 8.0, x, 0.02) for k, x in enumerate((0.9, 0.9, 1.4), 1)]
    again = replication_of([*scales[:runs], *scales[:runs]])
    d = diagnosis(causes=(structs.replace(FRICTION, replication=again),), **SHORT)
    tree = page_of(d)
    title = "Whether the runs agree"
    assert (title in headings(tree)) == (runs > 1)
    if runs > 1:
        section = tree.xpath(f"//details[summary//*[contains(text(), '{title}')]]")[0]
        assert section.get("open") is None
        text = " ".join(section.text_content().split())
        assert "run3 wants Coulomb friction on joint 2 of 0.854 ± 0.009 N m" in text
        assert "run1 0.549 ± 0.009 N m agrees" in text
