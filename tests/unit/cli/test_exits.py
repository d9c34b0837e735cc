"""Messages of the package in the words of the command that was typed."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from time import process_time
from typing import NoReturn

import click
import pytest
from click.testing import CliRunner

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.cli import main
from tactape_fab.cli.exits import answer, ended_by_signals, with_options

HANGUP = getattr(signal, "SIGHUP", signal.SIGTERM)
"""Windows has none."""
COMMAND = click.Command(
    "press",
    params=[
        click.Option(["--raw"], is_flag=True),
        *(click.Option([name]) for name in ("--crop", "--known-theta", "--rate", "--sensor", "--tape")),
    ],
)


@pytest.mark.parametrize(
    ("said", "typed"),
    [
        ("give raw=True with it, or leave it out", "give --raw with it, or leave it out"),
        ("give rate=HZ, or rate='max'", "give --rate HZ, or --rate max"),
        ("cut it out with crop=U,V,W,H, or give another sensor", "cut it out with --crop U,V,W,H, or give another --sensor"),
        ("press once and give known_theta=FRAME,DEG", "press once and give --known-theta FRAME,DEG"),
        ("another tape; give its kit", "another tape; give its kit with --tape"),
        ("give world='open'", "give world='open'"),  # no option of this command
    ],
)  # fmt: skip
def test_arguments_are_named_as_the_options_that_a_command_has(said: str, typed: str) -> None:
    with click.Context(COMMAND):
        assert with_options(said) == typed
    assert with_options(said) == said


@pytest.mark.parametrize("kind", [SpecError, TactapeError])
def test_a_message_of_a_megabyte_is_cut_before_it_is_looked_at(kind: type[TactapeError]) -> None:
    """A name from a file: half a minute of processor time, and a line of a megabyte."""
    before_s = process_time()
    ((line,),) = [lines for _, lines in [answer(kind("there are: " + "a = [" * 200_000 + "; give one of them"))]]
    assert process_time() - before_s < 1.0
    assert len(line) < 5000 and line.startswith("there are: ") and line.endswith("; give one of them")


def test_a_long_typed_value_is_cut_in_its_middle() -> None:
    typed = "1x" * 3000 + "7"
    _, (line,) = answer(SpecError(Problem("size_mm", "size_mm[1] = 7 mm is too much; give less")), {"size": ("--size", typed)})
    assert line == "--size = '" + typed[:99] + "..." + typed[-99:] + "': 7 mm is too much; give less"


@pytest.fixture
def handlers() -> Iterator[None]:
    """The default handlers of these signals, also where nohup runs the tests; what was there is put back afterwards."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, HANGUP)}
    for number in before:
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGTERM, HANGUP])
@pytest.mark.parametrize(
    ("call", "command"),
    [
        ("tactape_fab.make.kit.make_examined", "make --sector 7 --size 24x20 --no-3d"),
        ("tactape_fab.make.panel.make_panel", "coupon"),
        ("tactape_fab.make.emboss.emboss_kit", "emboss KIT part.stl"),
        ("tactape_fab.sense.files.simulated.simulate_file", "simulate KIT -o frames.npz"),
        ("tactape_fab.texture.certify.kits.registry", "registry KIT"),
        ("tactape_fab.texture.registry.read_registered", "registry KIT --pack tapes.registry"),
    ],
)
def test_what_writes_cleans_up_when_it_is_asked_to_stop(
    number: signal.Signals, call: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handlers: None
) -> None:
    monkeypatch.chdir(tmp_path)
    cleaned = []

    def stopped(*_: object, **__: object) -> None:
        try:
            signal.raise_signal(number)
        finally:
            cleaned.append(True)

    # the default would end the process of the tests
    for one in (signal.SIGTERM, HANGUP):
        signal.signal(one, lambda *_: None)
    monkeypatch.setattr(call, stopped)
    assert CliRunner().invoke(main, command.split()).exit_code == 128 + number and cleaned


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (HANGUP, 128 + HANGUP)])
def test_a_signal_of_which_a_library_makes_an_error_keeps_its_status(
    number: signal.Signals, status: int, handlers: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> NoReturn:
        try:
            signal.raise_signal(number)
        except BaseException:  # as reportlab has it where it reads a font
            raise RuntimeError("not a font") from None
        pytest.fail("the signal was lost")

    monkeypatch.setattr("tactape_fab.texture.certify.kits.registry", stopped)
    result = CliRunner().invoke(main, ["registry", "KIT"])
    assert (result.exit_code, result.stdout) == (status, "")


def test_a_command_under_nohup_outlives_its_terminal(handlers: None) -> None:
    signal.signal(HANGUP, signal.SIG_IGN)
    with ended_by_signals():
        assert signal.getsignal(HANGUP) == signal.SIG_IGN


def test_the_program_that_calls_a_command_keeps_its_handlers(handlers: None) -> None:
    signal.signal(signal.SIGTERM, mine := lambda *_: None)
    with ended_by_signals():
        assert signal.getsignal(signal.SIGTERM) is not mine
    assert signal.getsignal(signal.SIGTERM) is mine
    with ThreadPoolExecutor(1) as threads:  # in a thread that can have none
        assert threads.submit(CliRunner().invoke, main, ["profiles"]).result().exit_code == 0


def test_a_temporary_folder_without_room_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tactape_fab.texture.certify.kits.registry", full)
    done = CliRunner().invoke(main, ["registry", "KIT"])
    assert done.exit_code == 1 and done.stderr.count("\n") == 1
    assert tempfile.gettempdir() in done.stderr and "TMPDIR" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, HANGUP])
def test_a_signal_that_python_drops_comes_again(number: signal.Signals, handlers: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a handler is called within a function that is called from C, as numba's compiler does."""

    class Dropping:
        def __del__(self) -> None:
            signal.raise_signal(number)

    def drop() -> None:
        Dropping()
        Event().wait(10)

    monkeypatch.setattr(type(main), "get_command", lambda *_: click.Command("drop", callback=drop))
    assert CliRunner().invoke(main, ["drop"]).exit_code == 128 + number


@pytest.mark.parametrize("start", [("-m", "tactape_fab"), ("-c", "from tactape_fab.__main__ import run; run()")])
def test_ctrl_c_while_the_command_line_is_imported_ends_it_without_a_traceback(tmp_path: Path, start: tuple[str, str]) -> None:
    (tmp_path / "click.py").write_text("raise KeyboardInterrupt")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([sys.executable, *start, "simulate"], env=env, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "stopped by Ctrl-C\n")
