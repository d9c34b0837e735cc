"""A body as MuJoCo's MJCF and as URDF, which refer to an OBJ file beside them."""

from __future__ import annotations

from collections.abc import Iterable
from math import pi

import numpy as np

from tactape_fab.solids.sim.body import Body, Box, Frame

Colour = tuple[float, float, float]
_SEEN, _COLLIDES = 2, 3
"""MuJoCo's customary groups of visual geoms, and of collision geoms, which its viewer hides."""
_TAKEN = ("world", "texture", "tag")
"""Names of bodies and links that a tape's name must not be: MuJoCo's root, and the frames."""


def numbers(values: Iterable[float]) -> str:
    """Numbers as text, separated by blanks."""
    return " ".join(f"{value + 0.0:.9g}" for value in np.ravel(np.asarray(values, dtype=np.float64)))


def quaternion(turn: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """A rotation vector (axis times rad) as a quaternion, w first."""
    angle = float(np.linalg.norm(turn))
    x, y, z = (0.0, 0.0, 0.0) if angle == 0.0 else (np.sin(angle / 2) * np.array(turn) / angle).tolist()
    return float(np.cos(angle / 2)), x, y, z


def frame_quaternion(frame: Frame) -> tuple[float, float, float, float]:
    """Orientation of a frame as a quaternion, w first: half a turn about x, then its angle about the body's z."""
    # (cos t/2 + k sin t/2) i = i cos t/2 + j sin t/2; in URDF rpy = (pi, 0, t)
    return 0.0, float(np.cos(frame.turn_rad / 2)), float(np.sin(frame.turn_rad / 2)), 0.0


def _link(body: Body) -> str:
    """The name of the body or link."""
    return f"{body.name}_body" if body.name in _TAKEN else body.name


def mjcf(body: Body, mesh_file: str, colour_file: str | None, rgb: Colour) -> bytes:
    """The body with visual mesh, collision shapes, inertia, and a site for each frame; without a joint, to be part of an object.

    Rotations are quaternions, as the unit of angles is that of the whole model that includes the file.
    """
    m = body.inertia
    # MJCF's order of a full inertia: the diagonal, then xy, xz, yz
    inertia = numbers([m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]])
    look = f'rgba="{numbers([*rgb, 1])}"' if colour_file is None else 'texture="colour"'
    lines = [
        f'<mujoco model="{body.name}">',
        "  <asset>",
        *([] if colour_file is None else [f'    <texture name="colour" type="2d" file="{colour_file}"/>']),
        f'    <material name="look" {look} specular="0.1" shininess="0.1"/>',
        f'    <mesh name="{body.name}" file="{mesh_file}"/>',
        "  </asset>",
        "  <worldbody>",
        f'    <body name="{_link(body)}">',
        f'      <inertial pos="{numbers(body.centre)}" mass="{body.mass:.9g}" fullinertia="{inertia}"/>',
        f'      <geom name="visual" type="mesh" mesh="{body.name}" material="look" contype="0" conaffinity="0" group="{_SEEN}"/>',
        *(f"      {_geom(k, box)}" for k, box in enumerate(body.boxes)),
        *(
            []
            if body.hull is None  # MuJoCo uses the convex hull of any collision mesh
            else [f'      <geom name="collision" type="mesh" mesh="{body.name}" group="{_COLLIDES}"/>']
        ),
        *(
            f'      <site name="{frame.name}" pos="{numbers(frame.origin)}" quat="{numbers(frame_quaternion(frame))}" '
            'size="0.0005" group="4"/>'
            for frame in body.frames
        ),
        "    </body>",
        "  </worldbody>",
        "</mujoco>",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _geom(number: int, box: Box) -> str:
    return (
        f'<geom name="collision{number}" type="box" pos="{numbers(box.centre)}" size="{numbers(box.half)}" '
        f'quat="{numbers(quaternion(box.turn))}" group="{_COLLIDES}"/>'
    )


def urdf(body: Body, mesh_file: str, hull_file: str | None, rgb: Colour) -> bytes:
    """The body as one link, and each frame as a link with a fixed joint."""
    # about the centre of mass along the link's axes, so the origin has rpy 0
    m = body.inertia
    entries = {"ixx": m[0, 0], "iyy": m[1, 1], "izz": m[2, 2], "ixy": m[0, 1], "ixz": m[0, 2], "iyz": m[1, 2]}
    inertia = " ".join(f'{name}="{value + 0.0:.9g}"' for name, value in entries.items())
    lines = [
        '<?xml version="1.0"?>',
        f'<robot name="{body.name}">',
        f'  <link name="{_link(body)}">',
        "    <inertial>",
        f'      <origin xyz="{numbers(body.centre)}" rpy="0 0 0"/>',
        f'      <mass value="{body.mass:.9g}"/>',
        f"      <inertia {inertia}/>",
        "    </inertial>",
        "    <visual>",
        f'      <geometry><mesh filename="{mesh_file}"/></geometry>',
        f'      <material name="look"><color rgba="{numbers([*rgb, 1])}"/></material>',
        "    </visual>",
    ]
    for box in body.boxes:  # each is rotated about a single axis, so the rotation vector equals roll, pitch and yaw
        lines += [
            "    <collision>",
            f'      <origin xyz="{numbers(box.centre)}" rpy="{numbers(box.turn)}"/>',
            # URDF has whole sides, MJCF half sides
            f'      <geometry><box size="{numbers(2 * np.array(box.half))}"/></geometry>',
            "    </collision>",
        ]
    if hull_file is not None:
        lines += [f'    <collision><geometry><mesh filename="{hull_file}"/></geometry></collision>']
    lines.append("  </link>")
    for frame in body.frames:
        lines += [
            f'  <link name="{frame.name}"/>',
            f'  <joint name="{frame.name}_of_{body.name}" type="fixed">',
            f'    <parent link="{_link(body)}"/>',
            f'    <child link="{frame.name}"/>',
            f'    <origin xyz="{numbers(frame.origin)}" rpy="{numbers([pi, 0, frame.turn_rad])}"/>',
            "  </joint>",
        ]
    return ("\n".join([*lines, "</robot>"]) + "\n").encode("ascii")
