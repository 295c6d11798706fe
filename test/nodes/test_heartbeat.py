# SPDX-License-Identifier: Apache-2.0
"""A node that is dead or stands still is noticed by its heartbeat's liveliness, over real DDS."""

import signal
import time

from kits.harness import Harness
from rclpy.event_handler import SubscriptionEventCallbacks
from std_msgs.msg import Empty

from stack_counter.ros.qos import HEARTBEAT

NOTICED_S = 4.0


def test_a_node_that_dies_or_stands_still_is_noticed_in_four_seconds(tmp_path):
    ros = Harness(tmp_path)
    try:
        alive, beats = [], []
        ros.node.create_subscription(
            Empty, "/stack_counter/counter/heartbeat", beats.append, HEARTBEAT,
            event_callbacks=SubscriptionEventCallbacks(
                liveliness=lambda event: alive.append(event.alive_count)))
        node = ros.start("counter", estimator="prior")
        ros.wait(lambda: alive and alive[-1] == 1 and beats, "a heart that beats")
        for number in (signal.SIGSTOP, signal.SIGKILL):
            if number is signal.SIGKILL:
                node.send_signal(signal.SIGCONT)
                ros.wait(lambda: alive[-1] == 1, "a node that goes on")
                ros.processes.remove(node)
            begin = time.monotonic()
            node.send_signal(number)
            ros.wait(lambda: alive[-1] == 0, "word of the end")
            assert time.monotonic() - begin < NOTICED_S, number
        node.wait()
    finally:
        ros.close()
