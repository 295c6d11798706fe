# SPDX-License-Identifier: Apache-2.0
"""Starts collector, reconstructor and counter as three processes that come back if they die.

    ros2 launch stack_counter stack_counter.launch.py part:=demo_nut rig:=/path/to/rig.yaml

An argument that is not given leaves the setting of the file.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

SHARE = get_package_share_directory("stack_counter")
NODES = ("collector", "reconstructor", "counter")
# Argument -> its description, the nodes whose parameter it is, and its type.
ARGUMENTS = {
    "color_topic": ("colour images, without /compressed", ("collector",), str),
    "color_transport": ("how colour images come: auto, raw or compressed", ("collector",), str),
    "depth_topic": ("depth aligned to colour", ("collector",), str),
    "camera_info_topic": ("calibration of all images", ("collector",), str),
    "labels_topic": ("mono8 label images aligned to colour", ("collector",), str),
    "world_frame": ("frame of the poses, z up", ("collector",), str),
    "mode": ("scan, continuous or cycle", ("collector",), str),
    "rig": ("file that names several cameras", ("collector",), str),
    "reliable": ("ask camera topics for reliable delivery: true or false", ("collector",), bool),
    "record_folder": ("folder that every scan is recorded to", ("collector",), str),
    "part_catalogue": ("file of the known parts", ("collector", "counter"), str),
    "part": ("name of the part in the part file", ("collector", "counter"), str),
    "unit_volume_m3": ("volume of one part, m3", ("collector", "counter"), float),
    "part_size_m": ("outer dimensions of one part, m, e.g. 0.03x0.02x0.01",
                    ("collector", "counter"), list),
    "live": ("volume and count after every view: true or false", ("reconstructor",), bool),
    "segmenter": ("who labels the views: auto, geometric, labels, prompted, sam2",
                  ("reconstructor",), str),
    "prompts": ("file of what is marked in the first view", ("reconstructor",), str),
    "report_folder": ("folder that write_report writes to", ("reconstructor",), str),
    "container": ("name of a taught container", ("reconstructor",), str),
    "confidence": ("probability that the interval holds the true count", ("counter",), float),
    "expected_count": ("parts that every count is judged by", ("counter",), int),
    "tolerance": ("largest deviation from it that passes, parts", ("counter",), int),
    "result_log": ("file that every final result is added to: .csv or .jsonl", ("counter",), str),
    "use_sim_time": ("time from /clock: true or false", NODES, bool),
    "autostart": ("configure and activate at start: true or false", NODES, bool),
}
PARSERS = {str: str, int: int, float: float,
           bool: lambda text: text.lower() in ("true", "1", "yes"),
           list: lambda text: [float(number) for number in text.split("x")]}


def make_nodes(context):
    """Returns the three nodes, with the arguments that were given on top of the settings file."""
    def argument(name):
        return LaunchConfiguration(name).perform(context)

    nodes = []
    for name in NODES:
        given = {key: PARSERS[kind](argument(key))
                 for key, (_, node_names, kind) in ARGUMENTS.items()
                 if name in node_names and argument(key) != ""}
        nodes.append(Node(
            package="stack_counter", executable=name, output="screen",
            parameters=[argument("params_file"), given], respawn=True, respawn_delay=2.0,
            arguments=["--ros-args", "--log-level", argument("log_level")]))
    return nodes


def generate_launch_description():
    """Declares the arguments and starts the nodes."""
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
