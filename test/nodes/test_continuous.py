# SPDX-License-Identifier: Apache-2.0
"""The continuous mode on three real nodes: a count after every pick, none behind."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from stack_counter_msgs.msg import StackCount
from tf2_msgs.msg import TFMessage

from stack_counter.ros.standard_messages import to_camera_info, to_header, to_image, to_pose
from stack_counter.sim import read_scenes, record_fixed_camera, remove_parts

UNSEEN = Path(__file__).parents[2] / "data" / "unseen"


def static_transform(view):
    from geometry_msgs.msg import TransformStamped

    pose = to_pose(view.T_world_camera)
    t = TransformStamped(header=to_header(0, "base_link"), child_frame_id=view.camera)
    for axis in "xyz":
        setattr(t.transform.translation, axis, getattr(pose.position, axis))
    t.transform.rotation = pose.orientation
    return TFMessage(transforms=[t])


def test_a_count_after_every_pick_without_asking(ros):
    scene = next(s for s in read_scenes(UNSEEN, 12) if s.index == 11)
    states = list(remove_parts(scene, 20))[::5]
    random = np.random.default_rng(0)
    # Any colours do: that something has changed is all that they are asked for.
    views = [replace(v, color=random.integers(0, 255, (*v.depth.shape, 3), np.uint8))
             for v in record_fixed_camera(states, color=False)]
    node, qos = ros.node, QoSProfile(depth=10)
    color = node.create_publisher(Image, "/camera/color/image_raw", qos)
    depth = node.create_publisher(Image, "/camera/aligned_depth_to_color/image_raw", qos)
    info = node.create_publisher(CameraInfo, "/camera/color/camera_info", qos)
    static = node.create_publisher(TFMessage, "/tf_static", QoSProfile(
        depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    static.publish(static_transform(views[0]))
    ros.start("collector", mode="continuous", unit_volume_m3=scene.truth.unit_volume)
    ros.start("reconstructor", live=True)
    ros.start("counter", estimator="depth_corrected")
    counts = ros.collect_messages(StackCount, "/stack_counter/running_count")
    ros.wait_for_subscribers(color, depth, info, static)
    for view in views:
        header = to_header(view.stamp_ns, view.camera)
        info.publish(to_camera_info(view.intrinsics, header))
        depth.publish(to_image(np.round(view.depth * 1000).astype(np.uint16), "16UC1", header))
        color.publish(to_image(view.color, "rgb8", header))
        ros.wait(lambda s=view.stamp_ns: counts and counts[-1].header.stamp.sec * 10**9 == s,
                 f"a count of the view at {view.stamp_ns} ns")
    said = [m for m in counts if not m.error]
    assert len(said) == len(views) and not any(m.final for m in said)
    assert [m.views.used for m in said] == [1, 2, 3, 4, 5]
    assert all(m.age > 0 and "one_side" in m.reasons for m in said)
    # Twenty parts fewer: with one estimator all along, V says so.
    fell = said[0].count - said[-1].count
    assert 8 <= fell <= 40, [m.count for m in said]
