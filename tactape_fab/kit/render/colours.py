"""Colours of materials in pictures and models."""

from __future__ import annotations

from collections.abc import Mapping

Colour = str
"""``#rrggbb``."""

COVERLAY_COLOURS: Mapping[str, tuple[Colour, Colour]] = {
    "amber": ("#c98a1b", "#a8701a"),
    "yellow": ("#cc931f", "#a9771a"),
    "black": ("#26282b", "#17181a"),
    "white": ("#eceae4", "#cfccc3"),
    "green": ("#1f6b3a", "#164d2a"),
}
"""Colour of the coverlay on bare film, and of its edge. Coverlay sold as yellow is polyimide, which looks golden on polyimide."""
LEGEND_COLOURS: Mapping[str, Colour] = {"white": "#f7f7f2", "black": "#151515"}
BACKING_COLOURS: Mapping[str, Colour] = {"adhesive-bottom": "#7fb2d9", "stiffener-bottom": "#6f7f58"}
BASE_FILM = "#8a5a12"
"""Film without coverlay."""
GOLD = "#e9c46a"
"""Pads."""
BODY = "#1d1f24"
"""A resistor's body."""
TERMINAL = "#d9dce1"
TEXTURE = "#c6ccd4"
"""A printed or milled texture."""
MOULD = "#d9cdb8"


def rgb8(colour: Colour) -> tuple[int, int, int]:
    """Red, green and blue from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def rgb(colour: Colour) -> tuple[float, float, float]:
    """Red, green and blue from 0 to 1."""
    red, green, blue = rgb8(colour)
    return red / 255, green / 255, blue / 255
