# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: how they end."""

import os
import re
import subprocess
import sys

from stack_counter.ros.private_domain import PrivateDomain

# A signal ends the context while a callback works; what it then publishes fails.
ENDS_UNDER_A_CALLBACK = """
import rclpy
from std_msgs.msg import Header
from stack_counter.config import CounterConfig
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.qos import RELIABLE

class Late(ManagedNode):
    def __init__(self):
        super().__init__("late", CounterConfig)

    def setup(self, config):
        self.out = self.advertise(Header, "out", RELIABLE)
        self.add_timer(0.01, self.work)

    def work(self):
        print("worked", flush=True)
        if not {ends}:
            raise RuntimeError("a fault")
        rclpy.shutdown()
        self.out.publish(Header())

run(Late)
"""


def run_late(ends):
    with PrivateDomain() as domain:
        return subprocess.run([sys.executable, "-c", ENDS_UNDER_A_CALLBACK.format(ends=ends)],
                              capture_output=True, text=True,
                              env={**os.environ, **domain.environment})


def test_a_node_ends_cleanly_though_it_has_just_something_to_say():
    done = run_late(ends=True)
    assert done.stdout == "worked\n"
    assert done.returncode == 0
    assert re.fullmatch(r"\[INFO\] .*: ready \d+\.\d s after the start of its process\n",
                        done.stderr)


def test_a_fault_of_ours_is_not_taken_for_an_end():
    done = run_late(ends=False)
    assert done.returncode != 0 and "RuntimeError: a fault" in done.stderr


TELLS_ITS_REGIONS = """
import rclpy
from rclpy.parameter import Parameter
from stack_counter.config import ReconstructorConfig
from stack_counter.ros.lifecycle import ManagedNode

class Idle(ManagedNode):
    def setup(self, config):
        for region in config.regions:
            print(region.name, *region.center_m, *region.size_m)
        print(config.min_views, config.live)

rclpy.init()
node = Idle("reconstructor", ReconstructorConfig)
print([name for name in node.get_parameters_by_prefix("regions")])
node.trigger_configure()
wide = Parameter("regions.left.size_m", value=[0.5, 0.5, 0.5])
print(node.set_parameters([wide])[0].reason)
node.trigger_cleanup()
print(node.set_parameters([wide])[0].successful)
print(node.set_parameters([Parameter("regions.left.size_m", value=[0.5, 0.0, 0.5])])[0].reason)
node.trigger_configure()
"""


def test_regions_are_parameters_of_the_names_in_the_settings_file(tmp_path):
    settings = tmp_path / "p.yaml"
    settings.write_text("""
/stack_counter/reconstructor:
  ros__parameters:
    min_views: 5
    of_another_node: 1
    regions:
      left: {center_m: [0.1, 0.2, 0.3], size_m: [1.0, 1.0, 1.0]}
""")
    with PrivateDomain() as domain:
        done = subprocess.run([sys.executable, "-c", TELLS_ITS_REGIONS, "--ros-args",
                               "--params-file", str(settings), "-p", "live:=true",
                               "-p", "voxelsize:=0.1", "-p", "part:=of_the_counter"],
                              capture_output=True, text=True, timeout=60,
                              env={**os.environ, **domain.environment})
    assert done.stdout.splitlines() == [
        "['left.center_m', 'left.size_m']", "left 0.1 0.2 0.3 1.0 1.0 1.0", "5 True",
        "regions.left.size_m is read on configure; expected an unconfigured node: clean it up "
        "first", "True", "regions.left.size_m is [0.5, 0.0, 0.5]; expected three numbers above 0",
        "left 0.1 0.2 0.3 0.5 0.5 0.5", "5 True"], done.stderr
    unknown = [line for line in done.stderr.splitlines() if "unknown parameter" in line]
    assert len(unknown) == 1 and "'voxelsize'; expected 'voxel_size'" in unknown[0]
    said = [line for line in done.stderr.splitlines() if "changed from" in line]
    assert len(said) == 1, "the one change that was not refused"
    assert "parameter regions.left.size_m changed from" in said[0]
