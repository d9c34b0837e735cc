"""Mounts of a film on an object, flat or round a cylinder; transforms between tape and object frame.

The board frame in space: x right and y up along the film, z out of it, z = 0 at its top. A cylinder's frame has the axis as z;
if board x is the circumference, board point (x, y) is at arc length x, counter-clockwise seen from +z, from the frame's x
axis, and at height y; if board y is, it is at arc length y from the x axis, and at height -x.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import refuse
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.given_value import as_numbers, refuse_other
from tactape_fab.sense.decode.space import Surface, image_pose
from tactape_fab.sense.geometry import from_quaternion, is_rotation
from tactape_fab.sense.objects.rigid import to_quaternion
from tactape_fab.texture.frames import FloatArray, texture_to_board
from tactape_fab.texture.tape import Tape, refuse_no_tape

SurfaceKind = Literal["plane", "cylinder"]
Around = Literal["x", "y"]
SURFACES: tuple[str, ...] = get_args(SurfaceKind)
AROUND: tuple[str, ...] = get_args(Around)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mount:
    """Mount of a film on an object.

    Attributes
    ----------
    surface : {"plane", "cylinder"}
        Whether the film is flat or wrapped.
    rotation : ndarray, shape (3, 3)
        Rotation of the board frame, or of the cylinder's, in the object frame.
    position_mm : ndarray, shape (3,)
        Position of its origin there, mm: the lower left corner of the outline, or a point of the axis.
    top_mm : float
        Cylinder only: radius of the film's top, mm.
    true_mm : float
        Cylinder only: radius of the film's neutral layer, whose length does not change, mm.
    around : {"x", "y"}
        Cylinder only: the board axis along the circumference.
    covariance : ndarray, shape (6, 6), or None
        Of the mount's error: of `position_mm`, mm, then of small turns about the object's axes, rad. None: it is exact.

    Raises
    ------
    SpecError
        If the rotation is none, the covariance has a negative variance, or a value has another shape, or is no word or radius of
        these.
    """

    surface: SurfaceKind
    rotation: FloatArray
    position_mm: FloatArray
    top_mm: float = 0.0
    true_mm: float = 0.0
    around: Around = "x"
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        refuse_other(self.surface, str, "mount.surface", "surface", " or ".join(SURFACES))
        remedy = "a rotation matrix (3, 3)"
        rotation = as_numbers(self.rotation, (3, 3), "mount.rotation", remedy)
        position_mm = as_numbers(self.position_mm, (3,), "mount.position_mm", "x, y and z in mm")
        table = Fields({"surface": self.surface, "around": self.around, "top_mm": self.top_mm, "true_mm": self.true_mm}, "mount.")
        if not is_rotation(rotation):
            table.problem("rotation", f"rotation = {shown(rotation.tolist())} is no rotation; give {remedy}")
        if table.text("surface", choices=SURFACES) == "cylinder":
            table.text("around", choices=AROUND)
            table.number("top_mm", above=0.0)
            table.number("true_mm", above=0.0)
        if self.covariance is not None:
            remedy = "a covariance (6, 6), mm and rad"
            covariance = as_numbers(self.covariance, (6, 6), "mount.covariance", remedy)
            if not is_covariance(covariance):
                table.problem("covariance", f"covariance = {shown(covariance.tolist())} is none; give {remedy}")
            object.__setattr__(self, "covariance", covariance)
        refuse(table.problems)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "position_mm", position_mm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectPose:
    """Pose of a contact on an object.

    Attributes
    ----------
    object : str
        The object's name.
    position_mm : (float, float, float)
        The point of the film's top under the image centre (object frame, mm).
    rotation : (float, float, float, float)
        Quaternion (x, y, z, w) of the image's frame in the object frame: x along u, y along v, z into the object.
    covariance : ndarray, shape (6, 6), or None
        Of the position, mm, then of small turns about the object's x, y and z axes, rad, as `Localization.covariance6` has it:
        the mount's error is in it, where that is known.
    """

    object: str
    position_mm: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    covariance: FloatArray | None = None

    def transform(self) -> FloatArray:
        """The pose of the sensor's image in the object frame, as a homogeneous matrix.

        Returns
        -------
        ndarray, shape (4, 4)
            mm; from the image's frame, as `Localization.transform` has it.
        """
        out = np.eye(4)
        out[:3, :3] = from_quaternion(self.rotation)
        out[:3, 3] = self.position_mm
        return out


def is_covariance(matrix: FloatArray) -> bool:
    """Whether a square matrix is symmetric, and no variance along any direction is negative."""
    scale = np.sqrt(np.abs(matrix.diagonal()))
    # mm and rad differ in size: held against their own standard deviations
    scaled = matrix / np.outer(scale, scale).clip(1e-300)
    return bool(np.allclose(scaled, scaled.T) and np.linalg.eigvalsh(scaled)[0] > -1e-9)


def on_surface(mount: Mount, board_mm: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Board points on the mount's own surface, in its frame.

    board_mm (n, 2)
    Returns points (n, 3): mm.
    Returns axes (n, 3, 3): Columns: along board x, along board y, out of the film.
    """
    xy = np.asarray(board_mm, dtype=np.float64).reshape(-1, 2)
    if mount.surface == "plane":
        return np.column_stack([xy, np.zeros(len(xy))]), np.tile(np.eye(3), (len(xy), 1, 1))
    round_mm, height = (xy[:, 0], xy[:, 1]) if mount.around == "x" else (xy[:, 1], -xy[:, 0])
    # the neutral layer keeps its length when the film is bent, the top is stretched: arc lengths are angles there
    angle = round_mm / mount.true_mm
    c, s, none, one = np.cos(angle), np.sin(angle), np.zeros(len(xy)), np.ones(len(xy))
    along, up, out = np.stack([-s, c, none], axis=1), np.stack([none, none, one], axis=1), np.stack([c, s, none], axis=1)
    # board x and y on the cylinder's own directions; around y the board lies a quarter turn further, with x down the axis
    first, second = (along, up) if mount.around == "x" else (-up, along)
    return np.column_stack([mount.top_mm * c, mount.top_mm * s, height]), np.stack([first, second, out], axis=2)


def printed_mount(size_mm: tuple[float, float], radius_mm: float, around: Around) -> Mount:
    """The mount of a print round a cylinder in its model's frame: the board's middle line stays, the axis is at z = -R."""
    half_mm = size_mm[0 if around == "x" else 1] / 2
    c, s = cos(half_mm / radius_mm), sin(half_mm / radius_mm)
    # columns: out of the print and along its arc at the arc's beginning, and the axis, as `on_surface` has them
    rows = [(-s, c, 0.0), (0.0, 0.0, 1.0), (c, s, 0.0)] if around == "x" else [(0.0, 0.0, -1.0), (-s, c, 0.0), (c, s, 0.0)]
    middle_mm = np.array([half_mm, 0.0, -radius_mm] if around == "x" else [0.0, half_mm, -radius_mm])
    return Mount(
        surface="cylinder", rotation=np.array(rows), position_mm=middle_mm, top_mm=radius_mm, true_mm=radius_mm, around=around
    )


def to_object(mount: Mount, board_mm: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Board points in the object frame, (n, 3) mm, and the axes there as `on_surface` has them, (n, 3, 3)."""
    points, axes = on_surface(mount, board_mm)
    return points @ mount.rotation.T + mount.position_mm, mount.rotation @ axes


def texture_surface(mount: Mount, tape: Tape) -> Surface:
    """Where texture points of a mounted tape are in the object frame, and the texture's axes there, z into the object."""

    def surface(at_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        points, axes = to_object(mount, texture_to_board(at_mm, tape.board.texture_origin_mm)[None])
        # board axes to texture axes: y down and z into the object
        return points[0], axes[0] * (1.0, -1.0, -1.0)

    return surface


def sensor_on_object(name: str, mount: Mount, tape: Tape, position_mm: npt.ArrayLike, theta_deg: float) -> ObjectPose:
    """The pose of a sensor on a tape, in the frame of the object that the tape is on.

    Parameters
    ----------
    name : str
        The object's name.
    mount : Mount
        Mount of the film on the object.
    tape : Tape
    position_mm : (float, float)
        Texture point under the image centre (texture frame, mm), as in a `Localization`.
    theta_deg : float
        Turn of the sensor on the tape, degrees, counter-clockwise seen from above.

    Returns
    -------
    ObjectPose

    Raises
    ------
    SpecError
        If an argument is of another type.
    """
    refuse_other(mount, Mount, "mount", "Mount", "Mount(surface=, rotation=, position_mm=)")
    refuse_no_tape(tape)
    x, y = as_numbers(position_mm, (2,), "position_mm", "x and y in mm").tolist()
    theta = radians(as_numbers(theta_deg, (), "theta_deg", "degrees"))
    pose = image_pose(texture_surface(mount, tape), np.array([x, y, theta, 0.0, 0.0, 0.0]))
    x, y, z = pose[:3, 3].tolist()
    return ObjectPose(object=name, position_mm=(x, y, z), rotation=to_quaternion(pose[:3, :3]))
