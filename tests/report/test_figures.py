"""What every PNG has in common."""

from pathlib import Path

import pytest

from torchid.report.panels import new_figure, save, styled


@pytest.mark.parametrize("name", ["$x^2$", "$\\frac{$", "a\x00b"])
def test_names_are_no_formulas(tmp_path: Path, name: str) -> None:
    figure = new_figure(3, 2)
    axes = styled(figure.subplots())
    axes.set_yscale("log")
    axes.plot([1, 2], [1e-3, 1e3], label=name)
    axes.legend()
    axes.set_title(name)
    assert save(figure, tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    assert axes.get_title() == name.replace("\x00", "\ufffd")
    assert not axes.title.get_parse_math()
