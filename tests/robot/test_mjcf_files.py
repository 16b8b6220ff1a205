"""What an MJCF makes MuJoCo do: bounded before it is parsed."""

import os

import pytest

from tests.robustness.bad_robots import ATTACH, COPIES, FIELD, MJCF
from torchid.errors import RobotError
from torchid.robot.mjcf import read_mjcf


def written(folder, name="arm.xml", first="<worldbody>"):
    """The small arm, with something in front of its bodies."""
    path = folder / name
    path.write_text(MJCF.replace("<worldbody>", first, 1))
    return path


@pytest.mark.parametrize(
    ("first", "said"),
    [
        ('<worldbody><replicate count="1000000000"/>', "<replicate> on line 1 is too large"),
        (f"<worldbody><replicate count='200'>{COPIES}</replicate>", "4.02e.04 copies"),
        ('<size nkey="1000000000"/><worldbody>', "1e.09 nkey"),
        (f"<asset>{FIELD}</asset><worldbody>", "1e.10 nrow x ncol"),
        ('<include file="arm.xml"/><worldbody>', "got: arm.xml > arm.xml"),
        (ATTACH.format("other.xml"), "got: arm.xml > other.xml > arm.xml"),
        ('<include file="pipe.xml"/><worldbody>', "pipe.xml' is no regular file"),
        ('<include file="/dev/zero"/><worldbody>', "'/dev/zero' is no regular file"),
        ('<asset><mesh file="pipe.xml"/></asset><worldbody>', "pipe.xml' is no regular file"),
    ],
)
def test_what_has_no_end_is_refused_at_once(tmp_path, first, said) -> None:
    os.mkfifo(tmp_path / "pipe.xml")
    written(tmp_path, "other.xml", ATTACH.format("arm.xml"))
    with pytest.raises(RobotError, match=said):
        read_mjcf(written(tmp_path, first=first))


def test_attached_models_multiply(tmp_path) -> None:
    five = "".join(f'<attach model="m" body="l1" prefix="m{k}"/>' for k in range(5))
    asset = '<asset><model name="m" file="{}.xml"/></asset><worldbody>'
    written(tmp_path, "0.xml")
    for k in range(1, 8):
        written(tmp_path, f"{k}.xml", asset.format(k - 1) + five)
    with pytest.raises(RobotError, match="<attach> on line 1 is too large"):
        read_mjcf(tmp_path / "7.xml")


def test_a_few_copies_and_other_files_are_read(tmp_path) -> None:
    written(tmp_path, "other.xml")
    first = ATTACH.format("other.xml").replace("<worldbody>", f"<worldbody>{COPIES}", 1)
    assert read_mjcf(written(tmp_path, first=first)).n == 4
