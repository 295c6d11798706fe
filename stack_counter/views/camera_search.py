# SPDX-License-Identifier: Apache-2.0
"""Finds the cameras among topics by their types and by what camera drivers call them. No ROS.

The names are those of the drivers whose settings `config/cameras/` holds; where none of them is
there, any image with a calibration beside it is a camera, unless its name says that it is not.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from stack_counter.config import CollectorConfig
from stack_counter.views.color_transport import without_transport

# Colour images below a camera's namespace, the best first.
_COLOR_NAMES = (
    "color/image_raw",  # RealSense, Orbbec
    "color/image_rect_raw",  # RealSense D405
    "color/image_color",  # Zivid
    "rgb/color/rect/image",  # ZED from release 5 on
    "rgb/image_rect_color",  # ZED before
    "rgb/image_raw",  # Azure Kinect, OAK, Kinect
)
# Depth that is aligned to it, the best first.
_ALIGNED_NAMES = (
    "aligned_depth_to_color/image_raw",  # RealSense
    "depth_to_rgb/image_raw",  # Azure Kinect
    "depth/depth_registered",  # ZED
    "depth/image",  # Zivid
    "stereo/image_raw",  # OAK
    "depth_registered/image_raw", "depth_registered/image_rect",  # depth_image_proc
)
# Depth that may be another camera's: it is registered by its calibration and /tf_static.
_DEPTH_NAMES = ("depth/image_raw", "depth/image_rect_raw")  # Orbbec, Azure Kinect; RealSense
# Words in the name of an image that is neither colour nor depth.
_OTHER_WORDS = {"ir", "infra", "infra1", "infra2", "confidence", "disparity", "label", "labels",
                "mask", "snr", "gray", "right", "segmentation", "annotated", "overlay", "theora"}
_SEARCHED = ("color_topic", "camera_info_topic", "depth_topic")


@dataclass(frozen=True)
class FoundCamera:
    """Topics of one camera.

    Attributes:
        color_topic: raw name of its colour images.
        camera_info_topic: their calibration.
        depth_topic: raw name of its depth images; empty: none.
        is_aligned: by its name, depth is aligned to colour.
    """

    color_topic: str
    camera_info_topic: str
    depth_topic: str = ""
    is_aligned: bool = False

    def settings(self) -> dict[str, str]:
        """The collector's settings for this camera."""
        return {name: getattr(self, name) for name in _SEARCHED}


def find_cameras(topics: Mapping[str, str]) -> list[FoundCamera]:
    """Finds cameras with colour and calibration; only those with depth, if there are any.

    Args:
        topics: type name by topic, of topics that are published or recorded.
    """
    images = {without_transport(topic): None for topic, kind in sorted(topics.items())
              if _is_message(kind, "Image") or _is_message(kind, "CompressedImage")}
    infos = {topic for topic, kind in topics.items() if _is_message(kind, "CameraInfo")}
    known = [_camera_of_driver(prefix, list(images), infos) for prefix in
             dict.fromkeys(image[:-len(name)] for name in _COLOR_NAMES for image in images
                           if image.endswith("/" + name))]
    cameras = [camera for camera in known if camera]
    if not any(camera.depth_topic for camera in cameras):
        taken = {camera.color_topic for camera in cameras}
        cameras += [camera for camera in _cameras_of_any_name(list(images), infos)
                    if camera.color_topic not in taken]
    return [camera for camera in cameras if camera.depth_topic] or cameras


def lines_to_paste(cameras: list[FoundCamera]) -> str:
    """The settings of cameras as YAML on one line, to be chosen from."""
    return " or ".join("{" + ", ".join(f"{name}: {value or repr('')}" for name, value in
                                       camera.settings().items()) + "}" for camera in cameras)


def is_unset(config: CollectorConfig, name: str) -> bool:
    """Tells whether a topic has its default name, as where nobody has set it."""
    return getattr(config, name) == getattr(CollectorConfig(), name)


def is_rectified(topic: str) -> bool:
    """Tells whether images are free of distortion, by the name that image_proc gives them."""
    return "rect" in _words("/".join(without_transport(topic).split("/")[-2:]))


def _is_message(kind: str, name: str) -> bool:
    return kind.startswith("sensor_msgs/") and kind.endswith(f"/{name}")


def _camera_of_driver(prefix: str, images: list[str], infos: set[str]) -> FoundCamera | None:
    """The camera below a namespace, by the names of drivers; None without a calibration."""
    color = next(prefix + name for name in _COLOR_NAMES if prefix + name in images)
    info = _info_beside(color, infos)
    names = (*_ALIGNED_NAMES, *_DEPTH_NAMES)
    depth = next((name for name in names if prefix + name in images), "")
    return FoundCamera(color, info, prefix + depth if depth else "",
                       depth in _ALIGNED_NAMES) if info else None


def _cameras_of_any_name(images: list[str], infos: set[str]) -> list[FoundCamera]:
    """A camera for every image that has a calibration and may be colour."""
    depths = [image for image in images if "depth" in _words(image)]
    colors = [image for image in images if not _words(image) & {"depth", *_OTHER_WORDS}]
    cameras = []
    for color in colors:
        if info := _info_beside(color, infos):
            own = [depth for depth in depths if depth.split("/")[1] == color.split("/")[1]]
            candidates = own or (depths if len(colors) == 1 else [])
            cameras.append(FoundCamera(color, info,
                                       candidates[0] if len(candidates) == 1 else ""))
    return cameras


def _info_beside(image: str, infos: set[str]) -> str:
    """Topic of an image's calibration, where image_transport puts it or below; empty: none."""
    places = (f"{image.rpartition('/')[0]}/camera_info", f"{image}/camera_info")
    return next((place for place in places if place in infos), "")


def _words(topic: str) -> set[str]:
    return set(re.split(r"[/_]", topic.lower()))
