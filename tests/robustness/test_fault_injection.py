"""A short form of `python -m tests.robustness.faults`: one search is killed, starved of disk, and
continued."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow


def test_a_search_that_is_killed_or_whose_disk_is_full_goes_on_with_the_same_bits() -> None:
    """In a process of its own, which forks and has none of this one's threads."""
    asked = ["--of", "extract", "--kills", "3", "--disks", "2", "--memories", "1", "--pairs", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.robustness.faults", *asked],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 kills" in done.stdout
    assert "0 wrong" in done.stdout
