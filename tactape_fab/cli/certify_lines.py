"""Certificates and registries as lines of text, for the command line to print."""

from __future__ import annotations

from collections import Counter

from tactape_fab.cli.printing import table_lines
from tactape_fab.texture.certify.certificate import Certificate, Closest, pair_words, turn_words, window_words
from tactape_fab.texture.certify.kits import Certified, Registry, nearest_tapes
from tactape_fab.texture.certify.pairs import BEYOND, NO_WINDOWS, Across
from tactape_fab.texture.tape import Tape

MOST_SHOWN = 6
"""So many nearest pairs are printed; the JSON has more."""
MOST_COLUMNS = 12
"""Up to so many tapes a registry is printed as a matrix, more as its nearest tapes."""
MOST_CONFLICTS = 40
_NEAREST_TAPES = 20


def certified_lines(result: Certified) -> list[str]:
    """One tape: a table of its window sizes and its nearest windows. Several: a row each, and the windows across them."""
    if len(result.certificates) == 1:
        return _one(result.certificates[0])
    header = ("tape", *(f"{s.side}x{s.side}" for s in result.certificates[0].sizes), "told apart", "one wrong symbol")
    rows = [
        (c.tape.name, *map(_of_size, c.sizes), _square(c.distinct_side), _square(c.correcting_side)) for c in result.certificates
    ]
    lines = [
        "least number of differing symbols of two windows, and how many pairs differ by no more:",
        *table_lines(header, rows),
    ]
    lines += ["", "across the tapes:"]
    for windows in result.across:
        lines += _across_lines(windows, result)
    return lines


def _of_size(size: Closest) -> str:
    return "-" if size.distance is None else f"{size.distance} ({size.pairs})"


def _square(side: int | None) -> str:
    return "-" if side is None else f"{side}x{side}"


def _one(certificate: Certificate) -> list[str]:
    tape = certificate.tape
    header = ("windows", "number", "least distance", "pairs", "detects", "corrects")
    rows = [
        (_square(s.side), str(s.windows), *("-" if v is None else str(v) for v in (s.distance, s.pairs, s.detects, s.corrects)))
        for s in certificate.sizes
    ]
    lines = [
        f"{tape.name}: {tape.part_count} parts on {tape.columns} x {tape.rows} grid points, sector {tape.sector} of {tape.code} "
        f"at origin {tape.origin[0]},{tape.origin[1]}",
        *table_lines(header, rows),
        _contact_line("two contacts never read the same", certificate.distinct_side),
        _contact_line("one wrong symbol never misleads", certificate.correcting_side),
    ]
    if certificate.patches:
        lines.append("fewest bits in which two patches differ: one a quarter turn of a part, two a half turn")
        lines += table_lines(
            ("patch", "number", "bits", "pairs"),
            [(p.shape, str(p.patches), "-" if p.bits is None else str(p.bits), str(p.pairs)) for p in certificate.patches],
        )
    for size in certificate.sizes:
        if size.distance is not None:
            lines.append(f"nearest windows of {_square(size.side)}, {_symbols(size.distance)}:")
            shown = range(min(len(size.turn), MOST_SHOWN))
            lines += [f"  {pair_words(tape, size, i)}" for i in shown] + _more(size.pairs)
    return lines


def _contact_line(what: str, side: int | None) -> str:
    if side is None:
        return f"{what}: no square of this tape up to 8x8 parts is enough"
    return f"{what} from {_square(side)} parts on"


def _symbols(distance: int) -> str:
    return "which read the same" if distance == 0 else f"which differ by {distance} symbol{'s' * (distance != 1)}"


def _more(pairs: int) -> list[str]:
    return [f"  and {pairs - MOST_SHOWN} more"] if pairs > MOST_SHOWN else []


def _across_lines(windows: Across, result: Certified) -> list[str]:
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


def registry_lines(result: Registry) -> list[str]:
    """The tapes, their conflicts, and how far every two are apart."""
    names = result.names
    header = ("tape", "sector", "code", "origin", "grid", "size mm", "pitch mm", "tag", "fab")
    lines = [*table_lines(header, [_entry_row(n, e.tape, e.fab) for n, e in zip(names, result.entries, strict=True)]), ""]
    lines += [f"conflict: {c.message}" for c in result.conflicts[:MOST_CONFLICTS]]
    if len(result.conflicts) > MOST_CONFLICTS:
        kinds = sorted(Counter(c.kind for c in result.conflicts).items())
        lines.append(f"{len(result.conflicts)} conflicts: {', '.join(f'{n} of kind {kind}' for kind, n in kinds)}")
    if not result.conflicts:
        lines.append("no conflicts")
    if len(result.entries) == 1:
        return lines
    lines += ["", "least number of differing symbols of windows of two tapes, 4x4/5x5/6x6:"]
    return lines + (_matrix(result) if len(result.entries) <= MOST_COLUMNS else _nearest(result))


def _entry_row(name: str, tape: Tape, fab: str) -> tuple[str, ...]:
    width_mm, height_mm = tape.board.size_mm
    return (
        name,
        str(tape.sector),
        tape.code,
        f"{tape.origin[0]},{tape.origin[1]}",
        f"{tape.columns} x {tape.rows}",
        f"{width_mm:g} x {height_mm:g}" if tape.surface is None else "on a part",
        f"{tape.pitch_mm:g}",
        "-" if tape.tag is None else str(tape.tag.id),
        fab or "-",
    )


def _apart(result: Registry, a: int, b: int) -> str:
    return "/".join(_distance(int(w.matrix[a, b])) for w in result.across)


def _distance(value: int) -> str:
    return "-" if value == NO_WINDOWS else f"{value}+" if value == BEYOND else str(value)


def _matrix(result: Registry) -> list[str]:
    names = result.names
    rows = [
        (name, *("" if b >= a else _apart(result, a, b) for b in range(len(names) - 1))) for a, name in enumerate(names) if a > 0
    ]
    return table_lines(("", *names[:-1]), rows)


def _nearest(result: Registry) -> list[str]:
    names = result.names
    lines = []
    for windows in result.across:
        count = Counter(int(d) for d in windows.matrix[windows.matrix != NO_WINDOWS])
        said = ", ".join(f"{_distance(d)}: {n // 2} pairs" for d, n in sorted(count.items()))
        lines.append(f"{_square(windows.side)}: {said or 'no windows'}")
    near = nearest_tapes(result.across[0], _NEAREST_TAPES)
    lines += ["", "the nearest tapes:", *(f"  {names[a]} and {names[b]}: {_apart(result, a, b)}" for a, b, _ in near)]
    return lines
