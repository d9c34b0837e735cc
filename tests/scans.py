"""Flatbed scans of an assembled tape, drawn from signed distances; shares nothing with the inspector.

A pixel sees the film at A^-1 (u, v) plus its line's jitter; coverage of a shape is the Gaussian integral of its signed distance.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, radians, sin
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.special import erf

from tactape_fab import Tape

F = npt.NDArray[np.float64]
G = npt.NDArray[np.float32]
B = npt.NDArray[np.bool_]
Picture = npt.NDArray[np.uint8]

FILM, BASE, GOLD, SOLDER, TIN, BODY, INK, LID = (
    np.array(c, dtype=np.float64)
    for c in (
        (205, 142, 38),
        (140, 92, 20),
        (228, 190, 105),
        (168, 170, 176),
        (205, 208, 212),
        (34, 35, 40),
        (244, 244, 238),
        (236, 237, 236),
    )
)  # red, green, blue


FOOT_MM = np.array([3.0, -2.0])
"""Of a camera, from the tape's middle."""


@dataclass(frozen=True, kw_only=True)
class Built:
    """A tape as it was assembled: true places less nominal, board frame."""

    dx_mm: F
    dy_mm: F
    turn_deg: F
    present: npt.NDArray[np.bool_]
    tombstoned: npt.NDArray[np.bool_]
    specks: list[tuple[float, float, float]] = field(default_factory=list)  # x, y, radius, mm


def assembled(tape: Tape, *, sigma_mm: float = 0.05, turn_deg: float = 2.0, missing: int = 0, seed: int = 0) -> Built:
    rng = np.random.default_rng(seed)
    n = tape.part_count
    present = np.ones(n, dtype=bool)
    present[rng.choice(n, missing, replace=False)] = False
    return Built(
        dx_mm=rng.normal(0, sigma_mm, n),
        dy_mm=rng.normal(0, sigma_mm, n),
        turn_deg=rng.normal(0, turn_deg, n),
        present=present,
        tombstoned=np.zeros(n, dtype=bool),
    )


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """How the picture comes out worse than the tape is."""

    dpi: float = 1200.0
    turn_deg: float = 0.7
    scale: tuple[float, float] = (1.003, 0.998)
    skew_deg: float = 0.1
    jitter_um: float = 10.0
    blur_mm: float = 0.018
    noise: float = 3.0
    shading: float = 0.06
    shadow: float = 0.45
    glare: float = 1.0
    band_mm: float = 0.012
    """Scatter of the length of a part's metal ends."""
    margin_mm: float = 3.0
    perspective: float = 0.0
    """Relative change of scale from one end to the other, as of a camera that looks at a slant."""
    lens_k1: float = 0.0
    """Radial distortion of a camera at half the tape's width from the middle."""
    camera_mm: float = float("inf")
    """Height of a camera over the film: what stands up is seen farther from the middle. A scanner has none."""


def _edge(distance_mm: G, blur_mm: float) -> G:
    return np.asarray(0.5 - 0.5 * erf(distance_mm / (blur_mm * 2.0**0.5)))


def _box(x: G, y: G, half_x: float, half_y: float, radius: float = 0.0) -> G:
    qx, qy = np.abs(x) - half_x + radius, np.abs(y) - half_y + radius
    return np.asarray(np.hypot(np.maximum(qx, 0), np.maximum(qy, 0)) + np.minimum(np.maximum(qx, qy), 0) - radius)


class _Bed:
    """Pixels and the board points that they see."""

    def __init__(self, tape: Tape, scanner: Scanner, rng: np.random.Generator) -> None:
        r = scanner.dpi / 25.4
        t, s = np.radians(scanner.turn_deg), np.radians(scanner.skew_deg)
        turn = np.array([(np.cos(t), -np.sin(t)), (np.sin(t), np.cos(t))])
        warp = np.array([(scanner.scale[0], np.tan(s)), (0.0, scanner.scale[1])])
        self.linear = r * warp @ turn @ np.diag([1.0, -1.0])  # board to px, y down
        width, height = tape.board.size_mm
        corners = np.array([(0, 0), (width, 0), (0, height), (width, height)], dtype=np.float64)
        self.middle_mm = corners.mean(axis=0)
        at = self._bent((corners - self.middle_mm) @ self.linear.T, scanner, width * r)
        low, high = at.min(axis=0) - scanner.margin_mm * r, at.max(axis=0) + scanner.margin_mm * r
        self.shape = (int(high[1] - low[1]), int(high[0] - low[0]))
        self.shift = -low
        self.scanner, self.span_px = scanner, width * r
        h = self.shape[0]
        smooth = [gaussian_filter1d(rng.normal(size=(h, 2)), length * r, axis=0) for length in (0.3, 3.0)]
        parts = [rng.normal(size=(h, 2)), *smooth]
        jitter = sum(p / p.std(axis=0) * w for p, w in zip(parts, (0.35, 0.55, 0.75), strict=True))
        self.jitter_mm = jitter / jitter.std(axis=0) * scanner.jitter_um / 1000 * np.array([0.4, 1.0])

    @staticmethod
    def _bent(px: F, scanner: Scanner, span: float) -> F:
        flat = px / (1 + scanner.perspective * px[..., :1] / span)
        return np.asarray(flat * (1 + scanner.lens_k1 * (flat**2).sum(axis=-1, keepdims=True) / (span / 2) ** 2))

    def _straight(self, px: F) -> F:
        if self.scanner.lens_k1 == self.scanner.perspective == 0.0:
            return px
        flat = px
        for _ in range(8):
            flat = px / (1 + self.scanner.lens_k1 * (flat**2).sum(axis=-1, keepdims=True) / (self.span_px / 2) ** 2)
        return np.asarray(flat / (1 - self.scanner.perspective * flat[..., :1] / self.span_px))

    def seen_off_mm(self, at_mm: F, height_mm: float) -> F:
        """How far out a camera sees what stands so high."""
        return np.asarray((at_mm - self.middle_mm - FOOT_MM) * height_mm / (self.scanner.camera_mm - height_mm))

    def to_px(self, board_mm: F) -> F:
        return np.asarray(self._bent((board_mm - self.middle_mm) @ self.linear.T, self.scanner, self.span_px) + self.shift)

    def to_board(self, u: F, v: F) -> tuple[F, F]:
        p = np.stack([u - self.shift[0], v - self.shift[1]], axis=-1)
        xy = self._straight(p) @ np.linalg.inv(self.linear).T + self.middle_mm
        xy += self.jitter_mm[np.clip(v.astype(int), 0, self.shape[0] - 1)]
        return xy[..., 0], xy[..., 1]

    def window(self, at_mm: F, reach_mm: float) -> tuple[slice, slice, G, G]:
        u, v = self.to_px(at_mm)
        reach = reach_mm * self.scanner.dpi / 25.4 * 1.02
        rows = slice(max(int(v - reach), 0), max(min(int(v + reach) + 2, self.shape[0]), 0))
        cols = slice(max(int(u - reach), 0), max(min(int(u + reach) + 2, self.shape[1]), 0))
        vv, uu = np.mgrid[rows, cols].astype(np.float64)
        x, y = self.to_board(uu, vv)
        return rows, cols, (x - at_mm[0]).astype(np.float32), (y - at_mm[1]).astype(np.float32)


def _turned(x: G, y: G, c: float, s: float) -> tuple[G, G]:
    return x * c + y * s, y * c - x * s


def _shape(x: G, y: G, half_x: float, half_y: float, blur_mm: float, radius: float = 0.0) -> tuple[B, G]:
    """Pixels that a box may cover, and how far it covers each of them."""
    reach = 4.5 * blur_mm
    near = (np.abs(x) < half_x + reach) & (np.abs(y) < half_y + reach)
    return near, _edge(_box(x[near], y[near], half_x, half_y, radius), blur_mm)


def _over(image: G, near: B, cover: G, colour: npt.NDArray[Any]) -> None:
    below = image[near]
    image[near] = below + cover[..., None] * (colour.astype(np.float32) - below)


def scan(tape: Tape, built: Built, scanner: Scanner | None = None, *, seed: int = 0) -> Picture:
    """A scan as OpenCV has pictures: (h, w, 3), blue first."""
    return scan_with_places(tape, built, scanner, seed=seed)[0]


def scan_with_places(tape: Tape, built: Built, scanner: Scanner | None = None, *, seed: int = 0) -> tuple[Picture, _Bed]:
    scanner = scanner or Scanner()
    rng = np.random.default_rng(seed)
    bed = _Bed(tape, scanner, rng)
    image = _film(tape, bed, scanner, rng)
    nominal = tape.part_xy_mm()
    length, width, _ = tape.part.body_mm
    for i, at in enumerate(nominal):
        rows, cols, x, y = bed.window(at, 0.8)
        turn = radians(tape.part.rotation_deg)
        a, b = _turned(x, y, cos(turn), sin(turn))
        patch = image[rows, cols]
        blur = scanner.blur_mm
        _over(patch, *_shape(a, b, 0.60, 0.25, blur, 0.05), BASE)
        for end in (-1, 1):
            near, pad = _shape(a - end * 0.32, b, 0.23, 0.20, blur, 0.10)
            _over(patch, near, pad, GOLD)
            _over(patch, near, pad * rng.uniform(0.6, 0.9), SOLDER * rng.uniform(0.85, 1.1))
        shift = np.array([built.dx_mm[i], built.dy_mm[i]])
        spin = turn + radians(built.turn_deg[i])
        turned = cos(spin), sin(spin)
        if built.present[i] and np.isfinite(scanner.camera_mm):  # its sides
            for share in (0.0, 0.35, 0.7):
                side = shift + bed.seen_off_mm(at + shift, share * tape.part.body_mm[2])
                p, q = _turned(x - float(side[0]), y - float(side[1]), *turned)
                _over(patch, *_shape(p, q, length / 2, width / 2, blur), 0.8 * BODY)
            shift = shift + bed.seen_off_mm(at + shift, tape.part.body_mm[2])
        px, py = x - float(shift[0]), y - float(shift[1])
        p, q = _turned(px, py, *turned)
        if built.tombstoned[i]:
            _part_on_end(patch, p, q, width, blur)
        elif built.present[i]:
            _part(patch, a, b, p, q, (px, py), length * rng.normal(1, 0.01), width * rng.normal(1, 0.015), scanner, rng)
    for sx, sy, radius in built.specks:
        rows, cols, x, y = bed.window(np.array([sx, sy]), radius + 0.2)
        cover = _edge(np.hypot(x, 0.6 * y) - radius, scanner.blur_mm)
        _over(image[rows, cols], np.ones(x.shape, dtype=bool), cover.ravel(), np.array([60.0, 62.0, 58.0]))
    h, w = bed.shape
    light = 1 + scanner.shading * (np.linspace(-1, 1, w)[None, :] ** 2 * -0.5 + np.linspace(-0.5, 0.5, h)[:, None])
    seen = np.empty(image.shape, dtype=np.uint8)
    for start in range(0, h, 64):  # as many lines as the processor's caches hold
        rows = slice(start, start + 64)
        lines = image[rows] * light[rows, :, None].astype(np.float32)
        lines += rng.standard_normal(lines.shape, dtype=np.float32) * (scanner.noise * np.sqrt(0.4 + lines / 210))
        seen[rows] = np.clip(lines[..., ::-1] + 0.5, 0, 255)
    return seen, bed


def _part(
    patch: G,
    a: G,
    b: G,
    p: G,
    q: G,
    lamp: tuple[G, G],
    length: float,
    width: float,
    scanner: Scanner,
    rng: np.random.Generator,
) -> None:
    blur = scanner.blur_mm
    # the lamp stands above the picture's upper edge: a soft shadow falls toward board -y
    x, y = lamp[0], lamp[1] + 0.05
    near, shade = _shape(*_turned(x, y, 0.5**0.5, 0.5**0.5), length / 2, width / 2, 0.045)
    patch[near] *= 1 - scanner.shadow * shade[..., None]
    for end in (-1, 1):  # fillet: from the end of the part to the end of the pad
        near, cover = _shape(p - end * (length / 2 + 0.03), q, 0.09, width / 2 + rng.uniform(-0.01, 0.03), blur, 0.04)
        pad = _edge(_box(a[near] - end * 0.32, b[near], 0.23, 0.20, 0.10), blur)
        tone = (0.75 + 0.5 * np.clip(np.abs(p[near]) * 2 - 0.6, 0, 0.5))[..., None] * rng.uniform(0.8, 1.15)
        _over(patch, near, cover * pad, SOLDER * tone)
    _over(patch, *_shape(p, q, length / 2, width / 2, blur), BODY * rng.uniform(0.85, 1.2))
    for end in (-1, 1):
        band = rng.normal(0.14, scanner.band_mm)
        mid = end * (length / 2 - band / 2 + 0.005)
        _over(patch, *_shape(p - mid, q, band / 2, width / 2 + 0.006, blur, 0.02), TIN * rng.uniform(0.88, 1.08))
        if rng.random() < 0.7 * scanner.glare:
            gp, gq = end * rng.uniform(0.22, 0.42), rng.uniform(-0.1, 0.1)
            size_p, size_q = rng.uniform(0.02, 0.05), rng.uniform(0.02, 0.07)
            near = (np.abs(p - gp) < 4 * size_p) & (np.abs(q - gq) < 4 * size_q)
            bright = np.exp(-(((p[near] - gp) / size_p) ** 2) - ((q[near] - gq) / size_q) ** 2)
            patch[near] += (bright * rng.uniform(40, 160))[..., None]


def _part_on_end(patch: G, p: G, q: G, width: float, blur: float) -> None:
    near, shade = _shape(p - 0.25, q, 0.30, 0.16, 0.06)
    patch[near] *= 1 - 0.4 * shade[..., None]
    _over(patch, *_shape(p - 0.32, q, 0.115, width / 2, blur), TIN)


def _film(tape: Tape, bed: _Bed, scanner: Scanner, rng: np.random.Generator) -> G:
    h, w = bed.shape
    image = np.empty((h, w, 3), dtype=np.float32)
    width, height = tape.board.size_mm
    radius = tape.board.corner_radius_mm
    within, beyond = 8 * scanner.blur_mm, 4.5 * scanner.blur_mm  # of its edge the film is as if there were none
    image[:] = LID
    for start in range(0, h, 64):
        lines = image[start : start + 64]
        v, u = np.mgrid[start : start + len(lines), 0:w].astype(np.float64)
        x, y = (side.astype(np.float32) for side in bed.to_board(u, v))
        x, y = np.abs(x - width / 2), np.abs(y - height / 2)
        inside = (x < width / 2 - max(radius, within)) & (y < height / 2 - max(radius, within))
        lines[inside] = FILM
        edge = ~inside & (x < width / 2 + beyond) & (y < height / 2 + beyond)
        cover = _edge(_box(x[edge], y[edge], width / 2, height / 2, radius), scanner.blur_mm)
        lines[edge] += cover[:, None] * (FILM.astype(np.float32) - lines[edge])
    coarse = rng.normal(size=(h // 40 + 2, w // 40 + 2)).astype(np.float32)
    image *= 1 + 0.008 * cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC)[..., None]
    if tape.tag is not None:
        _tag(image, tape, bed, scanner)
    return image


def _tag(image: G, tape: Tape, bed: _Bed, scanner: Scanner) -> None:
    assert tape.tag is not None
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(cv2.aruco.generateImageMarker(dictionary, tape.tag.id, 8)[::-1, ::-1] > 127, 1, constant_values=True)
    cell = tape.tag.cell_mm
    rows, cols, x, y = bed.window(np.array(tape.tag.center_mm), 8 * cell)
    ink = np.zeros(x.shape, dtype=np.float32)
    half = cell / 2 + 0.01
    for r, c in zip(*np.nonzero(cells), strict=True):
        a, b = x - (c - 4.5) * cell, y + (r - 4.5) * cell
        near = np.maximum(np.abs(a), np.abs(b)) < half + 8 * scanner.blur_mm  # beyond, the cover is 0
        ink[near] = np.maximum(ink[near], _edge(_box(a[near], b[near], half, half), scanner.blur_mm))
    _over(image[rows, cols], np.ones(x.shape, dtype=bool), ink.ravel(), INK)
