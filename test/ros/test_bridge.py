# SPDX-License-Identifier: Apache-2.0
"""The bridge's node: what it hands on, over real DDS."""

import json

import pytest

pytest.importorskip("rclpy")

import rclpy
from kits.flat_results import flat
from kits.harness import LATCHED, Harness
from std_msgs.msg import String

from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.ros.bridge import Bridge
from stack_counter.ros.qos import LATCHED_ALL

TOPIC = f"{NAMESPACE}/result_json"


class KeptResults:
    """Stands in for the sinks: keeps what it is given."""

    def __init__(self):
        self.results, self.available = [], []

    def put(self, result):
        self.results.append(result)

    def set_available(self, available):
        self.available.append(available)

    def check(self):
        pass


@pytest.fixture
def ros(tmp_path):
    harness = Harness(tmp_path)
    yield harness
    harness.close()


def test_each_result_is_handed_on_once_and_who_is_there_is_said(ros):
    kept = KeptResults()
    bridge = Bridge(kept, ros.context)
    ros.spin_too(bridge.node)
    ros.wait(lambda: kept.available == [False], "word that no counter is there")
    counter = rclpy.create_node("counter", namespace=NAMESPACE, context=ros.context)
    ros.spin_too(counter)
    publisher = counter.create_publisher(String, TOPIC, LATCHED)
    publisher.publish(String(data=json.dumps(flat(600))))
    ros.wait(lambda: kept.results == [flat(600)], "what was latched")
    ros.wait(lambda: kept.available == [False, True], "word of the counter")
    # What is no result, and one that is counted again, are left out.
    lost = ros.node.create_publisher(String, TOPIC, LATCHED_ALL)
    ros.wait_for_subscribers(lost)
    ros.wait_for_subscribers(lost)
    again, failed = {**flat(600), "seconds.gamma": 0.1}, flat(None, scan_id="scan 8")
    for text in ("no JSON", "[1]", "[" * 99999, json.dumps(flat(region="left/#")),
                 json.dumps({**flat(), "stamp": "today"}), json.dumps(again), json.dumps(failed)):
        lost.publish(String(data=text))
    ros.wait(lambda: len(kept.results) == 2, "the result of a lost scan")
    assert kept.results[1] == failed
    counter.destroy_node()  # the supervisor's publisher does not stand in for it
    ros.wait(lambda: kept.available == [False, True, False], "word that it has gone")
    bridge.node.destroy_node()
