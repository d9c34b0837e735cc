"""Messages of the package in the words of the command that was typed."""

from __future__ import annotations

import click
import pytest

from tactape_fab.cli.exits import with_options

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
