"""A short form of `python -m tests.robustness.faults`: one search is killed, starved of disk, and
continued."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("scene", "kills", "disks"),
    [
        ("extract", 3, 2),
        ("gap", 3, 2),
        ("identify", 3, 2),
        ("export", 3, 2),
        ("correct", 3, 2),
        ("extract by two", 2, 0),
        ("fleet identify by two", 2, 2),
    ],
)
def test_what_is_killed_or_has_no_disk_goes_on_with_the_same_bits(scene, kills, disks) -> None:
    """In a process of its own, which forks and has none of this one's threads."""
    asked = ["--of", scene, "--kills", str(kills), "--disks", str(disks)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.robustness.faults", *asked],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{kills} kills" in done.stdout
    assert "0 wrong" in done.stdout
