"""Options are read off a command's signature and docstrings."""

from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
import typer
from typer.testing import CliRunner

from torchid.app.signature import Fields, Switch, command


@dataclass(frozen=True)
class Settings:
    """How.

    Attributes:
        folds: parts of the data, each
            left out in turn.
        rows, method: which.
        quiet: say nothing.
    """

    folds: int = 5
    rows: Literal["all", "moving"] = "all"
    method: str = "huber"
    quiet: bool = False


seen: list[object] = []


@command
def made_command(
    *,
    settings: Annotated[
        Settings, Fields("rows", "quiet", folds=Annotated[int, typer.Option(min=2)], method="ols")
    ],
    name: str,
    partial: Switch = False,
) -> None:
    """Do it.

    Example: `made`

    Args:
        name: Of it.
        rows: Rows fitted.
    """
    seen.append((settings, name, partial))


app = typer.Typer(add_completion=False)
app.command()(made_command)


def test_a_field_is_an_option_with_its_default_and_text() -> None:
    params = {p.opts[0]: p for p in typer.main.get_command(app).params}
    # Panel by panel: what no panel names comes first.
    expected = ["--folds", "--name", "--partial", "--rows", "--method", "--quiet", "--debug"]
    assert list(params) == expected
    assert [params[name].default for name in ("--folds", "--rows", "--method")] == [5, "all", "ols"]
    assert params["--folds"].help == "Parts of the data, each left out in turn."
    assert (params["--rows"].help, params["--method"].help) == ("Rows fitted.", "Which.")
    assert (params["--partial"].secondary_opts, params["--quiet"].secondary_opts) == (
        [], ["--no-quiet"],
    )  # fmt: skip
    assert typer.main.get_command(app).help == "Do it.\n\nExample: `made`"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--name", "a"], (Settings(method="ols"), "a", False)),
        (["--name", "a", "--folds", "3", "--rows", "moving", "--partial", "--quiet"],
         (Settings(3, "moving", "ols", True), "a", True)),
    ],
)  # fmt: skip
def test_the_command_is_given_the_dataclass(arguments, expected) -> None:
    seen.clear()
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert seen == [expected]


@pytest.mark.parametrize("arguments", [[], ["--name", "a", "--folds", "1"]])
def test_wrong_usage_exits_with_2(arguments) -> None:
    assert CliRunner().invoke(app, arguments).exit_code == 2
