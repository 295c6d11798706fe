# SPDX-License-Identifier: Apache-2.0
"""Which topics the collector subscribes to, by what is published; on a stand-in for its node."""

from types import SimpleNamespace

import pytest
from sensor_msgs.msg import CompressedImage, Image

from stack_counter.config import CollectorConfig
from stack_counter.nodes.camera_topics import CameraTopics
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler


class Node:
    """Subscribes to what it is told, and counts the publishers that a test names."""

    def __init__(self):
        self.publishers, self.topics = {}, {}

    def subscribe(self, kind, topic, callback, qos):
        self.topics[topic] = kind
        return SimpleNamespace(topic_name=topic,
                               get_publisher_count=lambda: self.publishers.get(topic, 0))

    def destroy_subscription(self, subscription):
        del self.topics[subscription.topic_name]

    def count_publishers(self, topic):
        return self.publishers.get(topic, 0)

    def get_topic_names_and_types(self):
        kinds = {"camera_info": "CameraInfo", "compressed": "CompressedImage"}
        return [(topic, [f"sensor_msgs/msg/{kinds.get(topic.rpartition('/')[2], 'Image')}"])
                for topic in {*self.topics, *self.publishers}]

    def resolve_topic_name(self, topic):
        return topic

    def get_logger(self):
        return SimpleNamespace(info=lambda line: None)


@pytest.fixture
def node():
    return Node()


def topics_of(node, **settings):
    assembler = RigAssembler(load_rig(CollectorConfig(**{"depth_topic": "", **settings})))
    return CameraTopics(node, assembler, True, lambda: True, lambda: None)


def colors(node):
    return {topic: kind for topic, kind in node.topics.items()
            if kind in (Image, CompressedImage)}


def test_auto_follows_what_is_published(node):
    topics = topics_of(node, color_topic="/c")
    raw, compressed = {"/c": Image}, {"/c/compressed": CompressedImage}
    assert colors(node) == raw  # nobody publishes yet
    for publishers, expected in (({}, raw), ({"/c/compressed": 1}, compressed),
                                 ({}, compressed),  # a driver that starts anew
                                 ({"/c": 1, "/c/compressed": 1}, raw), ({"/c": 1}, raw)):
        node.publishers = publishers
        topics.follow_publishers()
        assert colors(node) == expected, publishers
    assert "/c" not in topics.unmatched and topics.problems() == []
    assert [key for key in topics.status_values() if key.endswith("Hz")] == ["/c Hz", "tf Hz"]


def test_a_transport_that_is_set_stays_and_the_other_is_named(node):
    topics = topics_of(node, color_topic="/c", color_transport="raw")
    node.publishers = {"/c/compressed": 1}
    topics.follow_publishers()
    assert colors(node) == {"/c": Image} and "/c" in topics.unmatched
    assert topics.problems() == [
        "/c/compressed has 1 publisher: set color_transport: compressed (or auto)"]


def test_each_camera_of_a_rig_by_itself(node, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("cameras:\n  a: {color_topic: /a, camera_info_topic: /ai}\n"
                    "  b: {color_topic: /b, camera_info_topic: /bi, color_transport: raw}\n")
    topics = topics_of(node, rig=str(path))
    node.publishers = {"/a/compressed": 1, "/b/compressed": 1}
    topics.follow_publishers()
    assert set(colors(node)) == {"/a/compressed", "/b"}
    assert len(topics.problems()) == 1


def test_depth_follows_what_is_published_too(node):
    topics = topics_of(node, color_topic="/c", depth_topic="/d")
    assert colors(node) == {"/c": Image, "/d": Image}
    for publishers, expected in (({"/d/compressed": 1}, "/d/compressed"),
                                 ({"/d/compressedDepth": 1, "/d/compressed": 1},
                                  "/d/compressedDepth"), ({"/d": 1}, "/d")):
        node.publishers = publishers
        topics.follow_publishers()
        assert set(colors(node)) == {"/c", expected}
    named = topics_of(Node(), color_topic="/c", depth_topic="/d/compressedDepth")
    assert named.unmatched == ["/c", "/camera/color/camera_info", "/d/compressedDepth", "/tf"]


def test_cameras_that_are_published_where_the_one_that_is_set_is_not_are_named(node):
    topics = topics_of(node)
    assert topics.problems() == []  # nothing is published
    node.publishers = {"/a/color/image_raw": 1, "/a/color/camera_info": 1, "/a/depth/image": 1}
    assert topics.problems() == [
        "/camera/color/image_raw has no publisher; set for the collector {color_topic: "
        "/a/color/image_raw, camera_info_topic: /a/color/camera_info, depth_topic: "
        "/a/depth/image}"]
    node.publishers["/camera/color/image_raw/compressed"] = 1
    assert topics.problems() == []
