"""Escaping: of untrusted text for a line of a terminal, a log or a report, and of strings for a TOML file."""

from __future__ import annotations

import json


def one_line(text: str) -> str:
    """A text with its unprintable characters (line ends, escapes, direction marks) written as escapes such as \\x1b.

    The test is `str.isprintable`: Unicode's categories Cc, Cf, Cs, Co, Cn, Zl, Zp and spaces other than the usual one.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def toml_string(text: str) -> str:
    """A text as a TOML basic string, which has JSON's escapes but no surrogates.

    Unprintable characters are escaped, such as DEL, which TOML does not allow, and direction marks, which editors obey. Bytes of
    a file name that are not UTF-8 are shown as \\udcff.
    """
    whole = text.encode("utf-8", "backslashreplace").decode("utf-8")
    quoted = json.dumps(whole, ensure_ascii=False)
    return quoted if quoted.isprintable() else "".join(c if c.isprintable() else _escape(c) for c in quoted)


def _escape(character: str) -> str:
    """A character as a TOML Unicode escape."""
    number = ord(character)
    return f"\\u{number:04x}" if number <= 0xFFFF else f"\\U{number:08x}"
