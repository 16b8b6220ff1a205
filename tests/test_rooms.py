"""No room of the package is larger than its budget."""

from collections import Counter

from tests.rooms import above, code_lines

TEXT = '''"""A module.

Of two sentences."""

X = 1  # one


def f(a):
    """What it does."""
    # Why.
    return """two
lines""" if a else (
        a
    )
'''


def test_lines_without_words_are_counted():
    assert code_lines(TEXT) == 6


def test_a_room_above_its_budget_or_without_one_is_named():
    assert above(Counter(a=5, b=1), {"a": 4}) == [
        "a: 5 lines of code, budget 4", "b: 1 lines of code, budget none",
    ]  # fmt: skip
