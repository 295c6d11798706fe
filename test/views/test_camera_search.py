# SPDX-License-Identifier: Apache-2.0
"""Cameras are found by the types of topics and by what their drivers call them."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from stack_counter.config import CollectorConfig, Config, build_section, load_config
from stack_counter.views.camera_search import find_cameras, is_rectified, lines_to_paste

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, CLOUD = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2"


def typed(text, prefix=""):
    """Types of topics by their names."""
    kinds = {"camera_info": INFO, "compressed": COMPRESSED, "compressedDepth": COMPRESSED,
             "points": CLOUD}
    return {prefix + name: kinds.get(name.rpartition("/")[2], IMAGE) for name in text.split()}


# What a driver publishes -> its colour, calibration and depth.
DRIVERS = {
    "RealSense": (
        "color/image_raw color/image_raw/compressed color/camera_info depth/image_rect_raw "
        "depth/camera_info depth/color/points infra1/image_rect_raw infra1/camera_info "
        "aligned_depth_to_color/image_raw aligned_depth_to_color/image_raw/compressedDepth "
        "aligned_depth_to_color/camera_info",
        "color/image_raw color/camera_info aligned_depth_to_color/image_raw"),
    "RealSense, not aligned": (
        "color/image_raw color/camera_info depth/image_rect_raw depth/camera_info",
        "color/image_raw color/camera_info depth/image_rect_raw"),
    "RealSense D405": (
        "color/image_rect_raw color/camera_info depth/image_rect_raw depth/camera_info "
        "aligned_depth_to_color/image_raw aligned_depth_to_color/camera_info",
        "color/image_rect_raw color/camera_info aligned_depth_to_color/image_raw"),
    "Orbbec": (
        "color/image_raw color/camera_info depth/image_raw depth/camera_info depth/points "
        "ir/image_raw ir/camera_info left_ir/image_raw left_ir/camera_info",
        "color/image_raw color/camera_info depth/image_raw"),
    "Azure Kinect": (
        "rgb/image_raw/compressed rgb/camera_info depth_to_rgb/image_raw depth_to_rgb/camera_info "
        "depth/image_raw depth/camera_info ir/image_raw ir/camera_info rgb_to_depth/image_raw "
        "rgb_to_depth/camera_info",
        "rgb/image_raw rgb/camera_info depth_to_rgb/image_raw"),
    "Zivid": (
        "color/image_color color/camera_info depth/image depth/camera_info snr/image "
        "snr/camera_info", "color/image_color color/camera_info depth/image"),
    "OAK": (
        "rgb/image_raw rgb/image_rect rgb/camera_info stereo/image_raw/compressedDepth "
        "stereo/camera_info left/image_raw left/camera_info",
        "rgb/image_raw rgb/camera_info stereo/image_raw"),
    "ZED 4": (
        "rgb/image_rect_color rgb/camera_info rgb_raw/image_raw_color rgb_raw/camera_info "
        "left/image_rect_color left/camera_info right/image_rect_color right/camera_info "
        "depth/depth_registered depth/camera_info confidence/confidence_map",
        "rgb/image_rect_color rgb/camera_info depth/depth_registered"),
    "ZED 5": (
        "rgb/color/rect/image rgb/color/rect/camera_info rgb/color/rect/image/camera_info "
        "left/color/rect/image left/color/rect/camera_info depth/depth_registered "
        "depth/camera_info", "rgb/color/rect/image rgb/color/rect/camera_info "
                             "depth/depth_registered")}


def topics_of(camera):
    return [camera.color_topic, camera.camera_info_topic, camera.depth_topic]


@pytest.mark.parametrize("prefix", ["/", "/camera/", "/camera/camera/", "/zed/zed_node/"])
@pytest.mark.parametrize("driver", DRIVERS)
def test_the_drivers_cameras_are_found(driver, prefix):
    published, expected = DRIVERS[driver]
    (camera,) = find_cameras(typed(published, prefix))
    assert topics_of(camera) == [prefix + name for name in expected.split()]
    aligned = driver not in ("RealSense, not aligned", "Orbbec")
    assert camera.is_aligned == aligned


@pytest.mark.parametrize("published, expected", [
    ("/usb_cam/image_raw /usb_cam/camera_info",
     ["/usb_cam/image_raw", "/usb_cam/camera_info", ""]),
    ("/cam/image/compressed /cam/camera_info /cam/depth /cam/ir /cam/mask",
     ["/cam/image", "/cam/camera_info", "/cam/depth"]),
    ("/front/image /front/camera_info /range/depth_image",
     ["/front/image", "/front/camera_info", "/range/depth_image"]),
    ("/image /image/camera_info", ["/image", "/image/camera_info", ""])])
def test_a_camera_of_no_known_driver(published, expected):
    (camera,) = find_cameras(typed(published))
    assert topics_of(camera) == expected


@pytest.mark.parametrize("published", [
    "", "/cam/image", "/cam/camera_info", "/cam/depth/image /cam/depth/camera_info",
    "/cam/infra1/image_rect_raw /cam/infra1/camera_info"])
def test_what_is_no_colour_camera(published):
    assert find_cameras(typed(published)) == []


def test_of_several_those_with_depth_are_left():
    left, right = (typed(DRIVERS["Orbbec"][0], f"/{name}/") for name in ("left", "right"))
    webcam = typed("/webcam/image_raw /webcam/camera_info")
    assert len(find_cameras(left | webcam)) == 1
    both = find_cameras(right | webcam | left)
    assert [camera.color_topic for camera in both] == ["/left/color/image_raw",
                                                       "/right/color/image_raw"]
    # What is to be pasted are settings.
    for line, camera in zip(lines_to_paste(both).split(" or "), both):
        config = build_section(CollectorConfig, yaml.safe_load(line))
        assert topics_of(config) == topics_of(camera)


def test_other_types_are_no_images():
    assert find_cameras({"/a/color/image_raw": "my_msgs/msg/Image",
                         "/a/color/camera_info": INFO}) == []


@pytest.mark.parametrize("topic, expected", [
    ("/camera/color/image_raw", False), ("/camera/color/image_rect_color", True),
    ("/camera/color/image_rect_color/compressed", True), ("/kinect2/hd/image_color_rect", True),
    ("/zed/zed_node/rgb/color/rect/image", True), ("/direct/rgb/image", False),
    ("/rect/cam/color/image_raw", False), ("", False)])
def test_rectified_images_are_known_by_name(topic, expected):
    assert is_rectified(topic) == expected


PRESETS = sorted((Path(__file__).parents[2] / "config" / "cameras").glob("*.yaml"))


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_the_settings_of_drivers(path):
    """Each file loads, names a page of the driver, and what is found by itself."""
    lines = path.read_text().splitlines()
    assert any(line.startswith("# https://") for line in lines)
    assert any(line.strip().startswith("reliable: ") and "# " in line for line in lines)
    config = load_config(path)
    assert replace(config, collector=CollectorConfig()) == Config()
    names = topics_of(config.collector)
    (camera,) = find_cameras(typed(" ".join(names)))
    assert topics_of(camera) == names
    assert config.collector.depth_scale in (0, 0.001, 1)


def test_all_drivers_have_settings():
    assert [path.stem for path in PRESETS] == ["azure_kinect", "oak", "orbbec", "realsense", "zed",
                                               "zivid"]
