"""The element on every grid point of a tape."""

from __future__ import annotations

from dataclasses import dataclass

from tactape_fab.base.fields import Fields
from tactape_fab.texture.board import LEAST_MM

PART_SHAPES = ("block", "dome")
LEAST_ASPECT = 1.25
"""Least ratio of length to width of a long part, whose direction the decoder looks for. Chosen; chip resistors have 2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TapePart:
    """The element on every grid point: ``body_mm`` is (length, width, height), ``rotation_deg`` counter-clockwise.

    A ``block`` is a box; a ``dome`` is a spherical cap of (diameter, diameter, height), or a truncated cone whose flat
    top has the diameter ``top_mm``.
    """

    name: str
    shape: str
    body_mm: tuple[float, float, float]
    rotation_deg: float
    top_mm: float | None = None

    @property
    def relief(self) -> tuple[object, ...]:
        """Shape, size and, if the part is long, direction: everything that a contact can feel of it."""
        # half a turn maps a body onto itself
        turn_deg = self.rotation_deg % 180.0 if is_long(self.shape, self.body_mm) else 0.0
        return self.shape, self.body_mm, turn_deg

    @property
    def open_turns_deg(self) -> tuple[int, ...]:
        """Turns of a contact that cannot be told apart by the parts' direction: two of long parts, all four of others."""
        return (0, 180) if is_long(self.shape, self.body_mm) else (0, 90, 180, 270)


def is_long(shape: str, body_mm: tuple[float, float, float]) -> bool:
    """Whether a body (length, width, height in mm) is long enough for its dot to show its direction, and so a quarter turn."""
    return shape == "block" and max(body_mm[:2]) >= LEAST_ASPECT * min(body_mm[:2])


def read_part(table: Fields) -> TapePart:
    """A manifest's part. Problems are collected in `table`."""
    length, width, height = table.numbers("body_mm", 3, low=LEAST_MM, high=100.0)
    shape = table.text("shape", choices=PART_SHAPES)
    top_mm = None
    if table.values.get("top_mm") is not None:
        top_mm = table.number("top_mm", above=0.0, below=length)
    if shape == "dome" and (length != width or (top_mm is None and height >= length / 2)):
        table.problem(
            "body_mm", f"body_mm = {[length, width, height]} is no dome; give [diameter, diameter, less than the radius]"
        )
    return TapePart(
        name=table.text("name", longest=200),
        shape=shape,
        body_mm=(length, width, height),
        rotation_deg=table.number("rotation_deg", low=-360.0, high=360.0, unit="deg"),
        top_mm=top_mm,
    )
