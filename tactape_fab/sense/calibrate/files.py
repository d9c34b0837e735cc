"""Files of a calibration: the sensor profile with its mask, poses of an arm, and the hand-eye answer."""

from __future__ import annotations

import csv
import io
import json
import secrets
from collections.abc import Mapping
from math import isfinite
from pathlib import Path

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.libraries import library
from tactape_fab.sense.calibrate.hand_eye import ArmPose
from tactape_fab.sense.calibrate.result import Calibration
from tactape_fab.sense.sensors import SensorProfile, load_sensor
from tactape_fab.texture.frames import BoolArray

MARK = "# Calibrated by tactape-fab"
"""First words of a profile that `write_profile` wrote: only such a file is replaced."""
POSE_COLUMNS = ("frame", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
MOST_POSES = 10_000
_MOST_BYTES = 4 * 1024 * 1024
_FARTHEST_MM = 1e5
_UNIT_TOLERANCE = 0.02


def checked_output(output: str | Path) -> Path:
    """The path of a profile that may be written there.

    Raises
    ------
    SpecError
        If it is no .toml, its folder is missing, or a file is there that is no calibrated profile.
    """
    path = Path(output)
    if path.suffix != ".toml":
        raise SpecError(Problem("output", f"output = {shown_path(path)} is no .toml file; name it my-sensor.toml"))
    try:
        if not path.parent.is_dir():
            raise SpecError(Problem("output", f"output = {shown_path(path)} is in a folder that does not exist; make it first"))
        ours = not path.exists() or path.read_bytes()[: len(MARK)] == MARK.encode()
    except (OSError, ValueError) as error:
        raise SpecError(Problem("output", f"output = {shown_path(path)} cannot be used: {error}; give another file")) from error
    if not ours:
        message = f"output = {shown_path(path)} is there and is no calibrated profile; use another name"
        raise SpecError(Problem("output", message))
    return path


def write_profile(path: Path, found: Calibration) -> list[Path]:
    """Write the sensor profile, its mask where there is one, and the hand-eye answer where there is one; the files written.

    Each gets its name when it is complete; the profile last, and only if `load_sensor` reads it.

    Raises
    ------
    TactapeError
    """
    files: dict[Path, bytes] = {}
    if found.valid is not None:
        files[path.with_name(f"{path.stem}-mask.png")] = _png(found.valid)
    if found.hand_eye is not None:
        files[path.with_name(f"{path.stem}-hand-eye.json")] = (json.dumps(found.hand_eye.to_mapping(), indent=1) + "\n").encode()
    files[path] = profile_text(found, f"{path.stem}-mask.png").encode()
    for at, data in files.items():
        partial = at.with_name(f".{secrets.token_hex(4)}.{at.name}")
        try:
            partial.write_bytes(data)
            if at == path:
                load_sensor(partial)
            partial.replace(at)
        except OSError as error:
            raise TactapeError(f"{shown_path(at)} cannot be written: {error.strerror or error}") from error
        finally:
            partial.unlink(missing_ok=True)
    return list(files)


def _png(valid: BoolArray) -> bytes:
    cv2 = library("cv2", "writing a mask")

    done, data = cv2.imencode(".png", np.where(valid, 255, 0).astype(np.uint8))
    assert done
    return bytes(data)


def profile_text(found: Calibration, mask: str) -> str:
    """A sensor profile as TOML, as `load_sensor` reads it; what has no key there stands in comments.

    Parameters
    ----------
    found : Calibration
    mask : str
        Name of the mask's file.
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
    table: dict[str, object] = {"displacement_um": gel.displacement_um, "correlation_mm": gel.correlation_mm}
    for key in ("thickness_mm", "modulus_kpa", "blur_mm"):
        value = getattr(gel, key)
        if value is not None:
            table[key] = value
    return table


def _rounded(values: tuple[float, float]) -> list[float]:
    return [float(f"{value:.7g}") for value in values]


def _toml(value: object) -> str:
    """A value of TOML: JSON's strings, booleans and lists are TOML's as well."""
    if isinstance(value, float):
        return repr(float(f"{value:.6g}"))
    return json.dumps(value, ensure_ascii=True)


def read_arm_poses(path: str | Path, frames: int) -> list[ArmPose]:
    """Poses of a robot's flange in its base.

    Parameters
    ----------
    path : str or Path
        CSV with the columns ``frame,x_mm,y_mm,z_mm,qw,qx,qy,qz`` in any order: index of the frame from 0, place, unit quaternion.
    frames : int
        How many frames there are.

    Raises
    ------
    SpecError
        With every row that cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise SpecError(Problem("hand_eye", f"hand_eye = {shown_path(path)} cannot be opened: {reason}; give a CSV")) from error
    if len(data) > _MOST_BYTES:
        raise SpecError(
            Problem("hand_eye", f"hand_eye = {shown_path(path)} is larger than {_MOST_BYTES} bytes; give a row a press")
        )
    rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig", errors="replace")))
    names = [name.strip() for name in rows.fieldnames or []]
    if sorted(names) != sorted(POSE_COLUMNS):
        has, asked = shown(",".join(names)), ",".join(POSE_COLUMNS)
        message = f"hand_eye = {shown_path(path)} has the columns {has}; its first line must be {asked}"
        raise SpecError(Problem("hand_eye", message))
    rows.fieldnames = names
    problems: list[Problem] = []
    found: dict[int, ArmPose] = {}
    try:
        for number, row in enumerate(rows):
            if number >= MOST_POSES:
                problems.append(Problem("hand_eye", f"hand_eye has more than {MOST_POSES} rows; give those of the presses"))
                break
            pose = _pose(row, number + 2, frames, problems)
            if pose is not None and pose.frame in found:
                problems.append(
                    Problem("hand_eye", f"hand_eye line {number + 2}: frame {pose.frame} is there twice; leave one out")
                )
            elif pose is not None:
                found[pose.frame] = pose
    except csv.Error as error:
        problems.append(Problem("hand_eye", f"hand_eye = {shown_path(path)} is no CSV: {error}"))
    if problems:
        raise SpecError(problems[:20])
    return list(found.values())


def _pose(row: Mapping[str | None, object], line: int, frames: int, problems: list[Problem]) -> ArmPose | None:
    """A row's pose; None, and the problem is kept, where it has none."""
    from scipy.spatial.transform import Rotation

    try:
        values = [float(str(row[name])) for name in POSE_COLUMNS]
    except (KeyError, ValueError):
        values = [float("nan")]
    if None in row or len(values) < len(POSE_COLUMNS) or not all(isfinite(v) for v in values):
        said = ",".join(str(v) for v in row.values())
        problems.append(Problem("hand_eye", f"hand_eye line {line}: {shown(said)} is not eight numbers; correct it"))
        return None
    frame, place, turn = values[0], np.array(values[1:4]), np.array(values[4:])
    length = float(np.linalg.norm(turn))
    if frame != int(frame) or not 0 <= frame < frames:
        message = f"hand_eye line {line}: frame = {frame:g} is not a whole number from 0 to {frames - 1}; count the frames from 0"
        problems.append(Problem("hand_eye", message))
    elif np.abs(place).max() > _FARTHEST_MM:
        problems.append(
            Problem("hand_eye", f"hand_eye line {line}: {place.tolist()} mm is farther than {_FARTHEST_MM:g} mm; give mm")
        )
    elif abs(length - 1.0) > _UNIT_TOLERANCE:
        message = f"hand_eye line {line}: the quaternion's length is {length:.3g}, not 1; give qw,qx,qy,qz of a rotation"
        problems.append(Problem("hand_eye", message))
    else:
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat([*turn[1:], turn[0]]).as_matrix()
        matrix[:3, 3] = place
        return ArmPose(frame=int(frame), flange_to_base=matrix)
    return None
