"""HTML shared by all reports: templates, and escaping for a page's script and style elements."""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from functools import cache
from typing import Any

from tactape_fab.base.plain_text import one_line
from tactape_fab.base.templates import templates_folder


def script_json(content: Any) -> str:
    """JSON that is safe in a script element: no character in it ends one or begins a comment."""
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    # "</script>" and "<!--" end or change a script element whatever the string around them
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def allowed(text: str) -> str:
    """A source of a content security policy that allows exactly this text."""
    return f"'sha256-{b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"


def embedded(picture: bytes | None) -> str | None:
    """A picture's bytes as a data URL holds them; None without one."""
    return None if picture is None else b64encode(picture).decode("ascii")


@cache
def asset(name: str) -> str:
    """A file that is put into pages as it is."""
    return (templates_folder() / "report" / name).read_text(encoding="utf-8")


@cache
def script_of(names: tuple[str, ...]) -> str:
    """The parts of a page's script in one scope."""
    parts = "\n".join(asset(name) for name in names)
    return f'(() => {{\n"use strict";\n{parts}}})();\n'


def page(name: str, scripts: tuple[str, ...], /, **values: Any) -> bytes:
    """A page by the name of its template; its policy lets a browser run its own script alone, and fetch nothing."""
    # the policy names the hash of exactly this text: a script that came into the page by a name or a note is not run
    script, style = script_of(scripts), asset("report.css")
    policy = (
        f"default-src 'none'; img-src data:; script-src {allowed(script)}; style-src {allowed(style)}; "
        "base-uri 'none'; form-action 'none'"
    )
    text: str = template(name).render(script=script, style=style, policy=policy, **values)
    return text.encode("utf-8")


def _printed(text: str) -> str:
    """A text whose lines hold nothing but what is printed."""
    return text if text.isprintable() else "\n".join(map(one_line, text.split("\n")))


@cache
def template(name: str) -> Any:
    """A page's template; what it is given is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(templates_folder() / "report"),
        # a mark of writing direction in a profile's text would turn what a browser shows of its line
        finalize=lambda value: _printed(value) if isinstance(value, str) and not isinstance(value, Markup) else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=True,
    )
    return environment.get_template(name)
