"""Reports of kits that never were in a folder, and what stands in a report's page."""

from __future__ import annotations

import json
from base64 import b64decode
from dataclasses import dataclass, field
from hashlib import sha256
from html.parser import HTMLParser
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.make.kit import rendered
from tactape_fab.report import Written


def written(spec: TapeSpec) -> Written:
    """A kit as `make_kit` writes it, without a verification."""
    examined = examine(spec)
    artifacts, content = rendered(examined)
    files = {a.role: a.data for a in artifacts}
    for row in content["files"]:  # those of files made as they are written are filled in then
        row |= {"bytes": len(files[row["role"]]), "sha256": sha256(files[row["role"]]).hexdigest()}
    return Written(manifest=content, tape=examined.tape, files=files, stl=files.get("stl"), findings=examined.findings)


def unpacked(text: str, kind: str, *shape: int) -> npt.NDArray[Any]:
    return np.frombuffer(b64decode(text), dtype=kind).reshape(*shape)


@dataclass
class Page(HTMLParser):
    """A page as an HTML parser that is not ours reads it."""

    html: bytes
    scripts: list[tuple[dict[str, str | None], str]] = field(default_factory=list)
    styles: list[str] = field(default_factory=list)
    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    text: str = ""
    policy: str = ""

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.feed(self.html.decode("utf-8"))
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.text += " "
        self.tags.append((tag, given))
        if tag == "script":
            self.scripts.append((given, ""))
        elif tag == "style":
            self.styles.append("")
        elif given.get("http-equiv") == "Content-Security-Policy":
            self.policy = str(given["content"])

    def handle_endtag(self, tag: str) -> None:
        self.text += " "

    def handle_data(self, data: str) -> None:
        last = self.tags[-1][0] if self.tags else ""
        if self.cdata_elem == "script" and last == "script":
            attributes, content = self.scripts[-1]
            self.scripts[-1] = (attributes, content + data)
        elif self.cdata_elem == "style":
            self.styles[-1] += data
        else:
            self.text += data

    @property
    def data(self) -> dict[str, Any]:
        (text,) = [content for attributes, content in self.scripts if attributes.get("type") == "application/json"]
        content: dict[str, Any] = json.loads(text)
        return content

    @property
    def script(self) -> str:
        (text,) = [content for attributes, content in self.scripts if "type" not in attributes]
        return text
