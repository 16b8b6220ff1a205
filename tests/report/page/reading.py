"""A page as a browser and a strict reader see it."""

import base64
import hashlib
from html.parser import HTMLParser

import lxml.html

VOID = {"meta", "br", "hr", "img", "link", "input"}


class Balanced(HTMLParser):
    """Raises where an element is closed that is not open."""

    def __init__(self):
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(set(names)) == len(names), (tag, names)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        assert "svg" in self.open, f"<{tag}/> outside of a figure"

    def handle_endtag(self, tag):
        assert self.open, tag
        assert self.open.pop() == tag, (tag, self.getpos())


def parsed(text: str):
    """The page's tree, after checks that hold for every page."""
    reader = Balanced()
    reader.feed(text)
    reader.close()
    assert reader.open == []
    tree = lxml.html.document_fromstring(text)
    _loads_nothing(tree, text)
    _can_be_read_aloud(tree)
    return tree


def _loads_nothing(tree, text: str) -> None:
    assert len(text.encode()) < 3_000_000
    (policy,) = tree.xpath("//meta[@http-equiv='Content-Security-Policy']/@content")
    for element in tree.iter():
        assert element.tag not in ("link", "iframe", "object", "embed"), element.tag
        if element.tag == "script":
            # What runs is allowed by its own hash.
            digest = hashlib.sha256(element.text.encode()).digest()
            assert f"'sha256-{base64.b64encode(digest).decode()}'" in policy
        for name, value in element.attrib.items():
            assert not name.startswith("on"), name
            if name in ("href", "src", "xlink:href"):
                assert value.startswith(("#", "data:image/png;base64,")), value[:80]
            if "url(" in value:
                assert value.count("url(") == value.count("url(#"), value
    style = "".join(s.text for s in tree.iter("style"))
    assert "url(" not in style
    assert "@import" not in style


def headings(tree) -> list[str]:
    """Titles of the sections that fold, in their order."""
    return [s.text_content().strip() for s in tree.xpath("//details/summary/h2")]


def _can_be_read_aloud(tree) -> None:
    ids = tree.xpath("//@id")
    assert len(set(ids)) == len(ids)
    referred = [x[1:] for x in tree.xpath("//@href") if x.startswith("#")]
    referred += tree.xpath("//@aria-labelledby")
    assert set(referred) <= set(ids)
    assert len(tree.xpath("//h1")) == 1
    for landmark in ("header", "main", "footer"):
        assert len(tree.xpath(f"//{landmark}")) == 1, landmark
    for figure in tree.iter("figure"):
        assert len(figure.xpath(".//figcaption")[0].text_content()) > 40
        # One drawing, or a wide and a narrow one of which the style sheet shows one.
        pictures = figure.xpath(".//svg")
        assert len(pictures) in (1, 2)
        for picture in pictures:
            assert picture.get("role") == "img"
            assert len(picture.get("aria-label")) > 10
    for table in tree.iter("table"):
        assert table.xpath("./caption")[0].text_content().strip()
        assert all(th.get("scope") in ("col", "row") for th in table.iter("th"))
    assert tree.get("lang") == "en"


def rows_of(tree, title: str) -> list[list[str]]:
    """Cells of the table whose caption ends with the title."""
    for table in tree.iter("table"):
        if table.xpath("./caption")[0].text_content().strip().endswith(title):
            return [[c.text_content() for c in row] for row in table.xpath("./tbody/tr")]
    raise AssertionError(title)


def text_of(tree, css_class: str) -> str:
    """Text of the only element of a class."""
    (element,) = tree.find_class(css_class)
    return element.text_content()
