"""Tables of parts that declare their columns."""

import io
import math
from typing import Annotated

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.json import encode
from rich.console import Console

from torchid.report.table import Table, joint_table, plain_table, table_of
from torchid.results.record import Col, Ends, Joint, Part, Real, as_plain
from torchid.results.words import percent
from torchid.typing import Float, Tensor


class Gain(Part, frozen=True, kw_only=True):
    """Of a joint."""

    joint: Annotated[Joint, Col()]
    others: Annotated[tuple[Joint, ...], Col("with joints")] = ()
    unit: str
    kp: Annotated[Real, Col("gain", spread="std", unit_of="unit")]
    std: float | None = None
    speed: Annotated[Real, Col(digits=".1f", unit="rad/s")] = math.nan
    ends: Annotated[Ends, Col("between")] = (math.nan, 2.0)
    share: Annotated[float | None, Col(words=percent)] = None
    seen: Annotated[bool, Col()] = True

    @property
    def words(self) -> Annotated[str, Col("in words")]:
        """Its unit."""
        return f"in {self.unit}"


@pytest.fixture
def table() -> Table:
    rows = [
        Gain(joint=1, others=(0, 2), unit="N m^2", kp=0.6123, std=0.0234, share=0.5),
        Gain(joint=0, unit="1", kp=7.0, speed=2.04, seen=False),
    ]
    return table_of("gains", rows, note="A note.", most=1, beside={"more": ["x", "y"]})


def test_fields_and_properties_are_columns(table):
    assert table.columns == [
        "joint", "with joints", "gain", "speed [rad/s]", "between", "share", "seen", "in words",
        "more",
    ]  # fmt: skip
    assert table.letters == "rrrrrrppp"
    assert table.rows == [
        ["2", "1, 3", "0.61 ± 0.02 N m²", "-", "- .. 2", "50 %", "yes", "in N m^2", "x"],
        ["1", "-", "7", "2.0", "- .. 2", "-", "no", "in 1", "y"],
    ]


def test_some_columns_in_an_order_of_their_own():
    rows = [Gain(joint=0, unit="1", kp=1.0)]
    assert table_of("", rows, "seen joint").columns == ["seen", "joint"]
    assert not table_of("", [], "seen joint")


class Errors(Part, frozen=True):
    """Of all joints."""

    force: Annotated[Float[Tensor, " n"], Col(unit="N")]
    degree: Annotated[Float[Tensor, " K"], Col(words=lambda x: f"{float(x.min()):.1f}")]


def test_a_tensor_is_its_numbers_or_what_its_column_says():
    numbers = torch.tensor([0.12345, math.nan], dtype=torch.float64)
    rows = [Errors(force=numbers, degree=numbers[:1])]
    assert table_of("", rows).rows == [["0.123 -", "0.1"]]


def test_markdown_and_terminal_show_a_cell_as_it_is():
    sheet = Table("t [m]", ("a", "b"), [("||x|| *y*", "[N m]")], "p", "n [kg]")
    assert sheet.markdown().splitlines()[4] == r"| \|\|x\|\| \*y\* | [N m] |"
    text = "\n".join(printed(sheet, 80))
    for part in ("t [m]", "||x|| *y*", "[N m]", "n [kg]"):
        assert part in text


def test_a_page_has_all_rows_and_the_terminal_the_first(table):
    assert [len(t.rows) for t in (table, table.printed, table.on_page())] == [2, 1, 2]
    assert table.printed.note == "A note. And 1 more, in the JSON."
    assert table.plain()["rows"] == [[str(c) for c in row] for row in table.printed.rows]


def test_columns_change_no_json():
    gain = Gain(joint=1, unit="1", kp=math.nan)
    assert list(as_plain(gain)) == list(Gain.__struct_fields__)
    assert as_plain(gain)["joint"] == 2
    assert encode(as_plain(gain)["kp"]) == b"null"


def printed(table: Table, width: int) -> list[str]:
    """Lines of a terminal of that width."""
    file = io.StringIO()
    Console(file=file, width=width).print(table)
    return file.getvalue().splitlines()


NUMBERS = st.floats(-1e6, 1e6, width=32).map("{:.6g}".format)


def test_one_row_a_name_and_one_column_a_joint():
    rows = [("fit", [1.234, math.nan, 3.0]), ("RMSE", torch.tensor([0.5, 0.25]))]
    table = joint_table("errors", rows, last=("mean",))
    assert table.columns == ("", "1", "2", "mean")
    assert table.rows == [("fit", "1.23", "-", "3"), ("RMSE", "0.5", "0.25", "")]


def test_plain_data_have_a_column_a_key():
    entries = [{"name": "a", "from_s": 1.23456, "k": 1, "ends": [None, 2.0]}, {"k": 2, "ok": True}]
    table = plain_table("", entries)
    assert table.columns == ["name", "from s", "k", "ends", "ok"]
    assert table.rows == [["a", "1.235", "1", "none, 2", "-"], ["-", "-", "2", "-", "yes"]]
    assert table.letters == "pprpp"


WORDS = st.lists(st.text("abcdefgh", min_size=1, max_size=9), min_size=1, max_size=9).map(" ".join)


@settings(max_examples=15)
@given(st.data(), st.sampled_from([60, 80, 120]))
def test_no_number_is_cut_and_no_column_of_words_vanishes(data, width):
    letters = "p" + data.draw(st.text("rp", min_size=2, max_size=9))
    row = st.tuples(*(NUMBERS if letter == "r" else WORDS for letter in letters))
    rows = data.draw(st.lists(row, min_size=1, max_size=4))
    # Each column by a letter of its own, which shows where it begins and ends.
    heads = [chr(ord("A") + k) * 3 for k in range(len(letters))]
    lines = printed(Table("", heads, rows, letters), width)
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    shown = [k for k, head in enumerate(heads) if head in text.split("\u2500")[0]]
    assert shown == list(range(len(shown)))
    hidden = set(range(len(heads))) - set(shown)
    assert all(heads[k] in text for k in hidden)
    assert "\u2026" not in text
    for k in shown:
        for line in rows:
            # Of words their parts stand whole where the column is wide enough for them.
            whole = [line[k]] if letters[k] == "r" else line[k].split()
            assert all(part in text for part in whole)


def test_a_table_that_fits_no_more_breaks_headings_and_then_cells():
    rows = [["m2c2x - 0.6127 m2", "-8.35718", "0.001302 \u00b1 0.014", "0 (at its bound)"]]
    table = Table("", ["name", "its value", "viscous friction", "rotor inertia"], rows, "prrr")
    assert printed(table, 80)[-2].split() == " ".join(rows[0]).split()
    assert max(map(len, printed(table, 62))) <= 62
    narrow = printed(table, 44)
    assert "friction" in narrow[2]
    assert not any("viscous friction" in line for line in narrow)
    assert "0.001302" in "\n".join(narrow)
    assert "0.001302 \u00b1 0.014" not in "\n".join(narrow)
    note = " ".join(" ".join(printed(table, 34)).split())
    assert "in the JSON:" in note
    assert "rotor inertia." in note
