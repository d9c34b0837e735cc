"""The solid models as build123d objects, for scripts that build on them. Importing build123d takes a second or two."""

from __future__ import annotations

import tempfile
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from tactape_fab.base.errors import RenderError, SpecError, refuse
from tactape_fab.base.libraries import library
from tactape_fab.solids.checks import form_problems, refuse_no_form
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.texture.tape import Tape, refuse_no_tape

if TYPE_CHECKING:
    from build123d import Compound, Part

TEXTURE_RGB = (0.62, 0.66, 0.71)
BOARD_RGB = (0.79, 0.54, 0.11)
PART_RGB = (0.11, 0.12, 0.14)
_DATE = datetime(1980, 1, 1, tzinfo=timezone.utc)


def texture_part(tape: Tape, form: SolidForm | None = None) -> Part:
    """The one fused solid of a tape, the same as the kit's ``step-solid``.

    Parameters
    ----------
    tape : Tape
    form : SolidForm, optional
        Base, mould, tiles, cylinder; a flat texture on a base of 0.8 mm where None is given.

    Returns
    -------
    build123d.Part
        Board frame, mm; z = 0 is the top of the base.

    Raises
    ------
    SpecError
        With every reason why this solid cannot be built.
    RenderError
        If OCCT does not read exactly one solid from the STEP text.
    """
    refuse_no_tape(tape)
    form = SolidForm() if form is None else form
    refuse_no_form(form)
    problems = form_problems(tape, form)
    refuse(problems)
    imported = _imported(solid_step(tape, form, name=tape.name, date=_DATE, rgb=TEXTURE_RGB))
    solids = imported.solids()
    if len(solids) != 1:
        raise RenderError(f"OCCT reads {len(solids)} solids of {tape.name} instead of one")
    return library("build123d", "tactape_fab.solids.cad").Part([solids[0]], label=tape.name)


def assembly(tape: Tape) -> Compound:
    """A tape's board and parts, the same as the kit's ``step-assembly``.

    Parameters
    ----------
    tape : Tape
        Its parts are blocks.

    Returns
    -------
    build123d.Compound
        Children: the board, then every part labelled with its designator; all parts share one shape.

    Raises
    ------
    SpecError
        When the tape has solid elements instead of components.
    RenderError
        If OCCT reads another assembly from the STEP text.
    """
    refuse_no_tape(tape)
    if tape.part.shape != "block":
        raise SpecError(f"part = '{tape.part.name}' is no component that is placed; use texture_part for solid elements")
    text = assembly_step(tape, name=tape.name, date=_DATE, board_rgb=BOARD_RGB, part_rgb=PART_RGB)
    imported = _imported(text)
    names = ["board", *tape.designators()]
    if len(imported.children) != len(names):
        raise RenderError(f"OCCT reads {len(imported.children)} occurrences of {tape.name} instead of {len(names)}")
    for child, name in zip(imported.children, names, strict=True):
        child.label = name
    return imported


def _imported(text: bytes) -> Compound:
    import_step = library("build123d", "tactape_fab.solids.cad").import_step

    with tempfile.TemporaryDirectory(prefix="tactape-cad-") as folder:
        path = Path(folder) / "model.step"
        path.write_bytes(text)
        return import_step(path)
