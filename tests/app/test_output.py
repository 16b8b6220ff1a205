"""Messages of the library in the words of the command line."""

import pytest

from torchid.app import commands  # noqa: F401  # their options are what is asked for
from torchid.app.output import in_options, option_names


@pytest.mark.parametrize(
    ("python", "options"),
    [
        ('use `rows="all"`', "use --rows all"),
        ("refit: `parameters='free'`", "refit: --parameters free"),
        ("hold out its end: `held_out_fraction=0.3`", "hold out its end: --held-out-fraction 0.3"),
        ("`force=True` writes it", "--force writes it"),
        ("`worthwhile=...`, `gain=...`", "--worthwhile, --gain"),
        ('`columns="t=ms ms,q=pos_{j} deg"`', '--columns "t=ms ms,q=pos_{j} deg"'),
        ('`topic="/joint_states"`', "--topic /joint_states"),
    ],
)
def test_arguments_become_options(python: str, options: str) -> None:
    assert in_options(python) == options


@pytest.mark.parametrize(
    "text", ["`no_such_thing=...`", "lines such as `q: pos_{j} deg`", "without `=`.", "rows=all"]
)
def test_what_is_no_option_stays(text: str) -> None:
    assert in_options(text) == text


def test_options_are_those_of_all_commands() -> None:
    assert option_names()["error_cutoff"] == "--error-cutoff"  # identify
    assert option_names()["background"] == "--background"  # gap
    assert "logs" not in option_names()  # an argument without a name
