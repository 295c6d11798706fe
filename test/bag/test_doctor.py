# SPDX-License-Identifier: Apache-2.0
"""The doctor names what is wrong with a recording, the cause first."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from kits.recording_kit import (
    CAMERA_INFO,
    COLOR,
    DEPTH,
    FRAME,
    IMAGE,
    INFO,
    TF,
    camera_info,
    image,
    records,
    scan,
    tf_record,
    write,
)

from stack_counter.bag.doctor import examine_bag
from stack_counter.config import Config
from stack_counter.geometry import pose
from stack_counter.views.checkup.findings import Severity, advice_lines, cause_first

OWN_DEPTH = "/camera/depth/image_rect_raw"


def messages(views=None):
    return records(list(views or scan()))


def without(topic):
    return [record for record in messages() if record[1] != topic]


def changed(topic, change):
    """Records of which those of a topic are changed: (stamp, topic, kind, message)."""
    return [change(*record) if record[1] == topic else record for record in messages()]


def depth_mm(view):
    return np.round(view.depth * 1000).astype(np.uint16)


def depth_image(make, topic=DEPTH, frame=FRAME, late_ns=0, views=None):
    """A scan whose depth images are of these pixels: `make(view)` gives (pixels, encoding)."""
    out = without(DEPTH)
    for view in views or scan():
        stamp = view.stamp_ns + late_ns
        out.append((stamp, topic, IMAGE, image(*make(view), stamp, frame)))
    return out


def depth_of_own_camera():
    """Depth of another camera of which nothing says where it is."""
    beside = pose(np.eye(3), np.array([0.1, 0, 0]))
    static = tf_record(10**9, beside, "tool", "flange", "/tf_static")
    own = replace(scan()[0].intrinsics, fx=100.0, fy=100.0)
    return [*depth_image(lambda v: (depth_mm(v), "16UC1"), OWN_DEPTH, "camera_depth"), static,
            *((v.stamp_ns, "/camera/depth/camera_info", CAMERA_INFO,
               camera_info(own, v.stamp_ns, "camera_depth")) for v in scan())]


def blurred():
    return messages(replace(view, color=cv2.GaussianBlur(view.color, (0, 0), 12))
                    for view in scan())


def world_named(name):
    out = [record for record in messages() if record[1] != "/tf"]
    return out + [tf_record(view.stamp_ns + late, view.T_world_camera, parent=name)
                  for view in scan() for late in (-2 * 10**7, 0, 2 * 10**7)]


def tf_with_gaps():
    out = [record for record in messages() if record[1] != "/tf"]
    return out + [tf_record(view.stamp_ns - 4 * 10**8, view.T_world_camera) for view in scan()]


def robot_clock_behind():
    out = [record for record in messages() if record[1] != "/tf"]
    return out + [(view.stamp_ns, *tf_record(view.stamp_ns - 5 * 10**9, view.T_world_camera)[1:])
                  for view in scan()]


def transforms_of_no_rotation():
    return changed("/tf", lambda t, topic, kind, m: (t, topic, kind, replace(m, transforms=[
        replace(one, transform=replace(one.transform, rotation=replace(
            one.transform.rotation, x=0.0, y=0.0, z=0.0, w=0.0))) for one in m.transforms])))


def other_encoding():
    return changed(COLOR, lambda t, topic, kind, m: (t, topic, kind, replace(m, encoding="xyz9")))


def two_cameras():
    names = {COLOR: "color/image_raw", INFO: "color/camera_info",
             DEPTH: "aligned_depth_to_color/image_raw"}
    return [(t, f"/{camera}/{names[topic]}" if topic in names else topic, kind, m)
            for camera in ("left", "right") for t, topic, kind, m in messages()
            if camera == "left" or topic != "/tf"]


# Name, records, and what the first line must say.
BROKEN = {
    "no depth": (lambda: without(DEPTH), "no depth on"),
    "depth not aligned": (depth_of_own_camera, "depth_not_aligned"),
    "no transform of the depth camera": (lambda: [r for r in depth_of_own_camera()
                                                  if r[1] != "/tf_static"], "is left out"),
    "float depth in millimetres": (lambda: depth_image(
        lambda v: (depth_mm(v).astype(np.float32), "32FC1")), "depth_scale"),
    "depth in tenths of a millimetre": (lambda: depth_image(
        lambda v: (np.round(v.depth * 10000).astype(np.uint16), "16UC1")), "to 0.0001"),
    "root named differently": (lambda: world_named("world"), "set world_frame to 'world'"),
    "gaps in TF": (tf_with_gaps, "tf_max_gap_s"),
    "a robot whose clock is behind": (robot_clock_behind, "5.0 s ahead of those of /tf"),
    "quaternions of zeros": (transforms_of_no_rotation, f"bad_pose: {FRAME}: quaternion"),
    "no TF": (lambda: without("/tf"), "no_tf"),
    "no camera_info": (lambda: without(INFO), "no_camera_info"),
    "blurred": (blurred, "blurred"),
    "depth late by 50 ms": (lambda: depth_image(lambda v: (depth_mm(v), "16UC1"),
                                                late_ns=5 * 10**7), "unsynchronised"),
    "an encoding that nobody knows": (other_encoding, "bad_encoding"),
    "two cameras": (two_cameras, "2 cameras in the bag"),
    "too few views": (lambda: messages(scan()[:2]), "2 usable views"),
    "empty depth": (lambda: depth_image(lambda v: (0 * depth_mm(v), "16UC1")), "empty_depth"),
    "no images": (lambda: [r for r in messages() if r[2] in (TF, CAMERA_INFO)], "no images on"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_the_cause_comes_first(tmp_path, case):
    make, said = BROKEN[case]
    lines, findings = examine_bag(write(tmp_path / "bag", make()), Config())
    first = cause_first(findings)[0]
    assert (first.severity == Severity.STOPS or case == "blurred") and said in str(first)
    assert len(lines) <= 11


def test_a_bag_cut_short_is_named_first(tmp_path):
    file = next(write(tmp_path / "bag", messages()).glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:file.stat().st_size // 3])
    _, findings = examine_bag(file, Config())
    assert cause_first(findings)[0].text == "the bag is cut short"


def test_a_far_floor_around_the_bin_stops_nothing(tmp_path):
    def half_far(view):
        depth = depth_mm(view)
        depth[:, :depth.shape[1] * 6 // 10] = 5000
        return depth, "16UC1"

    _, (finding,) = examine_bag(write(tmp_path / "bag", depth_image(half_far)), Config())
    assert finding.severity == Severity.HARMS and "farther than 5 m" in finding.text


def test_a_good_bag_has_no_finding(tmp_path):
    lines, findings = examine_bag(write(tmp_path / "bag", messages()), Config())
    assert findings == [] and "nothing to change" in advice_lines(findings)[0]
    text = "\n".join(lines)
    assert "6 usable of 6" in text and "root base_link; base_link > camera_color" in text
    assert "depth near 100% (at most 0.0 ms off)" in text and "16UC1" in text
