"""Form of a KiCad board: which words and lists stand in each list, and where quotes may be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from tactape_fab.base.fields import counted, named
from tactape_fab.base.fields import shown as quoted
from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.s_expression import Quoted, Tree
from tactape_fab.verify.layers.kicad_drawn import number

_TEXTS: dict[str, Sequence[int]] = {
    **dict.fromkeys(("title", "date", "rev", "paper", "layer", "footprint", "gr_text", "pad", "generator", "descr"), (1,)),
    **dict.fromkeys(("fp_text", "net"), (2,)),
    "layers": range(1, 99),
}
"""Places of words that KiCad takes in quotes, by the name of their list. It refuses a board with others: "need a number"."""
_ROW = "row of layers"
_WORDS = {
    **dict.fromkeys(("general", "title_block", "setup", "effects", "font", "pts"), range(1)),
    **dict.fromkeys(("gr_line", "gr_arc", "gr_poly", "fp_rect", "segment"), range(1)),
    **dict.fromkeys(("version", "generator", "title", "date", "rev", "footprint", "layer", "gr_text", "descr"), range(1, 2)),
    **dict.fromkeys(("width", "fill", "thickness", "drill", "roundrect_rratio", "clearance", "justify"), range(1, 2)),
    **dict.fromkeys(("solder_mask_margin", "pad_to_mask_clearance"), range(1, 2)),
    **dict.fromkeys(("start", "mid", "end", "size", "xy", "aux_axis_origin", "grid_origin", "fp_text"), range(2, 3)),
    **{"at": range(2, 4), "pad": range(3, 4), "paper": range(3, 4), "net": range(1, 3), _ROW: range(2, 4)},
}
"""How many words and numbers stand between the name of a list and the first list in it."""


_NUMBERS = ("version", "at", "start", "mid", "end", "size", "width", "thickness", "drill", "aux_axis_origin", "grid_origin")
"""Lists of numbers alone. Those of an area are read one by one where they are compared."""
_GRAPHIC = ("start", "end", "layer", "width")
_HOLDS: dict[str, Sequence[str]] = {
    "general": ("thickness",),
    "title_block": ("title", "date", "rev"),
    "setup": ("pad_to_mask_clearance", "aux_axis_origin", "grid_origin"),
    "gr_line": _GRAPHIC,
    "gr_arc": (*_GRAPHIC, "mid"),
    "gr_poly": ("pts", "layer", "width", "fill"),
    "gr_text": ("at", "layer", "effects"),
    "segment": (*_GRAPHIC, "net"),
    "fp_text": ("at", "layer", "hide", "effects"),
    "fp_rect": (*_GRAPHIC, "fill"),
    "pad": ("at", "size", "layers", "drill", "roundrect_rratio", "solder_mask_margin", "clearance"),
    "effects": ("font", "justify"),
    "font": ("size", "thickness"),
}
"""Lists that stand in each list of `_WORDS`, once at most, and the word of a hidden text; others hold none."""
_OF_MANY = ("footprint", "pts")
"""Lists that hold some of a kind, which are compared one by one."""


def refuse_malformed(tree: Tree, known: Mapping[str, Sequence[str]]) -> None:
    """Refuse a list without a name, with other words than this tool gives it, or with other lists in it.

    known: Lists of a board and of a footprint; others in these two are passed over.
    Raises ReadbackError.
    """
    left: list[tuple[Tree, tuple[Tree, ...]]] = [(tree, ())]
    seen: set[int] = set()
    while left:
        inner, around = left.pop()
        if not inner or isinstance(inner[0], tuple):
            raise ReadbackError(f"a list without a name stands in {_way_to(around)}")
        name = _ROW if around and around[-1][0] == "layers" else inner[0]
        lists = [item for item in inner if isinstance(item, tuple)]
        words = inner.index(lists[0]) - 1 if lists else len(inner) - 1
        if (usual := _WORDS.get(name)) is not None and words not in usual:
            said = f"{counted(words, 'word', 'words')}, not {' or '.join(map(str, usual))}"
            raise ReadbackError(f"{_way_to((*around, inner))} begins with {said}")
        _refuse_others(str(name), inner, words, (*around, inner))
        inside = known.get(inner[0])
        for item in lists:
            # equal lists of the file are one object
            if id(item) not in seen:
                seen.add(id(item))
                if inside is None or not item or isinstance(item[0], tuple) or item[0] in inside:
                    left.append((item, (*around, inner)))


def _refuse_others(name: str, tree: Tree, words: int, way: Sequence[Tree]) -> None:
    """Refuse words behind the first list, lists that are not in `_HOLDS` or twice, and words for numbers.

    words: How many come before the first list.
    """
    rest = tree[1 + words :]
    if rest and name in _WORDS and name not in _OF_MANY:
        often = Counter([item if isinstance(item, str) else item[:1] for item in rest])
        for what, count in often.items():
            found = what if isinstance(what, str) else "".join(map(str, what))
            # a list without a name is refused when it is looked at itself
            if what and (found not in _HOLDS.get(name, ()) or isinstance(what, str) != (found == "hide")):
                raise ReadbackError(f"{_way_to(way)} holds {quoted(found)}, which this tool does not write")
            if count > 1:
                raise ReadbackError(f"{_way_to(way)} has {count} times {found}")
    if name == "pts" and (strays := [item for item in tree[1:] if isinstance(item, str)]):
        raise ReadbackError(f"{_way_to(way)} holds {quoted(strays[0])}, which this tool does not write")
    if name in _NUMBERS:
        for word in tree[1:]:
            number(str(word))
    if name == _ROW and any(not isinstance(word, Quoted) for word in tree[3:]):
        raise ReadbackError(f"{_way_to(way)} has another word than the name of its layer")


def _way_to(lists: Sequence[Tree]) -> str:
    """Names of lists one in the other, for a message: ``at of pad of footprint R7``."""
    names = []
    for tree in lists:
        of = [item[2] for item in tree[1:] if item[:2] == ("fp_text", "reference") and len(item) > 2]
        names.append(" ".join([quoted(str(tree[0])), *(quoted(str(name)) for name in of[:1])]))
    return " of ".join(reversed(names[1:] or names))


def misquoted(tree: Tree) -> list[str]:
    """Numbers and words of KiCad in quotes."""
    left, seen, wrong = [tree], set[int](), dict[str, None]()
    while left:
        if not (inner := left.pop()):  # of a list that is not looked into
            continue
        # rows of the table of layers begin with a number
        places = _TEXTS.get("layers" if str(inner[0]).isdigit() else str(inner[0]), ())
        for k, item in enumerate(inner):
            if isinstance(item, Quoted) and (k == 0 or k not in places):
                wrong[f"{quoted(str(item))} of {inner[0]}"] = None
            # equal lists of the file are one object
            if isinstance(item, tuple) and id(item) not in seen:
                seen.add(id(item))
                left.append(item)
    return [f"KiCad takes no quotes around {named([*wrong])}"] if wrong else []
