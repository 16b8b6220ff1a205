"""Tables of parts that declare their columns."""

import math
from typing import Annotated

import pytest
from msgspec.json import encode

from torchid.report.table import Table, table_of
from torchid.results.record import Col, Ends, Joint, Part, Real, as_plain
from torchid.results.words import percent


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


def test_a_page_has_all_rows_and_the_terminal_the_first(table):
    assert [len(t.rows) for t in (table, table.printed, table.on_page())] == [2, 1, 2]
    assert table.printed.note == "A note. And 1 more, in the JSON."
    assert table.plain()["rows"] == [[str(c) for c in row] for row in table.printed.rows]


def test_columns_change_no_json():
    gain = Gain(joint=1, unit="1", kp=math.nan)
    assert list(as_plain(gain)) == list(Gain.__struct_fields__)
    assert as_plain(gain)["joint"] == 2
    assert encode(as_plain(gain)["kp"]) == b"null"
