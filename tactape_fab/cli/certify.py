"""certify: distances between the windows of tapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import size, workers_of, workers_option
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, step_shown, table_lines

if TYPE_CHECKING:
    from tactape_fab.texture.certify.certificate import Certificate, Closest
    from tactape_fab.texture.certify.kits import Certified
    from tactape_fab.texture.certify.pairs import Across
    from tactape_fab.texture.tape import Tape
    from tactape_fab.texture.touch.patches import PatchDistance

MOST_SHOWN = 6
"""Most nearest pairs that are printed; the JSON has more."""


@click.command()
@click.argument("kits", nargs=-1, metavar="KITS...")
@click.option("--code", metavar="CODE", help="Without kits: the tapes of this code's sectors, as make would make them.")
@click.option("--size", "size_mm", metavar="WxH", help="Outline of the tapes of --code, mm.  [default: 100x50]")
@click.option("--as-built", multiple=True, metavar="FILE|none", help="Which parts are missing.  [default: KIT/as-built.json]")
@click.option("--picture", metavar="FILE.png", help="Write a map of the tape, or of several the distances of every two.")
@click.option("--overwrite", is_flag=True, help="Replace a file of the picture's name.")
@workers_option("compare tapes and windows", "1")
@click.option("--json", "as_json", is_flag=True, help="Print the certificates as JSON.")
def certify(
    kits: Sequence[str],
    code: str | None,
    size_mm: str | None,
    as_built: Sequence[str],
    picture: str | None,
    overwrite: bool,
    workers: str | None,
    as_json: bool,
) -> None:
    """Say what every 4x4, 5x5 and 6x6 window of these tapes can tell apart: kits, manifests, or folders of kits.

    \b
    Example: tactape-fab certify tactape-s007 --picture windows.png
    """
    with answers():
        from tactape_fab.texture.certify.kits import certified

        if picture is not None:
            from tactape_fab.base.picture_file import refuse_picture, write_picture

            refuse_picture(Path(picture), "picture", overwrite=overwrite)
        given = {"code": code, "size_mm": None if size_mm is None else size(size_mm)}
        options = {key: value for key, value in given.items() if value is not None}
        result = certified(*tapes_to_certify(kits, options, as_built), step_shown(), workers=workers_of(workers, 1))
        echo_json(result.to_mapping()) if as_json else echo_lines(certified_lines(result))
        if picture is not None:
            from tactape_fab.report.certify_picture import draw_certified

            write_picture(Path(picture), draw_certified(result), "picture", overwrite=overwrite, compression=9)


def tapes_to_certify(
    kits: Sequence[str], options: Mapping[str, Any], as_built: Sequence[str]
) -> tuple[list[Tape], tuple[str, ...]]:
    """Tapes of kits, or of a code's sectors as `make` plans them, and a label for each.

    options: ``code`` and ``size_mm``, if given.
    as_built: As `texture.registry.read_tapes` takes it.
    Raises SpecError with every problem of all of them.
    """
    if kits and options:
        raise SpecError(Problem("code", "kits and --code or --size are given, but a kit says all of it; give either"))
    if as_built and not kits:
        raise SpecError(Problem("as-built", "--as-built says where the parts of a kit are, and none is given; name the kit"))
    from tactape_fab.texture.registry import labels, read_registered, taken_once

    if kits:
        entries, again = taken_once(read_registered(kits, as_built))
        echo_lines_err([f"note: {line}" for line in again])
        return [e.tape for e in entries], labels(entries)
    if "code" not in options:
        message = "--size has no effect without --code" if options else "nothing to certify is given"
        raise SpecError(Problem("code", f"{message}; name kits, or a code with --code"))
    from tactape_fab.kit.examine.code_tapes import default_tapes

    tapes = default_tapes(**options)
    return tapes, tuple(t.name for t in tapes)


def certified_lines(result: Certified) -> list[str]:
    """Certificates as lines: of one tape its window sizes and nearest windows, of several a row each and their distances."""
    if len(result.certificates) == 1:
        return _one(result.certificates[0])
    header = ("tape", *(f"{s.side}x{s.side}" for s in result.certificates[0].sizes), "told apart", "one wrong symbol")
    rows = [
        (name, *map(_of_size, c.sizes), _square(c.distinct_side), _square(c.correcting_side))
        for name, c in zip(result.names, result.certificates, strict=True)
    ]
    lines = [
        "least number of differing symbols of two windows, and how many pairs differ by no more:",
        *table_lines(header, rows),
    ]
    lines += ["", "across the tapes:"]
    for windows in result.across:
        lines += _across_lines(windows, result)
    return lines + proven_lines(result.tapes)


def _of_size(size: Closest) -> str:
    return "-" if size.distance is None else f"{size.distance} ({size.pairs})"


def _square(side: int | None) -> str:
    return "-" if side is None else f"{side}x{side}"


def _one(certificate: Certificate) -> list[str]:
    from tactape_fab.texture.certify.certificate import pair_words

    tape = certificate.tape
    header = ("windows", "number", "least distance", "pairs", "detects", "corrects")
    rows = [
        (_square(s.side), str(s.windows), *("-" if v is None else str(v) for v in (s.distance, s.pairs, s.detects, s.corrects)))
        for s in certificate.sizes
    ]
    lines = [
        f"{tape.name}: {tape.part_count} parts on {tape.columns} x {tape.rows} grid points, sector {tape.sector} of {tape.code} "
        f"at origin {tape.origin[0]},{tape.origin[1]}"
        + ("" if tape.as_built is None else f"; {tape.as_built.missing} missing as built"),
        *table_lines(header, rows),
        _contact_line("two contacts never read the same", certificate.distinct_side),
        _contact_line("one wrong symbol never misleads", certificate.correcting_side),
    ]
    lines += _patch_lines(certificate.patches, tape.part.open_turns_deg)
    for closest in certificate.sizes:
        if closest.distance is not None:
            lines.append(f"nearest windows of {_square(closest.side)}, {_symbols(closest.distance)}:")
            shown = range(min(len(closest.turn), MOST_SHOWN))
            lines += [f"  {pair_words(tape, closest, i)}" for i in shown] + _more(closest.pairs)
    return lines


def _patch_lines(patches: Sequence[PatchDistance], open_turns_deg: tuple[int, ...]) -> list[str]:
    """Distances of small patches as lines: in all turns, in half turns, and proven for all sectors, as far as there are any."""
    columns = [
        ("patch", [p.shape for p in patches]),
        ("number", [str(p.patches) for p in patches]),
        ("any turn", [_bits(p.bits, p.pairs) for p in patches]),
    ]
    if any(p.half_turns for p in patches):
        columns.append(("0 or 180 deg", ["-" if p.half_turns is None else _bits(*p.half_turns) for p in patches]))
    if any(p.proven is not None for p in patches):
        columns.append(("turn known, all sectors", ["-" if p.proven is None else str(p.proven) for p in patches]))
    shown = "show a quarter turn, 0 and 180 deg stay open" if len(open_turns_deg) == 2 else "are round, any turn stays open"
    lines = [
        "fewest bits in which two patches differ (pairs): one a quarter turn of a part, two a half turn",
        f"turns: the parts {shown}",
    ]
    header, cells = zip(*columns, strict=True)
    return [*lines, *table_lines(header, list(zip(*cells, strict=True)))] if patches else []


def _bits(bits: int | None, pairs: int) -> str:
    return "-" if bits is None else f"{bits} ({pairs})"


def proven_lines(tapes: Sequence[Tape]) -> list[str]:
    """Proven distances between any two of several tapes, as lines."""
    from tactape_fab.texture.certify.certificate import proven_between

    proven = proven_between(tapes)
    bits = ", ".join(f"{bits} in {shape}" for shape, bits in proven.items() if bits)
    return (
        [f"proven of any two places of these tapes, the turn being known: at least so many bits differ: {bits}"] if proven else []
    )


def _contact_line(what: str, side: int | None) -> str:
    if side is None:
        return f"{what}: no square of this tape up to 8x8 parts is enough"
    return f"{what} from {_square(side)} parts on"


def _symbols(distance: int) -> str:
    return "which read the same" if distance == 0 else f"which differ by {distance} symbol{'s' * (distance != 1)}"


def _more(pairs: int) -> list[str]:
    return [f"  and {pairs - MOST_SHOWN} more"] if pairs > MOST_SHOWN else []


def _across_lines(windows: Across, result: Certified) -> list[str]:
    from tactape_fab.texture.certify.certificate import turn_words, window_words
    from tactape_fab.texture.certify.pairs import BEYOND

    size = _square(windows.side)
    if windows.distance is None:
        return [f"no two tapes have windows of {size}"]
    if windows.distance == BEYOND:
        return [f"windows of {size} of different tapes differ by at least {BEYOND} symbols"]
    lines = [f"nearest windows of {size} of different tapes, {_symbols(windows.distance)}:"]
    listed = zip(windows.first.tolist(), windows.second.tolist(), windows.turn.tolist(), strict=True)
    for _, ((a, *at), (b, *bt), turn) in zip(range(MOST_SHOWN), listed, strict=False):
        first = f"{result.names[a]} {window_words(result.tapes[a], *at)}"
        second = f"{result.names[b]} {window_words(result.tapes[b], *bt)}"
        lines.append(f"  {first} and {second}{turn_words(turn)}")
    return lines + _more(windows.pairs)
