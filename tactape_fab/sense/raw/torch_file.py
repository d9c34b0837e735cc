"""Tensors of a PyTorch checkpoint (.pth), read without PyTorch and without running its pickle.

``torch.save`` writes a zip (torch/serialization.py, since 1.6): ``<name>/data.pkl``, a pickle whose tensors are
``torch._utils._rebuild_tensor_v2(storage, offset, shape, strides, ...)``, and one entry ``<name>/data/<key>`` with the numbers
of each storage, uncompressed. A pickle is a program that may call anything; here it is only read, instruction by instruction,
and what a table of tensors does not need is refused.
"""

from __future__ import annotations

import io
import pickletools
import struct
import zipfile
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.input_file import read_regular

MOST_BYTES = 8 << 20
MOST_ENTRIES = 1000
MOST_PICKLE_BYTES = 1 << 16
MOST_VALUES = 1 << 19
_REMEDY = "give the file that torch.save wrote of the network's state_dict"
_NEEDLESS = f"which no table of tensors needs; nothing was run; {_REMEDY}"
_DAMAGED = (zipfile.BadZipFile, EOFError, OSError, ValueError, RuntimeError, NotImplementedError, struct.error, OverflowError)
"""Exceptions of reading a damaged zip archive."""

_TABLE, _TENSOR = "collections.OrderedDict", "torch._utils._rebuild_tensor_v2"
_STORAGES = {"torch.FloatStorage": "f4", "torch.DoubleStorage": "f8"}
_ARGUMENTS = {"BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE"}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Name:
    """A global that the pickle names; it is not imported."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Storage:
    """Numbers in an entry of the zip."""

    kind: str
    key: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Planned:
    """A tensor whose numbers have not been read."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]


_MARK = _Name(text="mark")
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": (), "MARK": _MARK}


def read_tensors(path: str | Path) -> dict[str, npt.NDArray[np.float32]]:
    """The tensors of a state_dict by name.

    Raises SpecError when the file is none, too large, or holds anything else. Nothing in it is run.
    """
    path = as_path(path, "path", "a file of weights")
    try:
        data = read_regular(path, MOST_BYTES)
        if len(data) > MOST_BYTES:
            raise SpecError(f"is larger than {MOST_BYTES} bytes; {_REMEDY}")
        if not data.startswith(b"PK"):
            raise SpecError(f"is no zip, as torch.save writes since PyTorch 1.6; {_REMEDY}")
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _read(archive)
    except SpecError as error:
        raise SpecError(Problem("weights", f"weights {shown_path(path)} {error}")) from None
    except _DAMAGED as error:
        reason = reason_of(error).split("\n", maxsplit=1)[0]
        message = f"weights {shown_path(path)} cannot be read: {reason or type(error).__name__}; {_REMEDY}"
        raise SpecError(Problem("weights", message)) from error


def _read(archive: zipfile.ZipFile) -> dict[str, npt.NDArray[np.float32]]:
    names = archive.namelist()
    # the folder in the zip has the name of the file when it was saved
    tables = [name for name in names if name.count("/") == 1 and name.endswith("/data.pkl")]
    if len(names) > MOST_ENTRIES or len(names) != len(set(names)) or len(tables) != 1:
        raise SpecError(f"is a zip of other things than one table of tensors; {_REMEDY}")
    top = tables[0].removesuffix("data.pkl")
    planned = _table_of(_entry(archive, tables[0], MOST_PICKLE_BYTES))
    # the storage of each tensor is read, of which the tensor may be a small part
    if sum(tensor.storage.count for tensor in planned.values()) > MOST_VALUES:
        raise SpecError(f"holds more than {MOST_VALUES} numbers, more than a network for one pixel has; {_REMEDY}")
    order = ">" if top + "byteorder" in names and _entry(archive, top + "byteorder", 16) == b"big" else "<"
    return {name: _tensor(archive, top, order, tensor) for name, tensor in planned.items()}


def _entry(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """An entry of at most so many bytes, stored as it is: no entry unpacks to more than the file holds."""
    try:
        info = archive.getinfo(name)
    except KeyError:
        raise SpecError(f"has no entry {shown(name)}, which its table of tensors names; {_REMEDY}") from None
    # torch stores entries as they are; a deflated one may be a thousand times as large as the file
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > most:
        raise SpecError(f"has an entry {shown(name)} that is compressed or larger than {most} bytes; {_REMEDY}")
    return archive.read(info)


def _tensor(archive: zipfile.ZipFile, top: str, order: str, tensor: _Planned) -> npt.NDArray[np.float32]:
    dtype = np.dtype(order + tensor.storage.kind)
    size = tensor.storage.count * dtype.itemsize
    data = _entry(archive, f"{top}data/{tensor.storage.key}", size)
    if len(data) != size:
        raise SpecError(f"ends in the middle of a tensor; {_REMEDY}")
    with np.errstate(over="ignore"):  # what single precision cannot hold is infinite, and refused where it is used
        values = np.frombuffer(data, dtype=dtype)[tensor.offset :][: prod(tensor.shape)].astype(np.float32)
    return values.reshape(tensor.shape)


def _table_of(data: bytes) -> dict[str, _Planned]:
    """Table of tensors that a pickle builds; any other object is refused."""
    try:
        table = _built(data)
    except SpecError:
        raise
    except (IndexError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise SpecError(f"has a damaged table of tensors; {_REMEDY}") from error
    if isinstance(table, dict) and "state_dict" in table:
        raise SpecError(
            f"holds a checkpoint with a 'state_dict' in it, such as gsrobotics' network of normals; {_REMEDY} of gs_sdk"
        )
    if not isinstance(table, dict) or not all(isinstance(value, _Planned) for value in table.values()):
        raise SpecError(f"holds something else than tensors by name; {_REMEDY}")
    return table


def _built(data: bytes) -> Any:
    """The value on top of the stack at the end; every value is a constant, a tuple, a dict, or one of the classes above."""
    stack: list[Any] = []
    memo: dict[Any, Any] = {}
    for opcode, argument, _ in pickletools.genops(data):
        match opcode.name:
            case "STOP":
                return stack.pop()
            case "PROTO" | "FRAME":
                pass
            case name if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case name if name in _ARGUMENTS:
                stack.append(argument)
            case "EMPTY_DICT":
                stack.append({})
            case "BINPUT" | "LONG_BINPUT":
                memo[argument] = stack[-1]
            # protocol 4: the next free number
            case "MEMOIZE":
                memo[len(memo)] = stack[-1]
            case "BINGET" | "LONG_BINGET":
                stack.append(memo[argument])
            case name:
                _combine(name, argument, stack)
    raise ValueError("no end")


def _combine(name: str, argument: Any, stack: list[Any]) -> None:
    """An instruction that makes one value of others, or fills one."""
    match name:
        case _ if name in _TUPLES:
            stack[-_TUPLES[name] :] = [tuple(stack[-_TUPLES[name] :])]
        case "TUPLE":
            stack.append(tuple(_marked(stack)))
        case "SETITEM":
            _set(stack, [stack.pop(-2), stack.pop()])
        case "SETITEMS":
            _set(stack, _marked(stack))
        case "GLOBAL":
            # pickletools gives both words of GLOBAL with a space between
            stack.append(_known(_text(argument).replace(" ", ".", 1)))
        case "STACK_GLOBAL":
            last, module = stack.pop(), stack.pop()
            stack.append(_known(f"{_text(module)}.{_text(last)}"))
        case "BINPERSID":
            stack.append(_storage(stack.pop()))
        case "REDUCE":
            arguments, called = stack.pop(), stack.pop()
            stack.append(_made(called, arguments))
        case "BUILD":  # attributes of the table, such as _metadata
            stack.pop()
            _dict(stack[-1])
        case _:
            raise SpecError(f"has a pickle with the instruction {name}, {_NEEDLESS}")


def _marked(stack: list[Any]) -> list[Any]:
    """Pop the values above the last mark, and the mark."""
    start = len(stack) - 1
    while stack[start] is not _MARK:  # runs out of the stack where there is none
        start -= 1
    taken = stack[start + 1 :]
    del stack[start:]
    return taken


def _set(stack: list[Any], pairs: list[Any]) -> None:
    table = _dict(stack[-1])
    for key, value in zip(pairs[::2], pairs[1::2], strict=True):
        table[_text(key)] = value


def _known(name: str) -> _Name:
    if name.startswith("torch.") and name.endswith("Storage") and name not in _STORAGES:
        raise SpecError(f"holds values of {shown(name)}, not single or double precision; {_REMEDY} after network.float()")
    if name not in (_TABLE, _TENSOR, *_STORAGES):
        raise SpecError(f"has a pickle that names {shown(name)}, {_NEEDLESS}")
    return _Name(text=name)


def _made(called: Any, arguments: Any) -> Any:
    """Value of a call in the pickle, an empty table or a tensor; nothing is run."""
    if called == _Name(text=_TABLE) and arguments == ():
        return {}
    if called != _Name(text=_TENSOR):
        raise SpecError(f"has a pickle that calls something else than makes a tensor; nothing was run; {_REMEDY}")
    storage, offset, shape, strides = arguments[:4]
    if any(arguments[6:]):  # torch.serialization: {"neg": True} of tensors whose numbers are to be negated
        raise SpecError(f"holds a tensor that PyTorch changes when it reads it, as tensor.resolve_neg() does; {_REMEDY}")
    sizes = [_count(n) for n in shape]
    if not isinstance(storage, _Storage) or not isinstance(shape, tuple) or not isinstance(strides, tuple) or len(sizes) > 2:
        raise TypeError("no tensor")
    # C order: the last axis is the nearest
    if strides != tuple(prod(sizes[i + 1 :]) for i in range(len(sizes))):
        raise SpecError(f"holds a tensor that does not lie in one piece, as tensor.contiguous() does; {_REMEDY}")
    if _count(offset) + prod(sizes) > storage.count:
        raise ValueError("a tensor reaches beyond its storage")
    return _Planned(storage=storage, offset=offset, shape=tuple(sizes))


def _storage(pid: Any) -> _Storage:
    # ("storage", class, key, device, number of values) as torch.save writes persistent ids; the device does not matter
    word, kind, key, _, count = pid
    if word != "storage" or not isinstance(kind, _Name) or kind.text not in _STORAGES:
        raise TypeError("no storage")
    if not (_text(key).isascii() and key.isdigit() and len(key) < 10):
        raise SpecError(f"names a storage {shown(key)}, which is not a number; {_REMEDY}")
    return _Storage(kind=_STORAGES[kind.text], key=key, count=_count(count))


def _count(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MOST_VALUES:
        raise SpecError(f"asks for a tensor of size {shown(value) if isinstance(value, int) else 'unknown'}; {_REMEDY}")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("no text")
    return value


def _dict(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("no table")
    return value
