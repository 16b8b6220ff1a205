"""A project file stands in for what the command line leaves out."""

import json
from pathlib import Path

import pytest
import torch

from torchid.app.project import read as read_project
from torchid.errors import TorchidError
from torchid.log.readers import read_log, write_log
from torchid.project.file import Project
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

GAINS = torch.tensor([2.0, 4.0, 5.0], dtype=torch.float64)


@pytest.fixture
def bench(folder, tmp_path, monkeypatch) -> Path:
    """A folder with a robot, raw logs of currents under other names, and a project file; `inside`
    is the working directory."""
    write_robot(load_robot("3r_friction"), tmp_path / "arm.yaml")
    other = read_log(folder / "fit.parquet").trajectories()[0]
    for name, log in (("run1", read_log(folder / "check.csv")), ("run2", other)):
        assert log.tau is not None
        current = log.tau / GAINS
        columns = {"ms": 1e3 * log.t, **{f"p{j}": log.q[:, j] for j in range(3)}}
        columns |= {f"amp{j}": current[:, j] for j in range(3)}
        rows = torch.stack(list(columns.values()), -1).tolist()
        text = "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)])
        (tmp_path / f"{name}.csv").write_text(text + "\n")
    (tmp_path / "torchid.toml").write_text(
        """
robot = "arm.yaml"
columns = {t = "ms ms", q = "p{j0} rad", i = "amp{j0}"}
gain = [2, 4, 5]
logs = ["run1.csv"]
effects = ["viscous_friction", "coulomb_friction"]
out = "results"

[limits]
acceleration = 3

[identify]
cutoff = 8
rows = "all"

[log.show]
json = "seen.json"
out = "converted.npz"
"""
    )
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    return tmp_path


@pytest.mark.slow
def test_every_command_needs_only_what_differs(command, bench, folder) -> None:
    done = command("identify")
    assert done.code == 0, done.err
    assert done.err.startswith("project: ../torchid.toml\n")
    data = json.loads((bench / "results" / "identify" / "identification.json").read_text())
    settings = data["settings"]
    assert settings["effects"] == ["viscous_friction", "coulomb_friction"]
    assert (settings["rows"], data["cutoff_hz"]) == ("all", 8.0)
    same = command(
        "identify", "3r_friction", folder / "check.csv", "--project", "none", "--cutoff", 8,
        "--rows", "all", "--effects", "viscous_friction,coulomb_friction", "--json", "same.json",
    )  # fmt: skip
    assert same.code == 0, same.err
    expected = json.loads(Path("same.json").read_text())["parameters"]
    assert [p["value"] for p in data["parameters"]] == pytest.approx(
        [p["value"] for p in expected], rel=1e-6, abs=1e-9
    )


@pytest.mark.slow
def test_the_command_line_goes_before_it(command, bench, folder) -> None:
    done = command(
        "identify", folder / "fit.parquet", "--cutoff", 6, "--effects", "viscous_friction",
        "--out", "mine", "--quiet",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")  # --quiet says nothing of the project
    data = json.loads(Path("mine/identification.json").read_text())
    assert (data["settings"]["effects"], data["cutoff_hz"]) == (["viscous_friction"], 6.0)
    assert not (bench / "results").exists()


def test_another_robot_has_its_own_tip_limits_and_payload(command, bench) -> None:
    for words, expected in (((), [3.0] * 3), (("3r",), [15.0, 7.5, 10.0])):
        done = command("robot", *words, "--json", "r.json", "--out", "o", "--overwrite")
        assert done.code == 0, done.err
        joints = json.loads(Path("r.json").read_text())["joints"]
        assert [joint["acceleration"][1] for joint in joints] == expected


def test_none_leaves_it_aside_and_a_file_replaces_it(command, bench, folder) -> None:
    done = command("identify", "--project", "none")
    assert done.code == 2
    assert "project:" not in done.err
    other = bench / "inside" / "other.toml"
    other.write_text('robot = "3r"\n')
    done = command("robot", "--project", other)
    assert done.code == 0
    assert done.err == f"project: {other}\n"
    assert done.out.startswith("3r:")
    done = command("robot", "--project", "no.toml")
    assert done.code == 1
    assert "no.toml" in done.err


def test_logs_with_torchids_own_columns_need_none_of_it(command, bench, folder) -> None:
    """Neither mapping nor gains: a log that was converted has torque."""
    for log in ("../run1.csv", folder / "check.csv"):
        done = command("log", "show", log, "--out", "own.parquet")
        assert done.code == 0, done.err
        own = read_log("own.parquet")
        torch.testing.assert_close(own.tau, read_log(folder / "check.csv").tau)
    done = command("log", "show", "own.parquet", "--gain", "1,1,1", "--out", "again.parquet")
    assert done.code == 1  # what is asked for must be possible: there are no currents
    assert "no motor currents" in done.err


def test_currents_become_torque_in_what_is_written(command, bench) -> None:
    done = command("log", "show", "../run1.csv", "--out", "own.csv")
    assert "current times the drive gains" in done.out
    own = read_log("own.csv")
    assert own.tau is not None
    assert own.current is not None
    torch.testing.assert_close(own.tau, own.current * GAINS)
    assert json.loads((bench / "seen.json").read_text())["schema"] == "torchid.log/1"
    assert command("log", "show", "-q").code == 0
    torch.testing.assert_close(read_log(bench / "converted.npz").tau, own.tau)
    done = command("log", "show", "../run1.csv", "--gain", "3", "--out", "three.csv")
    three = read_log("three.csv")
    torch.testing.assert_close(three.tau, three.current * 3)


@pytest.mark.slow
def test_a_log_that_is_given_is_not_held_out(command, bench, folder) -> None:
    text = (bench / "torchid.toml").read_text()
    (bench / "torchid.toml").write_text(text.replace("logs =", 'held-out = ["run2.csv"]\nlogs ='))
    for words, expected in (((), 1), (("../run2.csv",), 0), (("--held-out-fraction", 0.3), 1)):
        done = command("identify", *words, "--out", "o", "--overwrite", "--quiet")
        assert done.code == 0, done.err
        data = json.loads(Path("o/identification.json").read_text())
        assert len((data["held_out"] or {"trajectories": ()})["trajectories"]) == expected
        names = (data["held_out"] or {"trajectories": ()})["trajectories"]
        assert all(("run2" in name) == (words == ()) for name in names)


def test_the_payload_is_part_of_the_nominal_robot(command, bench) -> None:
    before = bench / "torchid.toml"
    before.write_text(before.read_text() + "\n[payload]\nmass = 2\ncom = [0.1, 0, 0]\n")
    masses = []
    for words in ((), ("--project", "none")):
        robot = () if not words else ("../arm.yaml",)
        assert command("robot", *robot, *words, "--json", "r.json", "-q").code == 0
        masses.append(json.loads(Path("r.json").read_text())["parameters"]["mass"])
    assert masses[0][:2] == masses[1][:2]
    assert masses[0][2] == pytest.approx(masses[1][2] + 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('robt = "3r"', ("line 2", "'robt'", "robot", "columns", "gap")),
        ("\n[gap]\ncutof = 3", ("line 4", "[gap]", "'cutof'", "cutoff", "worthwhile")),
        ("[log.doctr]\n", ("line 2", "[log]", "'doctr'", "doctor, show")),
        ("[log.show]\nnothing = 1", ("line 3", "[log.show]", "'nothing'")),
        ("[limits]\nforce = 3", ("line 3", "[limits]", "'force'", "velocity")),
        ("gap = 3", ("line 2", "[gap] is a table", "3")),
        ("gain = true", ("line 2", "gain", "True")),
        ("logs = [1, 2]", ("line 2", "logs")),
        ("out = ", ("torchid.toml", "line 2")),
        ("robot = 'twice'", ("torchid.toml", "line 2")),
        ("[payload]\ncom = [0, 0, 0]", ("line 2", "no mass")),
        ("[payload]\nmass = -2", ("-2",)),
        ("[payload]\nmass = 1\ninertia = [1, 0, 0, 0, 0, 0]", ("no body",)),
        ("[payload]\nmass = 1\ncom = [1, 2]", ("com of three numbers",)),
        ('[payload]\nmass = "2 kg"', ("line 3", "mass is a number", "2 kg")),
        ("[limits]\nvelocity = [1, 2]", ("velocity", "3r")),
        ("[limits]\nvelocity = 'fast'", ("line 3", "velocity is a number", "fast")),
    ],
)
def test_what_is_wrong_is_one_error(command, bench, text, words) -> None:
    (bench / "torchid.toml").write_text(f'robot = "3r"\n{text}\n')
    done = command("robot")
    assert (done.code, done.out) == (1, "")
    said = done.err.removeprefix("project: ../torchid.toml\n")
    assert said.startswith("error: ")
    assert said.count("error") == 1
    for word in words:
        assert word in said, said


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gain = [2, 4, 5]", "gain = [2, 4]", ("gain", "got: 2", "expected: 3")),
        ("cutoff = 8", "cutoff = 'fast'", ("--cutoff", "fast")),
        ('"arm.yaml"', '"gone.urdf"', ("../gone.urdf",)),
        ('"run1.csv"', '"gone.csv"', ("../gone.csv",)),
    ],
)
def test_a_wrong_value_is_found_where_it_is_used(command, bench, old, new, words) -> None:
    text = (bench / "torchid.toml").read_text()
    assert old in text
    (bench / "torchid.toml").write_text(text.replace(old, new))
    done = command("identify")
    assert done.code == 1
    assert done.err.startswith("project: ../torchid.toml\nerror: ")
    for word in words:
        assert word in done.err, done.err


def test_paths_are_relative_to_the_file(bench, monkeypatch) -> None:
    (bench / "torchid.toml").write_text(
        'robot = "arm.yaml"\ncolumns = "map.yaml"\nlogs = "a.csv"\nheld-out = ["/abs/b.csv"]\n'
        'out = "."\n[check]\nnearest = "near.json"\nrobot = "3r"\n'
    )
    found = read_project(Path("../torchid.toml"))
    assert (found.robot, found.columns, found.logs) == ("../arm.yaml", "../map.yaml", ("../a.csv",))
    assert Path(found.held_out[0]).resolve() == Path("/abs/b.csv")
    assert found.out == ".."
    assert found.options["check"] == {"nearest": "../near.json", "robot": "3r"}
    monkeypatch.chdir(bench)
    assert read_project(Path("torchid.toml")).robot == "arm.yaml"


def test_a_built_in_robot_is_no_path(bench) -> None:
    (bench / "torchid.toml").write_text('robot = "3r"\n')
    assert read_project(Path("../torchid.toml")).robot == "3r"


def test_without_a_project_nothing_changes() -> None:
    robot = load_robot("3r")
    assert torch.equal(Project().on(robot).parameters.pi, robot.parameters.pi)


def test_help_needs_no_right_project(command, bench) -> None:
    (bench / "torchid.toml").write_text("nonsense")
    assert command("gap", "--help").code == 0
    done = command("gap")
    assert done.code == 1
    assert "cannot be read" in done.err


def test_what_a_project_cannot_be() -> None:
    with pytest.raises(TorchidError, match="cannot be read"):
        read_project(Path("/no/such/torchid.toml"))


def test_converted_logs_and_the_written_folder(command, bench) -> None:
    """A raw log, diagnosed, in three words a command."""
    write_log(read_log("../run1.csv", columns="t=ms ms,q=p{j0},i=amp{j0}"), "own.npz")
    done = command("log", "doctor", "own.npz")
    assert done.code == 0, done.err
    assert (bench / "results" / "doctor" / "doctor.json").exists()


@pytest.mark.slow
def test_logs_without_payload_that_the_project_file_names_are_said_first(command, bench) -> None:
    got = command("payload", "--loaded", "../run2.csv", "--cutoff", "5", "--out", bench / "out")
    assert got.code == 0, got.err
    first = got.out.splitlines()[0]
    assert first.startswith("Without payload, as ")
    assert first.endswith("torchid.toml says: ../run1.csv")
    assert "Without payload, as" not in command("payload", "--help").out


def test_a_log_with_the_payload_is_none_without_it(command, bench) -> None:
    got = command("payload", "--loaded", "../run1.csv", "--force", "--out", bench / "out")
    assert got.code == 1
    assert "Without payload, as" not in got.out
    assert "the arm without payload is not known" in got.err
