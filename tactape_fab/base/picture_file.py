"""Pictures for a user: PNG files whose tEXt chunk names this software, so that only such files are ever replaced."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, RenderError, SpecError, TactapeError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import mode_of, read_regular
from tactape_fab.base.libraries import library
from tactape_fab.base.output_file import refuse_taken_place, write_file

_TEXT = b"tEXtSoftware\0tactape-fab"
# length of the data without the type, then type and data, then the CRC of both (PNG, 5.3)
_WRITER = (len(_TEXT) - 4).to_bytes(4, "big") + _TEXT + zlib.crc32(_TEXT).to_bytes(4, "big")
"""The chunk that names the software (PNG, 11.3.3.2)."""
_AFTER_HEADER = 33
"""Bytes of the signature and of IHDR, which comes first (PNG, 5.6)."""
_KIND = "no picture of this tool"


def encoded_png(picture: npt.NDArray[np.uint8], settings: Sequence[int] = ()) -> bytes:
    """A picture (grey or BGR) as a PNG file, by OpenCV's settings. Raises RenderError when it cannot be encoded."""
    done, data = library("cv2", "drawing a picture").imencode(".png", picture, settings)
    if not done:
        raise RenderError("the picture could not be encoded as PNG")
    return bytes(data)


def is_own_picture(path: Path) -> bool:
    """Whether a file is a picture that this module wrote. Raises OSError."""
    return read_regular(path, _AFTER_HEADER + len(_WRITER))[_AFTER_HEADER:].startswith(_WRITER)


def refuse_picture(path: Path, key: str, *, overwrite: bool | None = None) -> None:
    """Refuse the path of a picture if it does not end in .png, its folder does not exist, or another file is there.

    key: The option that names it.
    overwrite: As for `refuse_taken_place`.
    Raises SpecError.
    """
    if path.suffix.lower() != ".png":
        raise SpecError(Problem(key, f"{key} = {shown_path(path)} does not end with .png; give a name that does"))
    refuse_taken_place(path, key, overwrite=overwrite, ours=is_own_picture, kind=_KIND)


def refuse_pictures(folder: Path, names: str | Iterable[str], key: str) -> None:
    """Refuse a folder for pictures before they are drawn: a file, read-only, or with other files that have the pictures' names.

    names: The pictures' file names, or a glob pattern of them.
    key: The option that names the folder.
    Raises SpecError, and TactapeError if no file can be made there.
    """
    given = f"{key} = {shown_path(folder)}"
    try:
        # the folder may not exist yet: its nearest existing parent decides whether it can be made
        nearest = next(place for place in (folder, *folder.parents) if mode_of(place) is not None)
        is_folder, can_hold = nearest.is_dir(), os.access(nearest, os.W_OK | os.X_OK)
        paths = sorted(folder.glob(names)) if isinstance(names, str) else [folder / name for name in names]
        taken = [path for path in paths if mode_of(path) is not None]
    except (OSError, ValueError) as error:
        raise SpecError(Problem(key, f"{given} cannot be looked at: {reason_of(error)}; use another folder")) from error
    if not is_folder:
        message = f"{given}: {shown_path(nearest)} is there and is no folder; nothing was touched; use another folder"
        raise SpecError(Problem(key, message))
    if not can_hold:  # a failure to write, as in the middle of the work
        raise TactapeError(f"{given} cannot be written: no file can be made in {shown_path(nearest)}; use another folder")
    for path in taken:  # the first other file is enough to refuse the folder
        refuse_taken_place(path, key, ours=is_own_picture, kind=_KIND)


def write_picture(
    path: Path, picture: npt.NDArray[np.uint8], key: str, *, overwrite: bool | None = None, compression: int | None = None
) -> None:
    """Write a PNG atomically; its folder is made if it does not exist.

    picture (h, w, 3): BGR.
    key, overwrite: As for `refuse_picture`, which is asked first.
    compression: zlib level from 0 to 9; None for OpenCV's default.
    Raises SpecError if another file is there, TactapeError if it cannot be written.
    """
    cv2 = library("cv2", "drawing a picture")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        message = f"{key} = {shown_path(path.parent)} cannot be written: {reason_of(error)}; use another folder"
        raise TactapeError(message) from error
    data = encoded_png(picture, [] if compression is None else [cv2.IMWRITE_PNG_COMPRESSION, compression])
    refuse_picture(path, key, overwrite=overwrite)
    write_file(path, data[:_AFTER_HEADER] + _WRITER + data[_AFTER_HEADER:], key, overwrite=overwrite is not False)
