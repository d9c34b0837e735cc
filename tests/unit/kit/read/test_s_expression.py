"""S-expressions as nested tuples: whatever white space and depth, and what is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.s_expression import Tree, read_s_expression

WORDS = st.text(st.sampled_from("ab.*0-"), min_size=1, max_size=4) | st.text(st.sampled_from('a ()"\\#\n\té'), max_size=5)
TREES = st.recursive(st.lists(WORDS).map(tuple), lambda inner: st.lists(WORDS | inner).map(tuple), max_leaves=30)


def read(text: str) -> Tree:
    return read_s_expression(text.encode("utf-8"), ("tstamp",))


def written(tree: Tree, space: str, stamp: str) -> str:
    def word(text: str) -> str:
        plain = text.isascii() and text and not set(text) & set(' ()"\\#\n\t')
        return text if plain else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'

    inner = [word(item) if isinstance(item, str) else written(item, space, stamp) for item in tree]
    return f"({space}{space.join([*inner, stamp])}{space})"


@given(tree=TREES, space=st.sampled_from([" ", "\n", "\t \r\n"]), stamp=st.sampled_from(["", "(tstamp 0-a)", '( tstamp "1" )']))
def test_what_was_written_is_read(tree: Tree, space: str, stamp: str) -> None:
    assert read(written(tree, space, stamp)) == tree


def test_lists_that_read_alike_are_one_object() -> None:
    first, second, third = (
        item[1] for item in read('(a (b (c 1 "x")) (b (c 1 "x")) (b (c 1 "y")))')[1:] if isinstance(item, tuple)
    )
    assert first is second
    assert first != third


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "do not match"),
        ("a", "do not match"),
        ("(a", "do not match"),
        ("(a))", "do not match"),
        (")a(", "do not match"),
        ("(a) (b)", "more than one list"),
        ("(a) b", "more than one list"),
        ('(a "b)', "quote without an end"),
        ('(a "\\")', "quote without an end"),
        ("(a \\( b)", "backslash"),
        ("(a\n# (b)\n)", "'#' or character beyond ASCII outside quotes"),
        ("(a 1\u00a02)", "beyond ASCII outside quotes"),
        ("(a 1\x0b2)", "beyond ASCII outside quotes"),
        ("(" * 17 + ")" * 17, "more than 16 deep"),
        ("(" * 1_000_000, "do not match"),
    ],
)
def test_what_cannot_be_read_is_refused(text: str, says: str) -> None:
    with pytest.raises(ReadbackError, match=says):
        read(text)


def test_a_name_to_leave_out_hides_nothing_when_it_begins_in_quotes() -> None:
    hidden = '(a (b "(tstamp "x ) (zone 1) (b "y"))'
    assert ("zone", "1") in read(hidden)


def test_other_encodings_are_refused() -> None:
    with pytest.raises(ReadbackError, match="UTF-8"):
        read_s_expression(b'(a (b (c "\xff")))', ())
