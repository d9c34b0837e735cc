"""Warp of a scan: board points to pixels, as a polynomial and a shift of each line and column of pixels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.frames import FloatArray

_EXPONENTS = {order: [(i - j, j) for i in range(order + 1) for j in range(i + 1)] for order in (1, 2, 3)}  # 1, x, y, x^2, ...
_STEPS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class LineShift:
    """Shift of pixels that depends on one coordinate alone, in px, piecewise linear: the jitter of a scanner's carriage.

    ``axis`` is 1 where it depends on v, 0 where on u; ``value_px`` (m, 2) is given at knots ``start_px + i step_px``.
    """

    axis: int
    start_px: float
    step_px: float
    value_px: FloatArray

    def weights(self, at_px: FloatArray) -> tuple[npt.NDArray[np.int64], FloatArray]:
        """Index of the knot before each coordinate, and the weight of the next knot."""
        # just below the last knot, so that there is always a next one; beyond the ends the shift stays
        t = np.clip((at_px - self.start_px) / self.step_px, 0.0, len(self.value_px) - 1.000001)
        knot = t.astype(np.int64)
        return knot, t - knot

    def of_pixels(self, count: int) -> npt.NDArray[np.float32]:
        """The shift at pixels 0 to count - 1, a table for patches with many samples: half a pixel away it differs by 0.01 px."""
        before, share = self.weights(np.arange(count, dtype=np.float64))
        value = self.value_px
        return np.asarray(value[before] * (1 - share[:, None]) + value[before + 1] * share[:, None], dtype=np.float32)

    def at(self, px: FloatArray) -> FloatArray:
        """The shift at pixels (u, v), px; same shape as `px`."""
        knot, share = self.weights(px[..., self.axis])
        return self.value_px[knot] * (1 - share[..., None]) + self.value_px[knot + 1] * share[..., None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Warp:
    """Board points (mm) to pixels of one scan.

    middle_mm (2,)
    half_mm: Powers are those of (board point - middle) / half.
    order: 1 affine, 2 and 3 for what a camera adds.
    coefficients (k, 2): Of 1, x, y, x^2, x y, ...
    """

    middle_mm: FloatArray
    half_mm: float
    order: int
    coefficients: FloatArray
    lines: tuple[LineShift, ...] = field(default=())

    def basis(self, board_mm: npt.ArrayLike) -> FloatArray:
        """Powers of board points; shape (n, k)."""
        x, y = ((np.asarray(board_mm, dtype=np.float64) - self.middle_mm) / self.half_mm).T
        return np.stack([x**i * y**j for i, j in _EXPONENTS[self.order]], axis=-1)

    def smooth(self, board_mm: npt.ArrayLike) -> FloatArray:
        """Pixels without the shift of lines; shape (n, 2)."""
        return np.asarray(self.basis(board_mm) @ self.coefficients, dtype=np.float64)

    def to_px(self, board_mm: npt.ArrayLike) -> FloatArray:
        """Pixels (u, v) of board points; shape (n, 2)."""
        px = self.smooth(board_mm)
        return np.asarray(px + sum((line.at(px) for line in self.lines), np.zeros_like(px)), dtype=np.float64)

    def jacobian(self, board_mm: npt.ArrayLike) -> FloatArray:
        """Derivative of the smooth part, px/mm; shape (n, 2, 2), [..., pixel axis, board axis]."""
        x, y = ((np.asarray(board_mm, dtype=np.float64) - self.middle_mm) / self.half_mm).T
        powers = _EXPONENTS[self.order]
        dx = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in powers], axis=-1) @ self.coefficients
        dy = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in powers], axis=-1) @ self.coefficients
        return np.stack([dx, dy], axis=-1) / self.half_mm

    def to_board(self, px: npt.ArrayLike) -> FloatArray:
        """Board points of pixels, by Newton's method from the affine part; shape (n, 2), mm."""
        want = np.asarray(px, dtype=np.float64).reshape(-1, 2)
        linear = self.coefficients[1:3].T / self.half_mm
        at: FloatArray = (want - self.coefficients[0]) @ np.linalg.inv(linear).T + self.middle_mm
        for _ in range(_STEPS if self.order > 1 or self.lines else 0):
            # the jacobian is that of the smooth part: line shifts are small and slow beside it, and the steps converge all the
            # same
            at = at + np.linalg.solve(self.jacobian(at), (want - self.to_px(at))[..., None])[..., 0]
        return np.asarray(at, dtype=np.float64)

    @property
    def px_per_mm(self) -> float:
        """Scale in the middle: root of the area."""
        linear = self.coefficients[1:3] / self.half_mm
        return float(np.sqrt(abs(np.linalg.det(linear))))

    @property
    def mirrored(self) -> bool:
        """Whether the scan shows the tape mirrored: board y is up, v is down."""
        return bool(np.linalg.det(self.coefficients[1:3]) > 0)

    def raised(self, order: int) -> Warp:
        """The same warp with room for higher powers."""
        if order <= self.order:
            return self
        grown = np.zeros((len(_EXPONENTS[order]), 2))
        grown[: len(self.coefficients)] = self.coefficients
        return replace(self, order=order, coefficients=grown)


def affine_warp(linear: npt.ArrayLike, shift_px: npt.ArrayLike, middle_mm: npt.ArrayLike, half_mm: float) -> Warp:
    """The warp px = linear @ board + shift."""
    a, middle = np.asarray(linear, dtype=np.float64), np.asarray(middle_mm, dtype=np.float64)
    coefficients = np.vstack([a @ middle + np.asarray(shift_px), a.T * half_mm])
    return Warp(middle_mm=middle, half_mm=half_mm, order=1, coefficients=coefficients)


def fitted(warp: Warp, board_mm: FloatArray, px: FloatArray, *, gate_px: float, rounds: int = 4) -> tuple[Warp, FloatArray]:
    """Fit the smooth part to points, robustly; also the distance of each point from it, px."""
    a = warp.basis(board_mm)
    weight = np.ones(len(a))
    coefficients = warp.coefficients
    away = np.zeros(len(a))
    for _ in range(rounds):
        weighted = (a * weight[:, None]).T  # normal equations: powers of dimensionless points are well conditioned
        coefficients = np.asarray(np.linalg.lstsq(weighted @ a, weighted @ px, rcond=None)[0], dtype=np.float64)
        away = np.hypot(*(px - a @ coefficients).T)
        # a perfect fit has the median 0, and would leave out all but the nearest points
        scale = max(1.5 * float(np.median(away)), 0.02 * gate_px)
        # Cauchy's weights
        weight = 1.0 / (1.0 + (away / scale) ** 2)
    return replace(warp, coefficients=coefficients), away
