"""Small changes of a module, each in one place of its syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from types import CodeType

Swap = Callable[[], None]

_BOUNDARY: dict[type[ast.AST], type[ast.AST]] = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
_OPPOSITE: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
}
_OTHER: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult},
    **{ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.Pow: ast.Mult},
}
_NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "argmin": "argmax", "argmax": "argmin", "ceil": "floor"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One change.

    Attributes
    ----------
    line : int
        Where it is.
    text : str
        That line of the file, without blanks around it.
    change : str
        What is changed, in words that are unique among those of equal text.
    place : (int, int)
        Number of the node, and of the change of this node.
    in_function : bool
    """

    line: int
    text: str
    change: str
    place: tuple[int, int]
    in_function: bool


def mutants(source: str) -> Iterator[Mutant]:
    """Every change of a module, in the order of its text."""
    lines, seen = source.splitlines(), dict[tuple[str, str], int]()
    tree = ast.parse(source)
    inner = {id(node) for part in ast.walk(tree) if isinstance(part, ast.FunctionDef) for node in ast.walk(part)}
    for index, node in enumerate(_places(tree)):
        for number, (what, _) in enumerate(_changes(node)):
            line = node.target.lineno if isinstance(node, ast.comprehension) else getattr(node, "lineno", 1)
            key = lines[line - 1].strip(), what
            times = seen[key] = seen.get(key, 0) + 1
            change = what + (f" ({times})" if times > 1 else "")
            yield Mutant(line=line, text=key[0], change=change, place=(index, number), in_function=id(node) in inner)


def changed(source: str, mutant: Mutant, path: str) -> CodeType:
    """The whole module with the change."""
    tree = ast.parse(source)
    index, number = mutant.place
    _changes(_places(tree)[index])[number][1]()
    return compile(ast.fix_missing_locations(tree), path, "exec")


def _places(tree: ast.AST) -> list[ast.AST]:
    """Nodes that may be changed: no annotations, no documentation."""
    found: list[ast.AST] = []

    def walk(node: ast.AST) -> None:
        found.append(node)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            for child in value if isinstance(value, list) else [value]:
                is_text = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
                if isinstance(child, ast.AST) and not is_text:
                    walk(child)

    walk(tree)
    return found


def _changes(node: ast.AST) -> list[tuple[str, Swap]]:
    """Changes of one node: what each is called, and how it is done."""

    def put(owner: object, name: str, value: object) -> Swap:
        return lambda: setattr(owner, name, value)

    def other(table: dict[type[ast.AST], type[ast.AST]], op: ast.AST, swap: Callable[[ast.AST], Swap]) -> list[tuple[str, Swap]]:
        to = table.get(type(op))
        return [] if to is None else [(f"{_word(op)} to {_word(to())}", swap(to()))]

    match node:
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign():
            return other(_OTHER, node.op, lambda op: put(node, "op", op))
        case ast.Compare():
            ways = (other(table, node.ops[0], lambda op: lambda: node.ops.__setitem__(0, op)) for table in (_BOUNDARY, _OPPOSITE))  # type: ignore[call-overload]
            return [way for some in ways for way in some]
        case ast.Constant(value=bool() as flag):
            return [(f"{flag} to {not flag}", put(node, "value", not flag))]
        case ast.Constant(value=int() | float() as value):
            return [(f"{value} to {value + 1}", put(node, "value", value + 1))]
        case ast.UnaryOp(op=ast.USub() | ast.Invert()):
            return [(f"without {_word(node.op)}", lambda: _become(node, node.operand))]
        case ast.UnaryOp(op=ast.Not()):
            return [("not away", lambda: _become(node, ast.Call(ast.Name("bool", ast.Load()), [node.operand], [])))]
        case ast.If() | ast.IfExp() | ast.While():
            if isinstance(node.test, ast.Compare) and len(node.test.ops) == 1:
                return []  # the comparison's own opposite
            return [("condition to its opposite", put(node, "test", ast.UnaryOp(op=ast.Not(), operand=node.test)))]
        case ast.comprehension(ifs=[_, *_]):
            return [("without the condition", put(node, "ifs", []))]
        case ast.Name() if node.id in _NAMES and isinstance(node.ctx, ast.Load):
            return [(f"{node.id} to {_NAMES[node.id]}", put(node, "id", _NAMES[node.id]))]
        case ast.Attribute() if node.attr in _NAMES:
            return [(f"{node.attr} to {_NAMES[node.attr]}", put(node, "attr", _NAMES[node.attr]))]
        case ast.Return(value=ast.expr()) if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            return [("returns None", put(node, "value", ast.Constant(None)))]
        case ast.Expr(value=ast.Call()):
            return [("statement away", put(node, "value", ast.Constant(None)))]
        case ast.Continue() | ast.Break():
            return [("statement away", lambda: _become(node, ast.Pass()))]
    return []


def _become(node: ast.AST, other: ast.AST) -> None:
    where = {name: getattr(node, name) for name in ("lineno", "col_offset", "end_lineno", "end_col_offset")}
    copied = deepcopy(other)
    node.__class__ = copied.__class__
    node.__dict__.clear()
    node.__dict__.update(copied.__dict__ | where)


def _word(op: ast.AST) -> str:
    """An operator as it is written."""
    one, two = ast.Name("a", ast.Load()), ast.Name("b", ast.Load())
    if isinstance(op, ast.cmpop):
        tree: ast.expr = ast.Compare(one, [op], [two])
    elif isinstance(op, ast.boolop):
        tree = ast.BoolOp(op, [one, two])
    elif isinstance(op, ast.unaryop):
        return "minus" if isinstance(op, ast.USub) else "~"
    else:
        tree = ast.BinOp(one, op, two)  # type: ignore[arg-type]
    return ast.unparse(tree)[1:-1].strip()
