# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: how they end."""

import os
import subprocess
import sys

from stack_counter.ros.processes import private_environment

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
    return subprocess.run([sys.executable, "-c", ENDS_UNDER_A_CALLBACK.format(ends=ends)],
                          capture_output=True, text=True, timeout=60,
                          env={**os.environ, **private_environment()})


def test_a_node_ends_cleanly_though_it_has_just_something_to_say():
    done = run_late(ends=True)
    assert done.stdout == "worked\n"
    assert (done.returncode, done.stderr) == (0, "")


def test_a_fault_of_ours_is_not_taken_for_an_end():
    done = run_late(ends=False)
    assert done.returncode != 0 and "RuntimeError: a fault" in done.stderr
