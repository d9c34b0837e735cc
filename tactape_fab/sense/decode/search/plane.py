"""A contact located in a code plane alone, no tape registered: the interface of such a search, and its answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.plane import Plane


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanePlace:
    """The best place of the code plane.

    ``cells`` are code-plane columns and rows of the dots; ``score`` is ln E; ``others`` the sum of E over all other places as
    a multiple of this one's, ``lead`` ln of how much likelier the dots are here than at any of them.
    """

    score: float
    weight: float
    turn: int
    sector: int
    cells: IntArray
    x_bits: IntArray
    y_bits: IntArray
    others: float
    lead: float


class CodePlane(ABC):
    """A code's whole plane, prepared for `search`."""

    def __init__(self, code: Plane) -> None:
        self.code = code

    @property
    def places(self) -> float:
        """Number of places, sectors and turns together."""
        return 4.0 * float(self.code.range) ** 2 * self.code.sectors

    @abstractmethod
    def search(self, nodes: IntArray, q: FloatArray) -> PlanePlace | None:
        """The best column, row, sector and quarter turn for soft symbols on a grid; None if there is none."""
