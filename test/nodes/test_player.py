# SPDX-License-Identifier: Apache-2.0
"""How far the player runs ahead of the nodes."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from stack_counter_msgs.msg import ScanStatus

from stack_counter.ros import player
from stack_counter.ros.qos import LATCHED_ALL

TOPICS = [f"/camera{i}/image" for i in range(2)]


class TwoCycles:
    """A recording of two cycles of two cameras."""

    def records(self, topics, color_topics):
        data = serialize_message(Image())
        return [SimpleNamespace(topic=topic, log_time_ns=k * 10**9, data=data)
                for k in range(2) for topic in TOPICS]


def test_the_end_of_a_cycle_is_not_missed_in_whatever_order_word_of_it_comes(ros, monkeypatch):
    """The nodes are found one after the other: the reconstructor's word may come first."""
    monkeypatch.setattr(player, "SETTINGS", replace(
        player.SETTINGS, stall_timeout_s=20.0, arrival_timeout_s=0.1, settle_s=0.1))
    status = ros.node.create_publisher(ScanStatus, "/stack_counter/scan_status", LATCHED_ALL)
    for node, received in (("reconstructor", 0), ("collector", 2), ("reconstructor", 0)):
        status.publish(ScanStatus(node=node, scan_id="first", state=ScanStatus.STOPPED,
                                  received=received))
    context = rclpy.context.Context()
    rclpy.init(context=context, domain_id=int(ros.environment["ROS_DOMAIN_ID"]))
    node = player.Player(SimpleNamespace(check=lambda: None), set(TOPICS),
                         dict.fromkeys(TOPICS, "sensor_msgs/msg/Image"), 10**8, [""], context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    spinner.start()
    played = []
    try:
        node.play(TwoCycles(), 0, lambda: played.append(len(played)))
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
        spinner.join()
    assert len(played) == 4
