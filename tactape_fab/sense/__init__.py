"""The robot's half: sensors, simulated contacts, colour images, ROS 2 messages, and a tracker's results.

`Localizer`, `Tracker` and `read_object` are in `tactape_fab` itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactape_fab.base.lazy import lazy_names

if TYPE_CHECKING:
    from tactape_fab.sense.calibrate.calibration import calibrate_sensor as calibrate_sensor
    from tactape_fab.sense.calibrate.hand_eye import HandEye as HandEye
    from tactape_fab.sense.calibrate.result import Calibration as Calibration
    from tactape_fab.sense.decode.result import LocatedDots as LocatedDots
    from tactape_fab.sense.files.arm_poses import ArmPose as ArmPose
    from tactape_fab.sense.inspect.inspection import inspect_scans as inspect_scans
    from tactape_fab.sense.inspect.result import Deviation as Deviation
    from tactape_fab.sense.inspect.result import Inspection as Inspection
    from tactape_fab.sense.live.live_sensor import LiveSensor as LiveSensor
    from tactape_fab.sense.live.live_sensor import observation as observation
    from tactape_fab.sense.live.live_sensor import observation_names as observation_names
    from tactape_fab.sense.live.messages import image_message as image_message
    from tactape_fab.sense.live.messages import pose_message as pose_message
    from tactape_fab.sense.live.messages import text_message as text_message
    from tactape_fab.sense.live.messages import transform_message as transform_message
    from tactape_fab.sense.live.ros2_node import run_ros2_node as run_ros2_node
    from tactape_fab.sense.objects.mount import Mount as Mount
    from tactape_fab.sense.objects.mount import ObjectPose as ObjectPose
    from tactape_fab.sense.objects.mount import sensor_on_object as sensor_on_object
    from tactape_fab.sense.objects.tag_pose import TagPose as TagPose
    from tactape_fab.sense.raw.reconstruct import Network as Network
    from tactape_fab.sense.raw.reconstruct import Reconstruction as Reconstruction
    from tactape_fab.sense.raw.reconstruct import load_network as load_network
    from tactape_fab.sense.raw.reconstruct import make_reconstruction as make_reconstruction
    from tactape_fab.sense.sensors import SensorProfile as SensorProfile
    from tactape_fab.sense.sensors import load_sensor as load_sensor
    from tactape_fab.sense.simulation.draw import Frame as Frame
    from tactape_fab.sense.simulation.draw import Frames as Frames
    from tactape_fab.sense.simulation.draw import iterate_frames as iterate_frames
    from tactape_fab.sense.simulation.draw import simulate as simulate
    from tactape_fab.sense.simulation.draw import simulate_frames as simulate_frames
    from tactape_fab.sense.simulation.drawn_poses import draw_poses as draw_poses
    from tactape_fab.sense.simulation.elastic_contact import ElasticContact as ElasticContact
    from tactape_fab.sense.simulation.elastic_forces import simulate_forces as simulate_forces
    from tactape_fab.sense.simulation.parts import Parts as Parts
    from tactape_fab.sense.simulation.parts import parts_from_cpl as parts_from_cpl
    from tactape_fab.sense.simulation.scene import Scene as Scene
    from tactape_fab.sense.slam.measurement import PoseMeasurement as PoseMeasurement
    from tactape_fab.sense.slam.measurement import measure_pose as measure_pose
    from tactape_fab.sense.track.motion import Event as Event
    from tactape_fab.sense.track.motion import Slip as Slip

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "sense.calibrate.calibration": "calibrate_sensor",
        "sense.calibrate.hand_eye": "HandEye",
        "sense.calibrate.result": "Calibration",
        "sense.decode.result": "LocatedDots",
        "sense.files.arm_poses": "ArmPose",
        "sense.inspect.inspection": "inspect_scans",
        "sense.inspect.result": "Deviation Inspection",
        "sense.live.live_sensor": "LiveSensor observation observation_names",
        "sense.live.messages": "image_message pose_message text_message transform_message",
        "sense.live.ros2_node": "run_ros2_node",
        "sense.objects.mount": "Mount ObjectPose sensor_on_object",
        "sense.objects.tag_pose": "TagPose",
        "sense.raw.reconstruct": "Network Reconstruction load_network make_reconstruction",
        "sense.sensors": "SensorProfile load_sensor",
        "sense.simulation.draw": "Frame Frames iterate_frames simulate simulate_frames",
        "sense.simulation.drawn_poses": "draw_poses",
        "sense.simulation.elastic_contact": "ElasticContact",
        "sense.simulation.elastic_forces": "simulate_forces",
        "sense.simulation.parts": "Parts parts_from_cpl",
        "sense.simulation.scene": "Scene",
        "sense.slam.measurement": "PoseMeasurement measure_pose",
        "sense.track.motion": "Event Slip",
    },
)
