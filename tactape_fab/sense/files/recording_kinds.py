"""Kinds of recordings: the files and folders by which each is recognised, and the interface of their readers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy.typing as npt

from tactape_fab.base.fields import named

MCAP, BAG, DATASET = ".mcap", "metadata.yaml", "meta/info.json"
"""Marks of a recording: the ending of a file, and what is in a folder of rosbag2 and of LeRobot."""
OTHER_BAGS = (".db3", ".bag")
"""Endings of bags that nothing here reads: SQLite, and those of ROS 1."""
UPRIGHT = ("tactape-fab", "upright depth image")
"""Metadata of our channels of depth images: `mcap merge` keeps it, and names itself alone in the file's header."""
MOST_UNPACKED_BYTES, MOST_TIMES_PACKED = 1 << 30, 1000
"""Bytes that a recording unpacks to altogether, besides so many times its size: images without noise take 1/300 packed."""

SCALE = "px_per_mm"
"""Key of their metadata where the frames' file says its scale: px/mm along u and v, with a space between."""

_NAMED, _MOST_SHOWN = 20, 100
"""Topics or features that a message names, and characters of each: a file of 1 MB has 30,000, or one of 1 MB."""

Image = npt.NDArray[Any]
Stamped = tuple[float | None, Image]
Opened = tuple[str, bool, tuple[float, float] | None, Callable[[], Iterator[Stamped]]]
"""Topic, whether `watch` wrote it, px/mm of the file that it was written from, and a function that iterates over its images."""


def some_of(names: Iterable[str]) -> str:
    """The first names of a file's topics or features, for a message."""
    every = [name if len(name) <= _MOST_SHOWN else f"{name[:_MOST_SHOWN]}..." for name in names]
    return named(every, _NAMED) or "none"
