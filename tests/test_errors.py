"""What an error shows, whatever its parts come from."""

import pytest

from torchid.errors import TorchidError, visible


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("joint \x1b[31mred\x9b2J\x07", "joint \ufffd[31mred\ufffd2J\ufffd"),
        ("right \u202e left", "right \ufffd left"),
        ("\udcff.csv", "\ufffd.csv"),
        ("two\nlines\tand 3 \u00b5m", "two\nlines\tand 3 \u00b5m"),
        ("x" * 5000, "x" * 150 + "…" + "x" * 50),
    ],
)
def test_texts_are_safe_for_terminals(text, shown) -> None:
    assert visible(text) == shown
    assert visible(shown) == shown


def test_long_lines_are_cut() -> None:
    assert len(visible("word " * 2000)) == 2000


def test_parts_of_an_error_are_short() -> None:
    loop: list[object] = [1]
    loop.append(loop)
    bomb: object = "ha"
    for _ in range(40):
        bomb = [bomb] * 9
    for got in (loop, bomb, 10**5000, {"a": bomb}, ["x" * 10_000] * 100):
        assert len(str(TorchidError("no.", got=got, expected=bomb))) < 10_000
    assert str(TorchidError("no.", got=[1.5, "a"])) == "no.\n  got: [1.5, 'a']"


def test_the_nearest_of_many_choices_are_told():
    kinds = ["viscous_friction", "coulomb_friction", "backlash", "payload", "rotor_inertia"]
    error = TorchidError("unknown effect 'coulomb'.", got="coulomb_fricton", available=kinds)
    assert "  nearest: coulomb_friction, viscous_friction" in str(error).splitlines()
    assert "nearest" not in str(TorchidError("unknown effect.", got="sand", available=kinds))
    assert "nearest" not in str(TorchidError("no.", got="bachlash", available=kinds[:3]))
