"""An effect is at home in its class: no other source file knows it by its name."""

import ast
from collections import Counter

from tests.documents import ROOT
from torchid.effects.registry import KINDS
from torchid.effects.servo import SERVO_KINDS

NAMES = {*KINDS, *SERVO_KINDS}

OTHER_MEANINGS = Counter(
    {
        "__init__.py": 1,  # the page `payload`
        "app/help.py": 1,  # the command `payload`
        "doctor/torque.py": 2,  # the check `saturation`
        "export/servo_mjcf.py": 1,  # MJCF's element `contact`
        "position/in_mujoco.py": 1,  # MuJoCo's contacts
        "position/nominal.py": 1,  # the servo's number `dead_zone`, here and below
        "position/search.py": 2,
        "simulation/servo_kernel.py": 1,
        "simulators/servo.py": 2,
    }
)
"""Strings that are the name of something else, by file."""

STILL_AWAY = Counter(
    {
        "pair/faults.py": 2,
        "pair/record.py": 1,
        "pair/servos.py": 1,
        "position/effects.py": 5,
        "results/words.py": 2,  # what a sentence says otherwise, below the effects
        "robot/assemble.py": 6,  # what a file's joint is read as, below the effects
    }
)
"""Literals of effects' names outside effects/, by file: they only become fewer."""


def literals(text: str) -> int:
    """How many strings of a module, docstrings left out, are the name of an effect."""
    tree = ast.parse(text)
    told = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
    every = (n for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in told)
    return sum(n.value in NAMES for n in every if isinstance(n.value, str))


def test_literals_are_counted_and_words_of_docstrings_are_not() -> None:
    text = '"""payload"""\n\nX = ("payload", f(a="cogging"))\n"""backlash"""\nY = "payloads"\n'
    assert literals(text) == 2


def test_no_file_outside_of_effects_comes_to_know_one() -> None:
    package = ROOT / "torchid"
    found = Counter(
        {
            path.relative_to(package).as_posix(): literals(path.read_text())
            for path in package.rglob("*.py")
            if path.parent != package / "effects"
        }
    )
    grown = found - (OTHER_MEANINGS + STILL_AWAY)
    assert not grown, f"what others ask of an effect is a property of its class: {dict(grown)}"
