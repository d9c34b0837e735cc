"""What shells offer when Tab is pressed."""

from __future__ import annotations

import os
import re
import select
import shutil
import subprocess
import sys
from pathlib import Path
from time import monotonic

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from tactape_fab.base.templates import profile_names
from tactape_fab.cli import COMMANDS, command, main
from tactape_fab.cli.completion import NAMES
from tactape_fab.texture.code import ALL_CODE_NAMES, CODE_NAMES
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS


def offered(line: str) -> list[tuple[str, str]]:
    """Kind and value of what is offered for the last word of a line."""
    *words, last = line.split(" ")
    completer = ShellComplete(main, {}, "tactape-fab", "_TACTAPE_FAB_COMPLETE")
    return [(item.type, item.value) for item in completer.get_completions(words, last)]


def words(line: str) -> list[str]:
    return [value for kind, value in offered(line) if kind == "plain"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("ce", ["certify"]),
        ("make --fab ", profile_names("fabs")),
        ("profiles jl", [name for name in profile_names("fabs") if name.startswith("jl")]),
        ("make --part ", profile_names("parts")),
        ("check --process ", profile_names("processes")),
        ("advise --process ", ["fpc", *profile_names("processes")]),
        ("make --assembly ", list(ASSEMBLY_FORMATS)),
        ("make --code ", list(ALL_CODE_NAMES)),
        ("certify --code ", list(CODE_NAMES)),
        ("decode --code ", list(CODE_NAMES)),
        ("simulate --sensor ", profile_names("sensors")),
        ("verify --sensor di", ["digit"]),
        ("decode --world ", ["open", "closed"]),
        ("make --coverlay ", ["per-part", "lpi", "gang"]),
        ("make --panel ", ["auto", "none"]),
        ("make --origin ", ["best"]),
        ("make --sector ", []),
        ("completion ", ["bash", "zsh", "fish"]),
    ],
)
def test_words_are_those_that_the_command_takes(line: str, expected: list[str]) -> None:
    assert words(line) == expected


@pytest.mark.parametrize(
    "line",
    ["verify ", "certify ", "decode ", "decode --tape ", "decode --weights ", "make ", "emboss kit ", "make --fab ./mine",
     "verify --map ", "make --avoid "],
)  # fmt: skip
def test_files_are_left_to_the_shell(line: str) -> None:
    assert [kind for kind, _ in offered(line)] == ["file"]


def test_folders_are_left_to_the_shell() -> None:
    assert [kind for kind, _ in offered("make -o ")] == ["dir"]


def test_every_name_is_that_of_a_parameter() -> None:
    there = {(p.name, p.metavar) for name in COMMANDS for p in command(name).params}
    assert set(NAMES) <= there


def test_texts_stay_as_they_are() -> None:
    types = {type(p.type) for name in COMMANDS for p in command(name).params}
    assert all(issubclass(kind, click.types.StringParamType | click.types.BoolParamType | click.Choice) for kind in types)


@pytest.mark.parametrize(("key", "names"), [("code", ALL_CODE_NAMES), ("assembly", ASSEMBLY_FORMATS)])
def test_help_lists_every_name(key: str, names: tuple[str, ...]) -> None:
    (text,) = (p.help for p in command("check").params if isinstance(p, click.Option) and p.name == key)
    assert text is not None and set(names) <= set(re.findall(r"[\w-]+", text))


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_is_one_that_the_shell_reads(shell: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["completion", shell])
    assert result.exit_code == 0
    assert "_TACTAPE_FAB_COMPLETE" in result.stdout
    program = found(shell)
    script = tmp_path / "script"
    script.write_text(result.stdout, encoding="utf-8")
    done = subprocess.run([program, "-n", str(script)], capture_output=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Where a shell finds the program under its name."""
    program = tmp_path / "tactape-fab"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tactape_fab "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    path = os.pathsep.join([str(tmp_path), os.environ["PATH"]])
    packages = os.pathsep.join(p for p in sys.path if p)
    return {**os.environ, "PATH": path, "PYTHONPATH": packages, "HOME": str(tmp_path), "TERM": "dumb"}


def found(shell: str) -> str:
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed")
    return program


def test_bash_completes_in_earnest(environment: dict[str, str]) -> None:
    lines = 'eval "$(tactape-fab completion bash)"; COMP_WORDS=(tactape-fab make --fab pc) COMP_CWORD=3'
    command = [found("bash"), "-c", f'{lines}; _tactape_fab_completion tactape-fab; echo "${{COMPREPLY[@]}}"']
    done = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert (done.stdout.split(), done.stderr) == (["pcbway-fpc", "pcbway-fr4"], "")


def test_fish_completes_in_earnest(environment: dict[str, str]) -> None:
    lines = 'tactape-fab completion fish | source; complete -C "tactape-fab make --fab pc"'
    command = [found("fish"), "--no-config", "-c", lines]
    done = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert (done.stdout.split(), done.stderr) == (["pcbway-fpc", "pcbway-fr4"], "")


def test_zsh_completes_in_earnest(environment: dict[str, str]) -> None:
    """At its prompt, by Tab: zsh completes nowhere else."""
    shell, pty = found("zsh"), pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    terminal = dict.fromkeys(("stdin", "stdout", "stderr"), theirs)
    process = subprocess.Popen([shell, "-f", "-i"], env=environment, start_new_session=True, **terminal)
    os.close(theirs)
    try:
        os.write(ours, b'autoload -U compinit; compinit -u -D; eval "$(tactape-fab completion zsh)"; echo re""ady\n')
        said_by(ours, b"ready\r\n")
        os.write(ours, b"tactape-fab make --fab pcbway-fp\t")
        said_by(ours, b"pcbway-fpc ")
    finally:
        process.kill()
        process.wait()
        os.close(ours)


def said_by(terminal: int, words: bytes, within_s: float = 60.0) -> None:
    """Read a terminal until it shows some words."""
    said, end = b"", monotonic() + within_s
    while words not in said:
        assert monotonic() < end and select.select([terminal], [], [], within_s)[0], said
        said += os.read(terminal, 4096)


def test_no_other_shell_is_known() -> None:
    result = CliRunner().invoke(main, ["completion", "tcsh"])
    assert result.exit_code == 2
    assert "bash" in result.stderr
