# SPDX-License-Identifier: Apache-2.0
"""What clients of the live viewer get over their WebSocket."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("foxglove")

from kits.foxglove_client import FoxgloveClient
from kits.harness import LATCHED, Harness
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from stack_counter_msgs.msg import StackCount
from std_msgs.msg import String

from stack_counter.config import CollectorConfig
from stack_counter.errors import ConfigError
from stack_counter.ros.qos import profile_that_hears
from stack_counter.ros.viewer import Viewer, camera_topics

COUNT, VOLATILE = "/stack_counter/result", QoSProfile(depth=10)
PATIENCE_S = 60.0


@pytest.fixture
def ros(tmp_path):
    harness = Harness(tmp_path)
    yield harness
    harness.close()


@pytest.fixture
def viewer(ros):
    made = Viewer(["/tf"], "127.0.0.1", 0, ros.context)
    ros.spin_too(made.node)
    yield made
    made.close()


def test_clients_get_what_was_sent_early_and_late_ones(ros, viewer):
    sent = StackCount(scan_id="bin 7", count=179, count_low=163, count_high=195, final=True)
    counts = ros.node.create_publisher(StackCount, COUNT, LATCHED)
    counts.publish(sent)
    with FoxgloveClient(viewer.port, COUNT) as early:
        topic, data = early.receive(PATIENCE_S)
        assert topic == COUNT and deserialize_message(data, StackCount) == sent
        with FoxgloveClient(viewer.port, COUNT) as late:
            assert deserialize_message(late.receive(PATIENCE_S)[1], StackCount) == sent
        # What the server says of the type is enough to read it by.
        said = early.channels[COUNT]
        assert (said["encoding"], said["schemaEncoding"]) == ("cdr", "ros2msg")
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(said["schema"], said["schemaName"]))
        assert store.deserialize_cdr(data, said["schemaName"]).count == 179
        counts.publish(StackCount(scan_id="bin 8", final=True))
        scans = []
        while "bin 8" not in scans:  # bin 7 came once more, for the late one
            scans.append(deserialize_message(early.receive(PATIENCE_S)[1], StackCount).scan_id)
        assert scans[:-1] in ([], ["bin 7"])


def test_a_topic_is_subscribed_to_while_somebody_looks(ros, viewer):
    text = ros.node.create_publisher(String, "/stack_counter/text", VOLATILE)
    other = ros.node.create_publisher(String, "/other", VOLATILE)
    ros.wait(lambda: viewer.is_offered("/stack_counter/text"), "the topic")
    assert text.get_subscription_count() == 0 and not viewer.is_offered("/other")
    with FoxgloveClient(viewer.port, "/stack_counter/text") as client:
        with pytest.raises(TimeoutError):
            client.receive(0.2)  # reads what is offered, and subscribes
        ros.wait_for_subscribers(text)
        text.publish(String(data="hello"))
        assert deserialize_message(client.receive(PATIENCE_S)[1], String).data == "hello"
        assert "/other" not in client.channels
    ros.wait(lambda: text.get_subscription_count() == 0, "the end of the subscription")
    assert other.get_subscription_count() == 0


def test_publishers_that_change_are_heard_again(ros, viewer):
    """A camera's driver that starts anew may be best effort now."""
    first = ros.node.create_publisher(String, "/stack_counter/text", LATCHED)
    first.publish(String(data="latched"))
    with FoxgloveClient(viewer.port, "/stack_counter/text") as client:
        assert deserialize_message(client.receive(PATIENCE_S)[1], String).data == "latched"
        ros.node.destroy_publisher(first)
        second = ros.node.create_publisher(String, "/stack_counter/text", QoSProfile(
            depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        ros.wait_for_subscribers(second)
        second.publish(String(data="again"))
        assert deserialize_message(client.receive(PATIENCE_S)[1], String).data == "again"


def test_a_port_that_is_taken_is_named(viewer):
    with pytest.raises(ConfigError, match=f"cannot listen on 127.0.0.1:{viewer.port} .*in use"):
        Viewer([], "127.0.0.1", viewer.port)


@pytest.mark.parametrize("latched, reliable", [(True, True), (False, True), (False, False)])
def test_one_publisher_that_offers_less_decides(latched, reliable):
    less = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL if latched
                      else DurabilityPolicy.VOLATILE,
                      reliability=ReliabilityPolicy.RELIABLE if reliable
                      else ReliabilityPolicy.BEST_EFFORT)
    heard = profile_that_hears([LATCHED, less])
    assert (heard.durability, heard.reliability) == (less.durability, less.reliability)


def test_all_cameras_of_a_rig_are_shown(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras:\n" + "".join(
        f"  {name}:\n    color_topic: /{name}/color\n    camera_info_topic: /{name}/info\n"
        for name in ("left", "right")))
    topics = camera_topics(CollectorConfig(rig=str(rig)))
    assert {"/left/color", "/left/color/compressed", "/right/info", "/tf", "/tf_static"} <= topics
    assert "" not in topics and "/camera/aligned_depth_to_color/camera_info" in camera_topics(
        CollectorConfig())
