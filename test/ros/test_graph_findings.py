# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a live graph, told from what its nodes say; no node is started."""

import pytest

pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from stack_counter.ros.graph_findings import COLLECTOR, NOT_RUNNING, node_findings, qos_findings
from stack_counter.views.checkup.findings import Severity

TOPIC = "/camera/color/image_raw"
RELIABLE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_a_best_effort_camera_is_not_heard_by_a_reliable_collector():
    found, = qos_findings({topic: ([("/camera", BEST_EFFORT)], [(COLLECTOR, RELIABLE)])
                           for topic in (TOPIC, "/depth")})
    assert found.severity == Severity.STOPS and found.remedy.startswith("set reliable: false")
    assert f"nothing on {TOPIC}, /depth: /camera publishes best effort" in found.text


def test_another_node_that_hears_nothing_harms():
    found, = qos_findings({"/tf_static": ([("/robot", RELIABLE)], [("/rviz", LATCHED)])})
    assert found.severity == Severity.HARMS and "volatile" in found.text


def test_those_who_hear_each_other_are_no_finding():
    assert qos_findings({TOPIC: ([("/camera", RELIABLE)],
                                 [(COLLECTOR, RELIABLE), ("/rviz", BEST_EFFORT)])}) == []


def test_nodes_that_are_not_active_stop_a_count():
    found, = node_findings({"collector": "inactive", "counter": "active"})
    assert found.severity == Severity.STOPS
    assert "ros2 lifecycle set /stack_counter/collector activate" in found.remedy


def test_nodes_that_are_yet_to_be_started():
    found, = node_findings(dict.fromkeys(("collector", "counter"), NOT_RUNNING))
    assert found.severity == Severity.HARMS and "stack-counter run" in found.remedy
