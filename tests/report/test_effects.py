"""The catalogue of effects is complete, current and says what the code computes."""

import re
from typing import get_args

import pytest
import torch

from docs.draw_effects import (
    catalogue_page,
    example_motion,
    examples,
    picture_name,
    shown_torque,
)
from tests.documents import ROOT
from torchid.effects.base import Family, JointEffect, Motion
from torchid.effects.registry import KINDS
from torchid.effects.servo import SERVO_KINDS
from torchid.report.effects import effect_record, effect_table

CLOSED_FORM = {
    name: kind
    for name, kind in KINDS.items()
    if issubclass(kind, JointEffect) and not kind.memory and name != "joint_spring"
}
SHAPES = {"a": 1.7, "vs": 0.3, "T": 5.0, "k": 3.0, "limit": 0.4, "towards": -1.0}


def test_committed_page_is_what_the_program_writes() -> None:
    assert (ROOT / "docs/effects.md").read_text() == catalogue_page(), (
        "run `python docs/draw_effects.py`"
    )
    for family in get_args(Family):
        assert (ROOT / f"docs/img/{picture_name(family)}.png").stat().st_size > 0


@pytest.mark.parametrize("name", KINDS)
def test_equation_holds_all_coefficients_and_shapes(name: str) -> None:
    words = set(re.findall(r"\w+", KINDS[name].equation))
    kind = KINDS[name]
    assert {c.name for c in kind.coefficients} | {s.name for s in kind.shapes} <= words
    assert effect_record(kind)["equation"] == KINDS[name].equation


@pytest.mark.parametrize("kind", [KINDS["stribeck_friction"], SERVO_KINDS["command_delay"]])
def test_one_effect_is_told_in_full(kind) -> None:
    """Every number that it has, with its unit and meaning, and what to do about it."""
    one, rows = effect_record(kind), dict(effect_table(kind).rows)
    for number in (*one["coefficients"], *one["shapes"]):
        assert rows[f"{number['name']} [{number['unit']}]"] == number["meaning"]
    assert rows["remedy"] == kind.remedy
    assert rows["confused with"].split(", ") == one["confused_with"] != []


@pytest.mark.parametrize("name", CLOSED_FORM)
def test_equation_is_what_the_effect_computes(name: str) -> None:
    """Each equation, read by sympy, against the effect's torque at random instants."""
    sympy = pytest.importorskip("sympy")
    parsing = pytest.importorskip("sympy.parsing.sympy_parser")
    kind = CLOSED_FORM[name]
    shapes = {s.name: SHAPES[s.name] for s in kind.shapes}
    values = {c.name: 0.3 + 0.4 * i for i, c in enumerate(kind.coefficients)}
    numbers = torch.Generator().manual_seed(1)
    q, dq, ddq, tau = torch.randn(4, 20, 1, generator=numbers, dtype=torch.float64).unbind()
    t = torch.linspace(0, 9, 20, dtype=torch.float64)
    motion = Motion(q, dq, ddq, t=t, torque=tau)
    got = kind(0, **shapes).torque(motion, list(values.values()))

    text = re.sub(r"\|([^|]+)\|", r"abs(\1)", KINDS[name].equation)
    symbols = {x: sympy.Symbol(x) for x in re.findall(r"[A-Za-z_]\w*", text)}
    known = {"sgn": sympy.sign, "max": sympy.Max, "abs": sympy.Abs}
    known |= {f: getattr(sympy, f) for f in ("sin", "cos", "exp")}
    # As on paper: ^ is a power, and a space between two factors multiplies.
    rules = (*parsing.standard_transformations, parsing.convert_xor,
             parsing.implicit_multiplication_application)  # fmt: skip
    equation = parsing.parse_expr(text, local_dict=symbols | known, transformations=rules)
    for i in range(len(t)):
        at = {"q": q[i, 0], "dq": dq[i, 0], "ddq": ddq[i, 0], "tau": tau[i, 0], "t": t[i], "d": 2.0}
        at = {x: float(v) for x, v in (at | values | shapes).items()}
        expected = float(equation.subs({symbols[x]: v for x, v in at.items() if x in symbols}))
        assert float(got[i]) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_pictures_show_every_effect_with_torque_to_be_seen() -> None:
    motion, robot = example_motion(8.0)
    drawn = {}
    for family in get_args(Family):
        for effect in examples(family):
            assert effect.family == family
            drawn[effect.name] = shown_torque(effect, motion, robot)
    assert set(drawn) == set(KINDS)
    for name, torque in drawn.items():
        assert torch.isfinite(torque).all(), name
        assert torque.abs().max() > 0.01, name
