"""Entities of a kit's STEP files, counted before a CAD kernel is given them: a small file can keep a kernel busy for hours."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone

from tactape_fab.base.fields import named
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile

_LONGEST_HEADER = 2_000
_MORE = 1.5
"""Entities of a kind that another version may have written, of those that this one writes."""
_SPARE = 50
_COLOUR = re.compile(rb"COLOUR_RGB\('',[\d.,]{1,60}\)")
_KEYWORD = re.compile(rb"(?<![A-Za-z0-9_])([A-Za-z]\w*)\s*\(")
_DATE, _RGB = datetime(1980, 1, 1, tzinfo=timezone.utc), (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepText:
    """The data section of a STEP file, its colours left out.

    digest: Its SHA-256.
    count: Entities of each kind.
    plain: Whether all before it is a short header, and nothing in it is a comment.
    """

    digest: bytes
    count: Counter[bytes]
    plain: bool


def step_text(data: bytes) -> StepText:
    """The data section of a STEP file (ISO 10303-21), not parsed."""
    header, _, body = data.partition(b"\nDATA;\n")
    return StepText(
        # colours are no part of a shape, and are not known here
        digest=hashlib.sha256(_COLOUR.sub(b"", body)).digest(),
        count=Counter(word.upper() for word in _KEYWORD.findall(body)),
        plain=len(header) < _LONGEST_HEADER and b"/*" not in data,
    )


def written_steps(tape: Tape, form: SolidForm, files: Mapping[str, WrittenFile]) -> dict[str, StepText]:
    """STEP files of a tape as this version writes them, those that `files` has, by role."""
    title = f"{tape.name} mould" if form.negative else tape.name
    steps = {"step-solid": step_text(solid_step(tape, form, name=title, date=_DATE, rgb=_RGB))}
    if "step-assembly" in files:
        steps["step-assembly"] = step_text(assembly_step(tape, name=tape.name, date=_DATE, board_rgb=_RGB, part_rgb=_RGB))
    return steps


def strange(found: StepText, own: StepText) -> str | None:
    """Fault of a STEP file that no version writes for this tape; None if it may be given to a CAD kernel."""
    if not found.plain:
        return "it has comments or a long header"
    # kinds that this version does not write have no entry, so that one of them is one too many
    most = {kind: _MORE * count + _SPARE for kind, count in own.count.items()}
    many = [f"{count} of {kind.decode()[:60]}" for kind, count in found.count.items() if count > most.get(kind, 0)]
    return f"it holds entities that such a tape has no use for: {named(many)}" if many else None
