# SPDX-License-Identifier: Apache-2.0
"""The counter over real DDS."""

import os
import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from kits.harness import LATCHED, PATIENCE_S
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from stack_counter_msgs.msg import Container, StackCount, StackVolume
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from stack_counter.types import Reason

SPACE = "/stack_counter"
LATE = """
import rclpy
from rclpy.qos import QoSProfile, DurabilityPolicy
from stack_counter_msgs.msg import StackCount
rclpy.init()
node = rclpy.create_node("late")
got = []
node.create_subscription(StackCount, "/stack_counter/count", got.append,
                         QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
while not got:
    rclpy.spin_once(node, timeout_sec=1.0)
print(got[0].scan_id, got[0].count)
"""


@pytest.fixture(scope="module")
def ros(ros_of_module):
    return ros_of_module


@pytest.fixture(scope="module")
def counter(ros):
    ros.start("counter", estimator="prior")
    volumes = ros.node.create_publisher(StackVolume, f"{SPACE}/volume", LATCHED)
    counts = ros.collect_messages(StackCount, f"{SPACE}/count", LATCHED)
    ros.wait_for_subscribers(volumes)

    def count(**fields):
        volumes.publish(StackVolume(final=True, **fields))
        ros.wait(lambda: counts and counts[-1].scan_id == fields["scan_id"], "a count")
        return counts[-1]

    return count


def test_count_is_gamma_v_over_v_and_reaches_who_comes_late(ros, counter):
    got = counter(scan_id="a", unit_volume=1e-6, stack_volume=1e-3, stack_volume_std=1e-5)
    assert got.count == round(got.gamma * 1000) > 0
    assert got.count_low <= got.count <= got.count_high
    assert got.estimator == "prior (baseline)" and got.confidence == 0.9
    late = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True,
                          timeout=PATIENCE_S, env={**os.environ, **ros.environment}, check=True)
    assert late.stdout.split() == ["a", str(got.count)]


def test_refusals_are_said_and_the_next_scan_counts(counter):
    unknown = counter(scan_id="b", part="no_such_part", stack_volume=1e-3)
    assert unknown.status == StackCount.STATUS_ERROR
    assert "no_such_part" in unknown.error and "expected one of" in unknown.error
    assert "unit volume" in counter(scan_id="c", stack_volume=1e-3).error
    few = counter(scan_id="d", error="2 views used", part="demo_nut")
    assert few.error == "2 views used"
    assert (few.part, few.unit_volume) == ("demo_nut", pytest.approx(6.00488e-6))
    assert counter(scan_id="e", unit_volume=1e-6, stack_volume=0.0).count == 0


def test_the_count_stands_above_the_rim_as_text_and_an_error_does_too(ros, counter):
    shown = ros.collect_messages(MarkerArray, f"{SPACE}/count_marker", LATCHED)
    box = Container(kind="box")
    box.pose.position.x, box.pose.position.z = 0.5, 0.2
    box.outer_size.x, box.outer_size.y, box.outer_size.z = 0.3, 0.2, 0.1
    box.inner_size.x, box.inner_size.y, box.inner_size.z = 0.3, 0.2, 0.1
    count = counter(scan_id="f", unit_volume=1e-6, stack_volume=1e-3, stack_volume_std=1e-5,
                    container=box, header=Header(frame_id="cell"))
    text = f"{count.count} parts ({count.count_low} to {count.count_high}, 90%)"
    ros.wait(lambda: shown and shown[-1].markers[0].text.startswith(text), text)
    marker = shown[-1].markers[0]
    at = marker.pose.position
    assert marker.header.frame_id == "cell" and at.x == 0.5 and 0.3 < at.z < 0.45
    counter(scan_id="g", error="2 views used", header=Header(frame_id="cell"))
    ros.wait(lambda: shown[-1].markers[0].text == "2 views used", "the error")
    assert shown[-1].markers[0].pose.position.x == 0.5  # where one looks


def test_reasons_are_sentences_for_people_and_slugs_for_machines(ros, counter):
    diagnostics = ros.collect_messages(DiagnosticArray, "/diagnostics")
    shown = ros.collect_messages(MarkerArray, f"{SPACE}/count_marker", LATCHED)
    count = counter(scan_id="h", unit_volume=1e-6, stack_volume=1e-3, reasons=["no_depth"])
    assert count.status == StackCount.STATUS_DEGRADED and "no_depth" in count.reasons
    sentence = f"no_depth: {Reason.NO_DEPTH.sentence}"

    def last_status():
        status = [s for m in diagnostics for s in m.status if s.name == "stack_counter: counter"]
        return status[-1] if status else None

    ros.wait(lambda: last_status() and sentence in last_status().message, "the sentence")
    values = {value.key: value.value for value in last_status().values}
    assert "no_depth" in values["reasons"].split(", ")
    assert (f"scan 'h': {count.count} parts, 90% sure between {count.count_low} and "
            f"{count.count_high}; degraded. ") in ros.log("counter")
    assert sentence in ros.log("counter")
    ros.wait(lambda: shown and Reason.NO_DEPTH.sentence in
             shown[-1].markers[0].text.replace("\n", " "), "the sentence beside the stack")


def test_a_count_names_the_nodes_own_part_where_the_scan_names_none(ros, counter):
    own = Parameter("part", value="demo_nut").to_parameter_msg()
    assert ros.call(SetParameters, f"{SPACE}/counter/set_parameters",
                    SetParameters.Request(parameters=[own])).results[0].successful
    assert "parameter part changed from '' to 'demo_nut'\n" in ros.log("counter")
    failed = counter(scan_id="i", error="0 views used")
    assert failed.status == StackCount.STATUS_ERROR
    assert (failed.part, failed.unit_volume) == ("demo_nut", pytest.approx(6.00488e-6))
    assert counter(scan_id="j", stack_volume=1e-3).part == "demo_nut"
