"""advise."""

from __future__ import annotations

import click

from tactape_fab.cli.exits import answers, echo_json, echo_lines, echo_lines_err, step_shown
from tactape_fab.cli.group import main
from tactape_fab.cli.options import SENSOR_HELP, length, number, size


@main.command()
@click.option("--contact", metavar="MM", help="Diameter of the smallest contact that is to be located. Required.")
@click.option("--sensor", metavar="NAME", help=SENSOR_HELP)
@click.option("--process", metavar="fpc|sla|fdm|cnc", help="How it is made: ordered, printed or milled.  [default: fpc]")
@click.option("--fab", metavar="PROFILE", help="With fpc: fab profile, or a .toml file.  [default: generic-fpc]")
@click.option("--blur", metavar="MM", help="Standard deviation of what the gel smooths.  [default: 0.15]")
@click.option("--placement", metavar="MM", help="Standard deviation of the parts' places along each axis.  [default: 0]")
@click.option("--tapes", metavar="N", help="How many tapes will be registered.  [default: 1]")
@click.option("--size", "size_mm", metavar="WxH", help="Outline of one tape, mm.  [default: 100x50]")
@click.option("--simulate", "simulate_too", is_flag=True, help="Hold the first lines against simulated contacts.")
@click.option("--explain", is_flag=True, help="Say what the columns are, and what the figures rest on.")
@click.option("--json", "as_json", is_flag=True, help="Print the lines as JSON.")
def advise(
    contact: str | None,
    sensor: str | None,
    process: str | None,
    fab: str | None,
    blur: str | None,
    placement: str | None,
    tapes: str | None,
    size_mm: str | None,
    simulate_too: bool,
    explain: bool,
    as_json: bool,
) -> None:
    """Say which W, Δ and part locate a contact of some size: what the rules leave, what it locates and what it costs.

    \b
    Example: tactape-fab advise --contact 6 --sensor digit
    """
    lengths = {"contact_mm": contact, "blur_mm": blur, "placement_mm": placement}
    given = {key: length(text) for key, text in lengths.items() if text is not None}
    given |= {key: text for key, text in (("sensor", sensor), ("process", process), ("fab", fab)) if text is not None}
    given |= {} if tapes is None else {"tapes": number(tapes)}
    given |= {} if size_mm is None else {"size_mm": size(size_mm)}
    with answers():
        from tactape_fab.advise import advise as ask
        from tactape_fab.advise import checked, read_question
        from tactape_fab.cli.advise_lines import advice_lines, explained, verdict

        advice = ask(read_question(given))
        if simulate_too:
            advice = checked(advice, step_shown())
        if as_json:
            echo_json({**advice.to_mapping(), **({"explained": list(explained(advice))} if explain else {})})
        else:
            echo_lines(advice_lines(advice))
            echo_lines([f"  {line}" for line in explained(advice)] if explain else [])
        echo_lines_err([verdict(advice)])
