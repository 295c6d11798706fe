# SPDX-License-Identifier: Apache-2.0
"""Plays a recorded bag into the three nodes, in the bag's own time.

    ros2 launch stack_counter replay.launch.py bag:=/path/to/bag part:=demo_nut mode:=continuous

Where launch is not installed, `stack-counter replay BAG` does this and waits for the count.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    TimerAction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription

NODES = os.path.join(get_package_share_directory("stack_counter"), "launch",
                     "stack_counter.launch.py")


def generate_launch_description():
    """Starts the nodes, and some seconds later the bag."""
    declared = [
        DeclareLaunchArgument("bag", description="rosbag2 folder or .mcap file"),
        DeclareLaunchArgument("rate", description="speed of the bag's clock",
                              default_value="1.0"),
        DeclareLaunchArgument("delay", description="seconds that the nodes have to start",
                              default_value="10.0")]
    # Other arguments, as part:=..., reach the nodes' own file by name.
    nodes = IncludeLaunchDescription(PythonLaunchDescriptionSource(NODES),
                                     launch_arguments={"use_sim_time": "true"}.items())
    play = ExecuteProcess(cmd=["ros2", "bag", "play", LaunchConfiguration("bag"), "--clock",
                               "--rate", LaunchConfiguration("rate")], output="screen")
    return LaunchDescription([*declared, nodes, TimerAction(
        period=LaunchConfiguration("delay"), actions=[play])])
