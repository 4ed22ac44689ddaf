"""Edits attributes in the author's text of an MJCF and leaves every other byte unchanged.

    text = MjcfText(Path("robot.xml"))
    text.joints[0].set("damping", [0.16])
    text.written() -> bytes

Elements of included files can be read but not changed. A new element gets the indentation of its neighbours.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape

import numpy as np

from fishmj.base.errors import ConfigError

TAG = re.compile(rb"<[^\s/>]+(?:\s+[^\s=]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*\s*/?>")
ATTRIBUTE = re.compile(rb"(\s+)([^\s=]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
DECLARATION = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:<\?xml[^>]*\?>(?:[ \t]*(\r?\n))?)?")
COMMENT = re.compile(rb"(?<=<!--).*?(?=-->)", re.DOTALL)
REST_OF_LINE = re.compile(rb"[ \t]*(?:<!--[^\n]*?-->[ \t]*)?(?=\r?\n)")
OPEN_ENDED = ("gainprm", "biasprm", "gear", "stiffness", "damping")  # attributes whose last numbers may be left out
SAME = 1e-9  # of the largest number of an attribute


class NotEditable(ConfigError):
    """A change that the text of an MJCF cannot express. The message says why."""


@dataclass(eq=False)
class MjcfElement:
    """One element. start, head, tail, stop: bytes where its start tag begins and ends, and where its end tag begins and ends.

    include: the element of the main file through which an included file brought it. edits: new values, None to remove.
    """

    tag: str
    attributes: dict[str, str]
    start: int
    head: int
    tail: int = 0
    stop: int = 0
    include: "MjcfElement | None" = None
    children: "list[MjcfElement]" = field(default_factory=list)
    edits: dict[str, str | None] = field(default_factory=dict)
    renamed: str = ""

    def child(self, tag: str) -> "MjcfElement | None":
        """The last child of a tag."""
        return next((child for child in reversed(self.children) if child.tag == tag), None)

    @property
    def flat(self) -> "Iterator[MjcfElement]":
        """Its children, and those of its frames in the frames' place."""
        for child in self.children:
            yield from child.flat if child.tag == "frame" else (child,)

    @property
    def bodies(self) -> "Iterator[MjcfElement]":
        """All bodies below it in MuJoCo's order."""
        for child in self.flat:
            if child.tag == "body":
                yield child
                yield from child.bodies

    def set(self, name: str, value: Any) -> None:
        """Sets an attribute to a text, to numbers, or to None: removes it. Numbers that stay keep their spelling.

        Raises:
            NotEditable: it lies in an included file.
        """
        self.refuse_included()
        if value is None or isinstance(value, str):
            self.edits[name] = value
            return
        old = self.attributes.get(name, "").split()
        values = np.atleast_1d(np.asarray(value, float))
        if name in OPEN_ENDED:
            values = values[: max(len(old), 1, *(np.flatnonzero(values) + 1))]
        near = SAME * np.abs(values).max()
        kept = [k < len(old) and abs(float(old[k]) - x) <= near for k, x in enumerate(values)]
        if not all(kept) or len(old) != len(values):
            self.edits[name] = " ".join(
                old[k] if stays else spelled(x) for k, (stays, x) in enumerate(zip(kept, values, strict=True))
            )

    def rename(self, tag: str, *removed: str) -> None:
        """Gives the element another tag, without some of its attributes."""
        self.refuse_included()
        self.renamed = tag
        self.edits |= {name: None for name in removed if name in self.attributes}

    def refuse_included(self) -> None:
        """Raises NotEditable if it lies in an included file."""
        if self.include is not None:
            name = f" {self.attributes['name']}" if "name" in self.attributes else ""
            raise NotEditable(f"<{self.tag}>{name} lies in the included file {self.include.attributes['file']}")


class MjcfText:
    """An MJCF and the changes to it. data: its text, if it is not that of the file.

    Raises:
        NotEditable: no MJCF, no well-formed XML, or an included file is not found.
    """

    def __init__(self, path: Path, data: bytes | None = None) -> None:
        self.path, self.data = path, path.read_bytes() if data is None else data
        self.includes: list[MjcfElement] = []  # of the main file; what they bring stands in their place
        self.root = self._parsed(path, self.data, None)
        if self.root.tag != "mujoco":
            raise NotEditable(f"{path.name} is a URDF")
        self._pieces: list[tuple[int, int, bytes]] = []
        self.newline = b"\r\n" if b"\r\n" in self.data else b"\n"

    @property
    def elements(self) -> list[MjcfElement]:
        """All elements, each before its children."""
        return list(_all(self.root))

    @property
    def bodies(self) -> list[MjcfElement]:
        """Bodies in MuJoCo's order, the world left out."""
        return [body for world in self.root.children if world.tag == "worldbody" for body in world.bodies]

    @property
    def joints(self) -> list[MjcfElement]:
        """Joints in MuJoCo's order, free ones too."""
        return [child for body in self.bodies for child in body.flat if child.tag in ("joint", "freejoint")]

    @property
    def actuators(self) -> list[MjcfElement]:
        """Actuators in MuJoCo's order."""
        return [child for part in self.root.children if part.tag == "actuator" for child in part.children]

    def matched(self, found: Sequence[MjcfElement], names: Sequence[str]) -> Sequence[MjcfElement]:
        """Returns `found` if MuJoCo knows the same elements under the same names, in the same order; else raises NotEditable."""
        if [element.attributes.get("name", "") for element in found] != list(names):
            macros = {e.tag for e in self.elements} & {"replicate", "attach", "composite", "flexcomp"}
            cause = f"by <{min(macros)}>" if macros else "in another order or number than they are written in"
            raise NotEditable(f"MuJoCo makes joints, bodies or actuators of {self.path.name} {cause}")
        return found

    def set_section(self, tag: str, values: dict[str, Any], flags: dict[str, str]) -> None:
        """Sets attributes of <option>, <size> or <compiler>, and of the <flag> in it; makes what is not there.

        A later section wins in MuJoCo: the last one is changed, or one is written after it if it lies in an included file.
        """
        section = self.root.child(tag)
        if not values and not flags:
            return
        if section is None or section.include is not None:
            anchor = section.include if section else self.root.child("compiler")
            within = f"><flag{_attributes(flags)}/></{tag}>" if flags else "/>"
            written = f"<{tag}{_attributes(values)}{within}"
            anchor = anchor.include or anchor if anchor else None
            self.insert_after(anchor, written) if anchor else self.insert_in(self.root, written)
            return
        for name, value in values.items():
            section.set(name, value)
        if flag := section.child("flag"):
            for name, state in flags.items():
                flag.set(name, state)
        elif flags:
            self.insert_in(section, f"<flag{_attributes(flags)}/>")

    def insert_after(self, element: MjcfElement, written: str) -> None:
        """Adds an element after another, on a line of its own if the other has one."""
        indent = self._indent(element)
        self._insert(element.stop, indent, written)

    def insert_in(self, parent: MjcfElement, written: str, **attributes: Any) -> None:
        """Adds an element as the first child of a parent: XML, or a tag and its attributes."""
        parent.refuse_included()
        written = f"<{written}{_attributes(attributes)}/>" if attributes else written
        own = self._indent(parent)
        if parent.tail == parent.start:  # <tag/>
            lead = self.newline + own + self._step if own is not None else b""
            after = self.newline + own if own is not None else b""
            slash = self.data.rindex(b"/", parent.start, parent.head)
            tag = f"</{parent.renamed or parent.tag}>".encode()
            self._pieces.append((slash, parent.head, b">" + lead + written.encode() + after + tag))
            return
        mine = [child for child in parent.children if child.include is None]
        inner = self._indent(mine[0]) if mine else None if own is None else own + self._step
        self._insert(parent.head, inner, written)

    def written(self, comment: str = "") -> bytes:
        """The text with its changes. comment: for its first line."""
        pieces = [*self._pieces]
        for element in (*self.includes, *self.elements):
            if element.edits or element.renamed:
                pieces += self._start_tag(element)
        out = self.data
        for start, stop, new in sorted(pieces, key=lambda piece: piece[0], reverse=True):
            out = out[:start] + new + out[stop:]
        return with_comment(out, comment) if comment else out

    def _start_tag(self, element: MjcfElement) -> Iterator[tuple[int, int, bytes]]:
        """(start, stop, new bytes) of each change to an element's tags."""
        name = len(element.tag.encode())
        if element.renamed:
            yield element.start + 1, element.start + 1 + name, element.renamed.encode()
            if element.tail > element.start:
                yield element.tail + 2, element.tail + 2 + name, element.renamed.encode()
        last, space = element.start + 1 + name, b" "
        new = dict(element.edits)
        for found in ATTRIBUTE.finditer(self.data, element.start, element.head):
            last, space = found.end(), found[1]
            key = found[2].decode(errors="replace")
            if key in new:
                value = new.pop(key)
                if value is None:
                    yield found.start(), found.end(), b""
                else:
                    yield found.start(3) + 1, found.end(3) - 1, _escaped(value).encode()
        added = b"".join(space + f'{key}="{_escaped(value)}"'.encode() for key, value in new.items() if value is not None)
        if added:
            yield last, last, added

    def _insert(self, at: int, indent: bytes | None, written: str) -> None:
        """Adds text after a byte: on the next line with an indentation, or there if there is none."""
        rest = REST_OF_LINE.match(self.data, at)
        if indent is None or rest is None:
            self._pieces.append((at, at, written.encode()))
        else:
            self._pieces.append((rest.end(), rest.end(), self.newline + indent + written.encode()))

    def _indent(self, element: MjcfElement) -> bytes | None:
        """White space before an element on its line; None if something else stands there."""
        line = self.data.rfind(b"\n", 0, element.start) + 1
        before = self.data[line : element.start]
        return None if before.strip() else before

    @property
    def _step(self) -> bytes:
        """White space by which the file indents the children of its root."""
        return next(filter(None, (self._indent(child) for child in self.root.children if child.include is None)), b"  ")

    def _parsed(self, path: Path, data: bytes, include: MjcfElement | None) -> MjcfElement:
        """Root of a file, with included files in the place of their elements."""
        parser, open_ones = expat.ParserCreate(), [MjcfElement("", {}, 0, 0)]

        def begin(tag: str, attributes: dict[str, str]) -> None:
            start = parser.CurrentByteIndex
            head = TAG.match(data, start)
            if head is None:
                raise NotEditable(f"a start tag of {path.name} has an unusual form: <{tag}>")
            element = MjcfElement(tag, attributes, start, head.end(), include=include)
            open_ones[-1].children.append(element)
            open_ones.append(element)

        def end(tag: str) -> None:
            element = open_ones.pop()
            closed = data[element.head - 2 : element.head] == b"/>"
            element.tail = element.start if closed else parser.CurrentByteIndex
            element.stop = element.head if closed else data.index(b">", element.tail) + 1
            if tag == "include":
                siblings = open_ones[-1].children
                siblings.pop()
                self.includes += [] if include else [element]
                file = self._included(element, path)
                siblings.extend(self._parsed(file, file.read_bytes(), include or element).children)

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        try:
            blank = lambda comment: re.sub(rb"[^\n]", b" ", comment[0])
            parser.Parse(COMMENT.sub(blank, data), True)  # MuJoCo takes a comment with two hyphens, expat does not
        except expat.ExpatError as error:
            raise NotEditable(f"{path.name} is not well-formed XML: {error}") from error
        return open_ones[0].children[0]

    def _included(self, element: MjcfElement, within: Path) -> Path:
        """File of an <include>: beside the main file, or beside the file that includes it."""
        name = element.attributes.get("file", "")
        for folder in (self.path.parent, within.parent):
            if (folder / name).is_file():
                return folder / name
        raise NotEditable(f"the included file {name} was not found")


def with_comment(data: bytes, comment: str) -> bytes:
    """MJCF with a comment before its root element."""
    newline = b"\r\n" if b"\r\n" in data else b"\n"
    safe = b"<!-- " + comment.replace("--", "- -").encode().replace(b"\n", newline) + b" -->"

    def added(found: re.Match[bytes]) -> bytes:
        shares_line = b"<?" in found[0] and not found[1]
        return found[0] + safe + (b"" if shares_line else newline)

    return DECLARATION.sub(added, data, count=1)


def spelled(value: float) -> str:
    """A number in MJCF."""
    return f"{value:.12g}"


def _attributes(values: dict[str, Any]) -> str:
    texts = {n: v if isinstance(v, str) else " ".join(map(spelled, np.atleast_1d(v))) for n, v in values.items()}
    return "".join(f' {name}="{_escaped(text)}"' for name, text in texts.items())


def _escaped(text: str) -> str:
    return escape(text, {'"': "&quot;", "'": "&apos;"})


def _all(element: MjcfElement) -> Iterator[MjcfElement]:
    yield element
    for child in element.children:
        yield from _all(child)
