"""Ctrl-C, faults of torchid itself, and terminals that take little or nothing."""

import io
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from torchid.app import faults

ROOT = Path(__file__).resolve().parents[2]


def program(text: str, *arguments: str, **options) -> subprocess.CompletedProcess[bytes]:
    """A program of its own, as `torchid ARGUMENTS` after some lines of Python."""
    text += "\nimport sys\nsys.argv[0] = 'torchid'\nfrom torchid.app import main\nmain()"
    return subprocess.run(
        [sys.executable, "-c", text, *arguments],
        cwd=ROOT, check=False, **{"capture_output": True} | options,
    )  # fmt: skip


@pytest.fixture
def faulty(monkeypatch, tmp_path):
    """faulty(error) makes `torchid robot` fail; reports of faults go to tmp_path."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def make(error: BaseException) -> None:
        def fail(robot):
            raise error

        monkeypatch.setattr("torchid.report.robot.robot_record", fail)

    return make


@pytest.mark.parametrize(
    "error",
    [ValueError("of two\nlines"), ZeroDivisionError(), RecursionError("deep"), RuntimeError("x"),
     AssertionError("[/bold]"), KeyError("x" * 5000)],
    ids=lambda error: type(error).__name__,
)  # fmt: skip
def test_a_fault_is_one_line_and_a_file(command, faulty, tmp_path, error) -> None:
    faulty(error)
    done = command("robot", "3r", "--json", tmp_path / "r.json")
    assert done.code == faults.FAULT
    assert re.fullmatch(r"fault: torchid failed in `torchid robot 3r [^\n]*\n", done.err)
    assert len(done.err) < 1000
    name = re.search(r"\S+torchid-fault-\S+\.txt", done.err)
    assert name is not None
    told = Path(name[0]).read_text()
    assert "Traceback (most recent call last)" in told
    assert f"torchid robot 3r --json {tmp_path / 'r.json'}" in told
    assert type(error).__name__ in told
    assert not (tmp_path / "r.json").exists()


def test_debug_shows_the_traceback_instead(command, faulty, tmp_path, monkeypatch, capsys) -> None:
    faulty(ValueError("here"))
    from torchid.app.commands import run

    monkeypatch.setattr(sys, "argv", ["torchid", "robot", "3r", "--debug"])
    with pytest.raises(SystemExit) as stop:
        run()
    assert stop.value.code == faults.FAULT
    said = capsys.readouterr().err
    assert said.startswith("Traceback")
    assert said.rstrip().endswith("ValueError: here")
    assert not list(tmp_path.iterdir())


def test_a_report_that_cannot_be_written_is_no_second_fault(command, faulty, monkeypatch) -> None:
    faulty(ValueError("here"))
    monkeypatch.setattr("tempfile.tempdir", "/no/such/folder")
    done = command("robot", "3r")
    assert done.code == faults.FAULT
    assert "--debug" in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(
    "error",
    [MemoryError("Unable to allocate 7.28 TiB"),
     RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 1 bytes.")],
    ids=["numpy", "torch"],
)  # fmt: skip
def test_too_little_memory_is_an_error(command, faulty, tmp_path, error) -> None:
    faulty(error)
    done = command("robot", "3r", "--json", tmp_path / "r.json")
    assert done.code == 1
    assert done.err.startswith("error: this work needs more memory than this process may use.\n")
    assert not list(tmp_path.iterdir())


def test_too_little_memory_for_the_libraries_is_an_error_too() -> None:
    text = "import resource; resource.setrlimit(resource.RLIMIT_AS, (200 << 20, 200 << 20))"
    done = program(text, "robot", "3r")
    assert done.returncode == 1
    assert done.stderr.startswith(b"error: this work needs more memory")
    assert b"Traceback" not in done.stderr


def test_interrupted(command, faulty) -> None:
    faulty(KeyboardInterrupt())
    done = command("robot", "3r")
    assert (done.code, done.err) == (130, "interrupted\n")


@pytest.mark.slow
@pytest.mark.parametrize("module", ["typer", "torch.nn"])
def test_ctrl_c_while_modules_are_loaded(module) -> None:
    """From the first moment on, and in the midst of torch, which would make other errors of it."""
    text = f"""
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored by jobs in the background
class Hook:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.{signal.SIGINT.name})
sys.meta_path.insert(0, Hook())
"""
    done = program(text, "robot", "3r")
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"interrupted\n")


def test_signals_that_are_ignored_stay_so() -> None:
    """As of a program in the background of a shell."""
    text = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.kill(os.getpid(), signal.SIGINT)
"""
    done = program(text, "--version")
    assert (done.returncode, done.stdout.startswith(b"torchid ")) == (0, True)


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1", "utf-8"])
def test_every_terminal_can_show_a_table(command, tmp_path, monkeypatch, encoding) -> None:
    shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding=encoding))
    done = command("robot", "3r", "--json", tmp_path / "r.json")
    assert (done.code, done.err) == (0, "")
    text = shown.getvalue().decode(encoding)
    plain = encoding == "ascii"
    assert ("rad/s^2" in text, "rad/s\u00b2" in text) == (plain, not plain)
    assert ("\u2500" in text) == (encoding == "utf-8")
    assert json.loads((tmp_path / "r.json").read_text())["schema"]


def test_what_has_no_letters_is_a_question_mark() -> None:
    assert "\u00b1 1\u2009\u03bcm \u2192 \u017e\u2603 \udcff".encode("ascii", "torchid.plain") == (
        b"+- 1 um -> z? ?"
    )


@pytest.mark.slow
@pytest.mark.parametrize("where", ["full", "closed"])
def test_files_are_there_where_nothing_can_be_printed(tmp_path, where) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    asked = ("robot", "3r", "--json", str(tmp_path / "r.json"))
    if where == "full":
        with open("/dev/full", "wb") as full:
            done = program("", *asked, stdout=full, stderr=subprocess.PIPE, capture_output=False)
        assert done.returncode == 1
        lines = done.stderr.decode().splitlines()
        assert lines[0] == "error: what is printed could not be: No space left on device."
        assert "r.json" in lines[1]
        assert len(lines) == 2
    else:
        done = program("", *asked, preexec_fn=lambda: os.close(1))
        assert (done.returncode, done.stderr) == (0, b"")
    assert json.loads((tmp_path / "r.json").read_text())["schema"] == "torchid.robot/1"


@pytest.mark.slow
def test_a_backend_that_is_not_there_is_no_matter(tmp_path) -> None:
    """Commands draw into files only."""
    asked = ("excite", "3r", "--kind", "random", "--duration", "2", "--pictures")
    asked += ("--out", str(tmp_path))
    done = program("", *asked, env={**os.environ, "MPLBACKEND": "nonsense"})
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "trajectory_1.png").exists()
