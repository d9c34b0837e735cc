"""Errors of the decoder against the bound that the pixels set: `python -m tests.bench.pixel_bound [--count N] [ROW...]`.

The bound is that of Cramer and Rao for x, y and theta in Gaussian noise of known spectrum: the derivatives of the simulator's
frame without noise, by finite differences, are weighed in Fourier space by one over the spectrum of white slope noise,
S(k) = (slope / R)^2 / (4 sin^2(k_u / 2) + 4 sin^2(k_v / 2)). What is below `HIGH_PASS` cycles/mm, the background's, is left out.
Nothing of the decoder is in it. Blur, imprint, height and the camera are known to the bound, and not to the decoder: a camera
whose shear is unknown makes theta 1.5 to 1.8 times less exact.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import Frame, Scene, SensorProfile, iterate_frames, load_sensor, simulate
from tactape_fab.sense.geometry import Gel, Geometry
from tactape_fab.texture.frames import FloatArray
from tests.bench.localization_measure import error_of, is_right
from tests.bench.localization_rows import SEED, registered_tape

SLOPE = 0.032
"""Of a GelSight Mini off contact, root mean square a pixel at 15.77 px/mm."""
HIGH_PASS = 0.3
BOUND_POSES = 12
STEP_MM, STEP_DEG = 0.01, 0.05
ROUNDS = 3
UNITS = np.array([1000.0, 1000.0, np.degrees(1.0)])


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelRow:
    """A scene, its slope noise, the blur that the decoder is told, and whether it may take the profile's camera as exact."""

    name: str
    scene: dict[str, Any] = field(default_factory=dict)
    slope: float = SLOPE
    told_mm: float | None = None
    camera_known: bool = False


ROWS = (
    PixelRow(name="default"),
    PixelRow(name="default, blur told", told_mm=0.15),
    PixelRow(name="7x7 mm", scene={"contact_mm": (7.0, 7.0)}),
    PixelRow(name="noise x2", slope=2 * SLOPE),
    PixelRow(name="default, camera known", camera_known=True),
    PixelRow(name="7x7 mm, camera known", scene={"contact_mm": (7.0, 7.0)}, camera_known=True),
    PixelRow(name="noise x2, camera known", slope=2 * SLOPE, camera_known=True),
    PixelRow(name="blur 0.08, unknown", scene={"elastomer_mm": 0.08}),
    PixelRow(name="blur 0.2, unknown", scene={"elastomer_mm": 0.2}),
    PixelRow(name="blur 0.25, unknown", scene={"elastomer_mm": 0.25}),
    PixelRow(name="told blur 2x too large", told_mm=0.3),
    PixelRow(name="told blur 2x too small", told_mm=0.075),
    PixelRow(name="placement 0.05 mm", scene={"placement_mm": 0.05}),
    PixelRow(name="5 spurious bumps", scene={"bumps": 5}),
)


def slope_spectrum(shape: tuple[int, int], slope: float, px_per_mm: float) -> FloatArray:
    """Power spectrum of depth integrated from white slope noise, for `rfft2` of a shape; mm^2, infinite at k = 0."""
    v, u = 2 * np.pi * np.fft.fftfreq(shape[0])[:, None], 2 * np.pi * np.fft.rfftfreq(shape[1])[None]
    with np.errstate(divide="ignore"):
        spectrum: FloatArray = (slope / px_per_mm) ** 2 / (4 * np.sin(u / 2) ** 2 + 4 * np.sin(v / 2) ** 2)
    return spectrum


def slope_noise_mm(rng: np.random.Generator, shape: tuple[int, ...], slope: float, px_per_mm: float) -> FloatArray:
    """Depth noise of this spectrum; from twice the size, so that opposite edges do not match."""
    if slope == 0.0:
        return np.zeros(shape)
    size = (2 * shape[0], 2 * shape[1])
    spectrum = slope_spectrum(size, slope, px_per_mm)
    spectrum[0, 0] = 0.0
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(size)) * np.sqrt(spectrum), s=size)
    return np.asarray(noise[: shape[0], : shape[1]])


def bound_of(pose: FloatArray, row: PixelRow) -> FloatArray:
    """Least covariance of (x mm, y mm, theta rad) of any unbiased estimate of a pose from its frame; shape (3, 3)."""
    scene = Scene(noise=0.0, **{**row.scene, "bumps": 0, "placement_mm": 0.0})
    steps = np.diag([STEP_MM, STEP_MM, STEP_DEG])

    def frame(at: FloatArray) -> FloatArray:
        return simulate(registered_tape(), (float(at[0]), float(at[1])), float(at[2]), scene=scene).astype(np.float64)

    slopes = np.stack([frame(pose + step) - frame(pose - step) for step in steps])
    slopes /= 2 * np.array([STEP_MM, STEP_MM, np.radians(STEP_DEG)])[:, None, None]
    size, px_per_mm = (512, 640), 16.0  # zeros around the frame
    spectrum = slope_spectrum(size, row.slope, px_per_mm)
    frequency = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None]) * px_per_mm
    twice = np.where((np.arange(spectrum.shape[1]) % (size[1] // 2)) == 0, 1.0, 2.0)
    weight = np.where(frequency > HIGH_PASS, twice / spectrum, 0.0) / (size[0] * size[1])
    waves = np.fft.rfft2(slopes, s=size)
    information = np.einsum("ihw,jhw,hw->ij", waves, waves.conj(), weight).real
    return np.asarray(np.linalg.inv(information))


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Errors (um, deg) of one way to refine, mean of the normalised squared error over 3, time, and how often it fell back."""

    position_um: float
    theta_deg: float
    nees: float
    median_ms: float
    located: int
    wrong: int
    fell_back: int


def measure(localizer: Localizer, frames: list[Frame]) -> Result:
    """Locate frames; the processor's time for each is the least of some rounds."""
    errors, nees, elapsed, wrong, back = [], [], [], 0, 0
    for frame in frames:
        times = []
        for _ in range(ROUNDS):
            start = process_time()
            fix = localizer.locate(frame.depth)
            times.append(process_time() - start)
        elapsed.append(min(times))
        if not is_right(fix, frame):
            wrong += fix.located
            continue
        assert fix.covariance is not None
        error = error_of(fix, frame)
        errors.append(error)
        nees.append(float(error @ np.linalg.solve(fix.covariance, error)) / 3)
        back += fix.refine_reason is not None
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) * UNITS
    return Result(
        position_um=float(np.sqrt((rms[:2] ** 2).mean())),
        theta_deg=float(rms[2]),
        nees=float(np.mean(nees)),
        median_ms=float(np.median(elapsed)) * 1000,
        located=len(errors) + wrong,
        wrong=wrong,
        fell_back=back,
    )


def noisy_frames(row: PixelRow, count: int, sensor: SensorProfile) -> list[Frame]:
    """The row's frames, with slope noise and no other."""
    rng = np.random.default_rng(SEED)
    clean = iterate_frames(registered_tape(), count, SEED, sensor, Scene(noise=0.0, **row.scene))
    return [replace(f, depth=(f.depth + slope_noise_mm(rng, f.depth.shape, row.slope, 16.0)).astype(np.float32)) for f in clean]


def line_of(row: PixelRow, count: int) -> str:
    """A row of the table."""
    sensor = replace(load_sensor("gelsight-mini"), slope_noise=row.slope, gel=Gel(blur_mm=row.told_mm))
    if row.camera_known:
        sensor = replace(sensor, geometry=Geometry(sigma_px_per_mm=0.0, sigma_aspect=0.0, sigma_shear=0.0, sigma_k1=0.0))
    frames = noisy_frames(row, count, sensor)
    poses = [np.array([*frame.position_mm, frame.theta_deg]) for frame in frames[:BOUND_POSES]]
    bound = np.sqrt(np.mean([np.diag(bound_of(pose, row)) for pose in poses], axis=0)) * UNITS
    least_um, least_deg = float(np.sqrt((bound[:2] ** 2).mean())), float(bound[2])
    said = [f"{row.name:<24} {least_um:5.2f} {least_deg:7.4f}"]
    for how in ("dots", "pixels"):
        found = measure(Localizer(registered_tape(), sensor, refine=how), frames)
        ratios = found.position_um / least_um, found.theta_deg / least_deg
        said.append(
            f"{found.position_um:5.2f} {found.theta_deg:7.4f} {ratios[0]:5.2f} {ratios[1]:5.2f} {found.nees:5.2f}"
            f" {found.median_ms:5.2f} {found.located:5d} {found.wrong:3d} {found.fell_back:4d}"
        )
    return " | ".join(said)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.pixel_bound", description=__doc__)
    parser.add_argument("--count", type=int, default=200, metavar="N")
    parser.add_argument("rows", nargs="*", metavar="ROW", help="names of rows; all of them unless said")
    chosen = parser.parse_args()
    columns = "   um     deg   /um  /deg  nees    ms  loc. wrg back"
    print(f"{'':<24} {'bound':>13} | {'dots':<52} | pixels\n{'row':<24} {'um':>5} {'deg':>7} | {columns} | {columns}")
    for row in ROWS:
        if not chosen.rows or row.name in chosen.rows:
            print(line_of(row, chosen.count), flush=True)


if __name__ == "__main__":
    main()
