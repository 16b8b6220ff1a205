"""No room of the package is larger than its budget, and no budget is raised that none pays."""

import subprocess
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import rooms
from tests.rooms import Budgets, above, budgets, code_lines, start, unpaid

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


def test_a_landing_pays_for_what_it_raises():
    began = start()
    if began is None:
        pytest.skip("git has no earlier budgets here: nothing is compared")
    assert unpaid(began[1], budgets()) == []


LINES = st.dictionaries(st.sampled_from("abcd"), st.integers(0, 50), max_size=4)


@given(before=LINES, now=LINES, there=st.integers(0, 50), left=st.integers(-5, 80))
def test_a_reserve_is_half_of_what_went_and_pays_for_what_is_new(
    before: dict[str, int], now: dict[str, int], there: int, left: int
):
    rise = sum(now.values()) - sum(before.values())
    wrong = unpaid(Budgets(before, reserve=there), Budgets(now, reserve=left))
    balanced = left <= there - rise if rise > 0 else left - there <= -rise // 2
    assert bool(wrong) == (not balanced or left < 0)


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        ((9, 0), (3, 3), []),
        ((9, 0), (3, 4), ["reserve rises by 4, and half of what went is 3"]),
        ((3, 3), (6, 0), []),
        ((3, 3), (7, 0), ["budgets rise by 4 lines, of which the reserve pays 3: a +4"]),
        ((3, 1), (5, -1), ["reserve is overdrawn: -1"]),
        ((3, 3), (3, 0), []),
    ],
)
def test_a_reserve(before: tuple[int, int], now: tuple[int, int], words: list[str]):
    a, b = (Budgets({"a": lines}, reserve=reserve) for lines, reserve in (before, now))
    assert unpaid(a, b) == words


def test_a_room_that_replaces_another_has_its_own_line_until_the_switch():
    before, building = Budgets({"old": 9, "b": 3}), {"new": "old"}
    both = Budgets(before.lines | {"new": 6}, building)
    assert unpaid(before, both) == []
    assert unpaid(both, Budgets({"b": 3, "new": 6})) == []
    assert unpaid(both, Budgets(both.lines)) == [
        "budgets rise by 6 lines, which no fall pays: new +6"
    ]
    assert unpaid(both, Budgets({"b": 3, "new": 6}, building)) == [
        "new replaces old, which has no budget: take it out of [replaces]"
    ]
    assert unpaid(before, Budgets(before.lines | {"new": 10}, building)) == [
        "new: 10 lines replace the 9 of old"
    ]


def test_budgets_are_read_as_they_are_written():
    for one in (Budgets({"a": 3, "new": 2}, {"new": "a"}, 5), Budgets({"a": 3})):
        assert Budgets.parse(one.text) == one


@pytest.fixture
def history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository whose main has budgets of 1 and of 2, and a branch from there with 3 and 4."""
    file = tmp_path / "rooms.toml"
    monkeypatch.setattr(rooms, "ROOT", tmp_path)
    monkeypatch.setattr(rooms, "BUDGETS", file)

    def commit(lines: int) -> None:
        file.write_text(Budgets({"a": lines}).text)
        git(tmp_path, "add", ".")
        git(tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", str(lines))

    git(tmp_path, "init", "-q", "-b", "main")
    commit(1)
    commit(2)
    git(tmp_path, "checkout", "-qb", "branch")
    commit(3)
    commit(4)
    return file


def git(folder: Path, *arguments: str) -> None:
    subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True)


def begun_with() -> int | None:
    """The budget of `a` where the landing starts."""
    began = start()
    return began[1].lines["a"] if began else None


def test_a_landing_starts_where_it_left_main(history: Path):
    assert begun_with() == 2
    git(history.parent, "checkout", "-q", "main")
    assert begun_with() == 1
    history.write_text(Budgets({"a": 9}).text)
    assert begun_with() == 2
