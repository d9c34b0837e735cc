"""Kinds of recordings: by what files and folders each is told, and what a reader of any of them gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy.typing as npt

MCAP, BAG, DATASET = ".mcap", "metadata.yaml", "meta/info.json"
"""Marks of a recording: the ending of a file, and what is in a folder of rosbag2 and of LeRobot."""
OTHER_BAGS = (".db3", ".bag")
"""Endings of bags that nothing here reads: SQLite, and those of ROS 1."""

Image = npt.NDArray[Any]
Stamped = tuple[float | None, Image]
Opened = tuple[str, bool, Callable[[], Iterator[Stamped]]]
"""Topic, whether it is ours, and what reads it."""
