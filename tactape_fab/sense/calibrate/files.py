"""Files of a calibration: the sensor profile with its mask, and the hand-eye answer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from math import isfinite
from pathlib import Path

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import begins_with, mode_of
from tactape_fab.base.libraries import library
from tactape_fab.base.output_file import not_written, refuse_taken_place, sync_file, sync_folder, unfinished
from tactape_fab.base.plain_text import toml_string
from tactape_fab.base.templates import is_profile_file
from tactape_fab.sense.calibrate.result import Calibration
from tactape_fab.sense.sensors import SensorProfile, load_sensor
from tactape_fab.texture.frames import BoolArray

MARK = "# Calibrated by tactape-fab"
"""First words of a profile that `write_profile` wrote: only such a file is replaced."""


def checked_output(output: str | Path) -> Path:
    """The path of a profile that may be written there.

    Raises SpecError if it is no .toml, its folder is missing, or a file is there that is no calibrated profile.
    """
    path = Path(output)
    if not is_profile_file(path):
        raise SpecError(Problem("output", f"output = {shown_path(path)} is no .toml file; name it my-sensor.toml"))
    refuse_taken_place(path, "output", ours=partial(begins_with, mark=MARK), kind="no calibrated profile")
    if mode_of(path) is None:  # what stands beside a calibrated profile belongs to it
        for beside in _beside(path):
            refuse_taken_place(beside, "output")
    return path


def _beside(path: Path) -> tuple[Path, Path]:
    """The mask and the hand-eye answer of a profile."""
    return path.with_name(f"{path.stem}-mask.png"), path.with_name(f"{path.stem}-hand-eye.json")


def write_profile(path: Path, found: Calibration) -> list[Path]:
    """Write the sensor profile, its mask where there is one, and the hand-eye answer where there is one; the files written.

    They get their names when all are complete and `load_sensor` reads the profile, which gets its own last: an older profile
    keeps its mask where there is no room for a new one.

    Raises TactapeError.
    """
    files: dict[Path, bytes] = {}
    mask, hand_eye = _beside(path)
    if found.valid is not None:
        files[mask] = _png(found.valid)
    if found.hand_eye is not None:
        files[hand_eye] = (json.dumps(found.hand_eye.to_mapping(), indent=1) + "\n").encode()
    files[path] = profile_text(found, mask.name).encode()
    partials = {at: unfinished(at).with_suffix(at.suffix) for at in files}  # by its suffix `load_sensor` knows a file
    at = path
    try:
        for at, data in files.items():
            partials[at].write_bytes(data)
        if mask in partials:
            partials[path].write_bytes(profile_text(found, partials[mask].name).encode())
        load_sensor(partials[path])
        partials[path].write_bytes(files[path])
        for partial in partials.values():
            sync_file(partial)
        for at, partial in partials.items():
            partial.replace(at)
        sync_folder(path.parent)
    except OSError as error:
        raise not_written(at, "output", error) from error
    finally:
        for partial in partials.values():
            with suppress(OSError):
                partial.unlink()
    return list(files)


def _png(valid: BoolArray) -> bytes:
    cv2 = library("cv2", "writing a mask")

    done, data = cv2.imencode(".png", np.where(valid, 255, 0).astype(np.uint8))
    assert done
    return bytes(data)


def profile_text(found: Calibration, mask: str) -> str:
    """A sensor profile as TOML, as `load_sensor` reads it; values without a key there are comments.

    mask: Name of the mask's file.
    """
    sensor = found.sensor
    image: dict[str, object] = {
        "width_px": sensor.width_px,
        "height_px": sensor.height_px,
        "px_per_mm": _rounded(sensor.px_per_mm),
        "scale_tolerance": sensor.scale_tolerance,
    }
    if found.valid is not None:
        image["mask"] = mask
    tables: dict[str, Mapping[str, object]] = {
        "image": image,
        "orientation": {"sign": sensor.sign, "mirror": sensor.mirror, "rotate90": sensor.rotate90},
    }
    if sensor.depth_unit_mm is not None:
        tables["depth"] = {"unit_mm": sensor.depth_unit_mm}
    tables |= {"noise": _noise(sensor), "geometry": _geometry(sensor), "gel": _gel(sensor)}
    lines = [f"{MARK} from {len(found.presses)} presses of {found.frames} frames, {_dots(found)} dots; docs/calibrate.md", "#"]
    lines += [
        f"# {q.name} = {q.value:.6g}{_plus_minus(q.sigma)} {q.unit}{f'  ({q.note})' if q.note else ''}" for q in found.quantities
    ]
    if found.held_out is not None:
        out = found.held_out
        lines.append(
            f"# dots scatter by {out.inside_um:.2f} um in the adjustment, {out.outside_um:.2f} um in presses left out of it"
        )
    lines += [f"# {remark}" for remark in found.remarks]
    lines += ["", f"name = {_toml(sensor.name)}", f"title = {_toml(sensor.title)}"]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items())]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _dots(found: Calibration) -> int:
    return sum(len(press.weights) for press in found.presses)


def _plus_minus(sigma: float | None) -> str:
    return f" +- {sigma:.2g}" if sigma is not None and isfinite(sigma) else ""


def _noise(sensor: SensorProfile) -> dict[str, object]:
    smooth: dict[str, object] = {
        "white_um": sensor.white_um,
        "correlated_um": sensor.correlated_um,
        "correlated_px": sensor.correlated_px,
    }
    return smooth if sensor.slope_noise is None else {"slope": sensor.slope_noise, **smooth}


def _geometry(sensor: SensorProfile) -> dict[str, object]:
    geometry = sensor.geometry
    table: dict[str, object] = {"aspect": geometry.aspect, "shear": geometry.shear, "k1": geometry.k1}
    if geometry.center_px is not None:
        table["center_px"] = _rounded(geometry.center_px)
    if geometry.sigma_px_per_mm is not None:
        table["sigma_px_per_mm"] = geometry.sigma_px_per_mm
    return {
        **table,
        "sigma_aspect": geometry.sigma_aspect,
        "sigma_shear": geometry.sigma_shear,
        "sigma_k1": min(geometry.sigma_k1, 0.2),
    }


def _gel(sensor: SensorProfile) -> dict[str, object]:
    gel = sensor.gel
    keys = ("displacement_um", "correlation_mm", "thickness_mm", "modulus_kpa", "blur_mm", "poisson")
    table: dict[str, object] = {key: value for key in keys if (value := getattr(gel, key)) is not None}
    if gel.crown_mm is not None:
        table["crown_mm"] = _rounded(gel.crown_mm)
    return table


def _rounded(values: tuple[float, float]) -> list[float]:
    return [float(f"{value:.7g}") for value in values]


def _toml(value: object) -> str:
    """A value of TOML: JSON's strings, booleans and lists are TOML's as well."""
    if isinstance(value, float):
        return repr(float(f"{value:.6g}"))
    return toml_string(value) if isinstance(value, str) else json.dumps(value)
