"""Untrusted text made fit for a line of a terminal, a log or a report: the one place where that is done."""

from __future__ import annotations


def one_line(text: str) -> str:
    """A text without characters that are not printed: line ends, escapes, marks of writing direction. They are shown as \\x1b.

    The test is `str.isprintable`: Unicode's categories Cc, Cf, Cs, Co, Cn, Zl, Zp and spaces other than the usual one.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
