"""Colour images of a sensor's gel: read one by one, and handed on as the depth maps that its network sees in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError, Problem, SpecError, reason_of, tried
from tactape_fab.base.fields import shown_path
from tactape_fab.sense.raw.image_files import COLOUR_PICTURES, read_colour, read_colour_header
from tactape_fab.sense.sensors import SensorProfile

if TYPE_CHECKING:
    from tactape_fab.sense.raw.reconstruct import Reconstruction

_MOST_TOLD = 10
_NUMBERS = re.compile(r"0*([0-9]+)")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawImage:
    """A colour image whose header has been read and checked; it has neither a time nor a scale of its own."""

    path: Path
    reconstruction: Reconstruction
    count: int = 1
    px_per_mm: tuple[float, float] | None = None

    def frames(self) -> Iterator[npt.NDArray[np.float32]]:
        """Its depth map, mm, larger where pushed further in. Raises SpecError when the file is damaged, FrameError as `depth`."""
        image = _read(self.path, "raw")
        try:
            depth = self.reconstruction.depth(image)
        except FrameError as error:
            raise FrameError(f"raw {shown_path(self.path)}: {error}") from None
        yield depth

    def time_of(self, frame: int) -> float | None:
        """Time of a frame, s: None, as an image has none."""
        return None


def colour_paths(images: Sequence[str], sensor: SensorProfile, problems: list[Problem]) -> list[Path]:
    """Paths of colour images of a sensor; what is wrong with any of them is added to `problems`.

    images: PNG or JPEG of 8 bits, as large as the sensor's frames, or folders of them: all in a folder, numbers in their names by
        value.
    """
    paths = [path for given in images for path in _images_of(Path(given), problems)]
    refused: list[Problem] = []
    for path in paths:
        tried(partial(_checked, path, "raw", sensor), refused)
    problems += refused[:_MOST_TOLD]
    if len(refused) > _MOST_TOLD:
        problems.append(Problem("raw", f"{len(refused) - _MOST_TOLD} more of {len(paths)} images cannot be used either"))
    return paths


def open_reconstruction(
    background: str | None, weights: str | None, sensor: SensorProfile, problems: list[Problem]
) -> Reconstruction | None:
    """Reconstruction of depth maps from a sensor's colour images; None where it cannot be made, which adds to `problems`.

    background: Image of the untouched gel.
    weights: The sensor's network; see `reconstruct.load_network`.
    problems: Where there are some already the files are read, and nothing is made of them.
    """
    from tactape_fab.sense.raw.reconstruct import load_network, make_reconstruction

    if background is None:
        message = "colour images need an image of the gel that touches nothing; give background=FILE"
        problems.append(Problem("background", message))
    if weights is None:
        problems.append(Problem("weights", "colour images need the .pth of the sensor's network; give weights=FILE"))
    untouched = None if background is None else tried(partial(_checked, Path(background), "background", sensor), problems)
    network = None if weights is None else tried(partial(load_network, weights), problems)
    if problems:
        return None
    assert untouched is not None and network is not None
    x, y = sensor.px_per_mm
    # px_per_mm is of the canonical image, and colour images are as the camera delivers them
    scale = (y, x) if sensor.rotate90 % 2 else (x, y)
    return make_reconstruction(_read(untouched, "background"), network, scale)


def _images_of(path: Path, problems: list[Problem]) -> list[Path]:
    """A file as it is; of a folder all its images, frame_2 before frame_10."""
    try:
        if not path.is_dir():
            return [path]
        found = [file for file in path.iterdir() if file.suffix.lower() in COLOUR_PICTURES]
    except (OSError, ValueError) as error:
        message = f"raw {shown_path(path)} cannot be read: {reason_of(error)}; give a PNG or JPEG, or a folder"
        problems.append(Problem("raw", message))
        return []
    if not found:
        problems.append(Problem("raw", f"raw {shown_path(path)} is a folder without a PNG or JPEG; give images"))
    return sorted(found, key=lambda file: (by_number(file.name), file.name))


def by_number(name: str) -> list[tuple[int, str]]:
    """Sort key of a name that orders numbers in it by value."""
    parts = _NUMBERS.split(name)
    # odd parts are numbers without leading zeros: of those the longer is the larger, and of two as long the one that sorts later
    return [(len(part) * (i % 2), part) for i, part in enumerate(parts)]


def _checked(path: Path, key: str, sensor: SensorProfile) -> Path:
    """A path whose file is, by its header, an image as large as a sensor's frames."""
    with _refused(path, key):
        (h, w), (height, width) = read_colour_header(path), sensor.frame_shape
        if (h, w) != (height, width):
            asked = f"frames of sensor '{sensor.name}' are {height} x {width} (height x width)"
            remedy = "crop and scale it as the images of the network's calibration were, or give another sensor"
            raise SpecError(f"it is {h} x {w} px, {asked}; {remedy}")
    return path


def _read(path: Path, key: str) -> npt.NDArray[np.uint8]:
    with _refused(path, key):
        return read_colour(path)


@contextmanager
def _refused(path: Path, key: str) -> Iterator[None]:
    """Every way in which an image cannot be read as one message that names it."""
    try:
        yield
    except SpecError as error:
        raise SpecError([Problem(key, f"{key} {shown_path(path)}: {p.message}") for p in error.problems]) from None
    except (OSError, ValueError) as error:
        reason = reason_of(error)
        raise SpecError(Problem(key, f"{key} {shown_path(path)} cannot be read: {reason}; give a PNG or JPEG")) from error
