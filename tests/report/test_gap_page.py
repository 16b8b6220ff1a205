"""The page of a diagnosis says what the diagnosis holds."""

from dataclasses import replace
from typing import get_args

import pytest

from tests.gap.diagnoses import FRICTION, OFFSET, VISCOUS, coulomb, diagnosis, some_left, trace
from tests.marks import quick_first
from tests.report.page.reading import parsed, rows_of, text_of
from torchid.gap.diagnosis import HowFar
from torchid.gap.record import Budget, Parametric, Status
from torchid.report.diagnosis import page
from torchid.report.gap import STATUS
from torchid.report.gap_figures import budget_figure
from torchid.report.page import document as rendering
from torchid.report.page.document import InputFile, origin, render

FILES = (InputFile("log", "run <1>.csv", 1234567, "ab" * 32),)


def made(**changes):
    given = {
        "arguments": ["/usr/bin/torchid", "gap", "3r", "run <1>.csv"],
        "started": 0.0,
        "seeds": {"seed": 7},
        "settings": {"cutoff": "auto", "rollout": True, "effects": ("a", "b"), "alpha": 0.01},
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
    assert text_of(tree, "verdict") == d.answer.headline
    assert STATUS[status] in text_of(tree, "facts")
    assert tree.xpath("//header/*[1]")[0].tag == "h1"
    assert tree.xpath("//header/*[2]")[0].get("class") == "verdict"


def test_order(undrawn):
    tree = page_of(diagnosis())
    headings = [h.text_content() for h in tree.iter("h2")]
    assert headings == [
        "The answer",
        "Pictures",
        "Numbers",
        "For your simulator",
        "To bear in mind",
        "How this was obtained",
    ]
    links = [a.get("href") for a in tree.xpath("//nav/a")]
    assert links == ["#answer", "#pictures", "#numbers", "#block", "#remarks", "#origin"]


def test_numbers_are_those_of_the_json(undrawn):
    d = diagnosis(findings=(FRICTION, VISCOUS, OFFSET), parametric=(Parametric((2,), 0.1, 0.01),))
    tree, data = page_of(d), d.plain()
    rows = rows_of(tree, "Coefficients of the effects")
    found = [f for f in data["which"] if f["std"]]
    assert len(rows) == len(found) == 3
    for row, f in zip(rows, found, strict=True):
        ((name, std),) = f["std"].items()
        value = f["parameters"][name]
        assert float(row[3]) == pytest.approx(value, rel=1e-5)
        if std is None:
            assert row[4:6] == ["-", "-"]
            continue
        low, high = (float(x) for x in row[5].strip("[]").split(", "))
        assert float(row[4]) == pytest.approx(std, rel=1e-2)
        assert (low + high) / 2 == pytest.approx(value, abs=1e-5)
        assert (high - low) / 2 == pytest.approx(1.96 * std, rel=1e-3)
    rms = rows_of(tree, "RMS of what the model lacks [N m]")
    for name, key in (("as given", "before"), ("corrected", "after")):
        (row,) = (r for r in rms if r[0] == name)
        expected = [j[key] for j in data["how_far"]["per_joint"]]
        assert [float(x) for x in row[1:-1]] == pytest.approx(expected, rel=5e-3)
    gaps = rows_of(tree, "torque the model lacks, below 20 Hz")
    assert [float(r[1].split()[0]) for r in gaps] == pytest.approx(
        [j["gap_rms"] for j in data["where"]["joints"]], rel=5e-3
    )


def test_the_answer_has_a_row_a_joint_the_largest_remaining_error_first(undrawn):
    """With what stands below it: one number for one thing."""
    d = diagnosis(findings=(FRICTION, VISCOUS, OFFSET), parametric=(Parametric((2,), 0.1, 0.01),))
    rows = rows_of(page_of(d), "RMS error [N m], below 20 Hz")
    per_joint = {str(j["joint"]): j for j in d.plain()["how_far"]["per_joint"]}
    joints = [r for r in rows if r[0] in per_joint]
    assert sorted(r[0] for r in joints) == sorted(per_joint)
    after = [float(r[2]) for r in joints]
    assert after == sorted(after, reverse=True)
    for r in joints:
        assert float(r[1]) == pytest.approx(per_joint[r[0]]["before"], rel=5e-3)
        assert float(r[2]) == pytest.approx(per_joint[r[0]]["after"], rel=5e-3)
    # Every cause is there, with its action.
    causes = " ".join(r[4] for r in rows)
    for name in ("Coulomb friction", "viscous friction", "torque offset", "inertia"):
        assert name in causes
    assert all(r[6] for r in rows if r[4] not in ("-", ""))


def test_captions_say_where(undrawn):
    captions = [c.text_content() for c in page_of(diagnosis()).iter("figcaption")]
    assert (
        "Joint 2 holds 98 % of the gap, above all at velocity reversals and at low" in captions[1]
    )
    assert captions[0].startswith("Figure 1. Torque of joint 2")
    assert "RMS 0.61 N m before and 0.07 after" in captions[2]


def test_no_traces_no_budget(undrawn):
    far = HowFar(*(2 * [diagnosis().how_far.rms_after]), None, None)
    tree = page_of(diagnosis("no_gap", traces=(), budget=Budget(0, 0, 0), how_far=far))
    assert len(list(tree.iter("figure"))) == 2


@pytest.mark.parametrize("status", quick_first(["explained", "no_gap"], 1))
def test_every_figure_is_drawn(status):
    tree = page_of(diagnosis(status, **SHORT))
    assert len(list(tree.iter("figure"))) == 5
    assert all(len(svg) > 10 for svg in tree.iter("svg"))


def test_worse_after_than_before_is_drawn():
    (axes,) = budget_figure(diagnosis(budget=Budget(0.0, -0.3, 1.3)).record).axes
    assert [p.get_width() for p in axes.patches] == [0.0, 0.0, 1.3]
    assert axes.get_xlim()[1] == 1.3


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
        "seed": "7", "cutoff": "auto", "rollout": "yes", "effects": "a, b", "alpha": "0.01",
    }  # fmt: skip


def test_of_the_library_there_is_no_command(undrawn):
    (block,) = page_of(diagnosis(), made(arguments=[])).iter("pre")
    assert "MJCF" in block.text_content()  # what is to be copied


def test_budget_alt_is_spoken(undrawn):
    labels = [svg.get("aria-label") for svg in page_of(diagnosis()).iter("svg")]
    assert labels[-1] == "Shares of the gap: base parameters 2 %, effects 93 %, unexplained 5 %."
