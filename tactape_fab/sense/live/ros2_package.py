"""A ROS 2 package of the node for a user's own workspace: package.xml, launch file, parameters, entry point."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

from tactape_fab.base.errors import Problem, SpecError, TactapeError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.output_file import unfinished
from tactape_fab.base.templates import templates_folder
from tactape_fab.base.version import __version__
from tactape_fab.sense.live.ros2_node import PARAMETERS

DEPENDENCIES = (
    *("diagnostic_msgs", "geometry_msgs", "launch_ros", "rclpy", "rosidl_runtime_py", "sensor_msgs", "std_msgs", "tf2_ros"),
)
"""ROS packages that the node imports, and the launch file."""
MEANINGS = {
    "kits": "kits that can be touched",
    "sensor": "sensor profile, or the path of a TOML file",
    "world": "open: other textures may be touched, too; closed: none",
    "max_p_false": "largest chance of a wrong answer",
    "frame_id": "parent frame of the poses; empty: the name of the tape that is touched",
    "sensor_frame": "child frame of the transform; empty: the sensor's name",
    "publish_tf": "false where the transform tree has the sensor under the arm already: a frame has one parent",
    "max_age_s": "images that are older when they come are dropped and counted; 0: none is",
}


def write_package(folder: Path, parameters: Mapping[str, Any]) -> list[str]:
    """Write a package; its name is the folder's.

    folder: Must not be there.
    parameters: Values of the node's parameters that are not the defaults.
    Returns: Paths of its files, relative to the folder.
    Raises SpecError if the folder is there, or its name is none of a package.
    Raises TactapeError when it cannot be written.
    """
    name = refuse_package(folder)
    files = package_files(name, {**PARAMETERS, **parameters})
    partial = unfinished(folder)
    try:
        for path, text in files.items():
            place = partial / path
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text, encoding="utf-8", newline="\n")
        partial.rename(folder)
    except OSError as error:
        message = f"package = {shown_path(folder)} cannot be written: {reason_of(error)}; give a folder elsewhere"
        raise TactapeError(message) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return list(files)


def refuse_package(folder: Path) -> str:
    """The name of a package that may be written there. Raises SpecError."""
    name = folder.resolve().name
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
        remedy = "use small letters, digits and single underscores, such as src/tactape_node"
        raise SpecError(Problem("package", f"package = {shown_path(folder)}: {name} is no name of a ROS package; {remedy}"))
    if folder.exists():
        message = f"package = {shown_path(folder)} is there, and nothing is written over; give a new one"
        raise SpecError(Problem("package", message))
    return name


def package_files(name: str, parameters: Mapping[str, Any]) -> dict[str, str]:
    """Paths and contents of a package's files (ament_python, REP 149 format 3)."""
    depends = "\n".join(f"  <exec_depend>{package}</exec_depend>" for package in DEPENDENCIES)
    settings = "\n".join(f"    {key}: {json.dumps(value)}  # {MEANINGS[key]}" for key, value in parameters.items())
    values = {"name": name, "version": __version__, "depends": depends, "settings": settings}
    folder = templates_folder() / "ros2"

    def filled(file: str) -> str:
        return Template((folder / f"{file}.in").read_text(encoding="utf-8")).substitute(values)

    return {
        **{file: filled(file) for file in ("package.xml", "setup.py", "setup.cfg")},
        **dict.fromkeys((f"resource/{name}", f"{name}/__init__.py"), ""),
        f"{name}/node.py": filled("node.py"),
        "config/tactape.yaml": filled("tactape.yaml"),
        "launch/tactape.launch.py": filled("tactape.launch.py"),
    }
