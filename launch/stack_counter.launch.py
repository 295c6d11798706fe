"""Starts collector, reconstructor and counter as three processes that come back if they die.

    ros2 launch stack_counter stack_counter.launch.py part:=demo_nut rig:=/path/to/rig.yaml

An argument that is not given leaves what the settings file says.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

SHARE = get_package_share_directory("stack_counter")
ALL = ("collector", "reconstructor", "counter")
# Argument -> what it says, the nodes whose parameter it is, and its type.
ARGUMENTS = {
    "color_topic": ("colour images, without /compressed", ("collector",), str),
    "color_transport": ("how colour images come: raw or compressed", ("collector",), str),
    "depth_topic": ("depth aligned to colour", ("collector",), str),
    "camera_info_topic": ("calibration of all images", ("collector",), str),
    "labels_topic": ("mono8 label images aligned to colour", ("collector",), str),
    "world_frame": ("frame of the poses, z up", ("collector",), str),
    "mode": ("scan, continuous or cycle", ("collector",), str),
    "rig": ("file that names several cameras", ("collector",), str),
    "reliable": ("ask camera topics for reliable delivery: true or false", ("collector",), bool),
    "record_folder": ("folder that every scan is recorded to", ("collector",), str),
    "part": ("name of the part in the part file", ("collector", "counter"), str),
    "unit_volume_m3": ("volume of one part, m3", ("collector", "counter"), float),
    "live": ("volume and count after every view: true or false", ("reconstructor",), bool),
    "container": ("name of a taught container", ("reconstructor",), str),
    "confidence": ("probability that the interval holds the true count", ("counter",), float),
    "use_sim_time": ("time from /clock: true or false", ALL, bool),
    "autostart": ("configure and activate at start: true or false", ALL, bool),
}
READ = {str: str, float: float, bool: lambda text: text.lower() in ("true", "1", "yes")}


def make_nodes(context):
    """The three nodes, with the arguments that were given on top of the settings file."""
    def said(name):
        return LaunchConfiguration(name).perform(context)

    nodes = []
    for name in ALL:
        given = {key: READ[kind](said(key)) for key, (_, of, kind) in ARGUMENTS.items()
                 if name in of and said(key) != ""}
        nodes.append(Node(
            package="stack_counter", executable=name, output="screen",
            parameters=[said("params_file"), given], respawn=True, respawn_delay=2.0,
            arguments=["--ros-args", "--log-level", said("log_level")]))
    return nodes


def generate_launch_description():
    """Arguments and nodes."""
    declared = [
        DeclareLaunchArgument("params_file", description="settings of all nodes",
                              default_value=os.path.join(SHARE, "config", "stack_counter.yaml")),
        DeclareLaunchArgument("log_level", description="debug, info, warn or error",
                              default_value="info"),
        *(DeclareLaunchArgument(key, description=text, default_value="")
          for key, (text, _, _) in ARGUMENTS.items())]
    profile = os.path.join(SHARE, "config", "fastdds.xml")
    shared_memory = SetEnvironmentVariable(
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", profile))
    return LaunchDescription([*declared, shared_memory, OpaqueFunction(function=make_nodes)])
