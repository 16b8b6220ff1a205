"""The answer in a terminal as a user has it: a pseudo-terminal of some width."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.app.test_start_up import ROOT, _loaded
from tests.marks import some
from tests.terminal import on_a_terminal

RUN = "import sys; sys.argv = ['torchid', *sys.argv[1:]]; from torchid.app import main; main()"
LINES = 25


def lines_of(columns: int, folder: Path, *arguments: str) -> list[str]:
    """The lines that a command leaves on a terminal, what it shows while it runs apart."""
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}

    def start(terminal: int) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-c", RUN, *arguments],
            stdout=terminal, stderr=subprocess.DEVNULL, cwd=folder,
            env=environment | {"PYTHONPATH": ROOT, "TERM": "xterm"},
        )  # fmt: skip

    shown, _ = on_a_terminal(start, columns)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown).splitlines()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a KUKA whose joints have friction, and one of them more."""
    import torchid

    robot = torchid.load_robot("kuka_lwr4")
    motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log(rate=100)
    faults = [{"effect": "viscous_friction", "joint": j, "Fv": 2.0 / j} for j in range(1, 8)]
    faults += [{"effect": "coulomb_friction", "joint": j, "Fc": 1.0 / j} for j in range(1, 8)]
    faults += [{"effect": "torque_offset", "joint": 3, "F0": 1.0}]
    file = tmp_path_factory.mktemp("screen") / "run.parquet"
    torchid.write_log(torchid.simulate(robot, motion, effects=faults, seed=1), file)
    return file


@pytest.mark.parametrize("columns", some([60, 80, 120], 1))
def test_the_answer_is_one_screen(log: Path, columns: int, tmp_path: Path) -> None:
    """Headline to the files' names; no line is broken by the terminal; the names are whole."""
    effects = "viscous_friction,coulomb_friction,torque_offset"
    lines = lines_of(
        columns, tmp_path, "gap", "kuka_lwr4", str(log), "--effects", effects, "--out", "gap",
        "--save-model", "c.yaml",
    )  # fmt: skip
    assert len(lines) <= LINES, "\n".join(lines)
    assert max(map(len, lines)) <= columns, "\n".join(lines)
    text = " ".join(" ".join(lines).split())
    for part in (
        ": error 2.85 -> ",
        "Do first: friction, all joints",
        "% less",
        "c.yaml",
        "written:",
    ):
        assert part in text, text
    assert _loaded("explain", str(tmp_path / "gap/gap.json")) == []  # nor torch
