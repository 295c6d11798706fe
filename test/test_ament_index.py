# SPDX-License-Identifier: Apache-2.0
"""`ros2 run` and `ros2 launch` find the package, in an environment of wheels as after colcon."""

import os
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

NODES = ("collector", "reconstructor", "counter")


@pytest.mark.parametrize("package", ["stack_counter", "stack_counter_msgs"])
def test_a_package_is_where_the_index_says(package):
    share = Path(get_package_share_directory(package))
    assert f"<name>{package}</name>" in (share / "package.xml").read_text()


def test_launch_files_and_settings_are_shared():
    share = Path(get_package_share_directory("stack_counter"))
    assert (share / "launch" / "stack_counter.launch.py").is_file()
    assert (share / "config" / "stack_counter.yaml").is_file()


@pytest.mark.parametrize("node", NODES)
def test_a_node_is_run_as_ros2_run_does(node):
    """Which takes any executable file of that name below lib/PACKAGE of the package's prefix."""
    folder = Path(get_package_prefix("stack_counter")) / "lib" / "stack_counter"
    path, = (path for path in folder.rglob(node) if os.access(path, os.X_OK))
    done = subprocess.run([path, "--ros-args", "--params-file", "/no/such/file.yaml"],
                          capture_output=True, text=True)
    assert done.returncode != 0 and "/no/such/file.yaml" in done.stderr
