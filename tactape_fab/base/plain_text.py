"""Text made fit for where it goes: untrusted text for a line of a terminal, a log or a report; text of a TOML file."""

from __future__ import annotations

import json


def one_line(text: str) -> str:
    """A text without characters that are not printed: line ends, escapes, marks of writing direction. They are shown as \\x1b.

    The test is `str.isprintable`: Unicode's categories Cc, Cf, Cs, Co, Cn, Zl, Zp and spaces other than the usual one.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def toml_string(text: str) -> str:
    """A text as a basic string of TOML, which has JSON's escapes but no halves of a character beyond U+FFFF.

    What is not printed is escaped: DEL, which TOML does not allow, and marks of writing direction, which editors obey. Bytes of a
    file's name that are no UTF-8 are shown as \\udcff.
    """
    whole = text.encode("utf-8", "backslashreplace").decode("utf-8")
    quoted = json.dumps(whole, ensure_ascii=False)
    return quoted if quoted.isprintable() else "".join(c if c.isprintable() else _escape(c) for c in quoted)


def _escape(character: str) -> str:
    """A character by its number, as TOML has it."""
    number = ord(character)
    return f"\\u{number:04x}" if number <= 0xFFFF else f"\\U{number:08x}"
