# SPDX-License-Identifier: Apache-2.0
"""The counter over real DDS."""

import os
import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from kits.harness import LATCHED, PATIENCE_S
from kits.result_schema import read_result
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from stack_counter_msgs.msg import Container, HeightMap, StackCount, StackVolume
from std_msgs.msg import Header, String
from visualization_msgs.msg import MarkerArray

from stack_counter.display.result_schema import flat_line
from stack_counter.ros.qos import LATCHED_ALL
from stack_counter.types import Reason

SPACE = "/stack_counter"
# Who comes late, with the usual profile of latched topics: prints what it gets, until three
# seconds have brought nothing more.
LATE = """
import sys
import rclpy
from rclpy.qos import QoSProfile, DurabilityPolicy
from stack_counter_msgs.msg import StackCount
rclpy.init()
node = rclpy.create_node("late")
got = []
node.create_subscription(StackCount, f"/stack_counter/{sys.argv[1]}", got.append,
                         QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
seen = -1
while not got or seen < len(got):
    seen = len(got)
    rclpy.spin_once(node, timeout_sec=3.0)
for message in got:
    print(message.scan_id, message.count, message.region)
"""


@pytest.fixture(scope="module")
def ros(ros_of_module):
    return ros_of_module


@pytest.fixture(scope="module")
def counter(ros):
    ros.start("counter", estimator="prior", result_log=ros.folder / "results.jsonl",
              result_json="true")
    volumes = ros.node.create_publisher(StackVolume, f"{SPACE}/volume", LATCHED)
    results = ros.collect_messages(StackCount, f"{SPACE}/result", LATCHED)
    running = ros.collect_messages(StackCount, f"{SPACE}/running_count")
    ros.wait_for_subscribers(volumes)

    def count(final=True, **fields):
        counts = results if final else running
        before = len(counts)
        volumes.publish(StackVolume(final=final, **fields))
        ros.wait(lambda: len(counts) > before and counts[-1].scan_id == fields["scan_id"],
                 "a count")
        return counts[-1]

    return count


def latecomer(ros, topic):
    """[scan_id, count] or [scan_id, count, region] of each message that a latecomer gets."""
    late = subprocess.run([sys.executable, "-c", LATE, topic], capture_output=True, text=True,
                          timeout=PATIENCE_S, env={**os.environ, **ros.environment}, check=True)
    return [line.split() for line in late.stdout.splitlines()]


def test_count_is_gamma_v_over_v_and_a_latecomer_gets_the_last_result_alone(ros, counter):
    counter(scan_id="before", unit_volume=1e-6, stack_volume=2e-3)
    for litres in (0.6, 0.8):
        so_far = counter(False, scan_id="a", unit_volume=1e-6, stack_volume=litres * 1e-3)
        assert not so_far.final
    got = counter(scan_id="a", unit_volume=1e-6, stack_volume=1e-3, stack_volume_std=1e-5)
    assert got.final and got.count == round(got.gamma * 1000) > so_far.count
    assert got.count_low <= got.count <= got.count_high
    assert got.estimator == "prior (baseline)" and got.confidence == 0.9
    counter(False, scan_id="next", unit_volume=1e-6, stack_volume=1e-3)
    for topic in ("result", "count"):
        assert latecomer(ros, topic) == [["a", str(got.count)]], topic


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


def test_a_latecomer_gets_the_last_result_of_each_region(ros, counter):
    latest = {region: [scan, str(counter(scan_id=scan, region=region, unit_volume=1e-6,
                                         stack_volume=litres * 1e-3).count), region]
              for scan, litres in (("r1", 1), ("r2", 2)) for region in ("left", "right")}
    got = [words for words in latecomer(ros, "result") if words[2:]]
    assert sorted(got) == sorted(latest.values())


def test_every_final_result_is_a_line_of_the_log_and_flat_json(ros, counter):
    log = ros.folder / "results.jsonl"
    texts = ros.collect_messages(String, f"{SPACE}/result_json", LATCHED_ALL)

    def json_of(scan):
        """The last result of a scan; latched ones of other regions may follow it."""
        return next((m.data for m in reversed(texts) if f'"{scan}"' in m.data), "")
    count = counter(scan_id="k", unit_volume=1e-6, stack_volume=1e-3, stack_volume_std=1e-5,
                    container=Container(kind="none"))
    counter(scan_id="l", error="2 views used")
    ros.wait(lambda: '"l"' in log.read_text(), "a line of the last scan")
    good, failed = (read_result(line, "log_line") for line in log.read_text().splitlines()[-2:])
    assert (good["scan_id"], good["count"]) == ("k", count.count)
    assert good["count_interval"] == [count.count_low, count.count_high]
    assert (failed["scan_id"], failed["error"]) == ("l", "2 views used")
    ros.wait(lambda: json_of("l"), "the last scan as JSON")
    assert read_result(json_of("l"), "flat") == flat_line(failed)
    counter(final=False, scan_id="m", unit_volume=1e-6, stack_volume=1e-3)
    assert not json_of("m")


@pytest.mark.parametrize("fields, said", [
    ({"top": HeightMap(rows=4000000000, cols=4000000000, pitch=0.1)}, "over an inner surface of"),
    ({"stack_volume": float("nan")}, "stack_volume is nan"),
    ({"stack_volume": 1.0, "unit_volume": 1e-30}, "expected at most 1e+09")])
def test_a_volume_that_cannot_be_one_is_an_error_with_its_reason(counter, fields, said):
    count = counter(scan_id=f"no volume {said}", **{
        "unit_volume": 1e-6, "container": Container(kind="none"), **fields})
    assert count.status == StackCount.STATUS_ERROR and said in count.error
