"""HTML functions shared by all reports: templates, and escaping for script and style elements."""

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
    # "</script>" and "<!--" would end or change a script element even inside a string
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def allowed(text: str) -> str:
    """Source expression of a content security policy that allows exactly this text."""
    return f"'sha256-{b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"


def embedded(picture: bytes | None) -> str | None:
    """A picture's bytes encoded for a data URL; None without a picture."""
    return None if picture is None else b64encode(picture).decode("ascii")


@cache
def asset(name: str) -> str:
    """Text of a file that pages include unchanged."""
    return (templates_folder() / "report" / name).read_text(encoding="utf-8")


@cache
def script_of(names: tuple[str, ...]) -> str:
    """A page's script: its files, joined in one scope."""
    parts = "\n".join(asset(name) for name in names)
    return f'(() => {{\n"use strict";\n{parts}}})();\n'


def page(name: str, scripts: tuple[str, ...], /, **values: Any) -> bytes:
    """Render a page by the name of its template; its policy allows only its own script, and no network access."""
    # the policy has the hash of this text, so that a script injected by a name or a note is not run
    script, style = script_of(scripts), asset("report.css")
    policy = (
        f"default-src 'none'; img-src data:; script-src {allowed(script)}; style-src {allowed(style)}; "
        "base-uri 'none'; form-action 'none'"
    )
    text: str = template(name).render(script=script, style=style, policy=policy, **values)
    return text.encode("utf-8")


def _printed(text: str) -> str:
    """A text whose unprintable characters, except line ends, are escaped."""
    return text if text.isprintable() else "\n".join(map(one_line, text.split("\n")))


@cache
def template(name: str) -> Any:
    """A page's template, which escapes its values."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(templates_folder() / "report"),
        # a direction mark in a profile's text would reorder the line in a browser
        finalize=lambda value: _printed(value) if isinstance(value, str) and not isinstance(value, Markup) else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=True,
        optimized=False,  # folding constants takes longer than it saves in one page
    )
    return environment.get_template(name)
