# SPDX-License-Identifier: Apache-2.0
"""The action `count_stack` on three real nodes: feedback, verdict, cancel, rejection."""

import threading
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from kits.harness import PATIENCE_S
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from stack_counter_msgs.action import CountStack
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import GetCount, StartCount
from std_srvs.srv import Trigger

from stack_counter.bag.bag_views import subscribed_topics
from stack_counter.bag.camera_topics import fit_camera_to_bag
from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig
from stack_counter.ros.standard_messages import message_type
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

BAG = Path(__file__).parents[2] / "bags" / "demo"


@pytest.fixture
def cell(ros):
    """Three nodes, the demo bag ready to be played, and an action client."""
    reader = BagReader(BAG)
    config = fit_camera_to_bag(CollectorConfig(), reader.topics)
    ros.start("collector", color_transport="compressed", tf_timeout_s=20.0)
    ros.start("reconstructor")
    ros.start("counter", estimator="depth_corrected")
    qos = QoSProfile(depth=1000)
    publishers = {t: ros.node.create_publisher(message_type(reader.topics[t][0]), t, qos)
                  for t in subscribed_topics(RigAssembler(load_rig(config))) if t in reader.topics}
    client = ActionClient(ros.node, CountStack, "/stack_counter/count_stack")
    assert client.wait_for_server(PATIENCE_S)
    ros.wait_until_collector_receives(*publishers.values())

    def play(pause_s=0.1):
        for record in reader.records(set(publishers)):
            if record.topic.endswith("compressed"):
                threading.Event().wait(pause_s)
            publishers[record.topic].publish(record.data)

    return client, play


def goal(**fields):
    return CountStack.Goal(**{"part": "demo_nut", "timeout": 40.0, **fields})


def test_scan_with_verdict_then_rejection_and_cancel(ros, cell):
    client, play = cell
    feedback, states = [], ros.collect_messages(ScanStatus, "/stack_counter/scan_status")
    sent = ros.call_in_executor(lambda: client.send_goal_async(
        goal(max_views=12, expected_count=5000, tolerance=10),
        feedback_callback=lambda m: feedback.append(m.feedback)))
    ros.wait(sent.done, "the goal's acceptance")
    assert sent.result().accepted
    second = ros.call_in_executor(lambda: client.send_goal_async(goal()))
    ros.wait(second.done, "an answer")
    assert not second.result().accepted, "one goal at a time"
    result = ros.call_in_executor(sent.result().get_result_async)
    ros.wait(lambda: any(s.state == ScanStatus.SCANNING and s.scan_id for s in states), "a scan")
    play()
    ros.wait(result.done, "the result")
    answer = result.result().result
    assert answer.success, answer.message
    assert answer.count.verdict == StackCount.VERDICT_FAIL  # 5000 is not in the bin
    assert answer.count.views.used == 12
    assert feedback and feedback[-1].views.used >= 11
    assert all(repr(one) != repr(next_one) for one, next_one in zip(feedback, feedback[1:]))

    cancelled = ros.call_in_executor(lambda: client.send_goal_async(goal()))
    ros.wait(cancelled.done, "the goal's acceptance")
    stop = ros.call_in_executor(cancelled.result().cancel_goal_async)
    ros.wait(stop.done, "the cancellation")
    end = ros.call_in_executor(cancelled.result().get_result_async)
    ros.wait(end.done, "the cancelled goal's end")
    assert end.result().status == GoalStatus.STATUS_CANCELED

    short = ros.call_in_executor(lambda: client.send_goal_async(goal(timeout=1.0, min_views=3)))
    ros.wait(short.done, "the goal's acceptance")
    assert short.result().accepted, "ready again after a cancel"
    end = ros.call_in_executor(short.result().get_result_async)
    ros.wait(end.done, "the timeout")
    assert not end.result().result.success and "0 views" in end.result().result.message
    assert end.result().status == GoalStatus.STATUS_ABORTED
    said = [line for line in ros.log("counter").splitlines() if "[ERROR]" in line]
    assert len(said) == 2 and all("0 views" in line for line in said), "a cancel is no error"


def test_the_same_by_services_and_what_a_goal_is_refused_for(ros, cell):
    client, play = cell

    def ask(**fields):
        return ros.call(StartCount, "/stack_counter/start_count", StartCount.Request(
            **{"part": "demo_nut", "timeout": 40.0, **fields}))

    def state():
        return ros.call(GetCount, "/stack_counter/get_count", GetCount.Request())

    for fields, why in (({"part": "no_such_part"}, "unknown part 'no_such_part'"),
                        ({"timeout": -1.0}, "timeout -1.0 s"),
                        ({"confidence": float("nan")}, "confidence nan"),
                        ({"min_views": 9, "max_views": 3}, "9 to 3 views"),
                        ({"unit_volume": -1.0}, "unit volume is -1.0")):
        refused = ask(**fields)
        assert not refused.accepted and why in refused.message
    assert not state().success
    states = ros.collect_messages(ScanStatus, "/stack_counter/scan_status")
    assert ask(max_views=12, expected_count=200, tolerance=300).accepted
    assert "another count" in ask().message
    assert state().running
    ros.wait(lambda: any(s.state == ScanStatus.SCANNING and s.scan_id for s in states), "a scan")
    play()
    ros.wait(lambda: not state().running, "its end")
    end = state()
    assert end.success and end.message.startswith("PASS") and "within 200 +- 300" in end.message
    assert end.count.verdict == StackCount.VERDICT_PASS and end.count.views.used == 12
    assert ask().accepted
    cancelled = ros.call(Trigger, "/stack_counter/cancel_count", Trigger.Request())
    assert cancelled.success
    ros.wait(lambda: not state().running, "the end of what was cancelled")
    assert state().message == "cancelled"
    assert not ros.call(Trigger, "/stack_counter/cancel_count", Trigger.Request()).success
