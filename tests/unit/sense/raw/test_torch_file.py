"""Weights of a network: what is read, and that a file which is anything else is refused without anything in it being run."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.sense import load_network
from tactape_fab.sense.raw.torch_file import MOST_BYTES, read_tensors
from tests.raw_images import (
    EMPTY,
    archive,
    random_layers,
    storage,
    table,
    tensor,
    tensors_of,
    text,
    weights_file,
)

ONE = {"w/data/0": np.arange(6, dtype="<f4").tobytes()}


def refused(data: bytes, folder: Path) -> str:
    """The one message with which a file of weights is refused."""
    path = folder / "w.pth"
    path.write_bytes(data)
    with pytest.raises(SpecError) as error:
        load_network(path)
    assert [p.key for p in error.value.problems] == ["weights"]
    message = str(error.value)
    assert str(path) in message and "; give " in message and "\n" not in message
    return message


def with_table(pickled: bytes) -> bytes:
    return archive({"w/data.pkl": pickled, **ONE})


def test_tensors_come_as_they_were_saved(tmp_path: Path) -> None:
    written = tensors_of(random_layers((5, 7, 2)))
    found = read_tensors(weights_file(tmp_path / "w.pth", written))
    assert list(found) == list(written)
    for name, values in written.items():
        np.testing.assert_array_equal(found[name], values)


def test_offsets_kinds_and_byte_orders_are_kept(tmp_path: Path) -> None:
    values = np.arange(8.0)
    for order, entry in (("<", b"little"), (">", b"big")):
        pickled = table({"a": tensor(storage("3", 8, "DoubleStorage"), (2, 3), offset=2)})
        entries = {"w/data.pkl": pickled, "w/byteorder": entry, "w/data/3": values.astype(order + "f8").tobytes()}
        (tmp_path / "w.pth").write_bytes(archive(entries))
        np.testing.assert_array_equal(read_tensors(tmp_path / "w.pth")["a"], values[2:].reshape(2, 3))


def test_attributes_of_the_table_are_passed_over(tmp_path: Path) -> None:
    pickled = table({"a": tensor(storage("0", 6), (6,))})[:-1] + b"}" + text("_metadata") + EMPTY + b"sb."
    (tmp_path / "w.pth").write_bytes(with_table(pickled))
    assert list(read_tensors(tmp_path / "w.pth")) == ["a"]


SYSTEM = b"cos\nsystem\n"


class _Calls:
    """Pickles as a call of os.system."""

    def __init__(self, command: str) -> None:
        self.command = command

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (self.command,)


def _line(command: str) -> bytes:
    return repr(command).encode()


PROGRAMS: dict[str, Callable[[str], bytes]] = {
    **{f"os.system, protocol {n}": (lambda c, n=n: pickle.dumps(_Calls(c), protocol=n)) for n in range(6)},  # type: ignore[misc]
    "in a table": lambda c: pickle.dumps({"fc1.weight": _Calls(c)}, protocol=2),
    "as a key": lambda c: b"}" + pickle.dumps(_Calls(c), protocol=2)[2:-1] + b"Ns.",
    "eval": lambda c: b"cbuiltins\neval\n(" + text(f"__import__('os').system({c!r})") + b"tR.",
    "INST": lambda c: b"(S" + _line(c) + b"\nios\nsystem\n.",
    "OBJ": lambda c: b"(cos\nsystem\nS" + _line(c) + b"\no.",
    "STACK_GLOBAL": lambda c: b"\x80\x04" + text("os") + text("system") + b"\x93" + text(c) + b"\x85R.",
    "a name with dots": lambda c: (
        b"\x80\x04" + text("collections") + text("_sys.modules.get") + b"\x93" + text("os") + b"\x85R"
        b"0" + SYSTEM + text(c) + b"\x85R."
    ),
    "hidden in memory": lambda c: b"cos\nsystem\nq\x000h\x00" + text(c) + b"\x85R.",
    "BUILD": lambda c: b"ccollections\nOrderedDict\n)R" + pickle.dumps(_Calls(c), protocol=2)[2:-1] + b"0}b.",
    "after a table": lambda c: table({})[:-1] + b"0" + SYSTEM + text(c) + b"\x85R.",
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_no_program_is_run(name: str, tmp_path: Path) -> None:
    marker = tmp_path / "it-was-run"
    program = PROGRAMS[name](f"touch {marker}")
    pickle.loads(program)
    assert marker.exists(), "the program does nothing: no test"
    marker.unlink()
    message = refused(with_table(program), tmp_path)
    assert "nothing was run" in message
    assert not marker.exists()


def test_no_program_is_run_inside_a_tensor(tmp_path: Path) -> None:
    marker = tmp_path / "it-was-run"
    call = SYSTEM + text(f"touch {marker}") + b"\x85R"
    whole_tensor = tensor(storage("0", 6), (6,))
    for inside in (tensor(call, (6,)), whole_tensor.replace(b"\x89", call), whole_tensor.replace(text("cpu"), call)):
        assert "'os.system'" in refused(with_table(table({"fc1.weight": inside})), tmp_path)
    assert not marker.exists()


@pytest.mark.parametrize(
    ("pickled", "says"),
    [
        (b"\x82\x01.", "EXT1"),
        (b"Pstorage\n.", "PERSID"),
        (b"\x80\x04\x97.", "NEXT_BUFFER"),
        (b"ccollections\nOrderedDict\n)\x81.", "NEWOBJ"),
        (b"ccollections\nOrderedDict\n(]tR.", "EMPTY_LIST"),
        (b"ctorch._utils\n_rebuild_tensor_v2\n)R.", "damaged"),
        (b"ccollections\nOrderedDict\nK\x01\x85R.", "calls something else"),
        (b"K\x01K\x02R.", "calls something else"),
        (b"}.", "not weights and biases of 1 to 8 layers"),
        (b"}" + text("a") + b"K\x01s.", "something else than tensors"),
        (b"}" + text("state_dict") + EMPTY + b"s.", "gsrobotics"),
        (b"K\x01.", "something else than tensors"),
        (b"", "damaged"),
        (b".", "damaged"),
        (b"h\x05.", "damaged"),
        (b"t.", "damaged"),
        (b"}(K\x01u.", "damaged"),
        (b"}K\x01K\x02s.", "damaged"),
        (table({"a": tensor(storage("0", 6), (7,))}), "damaged"),
        (table({"a": tensor(storage("0", 6), (2,), offset=5)}), "damaged"),
        (table({"a": tensor(storage("0", 6), (2,), offset=-1)}), "size -1"),
        (table({"a": tensor(storage("0", 6), (-2,))}), "size -2"),
        (table({"a": tensor(storage("0", 6), (1 << 30, 1 << 30))}), "size 1073741824"),
        (table({"a": tensor(storage("0", 1 << 30), (6,))}), "size 1073741824"),
        (table({"a": tensor(storage("0", 6), (1, 2, 3))}), "damaged"),
        (table({"a": tensor(storage("0", 6), (2, 3), strides=(1, 2))}), "contiguous"),
        (table({"a": tensor(storage("0", 6), (2, 3), strides=(0, 0))}), "contiguous"),
        (table({"a": tensor(storage("0", 5), (5,))}), "compressed or larger than 20 bytes"),
        (table({"a": tensor(storage("0", 7), (7,))}), "ends in the middle"),
        (table({"a": tensor(storage("1", 6), (6,))}), "no entry 'w/data/1'"),
        (table({"a": tensor(storage("../data/0", 6), (6,))}), "is not a number"),
        (table({"a": tensor(storage("/etc/passwd", 6), (6,))}), "is not a number"),
        (table({"a": tensor(storage("٣", 6), (6,))}), "is not a number"),
        (table({"a": tensor(storage("0", 6, "HalfStorage"), (6,))}), "'torch.HalfStorage', not single or double precision"),
        (table({"a": tensor(storage("0", 6), (6,)).replace(b")Rt", b")R}" + text("neg") + b"\x88st")}), "resolve_neg"),
        (table({f"a{k}": tensor(storage("0", 1 << 19), (1 << 19,)) for k in range(2)}), "more than 524288 numbers"),
        (table({f"a{k}": tensor(storage("0", 1 << 19), (0,)) for k in range(2)}), "more than 524288 numbers"),
    ],
)
def test_what_is_no_table_of_tensors_is_refused(pickled: bytes, says: str, tmp_path: Path) -> None:
    assert says in refused(with_table(pickled), tmp_path)


def test_pickles_made_to_take_for_ever_are_refused_at_once(tmp_path: Path) -> None:
    doubling = b")" + b"q\x00h\x00\x86" * 400  # a tuple of twice itself, 400 times over: 2^400 leaves
    marks = b"(" * 30_000 + b"t" * 30_000
    for pickled in (
        doubling + b".",
        b"}" + text("a") + doubling + b"s.",
        b"}" + doubling + b"Ns.",
        doubling + b"Q.",
        b"ctorch._utils\n_rebuild_tensor_v2\n" + doubling + b"R.",
        marks + b".",
        b"(" * 60_000 + b".",
        b"I" + b"9" * 60_000 + b"\n.",
    ):
        start = process_time()
        refused(with_table(pickled), tmp_path)
        assert process_time() - start < 2.0


def test_zips_of_other_things_are_refused(tmp_path: Path) -> None:
    good = table({"a": tensor(storage("0", 6), (6,))})
    bomb = {"w/data.pkl": good, "w/data/0": bytes(1 << 22)}
    assert "compressed" in refused(archive(bomb, zipfile.ZIP_DEFLATED), tmp_path)
    assert "compressed" in refused(archive({"w/data.pkl": good + bytes(1 << 17)}), tmp_path)
    assert "one table" in refused(archive({"w/data.pkl": good, "v/data.pkl": good}), tmp_path)
    assert "one table" in refused(archive({"data.pkl": good}), tmp_path)
    assert "one table" in refused(archive({"w/data.pkl": good, **{f"w/{k}": b"" for k in range(1000)}}), tmp_path)
    assert "no zip" in refused(pickle.dumps({}), tmp_path)
    assert "no zip" in refused(b"", tmp_path)
    assert f"larger than {MOST_BYTES}" in refused(b"PK" + bytes(MOST_BYTES), tmp_path)
    twice = io.BytesIO()
    with zipfile.ZipFile(twice, "w") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.writestr("w/data.pkl", good)
        file.writestr("w/data.pkl", good)
    assert "one table" in refused(twice.getvalue(), tmp_path)
    (tmp_path / "w.pth").unlink()
    with pytest.raises(SpecError, match="No such file"):
        load_network(tmp_path / "w.pth")
    with pytest.raises(SpecError, match="no regular file"):
        load_network(tmp_path)


def test_a_damaged_file_is_refused_or_read(tmp_path: Path) -> None:
    """Whatever byte is changed and wherever the file ends, nothing but a message comes of it."""
    path = weights_file(tmp_path / "w.pth", tensors_of(random_layers((5, 6, 2))))
    data, rng = path.read_bytes(), np.random.default_rng(3)
    outcomes = {"read": 0, "refused": 0}
    for k in range(600):
        broken = bytearray(data)
        if k % 3 == 0:
            del broken[rng.integers(len(data)) :]
        else:
            broken[rng.integers(len(data))] = rng.integers(256)
        path.write_bytes(broken)
        try:
            load_network(path)
            outcomes["read"] += 1
        except SpecError as error:
            assert [p.key for p in error.problems] == ["weights"]
            outcomes["refused"] += 1
    assert outcomes["refused"] > 300


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"fc2.weight": np.zeros((2, 8))}, "fc2 has weights of shape (2, 8) and biases of shape (2,) for 7 inputs"),
        ({"fc2.bias": np.zeros(3)}, "fc2 has weights of shape (2, 7) and biases of shape (3,) for 7 inputs"),
        ({"fc1.weight": np.zeros((7, 3))}, "fc1 has weights of shape (7, 3) and biases of shape (7,) for 5 inputs"),
        ({"fc1.weight": np.zeros(35)}, "fc1 has weights of shape (35,)"),
        ({"fc2.weight": np.zeros((3, 7)), "fc2.bias": np.zeros(3)}, "a network with 5 - 7 - 3 neurons"),
        ({"fc1.weight": np.zeros((300, 5)), "fc1.bias": np.zeros(300), "fc2.weight": np.zeros((2, 300))}, "5 - 300 - 2 neurons"),
        ({"fc1.weight": np.zeros((0, 5)), "fc1.bias": np.zeros(0), "fc2.weight": np.zeros((2, 0))}, "5 - 0 - 2 neurons"),
        ({"fc1.bias": np.full(7, np.nan)}, "hold values that are NaN or infinite"),
        ({"fc1.bias": np.full(7, np.inf)}, "hold values that are NaN or infinite"),
        ({"bn1.weight": np.zeros(7), "bn1.bias": np.zeros(7)}, "bn1.bias, bn1.weight, fc1.bias"),
        ({"fc3.weight": np.zeros((2, 2))}, "not weights and biases of 1 to 8 layers"),
    ],
)
def test_layers_that_do_not_fit_are_refused(change: dict[str, np.ndarray], says: str, tmp_path: Path) -> None:
    tensors = tensors_of(random_layers((5, 7, 2))) | {name: a.astype(np.float32) for name, a in change.items()}
    path = weights_file(tmp_path / "x.pth", tensors)
    assert says in refused(path.read_bytes(), tmp_path)


def test_too_many_layers_are_refused(tmp_path: Path) -> None:
    assert load_network(weights_file(tmp_path / "w.pth", tensors_of(random_layers((5, *[4] * 7, 2))))).sizes[-1] == 2
    path = weights_file(tmp_path / "w.pth", tensors_of(random_layers((5, *[4] * 8, 2))))
    assert "not weights and biases of 1 to 8 layers" in refused(path.read_bytes(), tmp_path)
