# SPDX-License-Identifier: Apache-2.0
"""The doctor of the live graph: a best-effort camera, a missing TF and a node that is inactive."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from kits.harness import FRAME, Harness
from kits.recording_kit import COLOR, DEPTH, INFO, scan
from lifecycle_msgs.srv import GetState
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image

from stack_counter.config import Config
from stack_counter.ros.doctor import GraphDoctor
from stack_counter.ros.standard_messages import to_camera_info, to_header, to_image
from stack_counter.views.checkup.findings import cause_first

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def ros(tmp_path):
    harness = Harness(tmp_path)
    yield harness
    harness.close()


def publish_camera(ros):
    """A camera that sends one view again and again, best effort, without any TF."""
    view = scan()[0]
    color, depth = (ros.node.create_publisher(Image, topic, BEST_EFFORT)
                    for topic in (COLOR, DEPTH))
    info = ros.node.create_publisher(CameraInfo, INFO, BEST_EFFORT)
    millimetres = np.round(view.depth * 1000).astype(np.uint16)

    def send():
        header = to_header(ros.node.get_clock().now().nanoseconds, FRAME)
        info.publish(to_camera_info(view.intrinsics, header))
        depth.publish(to_image(millimetres, "16UC1", header))
        color.publish(to_image(view.color, "rgb8", header))

    ros.node.create_timer(0.2, send)


def test_the_live_graph(ros):
    publish_camera(ros)
    ros.start("collector", autostart=False)
    ros.call_until_answered(GetState, "/stack_counter/collector/get_state")
    doctor = GraphDoctor(ros.context)
    try:
        lines, findings = doctor.examine(Config())
    finally:
        doctor.close()
    said = [str(finding) for finding in cause_first(findings)]
    assert "no transform names" in said[0] and "no_tf" in said[0]
    assert any("hears nothing on /camera/color" in line and "set reliable: false" in line
               for line in said)
    assert any("collector is unconfigured" in line for line in said)
    assert any(line.startswith("color") and "160x120 rgb8" in line for line in lines)
    assert any("depth near 100%" in line for line in lines)
    assert "clock" not in " ".join(said)
