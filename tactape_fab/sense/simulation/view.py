"""View of a sensor on a tape: transforms between board and image, and the parts in view."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import refuse
from tactape_fab.base.fields import Fields
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.contact import contact_local
from tactape_fab.sense.simulation.parts import Parts
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.simulation.true_camera import TrueCamera, true_camera
from tactape_fab.texture.frames import FloatArray, board_to_texture, texture_to_board
from tactape_fab.texture.tape import Tape

FARTHEST_MM = 100_000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A pose of a sensor on a tape, with the true camera.

    Points "in view" are mm from the image centre, right and down, as the sensor sees them.
    """

    tape: Tape
    profile: SensorProfile
    scene: Scene
    position_mm: FloatArray
    theta_deg: float
    camera: TrueCamera

    @property
    def px_per_mm(self) -> tuple[float, float]:
        """The true scale along u and v in the middle of the lens, px/mm."""
        return self.camera.px_per_mm

    @property
    def half_field_mm(self) -> FloatArray:
        """Farthest points in view along u and v."""
        return self.camera.half_field_mm

    @property
    def turn(self) -> FloatArray:
        """Matrix M with T = S + q @ M.T of a point q in view, [[cos, sin], [-sin, cos]]; shape (2, 2)."""
        c, s = cos(radians(self.theta_deg)), sin(radians(self.theta_deg))
        return np.array([[c, s], [-s, c]])

    def to_px(self, in_view_mm: FloatArray) -> FloatArray:
        """Points in view as pixels of the canonical image; shape (..., 2), px."""
        return self.camera.to_px(in_view_mm)

    def from_px(self, px: FloatArray) -> FloatArray:
        """Points in view that pixels of the canonical image see; shape (..., 2), mm."""
        return self.camera.from_px(px)

    def from_board(self, xy_mm: FloatArray) -> FloatArray:
        """Board points converted to points in view; shape (..., 2), mm."""
        flat: FloatArray = (board_to_texture(xy_mm, self.tape.board.texture_origin_mm) - self.position_mm) @ self.turn
        height_mm = self.tape.part.body_mm[2]  # what the gel touches are the parts' tops
        if self.scene.elastic is not None:
            return projected(self.scene, flat, height_mm)
        return bent(self.scene, flat, height_mm) if self.scene.contact == "strip" else flat

    def to_board(self, in_view_mm: FloatArray) -> FloatArray:
        """Points in view converted to board points, for a flat board; shape (..., 2), mm."""
        return texture_to_board(self.position_mm + in_view_mm @ self.turn.T, self.tape.board.texture_origin_mm)

    def in_reach(self, parts: Parts, margin_mm: float) -> npt.NDArray[np.bool_]:
        """Parts that may be in view, by their distance on the board."""
        farthest = float(np.hypot(*self.half_field_mm)) + margin_mm
        if self.scene.contact == "strip":  # an arc is at most pi/2 times its chord, and the chord may start off centre
            farthest = 2 * farthest + float(np.hypot(*self.scene.contact_offset_mm))
        offset = parts.xy_mm - texture_to_board(self.position_mm, self.tape.board.texture_origin_mm)
        return np.asarray((offset * offset).sum(axis=1) <= farthest * farthest)


def bent(scene: Scene, flat_mm: FloatArray, height_mm: float, across_slope: float = 0.0) -> FloatArray:
    """Points of a tape wrapped about a strip's cylinder, or above them, seen from above; the image centre does not move.

    across_slope: Slope of a tilt across the cylinder's axis, which moves the top line and so the foreshortening of the film.
    """
    radius = scene.cylinder_radius_mm
    seen_radius = radius + height_mm
    turn = radians(scene.contact_turn_deg)
    across = contact_local(scene, flat_mm)[..., 1]
    centre = float(contact_local(scene, np.zeros(2))[1])
    if across_slope != 0.0 and abs(centre) < seen_radius:
        slope = across_slope - centre / sqrt(seen_radius**2 - centre**2)
        from_centre, centre = across - centre, -seen_radius * slope / sqrt(1.0 + slope * slope)
        across = from_centre + centre
    # arc length along the film from the cylinder's top line; the image centre is seen at `centre` from it, and stays there
    arc = np.arcsin(np.clip(centre / seen_radius, -1.0, 1.0)) * radius + across - centre
    # beyond a quarter of the circle the film turns away: it stays at the cylinder's edge, where there is no contact
    seen = seen_radius * np.sin(np.clip(arc / radius, -np.pi / 2, np.pi / 2))
    shifted: FloatArray = flat_mm + (seen - across)[..., None] * np.array([sin(turn), cos(turn)])
    return shifted


def projected(scene: Scene, flat_mm: FloatArray, height_mm: float) -> FloatArray:
    """Tops of parts on a tape that is wrapped about a cylinder, tilted, or both, seen along the sensor's axis.

    The image centre does not move. A tilted tape is turned about a line across its slope: lengths along the slope shrink by
    the cosine of its angle. Round a cylinder that is so along its axis; across it a tilt moves the top line.
    """
    elastic = scene.elastic
    assert elastic is not None
    # the plane's gradient; its length is the tangent of the steepest angle, whose cosine is 1 / sqrt(1 + tan^2)
    slope = np.tan(np.radians(elastic.tilt_deg))
    if elastic.cylinder_radius_mm is not None:
        turn = radians(scene.contact_turn_deg)
        across = np.array([sin(turn), cos(turn)])
        flat_mm = bent(scene, flat_mm, height_mm, float(slope @ across))
        slope = slope - (slope @ across) * across
    square = float(slope @ slope)
    if square == 0.0:
        return flat_mm
    along = (flat_mm @ slope)[..., None] * slope / square
    tilted: FloatArray = flat_mm - along * (1 - 1 / np.sqrt(1 + square))
    return tilted


def make_view(tape: Tape, position_mm: npt.ArrayLike, theta_deg: float, profile: SensorProfile, scene: Scene) -> View:
    """A view of a tape from a pose in the texture frame. Raises SpecError if the pose is not finite or out of range."""
    plain = position_mm.tolist() if isinstance(position_mm, np.ndarray) else position_mm
    table = Fields({"position_mm": plain, "theta_deg": theta_deg})
    x, y = table.numbers("position_mm", 2, low=-FARTHEST_MM, high=FARTHEST_MM)
    theta = table.number("theta_deg", low=-1e6, high=1e6, unit="deg")
    refuse(table.problems)
    camera = true_camera(profile, scene)
    return View(tape=tape, profile=profile, scene=scene, position_mm=np.array([x, y]), theta_deg=theta, camera=camera)
