"""check: design rules of a tape, measured; nothing is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import click

from tactape_fab.base.errors import DesignRuleError, SpecError
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import avoid_option, examined_order, given_values, is_list, spec_values, tape_options
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, finding_lines, remark_lines, warn


@tape_options
@click.command()
@avoid_option
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check(spec_file: str | None, avoid: Sequence[str], as_json: bool, **options: Any) -> None:
    """Measure a tape against the design rules of its fab or process; nothing is written."""
    with answers():
        values, given = spec_values(spec_file), given_values(options)
        if is_list(values, given):
            what = "sectors names" if spec_file is None else f"{spec_file} is"
            raise SpecError(f"{what} a list of tapes; check takes one, make checks them all before it writes any")
        findings = examined_order(values, given, avoid).findings
        if as_json:
            echo_json([asdict(f) for f in findings])
        else:
            echo_lines(finding_lines(findings))
            echo_lines_err(f"note: {line}" for line in remark_lines(findings))
            warn(findings)
        if any(f.blocks for f in findings):
            raise DesignRuleError(findings)
