"""Pictures of Gerber and drill files by software that is not ours, each of exactly the window asked for."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from tests.readers.raster import PX_PER_MM, Window, iou

Picture = npt.NDArray[np.float32]
GrayImage = npt.NDArray[np.uint8]

_GERBER_TO_SVG = """
const file = require('fs').createReadStream(process.argv[1])
require('gerber-to-svg')(file, 'layer', (error, svg) => { if (error) throw error; process.stdout.write(svg) })
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reader:
    """A program that draws a file: coverage 0 to 1 of the window's pixels, and the IoU that is asked of it.

    A picture that is not antialiased has two values, and its truth is every pixel that is covered by half or more.
    """

    draw: Callable[[Path, Window], Picture]
    least_iou: float
    antialiased: bool = True

    def iou(self, picture: Picture, truth: Picture) -> float:
        return iou(picture, truth if self.antialiased else (truth >= 0.5).astype(np.float32))


def read_gray(path: Path) -> GrayImage:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, f"{path} is no picture"
    return np.asarray(image, dtype=np.uint8)


def gerbonara_svg(path: Path, window: Window) -> str:
    from gerbonara.excellon import ExcellonFile
    from gerbonara.rs274x import GerberFile

    file = ExcellonFile.open(path, plated=False) if path.suffix == ".drl" else GerberFile.open(path)
    bounds = ((window.left_mm, window.bottom_mm), (window.right_mm, window.top_mm))
    return str(file.to_svg(force_bounds=bounds, arg_unit="mm", fg="white", bg="black"))


def tracespace_svg(node: str, path: Path, window: Window) -> str:
    """The SVG of npm's gerber-to-svg with its view box moved to the window."""
    run = subprocess.run([node, "-e", _GERBER_TO_SVG, str(path)], capture_output=True, encoding="utf-8", check=True)
    flip = re.search(r'<g transform="translate\(0,(-?[\d.]+)\) scale\(1,-1\)"', run.stdout)
    assert flip is not None, "gerber-to-svg drew nothing"
    left, top = window.left_mm * 1000, float(flip[1]) - window.top_mm * 1000
    box = f'viewBox="{left:.3f} {top:.3f} {window.width_px * 1000 / PX_PER_MM:.3f} {window.height_px * 1000 / PX_PER_MM:.3f}"'
    svg = re.sub(r'width="[\d.]+mm" height="[\d.]+mm" viewBox="[^"]+"', box, run.stdout, count=1)
    return svg.replace("currentColor", "white")


def rasterised(rsvg_convert: str, svg: str, window: Window, folder: Path) -> Picture:
    source, target = folder / "layer.svg", folder / "layer.png"
    source.write_text(svg)
    size = ["-w", str(window.width_px), "-h", str(window.height_px)]
    subprocess.run([rsvg_convert, "--unlimited", *size, "-b", "black", "-o", str(target), str(source)], check=True)
    return _coverage(read_gray(target), window)


def gerbv_image(
    gerbv: str, path: Path, window: Window, folder: Path, *, ink: str = "#ffffff", film: str = "#000000"
) -> tuple[GrayImage, str]:
    """Gerbv's picture of the window and what it says of the file, but for attributes, which gerbv does not know.

    Gerbv draws what its files span: a second file under the first, in the colour of the film, spans the window.
    """
    frame, target = folder / "frame.gbr", folder / "gerbv.png"
    low, high = (
        [round(v * 1e6) for v in corner] for corner in ((window.left_mm, window.bottom_mm), (window.right_mm, window.top_mm))
    )
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]), (low[0], low[1])]
    lines = [f"X{x}Y{y}D0{2 if i == 0 else 1}*" for i, (x, y) in enumerate(corners)]
    head = ["%FSLAX46Y46*%", "%MOMM*%", "%ADD10C,0.1*%", "G01*", "G36*"]
    frame.write_text("\n".join([*head, *lines, "G37*", "M02*"]) + "\n")
    look = ["-x", "png", "-B", "0", "-D", str(round(PX_PER_MM * 25.4)), "-b", film, "-f", ink + "ff", "-f", film + "ff"]
    run = subprocess.run(
        [gerbv, *look, "-o", str(target), str(path), str(frame)], capture_output=True, encoding="utf-8", timeout=60, check=True
    )
    complaints = [line for line in run.stderr.splitlines() if line.strip() and not re.search("extension found %T[FAOD]%", line)]
    image = read_gray(target)[-window.height_px :, : window.width_px]  # it adds a pixel at the top and at the right
    assert image.shape == (window.height_px, window.width_px)
    return image, "\n".join(complaints)


def gerbv_picture(gerbv: str, path: Path, window: Window, folder: Path) -> Picture:
    image, complaints = gerbv_image(gerbv, path, window, folder)
    assert complaints == ""
    return _coverage(image, window)


def _coverage(image: GrayImage, window: Window) -> Picture:
    assert image.shape == (window.height_px, window.width_px)
    return np.divide(image, 255, dtype=np.float32)
