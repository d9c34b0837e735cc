"""ros2: runs the ROS 2 node, or writes a package for it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import SENSOR_HELP
from tactape_fab.cli.printing import echo_lines


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--tape", "kits", multiple=True, metavar="KIT...", help="Kits that can be touched, or a folder of kits.")
@click.option("--sensor", metavar="NAME|FILE.toml", help=SENSOR_HELP)
@click.option("--package", metavar="DIR", help="Write a ROS package of the node for your workspace instead, named as the folder.")
@click.argument("arguments", nargs=-1, metavar="[--ros-args ...]")
def ros2(kits: Sequence[str], sensor: str | None, package: str | None, arguments: Sequence[str]) -> None:
    """Run the ROS 2 node, which subscribes to depth images and publishes poses, answers, transforms and diagnostics.

    Its Python must be that of ROS 2: source /opt/ros/DISTRO/setup.bash first. What follows --ros-args is for ROS.

    \b
    Example: tactape-fab ros2 --tape tactape-s007 --ros-args -r depth:=/gelsight/depth
             tactape-fab ros2 --tape tactape-s007 --package src/tactape_node
    """
    with answers():
        at = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
        more, for_ros = arguments[:at], arguments[at:]
        from tactape_fab.base.templates import is_profile_file

        unknown = [text for text in more if text.startswith("-")]
        if unknown:
            message = f"{shown(unknown[0])} is no option of ros2; give parameters of the node as --ros-args -p NAME:=VALUE"
            raise SpecError(Problem("ros-args", message))
        if more and not kits:
            raise SpecError(Problem("tape", f"{shown(more[0])} stands without an option; give kits as --tape KIT"))
        if for_ros and package is not None:
            message = "--ros-args is for a node that runs; leave it out, and write parameters into config/tactape.yaml"
            raise SpecError(Problem("ros-args", message))
        kits = [*kits, *more]  # a shell expands a pattern to --tape A B
        given: dict[str, Any] = {} if sensor is None else {"sensor": sensor}
        if package is not None and sensor is not None and is_profile_file(sensor):  # the node runs in another folder
            given["sensor"] = str(Path(sensor).resolve())
        if kits:
            given["kits"] = [str(Path(kit).resolve()) if package is not None else kit for kit in kits]
        if package is not None:
            from tactape_fab.sense.live.ros2_package import refuse_package, write_package
            from tactape_fab.sense.sensors import load_sensor
            from tactape_fab.texture.registry import read_tapes

            problems: list[Problem] = []
            tried(lambda: refuse_package(Path(package)), problems)
            tried(lambda: read_tapes(kits), problems)
            tried(lambda: None if sensor is None else load_sensor(sensor), problems)
            refuse(problems)
            echo_lines(str(Path(package) / path) for path in write_package(Path(package), given))
            return
        from tactape_fab.sense.live.ros2_node import run_ros2_node

        run_ros2_node(["tactape-fab", *for_ros], **given)
