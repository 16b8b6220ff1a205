"""Figures inside a page: themed, small, unique, and harmless."""

import re

import numpy as np
import pytest
from lxml import etree

from torchid.report.colours import BLUE, INK
from torchid.report.page.document import THEME, Picture, inline_svg
from torchid.report.panels import new_figure, styled


def picture(name: str = "a", title: str = "title", alt: str = "what is seen") -> Picture:
    def draw():
        figure = new_figure(4, 3)
        axes = styled(figure.subplots())
        x = np.linspace(0, 1, 3000)
        axes.plot(x, np.sin(40 * x), color=BLUE, label="curve")
        axes.scatter(x[:9], x[:9], color=INK, marker="s")
        axes.set_yscale("symlog")
        figure.suptitle(title)
        figure.legend()
        return figure

    return Picture(name, "caption", alt, draw)


def test_colours_follow_the_theme():
    text = inline_svg(picture())
    assert "var(--blue)" in text
    assert "var(--ink)" in text
    assert not set(re.findall(r"#[0-9a-f]{6}\b", text)) & set(THEME)
    assert "<style" not in text
    assert "DejaVu" not in text
    assert len(text) < 90_000


def test_ids_are_the_pictures_own():
    trees = [etree.fromstring(inline_svg(picture(name))) for name in ("a", "b")]
    ids = [set(tree.xpath("//@id")) for tree in trees]
    assert ids[0]
    assert not ids[0] & ids[1]
    for tree, own in zip(trees, ids, strict=True):
        referred = set(re.findall(r'(?:url\(|href=")#([^)"]+)', etree.tostring(tree).decode()))
        assert referred == own


def test_the_same_figure_is_the_same_text():
    assert inline_svg(picture()) == inline_svg(picture())


@pytest.mark.parametrize(
    "name", ["$x^2", "$\\frac{$", "</svg><script>alert(1)</script>", "€ & \"'"]
)
def test_names_are_text(name):
    tree = etree.fromstring(inline_svg(picture(title=name, alt=name)))
    assert name in ["".join(t.itertext()) for t in tree.iter("{*}text")]
    assert tree.get("aria-label") == name
    assert not list(tree.iter("{*}script"))


def test_labels_of_logarithmic_axes_are_formulas():
    texts = ["".join(t.itertext()) for t in etree.fromstring(inline_svg(picture())).iter("{*}text")]
    assert not any("$" in t for t in texts)
