"""Which log is of which unit."""

import csv

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchid.errors import TorchidError
from torchid.fleet.manifest import FleetLog, fleet_logs, read_manifest


def test_a_folder_is_a_unit(tmp_path) -> None:
    for name in ("b/monday.csv", "a/tuesday.parquet", "a/monday.parquet", "a/notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = fleet_logs([tmp_path])
    assert [(log.unit, log.session) for log in found] == [
        ("a", "monday"), ("a", "tuesday"), ("b", "monday"),
    ]  # fmt: skip
    assert fleet_logs(["s3://logs/arm-1/x.parquet"])[0].unit == "arm-1"


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_manifest_names_units_and_sessions(tmp_path, suffix) -> None:
    table = pa.table({"unit": [7, 7], "log": ["x.csv", "s3://b/y.csv"], "session": ["1a", "1b"]})
    file = tmp_path / f"fleet{suffix}"
    (pa.csv.write_csv if suffix == ".csv" else pa.parquet.write_table)(table, file)
    assert read_manifest(file) == (
        FleetLog("7", "1a", str(tmp_path / "x.csv")),
        FleetLog("7", "1b", "s3://b/y.csv"),
    )


def written(file, rows):
    """A manifest of (unit, session) pairs, each of a log of its own."""
    with open(file, "w", encoding="utf-8", newline="") as stream:
        names = [(f"{k}.csv", *row) for k, row in enumerate(rows)]
        csv.writer(stream).writerows([("log", "unit", "session"), *names])
    return file


def test_names_are_text_in_natural_order(tmp_path) -> None:
    big = "9007199254740993"
    rows = [
        ("10", "1"),
        ("2", "1"),
        ("007", "1.10"),
        ("1e5", "a"),
        ("100000", "a"),
        ("7", "1.1"),
        (big, "1"),
        ("9007199254740992", "1"),
        ("7", "1.10"),
        ("NA", "nan"),
        ("1.0", "-"),
    ]
    found = read_manifest(written(tmp_path / "fleet.csv", rows))
    assert {(log.unit, log.session) for log in found} == set(rows)
    units = list(dict.fromkeys(log.unit for log in found))
    assert units == [
        "1.0", "1e5", "2", "007", "7", "10", "100000", "9007199254740992", big, "NA",
    ]  # fmt: skip
    assert [log.session for log in found if log.unit == "7"] == ["1.1", "1.10"]


def test_whole_numbers_of_a_parquet_keep_their_digits(tmp_path) -> None:
    units = pa.array([2**53 + 1, 2**53, None])
    table = pa.table({"unit": units, "log": ["a.csv", "b.csv", "c.csv"], "session": [1, 1, 1]})
    pa.parquet.write_table(table, tmp_path / "fleet.parquet")
    with pytest.raises(TorchidError, match="no unit in row 3"):
        read_manifest(tmp_path / "fleet.parquet")
    pa.parquet.write_table(table.slice(0, 2), tmp_path / "fleet.parquet")
    found = read_manifest(tmp_path / "fleet.parquet")
    assert [log.unit for log in found] == [str(2**53), str(2**53 + 1)]


NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8)
NUMBERS = st.from_regex(r"[-+]?0{0,2}\d{1,3}(\.\d{1,2})?(e\d)?", fullmatch=True)
WORDS = st.one_of(NAMES, NUMBERS).filter(lambda text: bool(text.strip()))


@given(st.lists(st.tuples(WORDS, WORDS).map(lambda p: (p[0].strip(), p[1].strip())), min_size=1))
def test_distinct_text_stays_distinct(tmp_path_factory, rows) -> None:
    file = written(tmp_path_factory.mktemp("m") / "fleet.csv", rows)
    assert sorted((log.unit, log.session) for log in read_manifest(file)) == sorted(rows)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_a_manifest_in_another_encoding(tmp_path, encoding) -> None:
    file = tmp_path / "fleet.csv"
    file.write_bytes("log,unit\nx.csv,\xe9\n".encode(encoding))
    with pytest.raises(TorchidError, match=r"fleet\.csv' is not a csv file"):
        read_manifest(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("log,session\nx.csv,1\n", "no column unit"),
        ("log,unit\nx.csv,a\nx.csv,b\n", "named twice"),
        ("log,unit\nx.csv,a\ny.csv,\n", "no unit in row 2"),
    ],
)
def test_a_manifest_that_is_none(tmp_path, text, said) -> None:
    file = tmp_path / "fleet.csv"
    file.write_text(text)
    with pytest.raises(TorchidError, match=said):
        read_manifest(file)


@pytest.mark.parametrize("names", [("x/a/monday.csv", "y/a/monday.csv"), ("a/1.csv", "a/1.npz")])
def test_two_logs_of_one_unit_and_session_are_not_taken_for_one(tmp_path, names) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(TorchidError, match="two logs would be of unit 'a'"):
        fleet_logs([tmp_path])


def test_no_logs(tmp_path) -> None:
    with pytest.raises(TorchidError, match="no log in the folder"):
        fleet_logs([tmp_path])
    with pytest.raises(TorchidError, match="no manifest"):
        read_manifest(tmp_path / "none.csv")
