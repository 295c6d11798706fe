# SPDX-License-Identifier: Apache-2.0
"""The topics of a bag that the settings mean: theirs, those beside them, or those found."""

from dataclasses import replace

import numpy as np
import pytest
from kits.packed_depth import packed, png, rvl
from kits.recording_kit import (
    CAMERA_INFO,
    COLOR,
    COMPRESSED,
    DEPTH,
    IMAGE,
    INFO,
    TF,
    image,
    records,
    scan,
    write,
)

from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.camera_topics import (
    fit_camera_to_bag,
    fit_rig_to_bag,
    missing_depth_line,
    topic_notes,
)
from stack_counter.bag.info import describe_bag
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import BagError
from stack_counter.views.rig import load_rig

DEFAULT = CollectorConfig()


def held(*names):
    """Topics of a bag, their types told from their names."""
    kinds = {"camera_info": CAMERA_INFO, "compressed": COMPRESSED, "compressedDepth": COMPRESSED,
             "tf": TF, "tf_static": TF}
    return {name: (kinds.get(name.rpartition("/")[2], IMAGE), 12) for name in names}


def fitted(*names, config=DEFAULT):
    found = fit_camera_to_bag(config, held(*names))
    return found.color_topic, found.camera_info_topic, found.depth_topic


def notes_on(*names, say=topic_notes, config=DEFAULT):
    rig = fit_rig_to_bag(load_rig(config), held(*names))
    return say(config, rig, held(*names))


def test_topics_of_the_settings_stay():
    assert fitted(COLOR, INFO, DEPTH, "/b/color/image_raw", "/b/color/camera_info",
                  "/b/depth/image") == (COLOR, INFO, DEPTH)


def test_the_one_camera_is_found():
    names = ("/camera/camera/color/image_raw/compressed", "/camera/camera/color/camera_info",
             "/camera/camera/aligned_depth_to_color/image_raw/compressedDepth")
    color, info, depth = fitted(*names)
    assert (color + "/compressed", info, depth) == names
    (line,) = notes_on(*names)
    assert "color_topic: /camera/camera/color/image_raw, " in line and depth in line


def test_what_is_set_is_not_looked_for():
    names = ("/b/color/image_raw", "/b/color/camera_info", "/b/depth/image", "/b/mine")
    named = replace(DEFAULT, depth_topic="/b/mine")
    assert fitted(*names, config=named) == (names[0], names[1], "/b/mine")
    without = replace(DEFAULT, depth_topic="")
    assert fitted(*names, config=without)[2] == ""
    with pytest.raises(BagError, match="no images on /c/image.*color_topic: /b/color/image_raw"):
        fitted(*names, config=replace(DEFAULT, color_topic="/c/image"))


def test_several_cameras_are_listed_to_choose_from():
    names = [f"/{name}/{topic}" for name in "ab"
             for topic in ("color/image_raw", "color/camera_info", "depth/image")]
    with pytest.raises(BagError, match="2 cameras in the bag; expected one") as caught:
        fitted(*names)
    assert "{color_topic: /b/color/image_raw, camera_info_topic: /b/color/camera_info, " \
           "depth_topic: /b/depth/image}" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("names, depth", [
    (["/camera/depth/image_raw", "/camera/depth/camera_info", "/tf_static"],
     "/camera/depth/image_raw"),
    (["/camera/depth/image_raw", "/camera/depth/camera_info"], ""),  # nothing says where it is
    ([DEPTH + "/compressedDepth"], DEPTH + "/compressedDepth"),
    ([DEPTH + "/compressed"], DEPTH + "/compressed"),
    ([DEPTH + "/compressedDepth", DEPTH], DEPTH)])
def test_depth_beside_the_colour_of_the_settings(names, depth):
    assert fitted(COLOR, INFO, *names) == (COLOR, INFO, depth)


@pytest.mark.parametrize("setting, topic, kind, expected", [
    ("depth_topic", "/camera/depth/points", "sensor_msgs/msg/PointCloud2", "CompressedImage"),
    ("camera_info_topic", DEPTH, IMAGE, "CameraInfo"),
    ("labels_topic", "/labels/compressed", COMPRESSED, "Image"),
    ("color_topic", "/h264", "my_msgs/msg/Packet", "Image or CompressedImage"),
    ("pose_topic", "/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", "PoseStamped"),
    ("", "/tf", "my_msgs/msg/Transforms", "TFMessage")])
def test_messages_of_another_type_are_refused(setting, topic, kind, expected):
    config = replace(DEFAULT, **({setting: topic} if setting else {}))
    held_here = {**held(COLOR, INFO, DEPTH), topic: (kind, 12)}
    with pytest.raises(BagError) as caught:
        fit_rig_to_bag(load_rig(config), held_here)
    assert f"{topic} is of type {kind}; expected " in str(caught.value)
    assert expected in str(caught.value) and (setting or "record") in str(caught.value)


def test_depth_that_is_not_there_is_named():
    names = (COLOR, INFO, "/a/range/image", "/tf")
    said = notes_on(*names, say=missing_depth_line)
    assert f"no depth on {DEPTH}" in said and f"/a/range/image ({IMAGE})" in said
    assert "/tf" not in said and notes_on(*names) == []
    none = replace(DEFAULT, depth_topic="")
    assert notes_on(*names, say=missing_depth_line, config=none) == ""


def test_depth_that_is_left_out_is_named():
    names = (COLOR, INFO, "/camera/depth/image_raw", "/camera/depth/camera_info")
    assert notes_on(*names)[0].startswith("depth on /camera/depth/image_raw is left out")
    assert notes_on(*names, config=replace(DEFAULT, depth_topic="")) == []
    assert notes_on(*names, DEPTH) == []


def repacked(pack, suffix, name, **how):
    """Records of a scan whose depth is packed; `how`: of the message."""
    out = []
    for stamp, topic, kind, message in records(scan()):
        if topic == DEPTH:
            pixels = np.frombuffer(message.data, np.uint16).reshape(message.height, -1)
            topic, kind = topic + suffix, COMPRESSED
            message = packed(pack(pixels), name, stamp, **how)
        out.append((stamp, topic, kind, message))
    return out


@pytest.mark.parametrize("pack, suffix, name, config", [
    (png, "/compressedDepth", "16UC1; compressedDepth png", True),
    (rvl, "/compressedDepth", "16UC1; compressedDepth rvl", True),
    (png, "/compressed", "16UC1; png compressed ", False)])
def test_packed_depth_is_the_same_depth(tmp_path, pack, suffix, name, config):
    raw = [view.depth for _, view in BagViews(write(tmp_path / "raw", records(scan())), DEFAULT)]
    bag = BagViews(write(tmp_path / "packed", repacked(pack, suffix, name, config=config)),
                   DEFAULT)
    found = [view.depth for _, view in bag]
    assert len(found) == 6 and np.array_equal(found, raw)
    (note,) = bag.notes
    assert note.startswith(f"topics found in the bag: depth_topic: {DEPTH}{suffix};")


@pytest.mark.parametrize("factor, kind, encoding, scale", [
    (1, np.float32, "32FC1", 0.001), (10, np.uint16, "16UC1", 0.0001)])
def test_the_unit_of_depth_is_set(tmp_path, factor, kind, encoding, scale):
    out = []
    for stamp, topic, message_kind, message in records(scan()):
        if topic == DEPTH:
            pixels = np.frombuffer(message.data, np.uint16).reshape(message.height, -1)
            message = image((pixels * factor).astype(kind), encoding, stamp)
        out.append((stamp, topic, message_kind, message))
    path = write(tmp_path / "bag", out)
    views = [view for _, view in BagViews(path, replace(DEFAULT, depth_scale=scale))]
    assert len(views) == 6
    for view, truth in zip(views, scan()):
        assert view.depth == pytest.approx(np.round(truth.depth, 3), abs=1e-4)
    if kind == np.float32:
        bag = BagViews(path, DEFAULT)
        assert not list(bag) and bag.assembler.tally.skipped == {"wrong_depth_unit": 6}
        (line,) = bag.hints
        assert line.startswith(f"wrong_depth_unit: {DEPTH}: ") and "depth_scale: 0.001" in line


def test_info_says_what_was_found_and_assumed(tmp_path):
    out = []
    for stamp, topic, kind, message in records(scan()):
        if topic == COLOR:
            message = replace(message, encoding="8UC3")
        out.append((stamp, topic.replace("/camera/", "/arm/cam/"), kind, message))
    lines = describe_bag(write(tmp_path / "bag", out), Config())[0].splitlines()
    assert "views    6 usable of 6" in lines
    first, second = [line for line in lines if line.startswith("note ")]
    assert "color_topic: /arm/cam/color/image_raw" in first
    assert "/arm/cam/color/image_raw: '8UC3'" in second and second.endswith("read as BGR")
