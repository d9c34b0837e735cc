"""The dots of a located answer: where each is seen, its part, its symbol, and its residual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from math import cos, sin
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.pose import Pose
from tactape_fab.sense.decode.grid.posterior import lens_of
from tactape_fab.sense.decode.rank import View
from tactape_fab.sense.decode.result import LocatedDots
from tactape_fab.sense.decode.search.evidence import columns_by_symbol
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

_Kind = TypeVar("_Kind", bound=np.generic)
ALIKE = 1.15
"""Factor on the standard deviations of aspect and shear for correlated errors: dots on one side of the rim err alike. Without it
they are 5 to 20 % too small (`python -m tests.bench.nees`)."""
OBSERVED = 0.9
"""A frame observes a camera parameter if its posterior standard deviation is less than this share of the prior one."""


class LazyDots(LocatedDots):
    """`LocatedDots` that are computed on first access: most callers never read them."""

    __slots__ = ("_compute",)

    def __init__(self, compute: Callable[[], LocatedDots] | None = None, /, **values: Any) -> None:
        """Of the function that computes them, or of the values of all fields, as `dataclasses.replace` gives them."""
        object.__setattr__(self, "_compute", compute or partial(replace, LocatedDots(**values)))

    def __getattr__(self, name: str) -> Any:
        """Called for a field that is not computed yet; computes all fields."""
        if name not in _FIELDS:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self)
        # threads that ask at the same time compute the same
        found = self._compute()
        for field in _FIELDS:
            object.__setattr__(self, field, getattr(found, field))
        return getattr(found, name)


_FIELDS = tuple(field.name for field in fields(LocatedDots))


def located_dots(
    dots: Dots,
    q: FloatArray,
    turn: int,
    cells: IntArray,
    inside: BoolArray,
    offset_px: FloatArray,
    nominal_mm: FloatArray,
    pose: Pose,
    view: View,
) -> LocatedDots:
    """Build the `LocatedDots` of an accepted answer.

    dots: n of them.
    q (n, 4): From `fit.posteriors`, in the grid's axes.
    turn: Quarter turns of the grid's axes to the texture's.
    cells (k, 2): Of the dots inside.
    inside (n,): Dots at a part of the tape, k of them.
    offset_px, nominal_mm (k, 2): Their offsets from the image centre, in square pixels, and the nominal positions of their parts,
        texture frame.
    pose: Fitted to them.
    """
    seen_px = dots.xy_px if dots.seen_px is None else dots.seen_px
    out = LocatedDots(
        uv_px=seen_px.copy(),
        cell=_of_all(cells, inside, -1),
        symbol=q.take(columns_by_symbol(q.shape[1])[turn % 4], axis=1),
        residual_mm=_of_all(_on_texture(offset_px, pose, view) - nominal_mm, inside, np.nan),
        inlier=_of_all(pose.agree, inside, False),
    )
    for array in (out.uv_px, out.cell, out.symbol, out.residual_mm, out.inlier):
        array.flags.writeable = False
    return out


def _of_all(values: npt.NDArray[_Kind], inside: BoolArray, fill: float) -> npt.NDArray[_Kind]:
    """Values of the dots inside, expanded to all dots; the others get `fill`."""
    if len(values) == len(inside):
        return values.copy()
    out = np.full((len(inside), *values.shape[1:]), fill, dtype=values.dtype)
    out[inside] = values
    return out


def strain_of(pose: Pose, view: View) -> dict[str, tuple[float | None, float | None, None]]:
    """Fields `strain` and `strain_sigma` of an answer: aspect and shear where the frame observes them."""
    # a posterior nearly as wide as its prior repeats the profile: the frame does not observe the parameter
    (aspect, shear, _), (aspect_sigma, shear_sigma, _) = pose.camera.tolist()
    _, known_aspect, known_shear, _ = view.beliefs.sigmas.tolist()
    a, s = aspect_sigma < OBSERVED * known_aspect, shear_sigma < OBSERVED * known_shear
    return {
        "strain": (aspect if a else None, shear if s else None, None),
        "strain_sigma": (ALIKE * aspect_sigma if a else None, ALIKE * shear_sigma if s else None, None),
    }


def _on_texture(offset_px: FloatArray, pose: Pose, view: View) -> FloatArray:
    """Texture points of dots, (n, 2) mm, by a pose and the camera fitted with it; see `posterior` for the camera."""
    aspect, shear, k1 = pose.camera[0].tolist()
    centre_mm, corner_mm = view.beliefs.centre_mm, view.beliefs.corner_mm
    shrink, c, s = view.px_per_mm / pose.px_per_mm, cos(pose.theta_rad), sin(pose.theta_rad)
    along, down = (1.0 + 0.5 * aspect) / shrink, (1.0 - 0.5 * aspect) / shrink
    lean = shear / (1.0 + 0.5 * aspect)
    # R(theta) times the inverse of [[1 + aspect / 2, shear], [0, 1 - aspect / 2]], transposed
    turn = np.array([[c / along, -s / along], [(s - c * lean) / down, (c + s * lean) / down]])
    # `posterior._linearised` for all dots: the lens undone about the distortion's centre, its shift of the image centre put
    # back
    from_centre = offset_px / view.px_per_mm - centre_mm
    lens = lens_of.py_func(k1, ((from_centre / corner_mm) ** 2).sum(axis=1))[0]
    middle = lens_of.py_func(k1, float(((centre_mm / corner_mm) ** 2).sum()))[0]
    return np.asarray((from_centre * lens[:, None]) @ turn + (pose.position_mm + middle * (centre_mm @ turn)))
