"""Editing an XML file so that what is not edited stays: comments, order, white space, line ends."""

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import torch
from lxml import etree
from torch import Tensor

from torchid.digits import number
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.placement import exact
from torchid.robot.xml_numbers import content_of, parsed
from torchid.typing import Float

DECLARATION = b'<?xml version="1.0" encoding="utf-8"?>\n'
HEAD = "torchid export:"
"""How the comment at the top of an export begins, which a later export replaces."""
MARK = "torchid:"
"""How its other comments begin."""
_PROLOG = re.compile(rb"(?:\s|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^\[>]*(?:\[.*?\]\s*)?>)*", re.DOTALL)
_MARKUP = re.compile(
    rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<[^/!?](?:[^>\"']|\"[^\"]*\"|'[^']*')*>", re.DOTALL
)


class _Written(NamedTuple):
    """How an element's start tag is written in the file, and its attributes there."""

    tag: bytes
    attributes: dict[str, str]


@dataclass(frozen=True, eq=False)
class XmlFile:
    """A parsed file, and what lxml does not keep of it.

    Attributes:
        root: the root element.
        before, after: what stands around it, as it is written there.
        encoding: of the file.
        crlf: whether lines end as on Windows.
        written: start tags as they are in the file, by element.
    """

    root: Any
    before: bytes
    after: bytes = b"\n"
    encoding: str = "utf-8"
    crlf: bool = False
    written: Mapping[Any, _Written] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """The file's content in its own encoding; tags that were not edited as they were."""
        body = etree.tostring(
            self.root, encoding=self.encoding, xml_declaration=False, with_tail=False
        )
        if self.crlf:
            body = body.replace(b"\n", b"\r\n")
        elements = list(self.root.iter(etree.Element))
        if len(elements) == len(_start_tags(body)):
            following = iter(elements)
            body = _MARKUP.sub(lambda found: self._tag(found.group(), following), body)
        return self.before + body + self.after

    def _tag(self, markup: bytes, following: Iterator[Any]) -> bytes:
        """A start tag as in the file, where it still says the same; other markup as it is."""
        if not _is_start(markup):
            return markup
        element = next(following)
        old = self.written.get(element)
        if old is None or old.attributes != dict(element.attrib):
            return markup
        start = old.tag[:-2].rstrip() if old.tag.endswith(b"/>") else old.tag[:-1]
        if old.tag.endswith(b"/>") == markup.endswith(b"/>"):
            return old.tag
        return start + (b"/>" if markup.endswith(b"/>") else b">")


def _is_start(markup: bytes) -> bool:
    return markup[1:2] not in (b"!", b"?")


def _start_tags(data: bytes) -> list[bytes]:
    return [markup for markup in _MARKUP.findall(data) if _is_start(markup)]


def read_xml(path: Path) -> XmlFile:
    """A file with its comments; the robot readers have already refused what is not XML."""
    data = content_of(path)
    root = parsed(data, path, strip_cdata=False)
    found = _PROLOG.match(data)
    before = b"" if found is None else found.group()
    name = f"{root.prefix}:{local(root)}" if root.prefix else local(root)
    end = data.rfind(f"</{name}".encode())
    after = data[data.find(b">", end) + 1 :]
    tags, elements = _start_tags(data[len(before) :]), list(root.iter(etree.Element))
    written = {}
    if len(tags) == len(elements):
        pairs = zip(elements, tags, strict=True)
        written = {element: _Written(tag, dict(element.attrib)) for element, tag in pairs}
    encoding = root.getroottree().docinfo.encoding or "utf-8"
    return XmlFile(root, before, after, encoding, b"\r\n" in data, written)


def local(node: Any) -> str:
    """An element's tag without its namespace; empty for a comment."""
    return etree.QName(node).localname if isinstance(node.tag, str) else ""


def children(element: Any, *tags: str) -> list[Any]:
    """Child elements of these tags."""
    return [node for node in element if local(node) in tags]


def child(element: Any, tag: str) -> Any | None:
    """The first child element of a tag, or None."""
    found = children(element, tag)
    return found[0] if found else None


def new_child(element: Any, tag: str, *, first: bool = False) -> Any:
    """A new child in the element's namespace, first or last, indented as its neighbours."""
    namespace = etree.QName(element).namespace
    node = etree.Element(tag if namespace is None else f"{{{namespace}}}{tag}")
    insert(element, node, first=first)
    return node


def child_or_new(element: Any, tag: str, *, first: bool = False) -> Any:
    """The child of a tag, made where there is none."""
    found = child(element, tag)
    return new_child(element, tag, first=first) if found is None else found


def insert(element: Any, node: Any, *, first: bool) -> None:
    """Put a node among the element's children, on a line of its own where they have one."""
    if len(element) == 0:
        # White space in front of the element.
        previous, parent = element.getprevious(), element.getparent()
        outer = "" if parent is None else parent.text or ""
        outer = outer if previous is None else previous.tail or ""
        if outer.strip(" \t\r\n") == "" and "\n" in outer:
            element.text = f"{outer}  "
            node.tail = outer
        element.append(node)
    elif first:
        node.tail = element.text if not (element.text or "").strip() else None
        element.insert(0, node)
    else:
        last = element[-1]
        node.tail, last.tail = last.tail, element.text
        element.append(node)


def comment(words: str, mark: str = MARK) -> Any:
    """A comment that says so; what XML forbids in comments is written otherwise."""
    safe = re.sub(r"-(?=-)|-\Z", "- ", f" {mark} {words} ")
    return etree.Comment(safe)


def replace(node: Any, other: Any) -> None:
    """Put another node in the place of one, white space behind it kept."""
    other.tail = node.tail
    node.getparent().replace(node, other)


def set_head(root: Any, words: str) -> None:
    """A comment as the root's first child, in place of that of an earlier export."""
    for node in [n for n in root.iter(etree.Comment) if (n.text or "").strip().startswith(HEAD)]:
        parent, previous = node.getparent(), node.getprevious()
        if parent is None:
            continue
        if previous is not None:
            previous.tail = node.tail
        else:
            parent.text = node.tail
        parent.remove(node)
    insert(root, comment(words, HEAD), first=True)


def relocated_path(reference: str, old: Path, new: Path) -> str:
    """A relative file reference as seen from another folder; others (absolute, package://) as they
    are."""
    if not reference or "://" in reference or os.path.isabs(reference) or reference[0] == "$":
        return reference
    return Path(os.path.relpath(old.resolve() / reference, new.resolve())).as_posix()


def text(values: Iterable[float] | Tensor) -> str:
    """Numbers separated by blanks, each with the digits that give the same float64."""
    return " ".join(number(v) for v in values)


def roll_pitch_yaw_of(rotation: Float[Tensor, "3 3"]) -> list[float]:
    """Angles with Rz(yaw) Ry(pitch) Rx(roll) = rotation [rad].

    Roll and pitch are read off Rz(-yaw) rotation, so that near pitch = 90 deg, where yaw is
    arbitrary, the product is still exact to rounding.
    """
    r = rotation.double()
    yaw = torch.atan2(r[1, 0], r[0, 0])
    c, s = torch.cos(yaw), torch.sin(yaw)
    x, y = c * r[0] + s * r[1], c * r[1] - s * r[0]
    return [float(torch.atan2(-y[2], y[1])), float(torch.atan2(-r[2, 0], x[0])), float(yaw)]


def quaternion_of(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "4"]:
    """Unit quaternion (w, x, y, z), w >= 0, from its largest component (Shepperd 1978)."""
    r = rotation.double()
    trace = r.trace()
    largest = int(torch.stack([trace, *r.diagonal()]).argmax())
    if largest == 0:
        own = [1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        own = [r[k, j] - r[j, k]] + [r[i, a] + r[a, i] for a in range(3)]
        own[1 + i] = 1 + r[i, i] - r[j, j] - r[k, k]
    q = torch.stack(own)
    q = q / q.norm()
    return exact(-q if q[0] < 0 else q)


def principal_axes(
    parameters: InertialParameters, link: int
) -> tuple[Float[Tensor, "3"], Float[Tensor, "4"]]:
    """Principal moments (3,) of a link about its centre of mass [kg m^2], and the quaternion of
    their axes in the link frame; the link's own axes where these are principal."""
    tensor = symmetric(parameters.inertia_about_com[link])
    if not (tensor - torch.diag(tensor.diagonal())).any():
        return tensor.diagonal(), torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    values, axes = torch.linalg.eigh(tensor)
    axes[:, 2] *= torch.linalg.det(axes).sign()
    return values, quaternion_of(axes)
