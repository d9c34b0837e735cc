"""make: the kit of a tape, of a panel, or of each tape of a list."""

from __future__ import annotations

import dataclasses
import gc
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.cli.check import avoid_option, examined_order, given_values, is_list, spec_values, tape_options
from tactape_fab.cli.exits import answer, answers
from tactape_fab.cli.options import number, size, workers_option
from tactape_fab.cli.printing import (
    clear_step,
    counted,
    echo_json,
    echo_line,
    echo_lines,
    echo_lines_err,
    print_rules,
    purpose_lines,
    step_shown,
    table_lines,
    verified_line,
)

if TYPE_CHECKING:
    from tactape_fab.kit.examine.tape_lists import Planned
    from tactape_fab.kit.output_place import Overwrite
    from tactape_fab.make.kit import Kit
    from tactape_fab.make.many import FailedKit, MadeKit, PackedFilm
    from tactape_fab.make.panel import PanelKit
    from tactape_fab.texture.certify.origin import Choice
    from tactape_fab.texture.tape import Tape
    from tactape_fab.verify.signature import Signer

_OBJECTS_A_COLLECTION = 200_000
"""Garbage collection threshold, raised as loading modules makes many objects and few cycles, and each collection scans all."""
_NAMED = 3
"""Most tapes of a packed panel that are named."""


class _Make(click.Command):
    """The command; it has hints for options that other tools have."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if error.option_name not in ("--dry-run", "--check"):
                raise
            raise click.UsageError(
                f"No such option '{error.option_name}'. tactape-fab check measures, and writes nothing."
            ) from error


@tape_options
@click.command(cls=_Make)
@avoid_option
@click.option(
    "--order", "house", metavar="HOUSE", help="Choose W, Δ, coverlay and anchor for a house: jlcpcb, pcbway, a profile."
)
@click.option("--contact", metavar="WxH", help="With --order: the smallest contact that is to be located, mm.  [default: 11x9]")
@click.option("--pack", is_flag=True, help="Make panels of the tapes of a list, of any sizes, packed into as few as can be.")
@workers_option("make the kits of a list", "one per processor", "--jobs")
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    help="Folder of the kit, or of the kits of a list.  [default: the tape's name, or tactape-kits]",
)
@click.option("--overwrite", is_flag=True, help="Replace older kits of this tool.")
@click.option("--discard-edits", is_flag=True, help="Replace them even if files in them were edited since.")
@click.option("--no-verify", is_flag=True, help="Do not read the written files back.")
@click.option("--force", is_flag=True, help="Write the kit in spite of broken design rules; the manifest records them.")
@click.option("--sign", metavar="KEY", help="Sign it with a private Ed25519 key, of openssl or ssh-keygen.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def make(
    spec_file: str | None,
    avoid: Sequence[str],
    house: str | None,
    contact: str | None,
    pack: bool,
    workers: str | None,
    output: str | None,
    overwrite: bool,
    discard_edits: bool,
    no_verify: bool,
    force: bool,
    sign: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Write a tape's kit: everything that fab and assembly line need, or printer and mill, verified from the written files.

    With --sectors, or a SPEC.toml with [[tapes]], a kit for each tape of the list.

    \b
    Examples: tactape-fab make --sector 7 --w 1.5 --delta 0.25
              tactape-fab make --sector 7 --order jlcpcb
              tactape-fab make --sectors 7,8,9 --panel auto
              tactape-fab make --sector 7 --part dome --process sla
              tactape-fab make --sectors 0-9,20 --no-3d -o lab
    """
    gc.set_threshold(_OBJECTS_A_COLLECTION)
    with answers():
        from tactape_fab.kit.examine.tape import Examined
        from tactape_fab.make.kit import make_examined

        values, given = spec_values(spec_file), given_values(options)
        given = _ordered(values, given, house, contact)
        replace: Overwrite = "edits" if discard_edits else overwrite
        signer = _signer(sign)
        if is_list(values, given, avoid, alone=pack or workers is not None):
            settings: dict[str, Any] = {"overwrite": replace, "verify": not no_verify, "force": force, "signer": signer}
            _make_list(values, given, output, settings, pack=pack, workers=workers, as_json=as_json)
            return
        examined = examined_order(values, given, avoid, {"pack": pack, "workers": workers}, output=output, overwrite=replace)
        print_rules(examined.findings, force=force)
        how: dict[str, Any] = {
            "overwrite": replace,
            "verify": not no_verify,
            "force": force,
            "signer": signer,
            "progress": lambda text: (
                click.echo(f"{text} ...", err=True) if sys.stderr is not None and sys.stderr.isatty() else None
            ),
        }
        if isinstance(examined, Examined):
            kit = make_examined(examined, output, **how)
            echo_json(kit.to_mapping()) if as_json else echo_lines(_kit_lines(kit))
        else:
            from tactape_fab.make.panel import make_panel

            panel = make_panel(examined, output, **how)
            echo_json(panel.to_mapping()) if as_json else echo_lines(_panel_lines(panel))


def _ordered(values: dict[str, Any], given: dict[str, Any], house: str | None, contact: str | None) -> dict[str, Any]:
    """The options with those that --order chooses, which are printed."""
    if house is None:
        if contact is not None:
            raise SpecError(
                Problem("contact", "--contact is what --order chooses a tape for; give --order HOUSE, or leave it out")
            )
        return given
    if "tapes" in values:
        raise SpecError(
            Problem("order", "--order chooses one W and Δ for all tapes; give --sectors, or a SPEC.toml without [[tapes]]")
        )
    from tactape_fab.advise.order import choose_order

    sides = None if contact is None else size(contact)
    chosen = choose_order({**values, **given}, house, sides)
    echo_lines_err(chosen.remarks)
    return chosen.values


def _signer(key: str | None) -> Signer | None:
    if key is None:
        return None
    from tactape_fab.verify.signature import read_signer

    return read_signer(key)


def _make_list(
    values: dict[str, Any],
    given: dict[str, Any],
    output: str | None,
    settings: dict[str, Any],
    *,
    pack: bool,
    workers: str | None,
    as_json: bool,
) -> None:
    """Make the kits of a list and print a row for each, with its errors; the exit status is the highest of all."""
    from tactape_fab.kit.examine.tape_lists import list_tapes
    from tactape_fab.kit.rules.film_rules import OF_ASSEMBLY
    from tactape_fab.make.many import DEFAULT_FOLDER, FailedKit, make_kits, make_packed, pack_tapes
    from tactape_fab.make.panel import PanelKit

    folder = Path(DEFAULT_FOLDER if output is None else output)
    count = None if workers is None else number(workers)
    overwrite, force = settings["overwrite"], settings["force"]
    listed = list_tapes(values, given, folder, workers=count, overwrite=overwrite, force=force, packed=pack)
    print_rules(listed.findings, force=force)
    packed = pack_tapes(listed.tapes) if pack else []
    names = [name for film in packed for name in film.names] if pack else [tape.spec.name for tape in listed.tapes]
    make = make_packed(packed, folder, workers=listed.workers, **settings) if pack else None
    table, begin = _KitTable(listed.tapes), time.monotonic()
    rows_shown = not as_json and sys.stdout is not None and sys.stdout.isatty()
    show = (lambda *_: None) if rows_shown else step_shown()  # rows show the progress
    made, failed, statuses = [], [], [0]
    said = {f.rule for f in listed.findings if not f.passed}
    noun = "panel" if pack else "kit"
    echo_lines([] if as_json else _packed_lines(packed) if pack else [table.header()])
    try:
        with closing(make or make_kits(listed.tapes, folder, workers=listed.workers, **settings)) as results:
            for done, (result, name) in enumerate(zip(results, names, strict=True), start=1):
                if isinstance(result, FailedKit):
                    status, lines = answer(result.error)
                    statuses.append(status)
                    which = {"path": str(result.path), "name": result.name, "sector": result.sector}
                    failed.append({**which, "status": status, "errors": list(lines)})
                    clear_step()
                    echo_lines_err(f"error: {name}: {line}" for line in lines)
                else:
                    made.append(result.to_mapping())
                    # the list measured one tape of those that differ in sector alone, and none of a panel's own rules
                    new = [f for f in result.findings if not f.passed and f.rule not in said]
                    said |= {f.rule for f in new if not (pack and f.rule in OF_ASSEMBLY)}
                    clear_step()
                    print_rules([dataclasses.replace(f, message=f"{name}: {f.message}") for f in new], force=force)
                if not as_json and isinstance(result, PanelKit):
                    echo_lines(_panel_lines(result))
                elif not as_json and not pack:
                    echo_lines([table.row(result, listed.tapes[done - 1])])  # type: ignore[arg-type]
                show(f"{noun}s", done, len(names))
    except (KeyboardInterrupt, SystemExit):
        echo_line(f"stopped; the {noun}s that stand in {folder} are whole", err=True)
        raise
    if as_json:
        of_panels = {"panels": made, "packed": [film.to_mapping() for film in packed]}
        echo_json({"folder": str(folder), **(of_panels if pack else {"kits": made}), "failed": failed})
    echo_line(_summary(noun, len(made), len(names), folder, time.monotonic() - begin), err=True)
    sys.exit(max(statuses))


# A kit and a panel


def _kit_lines(kit: Kit) -> list[str]:
    tape = kit.tape
    width, height = tape.board.size_mm
    return [
        f"{kit.path}: {tape.part_count} parts on {tape.columns} x {tape.rows} grid points, board {width:g} x {height:g} mm"
        + left_out(tape),
        f"sector {tape.sector} of {tape.code} at origin {tape.origin[0]},{tape.origin[1]}; "
        f"pitch {tape.pitch_mm:g} mm, displacement {tape.displacement_mm:g} mm{tape.in_directions}",
        *_search_lines(kit.search),
        verified_line(kit.checks) if kit.checks else "not verified",
        *(f"{f.rule}: {f.message}" for f in kit.findings if f.rule == "coverlay" and f.level == "info"),
        *purpose_lines(kit.path, kit.files),
    ]


def left_out(tape: Tape) -> str:
    """Text about grid points without a part because of a hole or a rounded corner; "" if there are none."""
    count = len(tape.omitted)
    cells = ", ".join(f"({column}, {row})" for column, row in tape.omitted[:_NAMED])
    more = f" and {count - _NAMED} more" * (count > _NAMED)
    return f"; {counted(count, 'grid point')} at holes and corners left out: (column, row) {cells}{more}" if count else ""


def _search_lines(search: Choice | None) -> list[str]:
    if search is None:
        return []
    before = "" if search.default_distance is None else f" (at the default origin {search.default_distance})"
    lines = [f"best of {search.candidates} origins: 4x4 windows differ by at least {search.distance} symbols{before}"]
    if search.from_others is not None:
        lines.append(f"and by at least {search.from_others} from those of the tapes to avoid")
    return lines


def _panel_lines(made: PanelKit) -> list[str]:
    panel, first = made.panel, made.tapes[0]
    width, height = panel.size_mm
    parts = sum(tape.part_count for tape in made.tapes)
    rows = [
        (
            tape.name,
            str(tape.sector),
            f"{tape.origin[0]},{tape.origin[1]}",
            _size(tape.board.size_mm),
            f"{place.offset_mm[0]:g}, {place.offset_mm[1]:g}{', turned' * place.turned}",
            kit,
        )
        for tape, place, kit in zip(made.tapes, panel.places, made.kits, strict=True)
    ]
    grids = {f"pitch {t.pitch_mm:g} mm, displacement {t.displacement_mm:g} mm{t.in_directions}" for t in made.tapes}
    return [
        f"{made.path}: {panel.words}, panel {width:g} x {height:g} mm, {parts} parts",
        f"{first.code}; {' | '.join(sorted(grids))}",
        *table_lines(("tape", "sector", "origin", "size mm", "at x, y mm", "kit"), rows),
        verified_line(made.checks) if made.checks else "not verified",
        *(f"{f.rule}: {f.message}" for f in made.findings if f.rule == "coverlay" and f.level == "info"),
        *purpose_lines(made.path, made.files),
    ]


# A list of kits


class _KitTable:
    """Kits as rows of a table, printed one by one; column widths follow from the list."""

    def __init__(self, tapes: Sequence[Planned]) -> None:
        self._name_width = max(len("kit"), *(len(tape.spec.name) for tape in tapes))
        self._size_width = max(len("size mm"), *(len(_size(tape.spec.size_mm)) for tape in tapes))

    def header(self) -> str:
        return self._row("kit", "sector", "size mm", "grid", "parts", "result")

    def row(self, kit: MadeKit | FailedKit, tape: Planned) -> str:
        from tactape_fab.make.many import FailedKit

        if isinstance(kit, FailedKit):
            return self._row(kit.name, str(kit.sector), _size(tape.spec.size_mm), "", "", "failed")
        verified = f"{kit.checks} checks" if kit.checks else "not verified"
        grid = f"{kit.columns}x{kit.rows}"
        return self._row(kit.name, str(kit.sector), _size(kit.size_mm), grid, str(kit.parts), verified)

    def _row(self, name: str, sector: str, size: str, grid: str, parts: str, result: str) -> str:
        name, size = name.ljust(self._name_width), size.ljust(self._size_width)
        return f"{name}  {sector:>6}  {size}  {grid:>9}  {parts:>6}  {result}"


def _size(size_mm: Sequence[float]) -> str:
    return f"{size_mm[0]:g}x{size_mm[1]:g}"


def _summary(noun: str, made: int, count: int, folder: Path, seconds: float) -> str:
    """Text with the number of kits or panels that were made, and the rate."""
    rate = f", {made / seconds:.2g} {noun}s/s" if made and seconds > 0.0 else ""
    return f"made {made} of {counted(count, noun)} in {folder}; {seconds:.1f} s{rate}"


def _packed_lines(films: Sequence[PackedFilm]) -> list[str]:
    """Panels of each film, the covered fraction of their area, and the tapes on them, as lines."""
    lines = []
    for film in films:
        fab, shares = film.fab, film.shares
        lines.append(
            f"packed {counted(len(film.tapes), 'tape')} into {counted(len(film.panels), 'panel')} of up to "
            f"{_size(fab.largest_panel_mm)} mm ({fab.name}, rails {fab.panel.rail_mm:g} mm), each tape in a frame of its own: "
            f"{sum(shares) / len(shares):.1%} of the area is tape"
        )
        for name, packed, share in zip(film.names, film.panels, shares, strict=True):
            tapes = [film.tapes[i].spec.name for i in packed.tapes]
            named = ", ".join(tapes) if len(tapes) <= _NAMED else f"{tapes[0]} ... {tapes[-1]}"
            lines.append(f"  {name}: {packed.panel.words}, {_size(packed.panel.size_mm)} mm, {share:.1%}: {named}")
    return lines
