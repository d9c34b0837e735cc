"""Localization: the answer for one frame."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from tactape_fab.texture.frames import FloatArray

Status = Literal["none", "weak", "solid"]
SOLID_DOTS = 16
"""Dots from which a contact is solid (paper, section III-B.2)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Localization:
    """Where a sensor touches, or why that cannot be said. Fields that are unknown are None.

    Attributes
    ----------
    status : {"none", "weak", "solid"}
        No dots, fewer than 16, or 16 and more (paper, section III-B.2).
    located : bool
    reason : str or None
        Why it is not located.
    tape : str or None
        Name of the registered tape.
    sector : int or None
    position_mm : (float, float) or None
        S, the texture point under the image centre (texture frame).
    theta_deg : float or None
        Turn of the sensor on the tape, counter-clockwise seen from above, in (-180, 180].
    board_mm : (float, float) or None
        S in the board frame; None where the texture stands on no board.
    contact_mm : (float, float) or None
        Nominal centre of the agreeing dot nearest the contact's centre (texture frame): the paper's C.
    cell : (int, int) or None
        Column and row of that dot on the tape.
    index : (int, int) or None
        The same in the code plane.
    plane_mm : (float, float) or None
        S from code-plane index (0, 0); only without a tape.
    px_per_mm : float or None
        Used or estimated.
    covariance : ndarray of shape (3, 3), or None
        Of (x mm, y mm, theta rad).
    n_dots, n_agree : int
        Dots found, and those that fit the answer.
    p_tape, p_place, p_false : float or None
        Bound on the chance that a texture which is none of ours looks like this; chance that another place or tape is
        the true one (of a registered one alone, where p_tape refuses the answer already); their sum.
    elapsed_ms : float
    timestamp : float or None
        As it came with the frame.
    """

    status: Status
    located: bool
    reason: str | None = None
    tape: str | None = None
    sector: int | None = None
    position_mm: tuple[float, float] | None = None
    theta_deg: float | None = None
    board_mm: tuple[float, float] | None = None
    contact_mm: tuple[float, float] | None = None
    cell: tuple[int, int] | None = None
    index: tuple[int, int] | None = None
    plane_mm: tuple[float, float] | None = None
    px_per_mm: float | None = None
    covariance: FloatArray | None = None
    n_dots: int = 0
    n_agree: int = 0
    p_tape: float | None = None
    p_place: float | None = None
    p_false: float | None = None
    elapsed_ms: float = 0.0
    timestamp: float | None = None

    def to_mapping(self, frame: int) -> dict[str, Any]:
        """The answer as one JSON object, numbers as Python's own."""
        values: dict[str, Any] = {"frame": frame}
        for field in fields(self):
            value = getattr(self, field.name)
            values[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
        return values


def status_of(dots: int) -> Status:
    """Contact status of a number of dots (paper, section III-B.2)."""
    return "none" if dots == 0 else "weak" if dots < SOLID_DOTS else "solid"
