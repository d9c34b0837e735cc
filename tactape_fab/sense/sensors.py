"""Sensor profiles: conversion of a tactile sensor's frames to the canonical image, and its scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of, tried
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.image_file import PNG_HEADER, png_size, unpacked
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.templates import is_profile_file, profile_table, refuse_problems, templates_folder
from tactape_fab.sense.geometry import MOST_BARREL, Camera, Gel, Geometry, camera
from tactape_fab.texture.frames import FloatArray

MOST_PX = 4096
LEAST_UNIT_MM = 1e-9
"""A picometre: of finer units float32 overflows where a frame is divided by them."""
MOST_FRAMES = 1_000_000
"""Frames of one file, written, read or answered."""
_MASK_BYTES = 32 * 1024 * 1024
_VALID_GREY = 128
_UNCALIBRATED, _UNKNOWN_GEL = Geometry(), Gel()
_SMOOTH = {"white_um": (0.0, 1000.0, "um"), "correlated_um": (0.0, 1000.0, "um"), "correlated_px": (1.0, 100.0, "px")}
"""Least and largest value and unit of the numbers of a profile, in this table and those below."""
_CAMERA = dict.fromkeys(("aspect", "shear", "k1"), (-0.2, 0.2, ""))
MOST_SIGMA = 0.2
"""Largest standard deviation of a camera's aspect, shear or distortion."""
_SIGMAS = {"sigma_px_per_mm": (0.0, 1000.0, "px/mm")} | dict.fromkeys(
    ("sigma_aspect", "sigma_shear", "sigma_k1"), (0.0, MOST_SIGMA, "")
)
_GEL = {
    "thickness_mm": (0.1, 100.0, "mm"),
    "modulus_kpa": (1.0, 1e5, "kPa"),
    "displacement_um": (0.0, 1000.0, "um"),
    "correlation_mm": (0.1, 100.0, "mm"),
    "blur_mm": (0.01, 5.0, "mm"),
    "poisson": (0.0, 0.4999, ""),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorProfile:
    """A tactile sensor: conversion of its frames to the canonical image, the scale of that image, and its noise.

    The canonical image shows the tape seen from above its components, u right and v down, a larger value where the
    texture pushes further into the elastomer. A frame becomes it by `canonical`. Profiles that come with the package are read by
    name with `load_sensor`; yours is a TOML file, or this class.

    Attributes
    ----------
    name : str
        Short name, such as ``"gelsight-mini"``; messages and files of frames name the sensor by it.
    title : str
        Its name in full, for people.
    width_px, height_px : int
        Size of the canonical image, px.
    px_per_mm : (float, float)
        Scale along u and along v of the canonical image, px/mm.
    sign : int
        1 where a larger value of a frame means pushed further in, -1 where a smaller one does.
    mirror : bool
        Whether frames are mirrored left-right.
    rotate90 : int
        Quarter turns, counter-clockwise, that turn a frame upright after the mirror; 0 to 3.
    depth_unit_mm : float or None
        Millimetres in one unit of a frame; None where depth is not calibrated.
    white_um : float
        Noise that `simulate` adds to every pixel on its own: root mean square, micrometres.
    correlated_um : float
        Smooth noise that `simulate` adds: root mean square, micrometres.
    correlated_px : float
        Standard deviation of the Gaussian that makes the smooth noise smooth, px.
    scale_tolerance : float
        Largest relative error of `px_per_mm`: 0.1 is 10 %.
    mask : ndarray of bool, shape (height_px, width_px), or None
        A read-only copy; True where the canonical image carries depth. None: everywhere.
    slope_noise : float or None
        White noise of the measured slopes, root mean square a pixel, which `simulate` integrates to depth; None: `simulate` adds
        the white and the smooth noise above.
    geometry : Geometry
        Aspect, shear and lens, and how well they and the scale are known.
    gel : Gel
    """

    name: str
    title: str
    width_px: int
    height_px: int
    px_per_mm: tuple[float, float]
    sign: int = 1
    mirror: bool = False
    rotate90: int = 0
    depth_unit_mm: float | None = None
    white_um: float = 4.0
    correlated_um: float = 10.0
    correlated_px: float = 6.0
    scale_tolerance: float = 0.1
    mask: npt.NDArray[np.bool_] | None = None
    slope_noise: float | None = None
    geometry: Geometry = _UNCALIBRATED
    gel: Gel = _UNKNOWN_GEL

    def __post_init__(self) -> None:
        if isinstance(self.mask, np.ndarray) and self.mask.flags.writeable:
            mask = np.array(self.mask)  # what is made of it once is kept, and who made it may fill the array anew
            mask.setflags(write=False)
            object.__setattr__(self, "mask", mask)

    @property
    def camera(self) -> Camera:
        """The camera model: points on the gel to pixels of the canonical image, and back."""
        return camera(self.px_per_mm, (self.width_px, self.height_px), self.geometry)

    @property
    def frame_shape(self) -> tuple[int, int]:
        """(height, width) of a frame as the sensor delivers it."""
        return (self.width_px, self.height_px) if self.rotate90 % 2 else (self.height_px, self.width_px)

    @property
    def centre_px(self) -> FloatArray:
        """The image centre p0, (u, v) of the canonical image."""
        return np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])

    def canonical(self, frame: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """A frame as the canonical image, in the frame's own unit: times sign, mirrored, then turned.

        Parameters
        ----------
        frame : ndarray of float32, shape `frame_shape`
            As the sensor delivers it.

        Returns
        -------
        ndarray of float32, shape (height_px, width_px)
            A view of the frame where `sign` is 1.
        """
        # the order is part of the profile's meaning: sign, mirror, quarter turns
        signed = frame if self.sign > 0 else -frame
        upright = signed[:, ::-1] if self.mirror else signed
        return np.rot90(upright, self.rotate90) if self.rotate90 else upright


def load_sensor(name: str | Path, key: str = "sensor") -> SensorProfile:
    """A sensor profile by name, or by the path of a TOML file.

    Parameters
    ----------
    name : str or Path
        Name of a profile that comes with the package, or the path of a ``.toml`` file.
    key : str
        The option that names it, for messages.

    Returns
    -------
    SensorProfile

    Raises
    ------
    SpecError
        Every problem found in it, in its mask as well.
    """
    table = profile_table("sensors", key, str(name))
    # a mask's path is relative to the profile that names it
    folder = Path(name).parent if is_profile_file(name) else templates_folder() / "sensors"
    table.refuse_unknown(("name", "title", "image", "orientation", "depth", "noise", "geometry", "gel"))
    image = table.table("image", ("width_px", "height_px", "px_per_mm", "scale_tolerance", "mask"))
    orientation = table.table("orientation", ("sign", "mirror", "rotate90"))
    noise = table.table("noise", ("slope", "white_um", "correlated_um", "correlated_px"))
    slope_noise = noise.number("slope", low=0.0, high=10.0, unit="") if "slope" in noise.values else None
    unit_mm = None
    if "depth" in table.values:
        unit_mm = table.table("depth", ("unit_mm",)).number("unit_mm", low=LEAST_UNIT_MM, high=1000.0)
    before = len(table.problems)
    width_px = image.integer("width_px", low=16, high=MOST_PX, default=MOST_PX)
    height_px = image.integer("height_px", low=16, high=MOST_PX, default=MOST_PX)
    sized = len(table.problems) == before  # a mask cannot be held against a size that is refused
    scale = image.numbers("px_per_mm", 2, low=1.0, high=1000.0, unit="px/mm")
    # True is 1 in Python, and would pass
    if isinstance(orientation.values.get("sign"), bool) or orientation.values.get("sign") not in (1, -1):
        orientation.problem("sign", f"sign = {shown(orientation.values.get('sign'))} is neither 1 nor -1; give one of them")
    rotate90 = orientation.integer("rotate90", low=0, high=3)
    mirror = orientation.flag("mirror")
    profile = SensorProfile(
        name=table.text("name", longest=100),
        title=table.text("title"),
        width_px=width_px,
        height_px=height_px,
        px_per_mm=(scale[0], scale[1]),
        sign=-1 if orientation.values.get("sign") == -1 else 1,
        mirror=mirror,
        rotate90=rotate90,
        depth_unit_mm=unit_mm,
        **_given(noise, _SMOOTH, needed=slope_noise is None),
        scale_tolerance=image.number("scale_tolerance", low=0.0, high=0.5, unit=""),
        mask=_read_mask(image, folder, (height_px, width_px), mirror, rotate90) if "mask" in image.values and sized else None,
        slope_noise=slope_noise,
        geometry=_read_geometry(table, (width_px, height_px)),
        gel=_read_gel(table),
    )
    _examine_lens(profile, table)
    refuse_problems(table)
    return profile


def _examine_lens(profile: SensorProfile, table: Fields) -> None:
    """Report a barrel distortion that shows nothing at a pixel of the image, or too near to it for the way back."""
    # a profile that a program made may have values of any type here, which are already reported
    if table.problems or (k1 := profile.geometry.k1) >= 0.0:
        return
    h, w = profile.height_px, profile.width_px
    corners = np.array([0, 0, h - 1, h - 1]), np.array([0, w - 1, 0, w - 1])
    rows, columns = corners if profile.mask is None else profile.mask.nonzero()
    lens = profile.camera
    apart = (np.stack([columns, rows], axis=1) - lens.centre_px) / lens.corner_px
    farthest = float((apart**2).sum(axis=1).max(initial=0.0))
    if -k1 * farthest > MOST_BARREL:
        table.problem(
            "geometry.k1",
            f"geometry.k1 = {k1:g} is below {-MOST_BARREL / farthest:.3f}: this model of such a lens shows nothing at the "
            f"image's farthest pixel, {sqrt(farthest):.2f} half diagonals from the distortion's centre; give a weaker one, "
            f"or an image.mask of the pixels within {sqrt(MOST_BARREL / -k1):.2f}",
        )


def _given(table: Fields, bounds: Mapping[str, tuple[float, float, str]], *, needed: bool = False) -> dict[str, float]:
    """The numbers of a table, or where they are not needed those that are there; those left out keep their defaults."""
    return {
        key: table.number(key, low=low, high=high, unit=unit)
        for key, (low, high, unit) in bounds.items()
        if needed or key in table.values
    }


def _read_geometry(table: Fields, size_px: tuple[int, int]) -> Geometry:
    if "geometry" not in table.values:
        return Geometry()
    read = table.table("geometry", [field.name for field in fields(Geometry)])
    remedy = "give the difference from 1: 0.03 for 3 %"
    found: dict[str, Any] = {
        key: read.number(key, low=-0.2, high=0.2, unit="", remedy=remedy if key == "aspect" else "")
        for key in ("aspect", "shear", "k1")
        if key in read.values
    }
    if "center_px" in read.values:
        at = read.numbers("center_px", 2, low=-float(max(size_px)), high=2.0 * max(size_px), unit="px")
        found["center_px"] = (at[0], at[1])
    return Geometry(**(found | _given(read, _SIGMAS)))


def _read_gel(table: Fields) -> Gel:
    if "gel" not in table.values:
        return Gel()
    read = table.table("gel", [field.name for field in fields(Gel)])
    found: dict[str, Any] = dict(_given(read, _GEL))
    if "crown_mm" in read.values:
        radii = read.numbers("crown_mm", 2, low=10.0, high=1e9)
        found["crown_mm"] = (radii[0], radii[1])
    return Gel(**found)


def as_sensor(sensor: object) -> SensorProfile:
    """A profile itself, or read by name or path; the package's own are read once.

    Raises SpecError as `load_sensor`, for a profile with values that none can have, and if it is none of the three.
    """
    if isinstance(sensor, SensorProfile):
        return _checked(sensor)
    if isinstance(sensor, str | Path):
        return load_sensor(sensor) if is_profile_file(sensor) else _own_sensor(str(sensor))
    message = f"sensor = {shown(sensor)} is no sensor; give the name of a profile, a .toml file, or a SensorProfile"
    raise SpecError(Problem("sensor", message))


def _checked(made: SensorProfile) -> SensorProfile:
    """A profile that a program made, with a scale that can be hashed. Raises SpecError with all that is wrong with it."""
    scale = tuple(np.ravel(np.asarray(made.px_per_mm, dtype=object)).tolist())
    table = _known_fields(made, "", px_per_mm=scale)
    table.text("name", longest=100)
    table.text("title")
    table.integer("width_px", low=1, high=MOST_PX)
    table.integer("height_px", low=1, high=MOST_PX)
    table.numbers("px_per_mm", 2, low=0.01, high=1000.0, unit="px/mm")
    if table.integer("sign", low=-1, high=1, remedy="give 1 or -1", default=1) == 0:
        table.problem("sign", f"sign = {shown(made.sign)} is neither 1 nor -1; give one of them")
    table.flag("mirror")
    table.integer("rotate90", low=0, high=3)
    table.number("scale_tolerance", low=0.0, high=0.5, unit="")
    _given(table, _SMOOTH | {"slope_noise": (0.0, 10.0, "")})
    if "depth_unit_mm" in table.values:
        table.number("depth_unit_mm", low=LEAST_UNIT_MM, high=1000.0)
    shape = (made.height_px, made.width_px)
    if "mask" in table.values and not (
        isinstance(made.mask, np.ndarray) and made.mask.dtype == bool and made.mask.shape == shape
    ):
        table.problem("mask", f"mask is no array of bool of shape {shape}; give None, or one that is True where there is depth")
    for key, kind, bounds, pair, low in (
        ("geometry", Geometry, _CAMERA | _SIGMAS, "center_px", -2.0 * MOST_PX),
        ("gel", Gel, _GEL, "crown_mm", 10.0),
    ):
        part = getattr(made, key)
        if isinstance(part, kind):
            read = _known_fields(part, f"{key}.", table.problems)
            _given(read, bounds)
            if pair in read.values:
                read.numbers(pair, 2, low=low, high=1e9, unit=pair[-2:])
        else:
            table.problem(key, f"{key} = {shown(part)} is no {kind.__name__}; leave it out where nothing is known of it")
    _examine_lens(made, table)
    if table.problems:
        raise SpecError([Problem(p.key, f"sensor {shown(made.name)}: {p.message}") for p in table.problems])
    return made if isinstance(made.px_per_mm, tuple) else replace(made, px_per_mm=(scale[0], scale[1]))


def _known_fields(made: Any, where: str, problems: list[Problem] | None = None, **other: Any) -> Fields:
    """The attributes of a profile or of a part of it, without unknown ones (None)."""
    given = {f.name: getattr(made, f.name) for f in fields(made) if f.default is not None or getattr(made, f.name) is not None}
    return Fields(given | other, where, problems)


@lru_cache(maxsize=8)
def _own_sensor(name: str) -> SensorProfile:
    return load_sensor(name)


def _read_mask(image: Fields, folder: Path, shape: tuple[int, int], mirror: bool, rotate90: int) -> npt.NDArray[np.bool_] | None:
    """The mask in the canonical image; None if it has problems, which are collected."""
    value = image.values["mask"]
    mask = None
    if value == "ellipse":
        v, u = np.ogrid[: shape[0], : shape[1]]
        # pixel centres in units of half the sides, -1 to 1 between the image's edges
        mask = ((2 * u + 1) / shape[1] - 1) ** 2 + ((2 * v + 1) / shape[0] - 1) ** 2 <= 1.0
    elif isinstance(value, str) and value.lower().endswith(".png"):
        frame_shape = shape[::-1] if rotate90 % 2 else shape
        grey = tried(lambda: _read_png(folder / value, frame_shape), image.problems)
        if grey is None:
            return None
        valid = grey >= _VALID_GREY
        # a PNG is drawn on frames as they are delivered; the profile's mask is of the canonical image
        mask = np.ascontiguousarray(np.rot90(valid[:, ::-1] if mirror else valid, rotate90))
    elif isinstance(value, str):
        image.problem("mask", f'mask = {shown(value)} is no mask; give "ellipse", a border in px, or the path of a .png')
    else:
        border = round(image.number("mask", low=0.0, below=min(shape) / 2, unit="px", default=0.0))
        mask = np.zeros(shape, dtype=bool)
        mask[border : shape[0] - border, border : shape[1] - border] = True
    if mask is not None:
        if not mask.any():
            image.problem("mask", f"mask = {shown(value)} leaves no pixel that carries depth; make some of it white")
        mask.setflags(write=False)
    return mask


def _read_png(path: Path, shape: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """A PNG of exactly this (height, width) as grey levels; its header is checked before anything is unpacked."""
    try:
        data = read_regular(path, _MASK_BYTES)
    except (OSError, ValueError) as error:
        message = f"mask = {shown_path(path)} cannot be opened: {reason_of(error)}; give a PNG beside the profile"
        raise SpecError(Problem("mask", message)) from error
    height, width = png_size(data)
    if not data.startswith(PNG_HEADER) or len(data) > _MASK_BYTES:
        raise SpecError(Problem("mask", f"mask = {shown_path(path)} is no PNG of at most {_MASK_BYTES} bytes; write one"))
    if (height, width) != shape:
        message = f"mask = {shown_path(path)} is {width} x {height} px, a frame is {shape[1]} x {shape[0]}; make it as large"
        raise SpecError(Problem("mask", message))
    # as frames are read: an editor may leave the picture it began with marked as turned
    grey = unpacked(data, "IMREAD_GRAYSCALE IMREAD_IGNORE_ORIENTATION", "reading a PNG mask")
    if grey is None or grey.shape != shape:
        raise SpecError(Problem("mask", f"mask = {shown_path(path)} is a PNG that cannot be unpacked; write it again"))
    return np.asarray(grey, dtype=np.uint8)
