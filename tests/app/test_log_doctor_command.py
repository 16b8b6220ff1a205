"""`torchid log doctor` from the command line."""

import json
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from tests.doctor.synthetic import clean
from torchid.app.commands import app
from torchid.log.readers import read_log, write_log


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    _, log = clean("3r", 0)
    assert log.dq is not None
    path = tmp_path / "run.parquet"
    write_log(log.replace(q=log.q * 180 / torch.pi, dq=log.dq * 180 / torch.pi), path)
    return path


def run(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code
    return result.output


@pytest.mark.slow
def test_a_log_that_other_commands_refuse_is_examined_and_mended(bad: Path, tmp_path: Path) -> None:
    before = bad.read_bytes()
    copy, out = tmp_path / "mended.parquet", tmp_path / "out"
    asked = ("log", "doctor", "3r_friction", bad, "--apply", copy, "--out", out, "--pictures")
    text = run(*asked, code=1)
    assert "degrees" in text
    first, rest = text.split("Do first: ")
    assert "Wrong: position unit." in first
    assert "fine: " in rest
    assert bad.read_bytes() == before
    data = json.loads((out / "doctor.json").read_text())
    assert data["schema"] == "torchid.doctor/1"
    wrong = [c for c in data["checks"] if c["verdict"] == "wrong"]
    assert [c["name"] for c in wrong] == ["position unit"]
    assert wrong[0]["joints"] == [1, 2, 3]
    assert f'--columns "{data["columns"]}"' in text.replace("\n", " ")
    assert torch.allclose(read_log(bad, columns=data["columns"]).q, clean("3r", 0)[1].q)
    assert (out / "doctor.png").stat().st_size > 10_000
    assert torch.allclose(read_log(copy).q, clean("3r", 0)[1].q)
    again = tmp_path / "again.json"
    assert run("log", "doctor", "3r_friction", copy, "--json", again, "--quiet") == ""
    assert json.loads(again.read_text())["silent"] is True


@pytest.mark.slow
def test_equally_good_fixes_are_applied_only_once_one_is_chosen(tmp_path: Path) -> None:
    _, log = clean("3r", 0)
    assert log.tau is not None
    negated = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    path, copy = tmp_path / "run.parquet", tmp_path / "mended.parquet"
    write_log(log.replace(tau=log.tau * negated), path)
    text = run("log", "doctor", "3r", path, "--apply", copy, code=1)
    assert '--fix "torque sign 1"' in text
    assert '--fix "position sign 1"' in text
    assert "a copy with 0 fixes" in text
    text = run("log", "doctor", "3r", path, "--fix", "torque sign 1", "--apply", copy, code=1)
    assert "a copy with 1 fix" in text
    mended = read_log(copy).tau
    assert mended is not None
    assert torch.allclose(mended, log.tau)
    assert '--columns "tau=tau{j} *[-1,1,1]"' in text
