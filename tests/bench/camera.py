"""The camera's side: pictures of a kit's preview through a pinhole, pupil-apriltags, and how far off points are."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.base.errors import FrameError
from tactape_fab.kit.render.preview import MARGIN_MM, PX_PER_MM
from tactape_fab.sense.objects.tag_pose import refine_tag_pose
from tactape_fab.sense.objects.tag_view import (
    camera_to_texture,
    pixels_to_texture,
    tag_side_mm,
    tag_to_texture,
    texture_to_pixels,
)
from tactape_fab.texture.frames import FloatArray, board_to_picture, texture_to_board
from tests.bench.localization_accuracy import tag_detector

SIZE_PX = (1280, 960)
FOCAL_PX = 1200.0
AWAY_MM = 300.0
MOST_TILT_DEG = 40.0
BLUR_PX, NOISE_LEVELS, TABLE_LEVEL = 0.5, 2.0, 60
NEAR_MM = 15.0
FRAMES_TOGETHER = 10
CAMERA = np.array([[FOCAL_PX, 0.0, (SIZE_PX[0] - 1) / 2], [0.0, FOCAL_PX, (SIZE_PX[1] - 1) / 2], [0.0, 0.0, 1.0]])
_FINER = 4

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Printed:
    """A tape, and the picture of its written preview."""

    tape: Tape
    preview: Picture


@cache
def printed(cell_mm: float) -> Printed:
    """The default tape with a tag of this cell, as `make` writes it."""
    with tempfile.TemporaryDirectory() as folder:
        kit = make_kit(TapeSpec(sector=7, tag_cell_mm=cell_mm, models=False), Path(folder) / "kit", verify=False)
        preview = cv2.imread(str(kit.path / kit.files["preview-png"]), cv2.IMREAD_GRAYSCALE)
    assert preview is not None
    return Printed(tape=kit.tape, preview=np.asarray(preview, dtype=np.uint8))


def draw_pose(tape: Tape, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A camera `AWAY_MM` from the middle of the texture, tilted by up to `MOST_TILT_DEG`, turned anyhow: the tag's pose."""
    tilt, toward = np.radians(rng.uniform(0.0, MOST_TILT_DEG)), rng.uniform(0.0, 2 * np.pi)
    lean = np.asarray(cv2.Rodrigues(tilt * np.array([np.cos(toward), np.sin(toward), 0.0]))[0])
    rotation = lean @ np.asarray(cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))[0])
    middle = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm / 2
    of_tag = np.linalg.inv(tag_to_texture(tape)) @ np.array([*middle, 0.0, 1.0])
    return rotation, np.array([0.0, 0.0, AWAY_MM]) - rotation @ of_tag[:3]


def photograph(of: Printed, rotation: FloatArray, translation_mm: FloatArray, rng: np.random.Generator) -> Picture:
    """The preview as the camera sees it on a table: every pixel the mean of its area, blurred, with noise."""
    tape, s = of.tape, _FINER
    upper_left_mm = (-MARGIN_MM, tape.board.size_mm[1] + MARGIN_MM)
    ends = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    zero, right, down = board_to_picture(texture_to_board(ends, tape.board.texture_origin_mm), upper_left_mm, PX_PER_MM)
    to_preview = np.column_stack([[*(right - zero), 0.0], [*(down - zero), 0.0], [*zero, 1.0]])
    seen = np.linalg.inv(camera_to_texture(tape, rotation, translation_mm))
    to_px = CAMERA @ seen[:3][:, [0, 1, 3]]
    finer = np.array([[s, 0.0, (s - 1) / 2], [0.0, s, (s - 1) / 2], [0.0, 0.0, 1.0]])
    size = (SIZE_PX[0] * s, SIZE_PX[1] * s)
    margin = round(MARGIN_MM * PX_PER_MM)
    film = np.full(of.preview.shape, TABLE_LEVEL, dtype=np.uint8)
    film[margin:-margin, margin:-margin] = of.preview[margin:-margin, margin:-margin]
    large = cv2.warpPerspective(film, finer @ to_px @ np.linalg.inv(to_preview), size, borderValue=(TABLE_LEVEL,))
    small = cv2.resize(cv2.GaussianBlur(large, (0, 0), BLUR_PX * s), SIZE_PX, interpolation=cv2.INTER_AREA)
    noisy = small.astype(np.float64) + rng.normal(0.0, NOISE_LEVELS, small.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def detected(tape: Tape, picture: Picture) -> tuple[FloatArray, FloatArray] | None:
    """The tag's pose by pupil-apriltags, whose pixels are integer at corners; None where it is not found."""
    assert tape.tag is not None
    parameters = (FOCAL_PX, FOCAL_PX, CAMERA[0, 2] + 0.5, CAMERA[1, 2] + 0.5)
    found = tag_detector().detect(picture, estimate_tag_pose=True, camera_params=parameters, tag_size=tag_side_mm(tape))
    of = [one for one in found if one.tag_id == tape.tag.id and one.hamming == 0]
    return (np.asarray(of[0].pose_R), np.ravel(of[0].pose_t)) if of else None


def measure(cell_mm: float, views: int, seed: int = 47) -> dict[str, Any]:
    """Errors (mm) of texture points that the camera sees, by the detector's pose, the refined one, and ten of these."""
    of, rng = printed(cell_mm), np.random.default_rng([seed, round(1000 * cell_mm)])
    tape = of.tape
    high = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm
    points = np.stack(np.meshgrid(np.linspace(0.0, high[0], 12), np.linspace(0.0, high[1], 7)), axis=-1).reshape(-1, 2)
    near = np.hypot(*(points - tag_to_texture(tape)[:2, 3]).T) <= NEAR_MM + tag_side_mm(tape) / 2
    answers: dict[str, list[FloatArray]] = {"detector": [], "refined": []}
    refused = 0
    for _ in range(views):
        pose = draw_pose(tape, rng)
        picture = photograph(of, *pose, rng)
        found = detected(tape, picture)
        if found is None:
            continue
        pixels = texture_to_pixels(tape, points, *pose, CAMERA)
        answers["detector"].append(pixels_to_texture(tape, pixels, *found, CAMERA) - points)
        try:
            refined = refine_tag_pose(tape, picture, *found, CAMERA)
        except FrameError:
            refused += 1
            continue
        answers["refined"].append(pixels_to_texture(tape, pixels, refined.rotation, refined.translation_mm, CAMERA) - points)
    out: dict[str, Any] = {"cell_mm": cell_mm, "side_mm": tag_side_mm(tape), "views": views, "found": len(answers["detector"])}
    out["refused"] = refused
    whole = len(answers["refined"]) // FRAMES_TOGETHER * FRAMES_TOGETHER
    # of ten frames of a small tag one or two are mirrored, millimetres off, and would take a mean with them
    together = np.median(np.reshape(answers["refined"][:whole], (-1, FRAMES_TOGETHER, len(points), 2)), axis=1)
    for name, errors in (*answers.items(), ("ten refined", list(together))):
        if not len(errors):
            continue
        off = np.hypot(*np.moveaxis(np.asarray(errors), -1, 0))
        for where, which in (("near", near), ("whole", np.ones(len(points), dtype=bool))):
            quantiles = np.nanpercentile(off[:, which], [50, 95, 100]).tolist()
            out[f"{name}, {where}"] = dict(zip(("p50_mm", "p95_mm", "max_mm"), quantiles, strict=True))
    return out
