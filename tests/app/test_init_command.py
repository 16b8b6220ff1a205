"""`torchid init`: it writes what it is given, and the other commands then work."""

from pathlib import Path

import pytest
import torch

from tests.app.test_project import GAINS
from torchid.app.project import read as read_project
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.project.file import Project
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

BRANCHING = """<robot name="two"><link name="base"/>
<link name="left"/><link name="right"/>
<joint name="l" type="revolute"><parent link="base"/><child link="left"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="r" type="revolute"><parent link="base"/><child link="right"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""

COLUMNS = "t=time_ms ms,q='pos_{j} [deg]' deg,i=actual_current_{j}"


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """The working directory: a robot and three raw logs of currents."""
    monkeypatch.chdir(tmp_path)
    robot = load_robot("3r_friction")
    write_robot(robot, "arm.yaml")
    for seed, name in enumerate(("run1", "run2", "test_run")):
        motion = trajectory_log(random_trajectory(robot, seed, duration=8.0, fill=True), 100.0)
        log = synthetic_log(robot, motion, HonestNoise(), seed)
        assert log.tau is not None
        columns = {"time_ms": 1e3 * log.t}
        columns |= {f"pos_{j} [deg]": torch.rad2deg(log.q[:, j - 1]) for j in (1, 2, 3)}
        current = log.tau / GAINS
        columns |= {f"actual_current_{j}": current[:, j - 1] for j in (1, 2, 3)}
        rows = torch.stack(list(columns.values()), -1).tolist()
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        Path(f"{name}.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_what_is_not_given_is_a_comment(command, place) -> None:
    done = command("init")
    assert done.code == 0, done.err
    assert read_project(Path("torchid.toml")) == Project(Path("torchid.toml"), out="results")
    text = Path("torchid.toml").read_text()
    for key in ("robot", "tip", "root", "lock", "columns", "topic", "gain", "logs", "held-out"):
        assert f"\n# {key} = ..\n" in text


def test_what_is_given_is_written(command, place) -> None:
    (place / "below").mkdir()
    done = command(
        "init", "run2.csv", "--robot", "3r", "--held-out", "run1.csv", "--gain", "2,4,5",
        "--columns", COLUMNS.replace("i=", "i=-"), "--topic", "/joints", "--out", "found",
        "--to", "below/torchid.toml",
    )  # fmt: skip
    assert done.code == 0, done.err
    found = read_project(Path("below/torchid.toml"))
    assert (found.robot, found.gain, found.topic) == ("3r", "2.0,4.0,5.0", "/joints")
    assert (found.logs, found.held_out) == (("run2.csv",), ("run1.csv",))
    assert found.columns == COLUMNS.replace("i=", "i=-")
    assert found.out == "below/found"


def test_a_mapping_may_be_a_file(command, place) -> None:
    (place / "below").mkdir()
    Path("names.yaml").write_text("t: time_ms ms\nq: pos_{j} deg\n")
    assert command("init", "--columns", "names.yaml", "--to", "below/torchid.toml").code == 0
    assert read_project(Path("below/torchid.toml")).columns == "names.yaml"


def test_a_file_that_is_there_stays(command, place) -> None:
    Path("torchid.toml").write_text("# mine\n")
    done = command("init")
    assert done.code == 1
    assert "--force" in done.err
    assert Path("torchid.toml").read_text() == "# mine\n"
    assert command("init", "--robot", "arm.yaml", "--force").code == 0
    assert read_project(Path("torchid.toml")).robot == "arm.yaml"


@pytest.mark.parametrize(
    ("part", "tip", "lock"),
    [((), None, ()), (("--tip", "left"), "left", ()), (("--lock", "l=0.5"), None, ("l=0.5",))],
)
def test_it_keeps_the_part_that_is_chosen(command, place, part, tip, lock) -> None:
    Path("arm.yaml").unlink()
    Path("two.urdf").write_text(BRANCHING)
    done = command("init", "--robot", "two.urdf", *part)
    assert done.code == 0, done.err
    found = read_project(Path("torchid.toml"))
    assert (found.robot, found.tip, found.root, found.lock) == ("two.urdf", tip, None, lock)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nothing.csv",), ("nothing.csv",)),
        (("--robot", "nothing.urdf"), ("nothing.urdf",)),
        (("--gain", "1,x"), ("--gain", "x")),
        (("--lock", "joint_1"), ("--lock", "JOINT=VALUE")),
        (("--to", "nowhere/torchid.toml"), ("nowhere",)),
        (("run1.csv", "--to", "run1.csv", "--force"), ("overwrite the input",)),
    ],
)
def test_what_cannot_be_written_is_refused(command, place, arguments, words) -> None:
    before = {p.name: p.read_bytes() for p in place.iterdir()}
    done = command("init", *arguments)
    assert done.code == 1, done.out
    assert done.err.startswith("error: ")
    for word in words:
        assert word in done.err, done.err
    assert {p.name: p.read_bytes() for p in place.iterdir()} == before


def test_many_logs_stand_on_lines_of_their_own(command, place) -> None:
    for k in range(8):
        Path(f"a_long_name_of_a_run_{k}.csv").write_bytes(Path("run1.csv").read_bytes())
    logs = sorted(path.name for path in place.glob("a_long_*.csv"))
    assert command("init", *logs).code == 0
    assert max(map(len, Path("torchid.toml").read_text().splitlines())) <= 100
    assert read_project(Path("torchid.toml")).logs == tuple(logs)


def test_names_that_are_hard_to_write(command, place) -> None:
    """Quotes, backslashes and other letters in the names of files."""
    name = 'r\u00f6b "o" \\1.yaml'
    Path("arm.yaml").rename(name)
    assert command("init", "--robot", name).code == 0
    assert read_project(Path("torchid.toml")).robot == name


@pytest.mark.slow
def test_after_it_six_short_commands_go_from_raw_logs_to_a_corrected_model(
    command, place, types_unchecked
) -> None:
    """All of them read the raw logs; each is at most 60 characters long."""
    done = command(
        "init", "run1.csv", "run2.csv", "--held-out", "test_run.csv", "--robot", "arm.yaml",
        "--columns", COLUMNS, "--gain", "2,4,5",
    )  # fmt: skip
    assert done.code == 0, done.err
    few = "--effects load_dependent_friction,viscous_friction"
    for words in (
        "log show",
        "log doctor",
        "identify",
        f"gap {few} --no-rollout --save-model corrected.yaml",
        f"gap corrected.yaml run1.csv {few} --no-rollout",
        "export corrected.yaml --to urdf",
    ):
        assert len(f"torchid {words.replace(f'{few} --no-rollout', '')}") <= 60
        done = command(*words.split())
        assert done.code == 0, done.err
    kinds = {path.parent.name for path in Path("results").rglob("*.json")}
    assert {"doctor", "identify", "gap", "export"} <= kinds
    assert load_robot("results/export/3r_friction.urdf").n == 3
