"""Reader of s-expressions, the format of KiCad's files, as nested tuples.

Not by a library: a board of 1,984 parts (3.1 MB) takes sexpdata 1.0.2 0.91 s and kiutils 1.4.8 0.66 s, each more than all of a
quick verification. Here numpy finds the brackets, and lists with equal text, such as most of a footprint, are parsed once.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.texture.frames import IntArray

Tree: TypeAlias = "tuple[str | Tree, ...]"


class Quoted(str):
    """A word that stands in quotes: a text, never a number or a word of the format."""

    __slots__ = ()


_DEEPEST = 16
_TOKEN = re.compile(r'[()]|"(?:[^"\\]|\\.)*"|[^\s()"]+', re.DOTALL)
_FIRST_WORDS = re.compile(rb'\([^()"]*(?:"(?:[^"\\]|\\.)*"[^()"]*)*', re.DOTALL)
_BARE = np.isin(np.arange(256), [*b"\t\n\r", *range(ord(" "), 127)]) & ~np.isin(np.arange(256), [*b"\\#"])
"""Bytes that may stand outside quotes. KiCad takes no other white space for it; Python's reader of numbers does."""
_ESCAPED = re.compile(r"\\(.)", re.DOTALL)


def read_s_expression(data: bytes, without: Sequence[str]) -> Tree:
    """Parse the single list of a file; words are kept as written, those in quotes without them, as `Quoted`.

    data: UTF-8. Other characters than those of ASCII, a backslash, or a '#', which starts a comment in KiCad, are allowed only
        within quotes.
    without: Names of lists of one value that are removed everywhere, such as ``tstamp``, whose values are all different.
    Raises ReadbackError if brackets or quotes do not match, lists are nested more than 16 deep, or there is text outside the
        single list.
    """
    if without:  # quotes are removed in pairs only, so that the quoting of the rest does not change
        names = "|".join(without).encode()
        # such a list has one word, so nothing nested is lost
        data = re.sub(rb'\(\s*(?:%s)\s+(?:[\w.-]+|"[\w.-]*")\s*\)' % names, b" ", data)
    at, level = _brackets(data)
    # depth 1 is the board, 2 its footprints and lines, 3 their elements,
    # many of which are equal from one footprint to the next
    inner = _spans(at, level, 3)
    texts = [data[begin:end] for begin, end in inner]
    try:
        # most that differ do so in their first words alone, such as a designator, and what follows is parsed once as well
        begun = {text: _FIRST_WORDS.match(text).end() for text in dict.fromkeys(texts)}  # type: ignore[union-attr]
        rests = dict.fromkeys(text[end:] for text, end in begun.items())
        parsed = dict(zip(rests, _parsed(b"".join(b"(" + rest for rest in rests)), strict=True))
        known = {text: (*_words(text[1:end]), *parsed[text[end:]]) for text, end in begun.items()}
        lists = [(begin, end, known[text]) for (begin, end), text in zip(inner, texts, strict=True)]
        # parsed lists of depth 3 are inserted into those of depth 2, and these into the one of depth 1
        ((_, _, whole),) = _around(data, _spans(at, level, 1), _around(data, _spans(at, level, 2), lists))
    except UnicodeDecodeError as error:
        raise ReadbackError(f"it is not UTF-8: {error.reason}") from error
    return whole


def _brackets(data: bytes) -> tuple[IntArray, IntArray]:
    """Indices of the brackets outside quotes, and the depth, from 1, of the list that each begins or ends."""
    # escapes are overwritten with the same length, so that an escaped quote does not count and indices do not change
    text = np.frombuffer(re.sub(rb"\\.", b"__", data, flags=re.DOTALL) if b"\\" in data else data, dtype=np.uint8)
    at = np.flatnonzero((text == ord('"')) | (text == ord("(")) | (text == ord(")")))
    is_quote = text[at] == ord('"')
    quotes = at[is_quote]
    whole = np.frombuffer(data, dtype=np.uint8)
    marks = np.flatnonzero(~_BARE[whole])
    # a place after an odd number of quotes is inside quotes
    if len(quotes) % 2 or (np.searchsorted(quotes, marks) % 2 == 0).any():
        raise ReadbackError("it has a quote without an end, or a backslash, '#' or character beyond ASCII outside quotes")
    at = at[~is_quote & (np.cumsum(is_quote) % 2 == 0)]
    closes = text[at] == ord(")")
    # depth after each bracket; it must be positive until the last one, which ends the single list
    after = np.cumsum(1 - 2 * closes)
    if not len(at) or after[-1] != 0 or (after[:-1] <= 0).any() or (data[: at[0]] + data[at[-1] + 1 :]).strip():
        raise ReadbackError("its brackets do not match, or it holds more than one list")
    if after.max() > _DEEPEST:
        raise ReadbackError(f"its lists are nested more than {_DEEPEST} deep")
    # a closing bracket belongs to the depth before it
    return at, after + closes


def _spans(at: IntArray, level: IntArray, depth: int) -> list[tuple[int, int]]:
    """Start and end of each list of a depth, in file order: at one depth, opening and closing brackets alternate."""
    pairs = at[level == depth].reshape(-1, 2)
    return list(zip(pairs[:, 0].tolist(), (pairs[:, 1] + 1).tolist(), strict=True))


def _around(data: bytes, spans: list[tuple[int, int]], inner: list[tuple[int, int, Tree]]) -> list[tuple[int, int, Tree]]:
    """Parse lists around their already parsed inner lists, both in file order."""
    found, k = [], 0
    # most lists begin with the same words; between two lists and behind the last is mostly a blank, or nothing
    known: dict[bytes, list[str]] = {}
    for begin, end in spans:
        words: list[str | Tree] = []
        at = begin + 1
        while k < len(inner) and inner[k][0] < end:
            first, after, tree = inner[k]
            if not (between := data[at:first]).isspace():
                if between not in known:
                    known[between] = _words(between)
                words += known[between]
            words.append(tree)
            at, k = after, k + 1
        if last := data[at : end - 1].strip():
            words += _words(last)
        found.append((begin, end, tuple(words)))
    return found


def _words(text: bytes) -> list[str]:
    """Words of a text without brackets outside quotes."""
    if b'"' not in text:
        return text.decode("ascii").split()
    return [_word(token) if token[0] == '"' else token for token in _TOKEN.findall(text.decode("utf-8"))]


def _word(token: str) -> Quoted:
    """A word without its quotes."""
    return Quoted(_ESCAPED.sub(r"\1", token[1:-1]))


def _parsed(text: bytes) -> list[Tree]:
    """Parse lists one after the other, token by token."""
    stack: list[list[str | Tree]] = [[]]
    lists: list[Tree] = []
    for token in _TOKEN.findall(text.decode("utf-8")):
        if token == "(":
            stack.append([])
        elif token != ")":
            stack[-1].append(_word(token) if token[0] == '"' else token)
        # stack[0] collects the finished top-level lists
        elif len(stack) > 2:
            done = tuple(stack.pop())
            stack[-1].append(done)
        else:
            lists.append(tuple(stack.pop()))
    return lists
