# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag the settings of the cameras mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError
from stack_counter.views.camera_search import (
    FoundCamera,
    find_cameras,
    is_unset,
    lines_to_paste,
)
from stack_counter.views.color_transport import (
    AUTO,
    COMPRESSED,
    RAW,
    color_topics,
    depth_topics,
    published_transports,
    transport_topic,
)
from stack_counter.views.depth_stream import depth_camera_info_topic
from stack_counter.views.rig import Rig
from stack_counter.views.rig_assembler import RigAssembler

LABELS_TOPIC = "/camera/labels"
# By setting, types of the messages on its topic: the last part of their names.
_IMAGES = ("Image", "CompressedImage")
_TYPES_OF = {"color_topic": _IMAGES, "camera_info_topic": ("CameraInfo",), "depth_topic": _IMAGES,
             "depth_camera_info_topic": ("CameraInfo",), "labels_topic": ("Image",),
             "pose_topic": ("PoseStamped",), "joint_states_topic": ("JointState",)}
# Types of messages that hold poses, or what they follow from; all but the first are not read.
_POSES = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry", "PoseArray",
          "JointState")
# Gives the camera frame that a topic's images name, empty where it is not known.
FrameOf = Callable[[str], str]


def _no_frame(topic: str) -> str:
    """Knows no frame."""
    return ""


def fit_camera_to_bag(config: CollectorConfig, topics: dict[str, tuple[str, int]],
                      frame_of: FrameOf = _no_frame) -> CollectorConfig:
    """Settings of one camera with the topics and transports that a bag has, and no recording.

    Topics that have their default names and are not in the bag are looked for.

    Args:
        config: settings of the camera.
        topics: type name and number of messages by topic.
        frame_of: depth that is found, and is in the frame of colour, needs no /tf_static.

    Raises:
        BagError: the bag has no colour images of the camera, or of several that it may be.
    """
    named, config = config, _find_topics(config, topics, frame_of)
    if not published_transports(config.color_topic, topics.__contains__):
        raise BagError(f"no images on {config.color_topic} or "
                       f"{transport_topic(config.color_topic, COMPRESSED)}; expected "
                       f"colour images: record them, or set color_topic; the bag has "
                       f"{_listed(topics)}{_proposal(topics)}")
    labels = config.labels_topic or LABELS_TOPIC
    depth = _recorded_depth(config, topics)
    info = depth_camera_info_topic(config)
    return replace(
        config, color_transport=_recorded_transport(config, topics), depth_topic=depth,
        depth_camera_info_topic=info if info in topics else named.depth_camera_info_topic,
        labels_topic=labels if labels in topics else "", record_folder="")


def _find_topics(config: CollectorConfig, topics: dict[str, tuple[str, int]], frame_of: FrameOf
                 ) -> CollectorConfig:
    """The settings with the bag's names of topics that have their default name and are not there.

    Raises:
        BagError: more than one camera of the bag may be meant.
    """
    present = {"color_topic": bool(published_transports(config.color_topic, topics.__contains__)),
               "camera_info_topic": config.camera_info_topic in topics,
               "depth_topic": any(topic in topics for topic in depth_topics(config.depth_topic))}
    searched = [name for name in present if not present[name] and is_unset(config, name)]
    if not present["color_topic"] and "color_topic" not in searched:
        return config
    cameras = _cameras_of(topics, frame_of)
    if present["color_topic"]:
        cameras = [camera for camera in cameras if camera.color_topic == config.color_topic]
    if len(cameras) > 1:
        raise BagError(f"no images on {config.color_topic}, and {len(cameras)} cameras in the "
                       f"bag; expected one: set for the collector {lines_to_paste(cameras)}")
    found = cameras[0].settings() if cameras else {}
    changes: dict[str, Any] = {name: found[name] for name in searched if found.get(name)}
    return replace(config, **changes)


def _cameras_of(topics: dict[str, tuple[str, int]], frame_of: FrameOf) -> list[FoundCamera]:
    """The cameras of a bag; without depth that could not be brought into the colour images."""
    cameras = find_cameras(_types(topics))
    return [camera if camera.is_aligned or "/tf_static" in topics
            or _is_of_one_frame(camera, topics, frame_of) else
            replace(camera, depth_topic="") for camera in cameras]


def _is_of_one_frame(camera: FoundCamera, topics: dict[str, tuple[str, int]], frame_of: FrameOf
                     ) -> bool:
    """Whether a camera's depth names the frame that its colour names, as where it is aligned."""
    color, depth = (frame_of(next((name for name in names if name in topics), "")) for names in (
        color_topics(camera.color_topic, AUTO), depth_topics(camera.depth_topic)))
    return color != "" and color == depth


def _listed(topics: dict[str, tuple[str, int]]) -> str:
    """Names the topics of a bag with their types."""
    return ", ".join(f"{topic} ({kind})" for topic, (kind, _) in topics.items()) or "no topics"


def _proposal(topics: dict[str, tuple[str, int]]) -> str:
    """Says which topics may be set instead; "" where there are none."""
    cameras = find_cameras(_types(topics))
    return f"; set for the collector {lines_to_paste(cameras)}" if cameras else ""


def _recorded_transport(config: CollectorConfig, topics: dict[str, tuple[str, int]]) -> str:
    """How a bag's colour images of a camera come: as is set, if they do, or else as most do."""
    recorded = published_transports(config.color_topic, topics.__contains__)
    if config.color_transport in recorded:
        return config.color_transport
    by_topic = {transport_topic(config.color_topic, transport): transport
                for transport in recorded}
    return by_topic.get(_most_recorded(list(by_topic), topics), RAW)


def _recorded_depth(config: CollectorConfig, topics: dict[str, tuple[str, int]]) -> str:
    """The topic by which a bag's depth images of a camera come; empty where there are none."""
    return _most_recorded([topic for topic in depth_topics(config.depth_topic)
                           if topic in topics], topics)


def _most_recorded(names: list[str], topics: dict[str, tuple[str, int]]) -> str:
    """The first of some topics of a bag, if no other has twice as many messages; "" of none.

    A recorder that somebody stops for one of them, or that lacks room, leaves a few of it.
    """
    most = max((topics[name][1] for name in names), default=0)
    return next((name for name in names if 2 * topics[name][1] >= most), "")


def fit_rig_to_bag(rig: Rig, topics: dict[str, tuple[str, int]], frame_of: FrameOf = _no_frame
                   ) -> Rig:
    """One camera with the topics and transports that a bag has; a rig file's as it names them.

    Args:
        rig: the cameras.
        topics: type name and number of messages by topic.
        frame_of: depth that is found, and is in the frame of colour, needs no /tf_static.

    Raises:
        BagError: the bag has no colour images of any camera, or other messages on a topic than
            are expected there.
    """
    fitted = _fit_cameras(rig, topics, frame_of)
    for name, expected in _TYPES_OF.items():
        for topic in (getattr(camera.config, name) for camera in fitted.cameras):
            _check_type(topic, topics, expected, f"set {name}")
    for topic in ("/tf", "/tf_static"):
        _check_type(topic, topics, ("TFMessage",), "record the transforms there")
    return fitted


def _check_type(topic: str, topics: dict[str, tuple[str, int]], expected: tuple[str, ...],
                remedy: str) -> None:
    """Raises BagError: the messages on a topic are of another type."""
    kind = topics.get(topic, (expected[0], 0))[0]
    if kind.rpartition("/")[2] not in expected:
        raise BagError(f"{topic} is of type {kind or 'unknown'}; expected "
                       f"{' or '.join(expected)}: {remedy}")


def _fit_cameras(rig: Rig, topics: dict[str, tuple[str, int]], frame_of: FrameOf) -> Rig:
    """The rig of `fit_rig_to_bag`, unchecked."""
    if len(rig.cameras) == 1:
        camera = rig.cameras[0]
        fitted = fit_camera_to_bag(camera.config, topics, frame_of)
        return replace(rig, cameras=(replace(camera, config=fitted),))
    rig = replace(rig, cameras=tuple(
        replace(camera, config=replace(
            camera.config,
            color_transport=_recorded_transport(camera.config, topics)
            if camera.config.color_transport == AUTO else camera.config.color_transport,
            depth_topic=_recorded_depth(camera.config, topics) or camera.config.depth_topic))
        for camera in rig.cameras))
    expected = RigAssembler(rig).color_topics()
    if not set(expected) & set(topics):
        raise BagError(f"no images on {', '.join(expected)}; expected some: record them, or "
                       f"set color_topic in the rig file; the bag has {_listed(topics)}")
    return rig


def topic_notes(config: CollectorConfig, rig: Rig, topics: dict[str, tuple[str, int]]
                ) -> list[str]:
    """Says what was found in a bag, and which depth in it is left out, a line each.

    Args:
        config: the settings.
        rig: the cameras, fitted to the bag.
        topics: type name and number of messages by topic.
    """
    if config.rig:  # it names its topics
        return []
    fitted = rig.cameras[0].config
    found = [f"{name}: {getattr(fitted, name)}" for name in
             ("color_topic", "camera_info_topic", "depth_topic")
             if getattr(fitted, name) not in ("", getattr(config, name))]
    notes = [f"topics found in the bag: {', '.join(found)}; set the collector's to choose others"
             ] if found else []
    cameras = [camera for camera in find_cameras(_types(topics))
               if camera.color_topic == fitted.color_topic and camera.depth_topic]
    if cameras and config.depth_topic and not fitted.depth_topic:
        notes.append(f"depth on {cameras[0].depth_topic} is left out, no /tf_static says where "
                     "its camera is; set depth_topic to use it")
    return notes


def missing_depth_line(config: CollectorConfig, rig: Rig, topics: dict[str, tuple[str, int]]
                       ) -> str:
    """Names the depth that a bag lacks, and its images; "" where it has or needs none."""
    if config.rig or rig.cameras[0].config.depth_topic or not config.depth_topic:
        return ""
    known = {*RigAssembler(rig).color_topics(), rig.cameras[0].config.labels_topic}
    others = {topic: held for topic, held in topics.items()
              if held[0].rpartition("/")[2] in _IMAGES and topic not in known}
    unread = {topic: held for topic, held in topics.items()
              if held[0].rpartition("/")[2] in ("PointCloud2", "DisparityImage")}
    return f"no depth on {config.depth_topic}; expected depth aligned to colour: " + (
        f"set depth_topic if it is one of {_listed(others)}" if others else
        f"record images of depth, no {_listed(unread)} (depth_image_proc and the camera's driver "
        "make them)" if unread else "record it")


def unread_poses_line(config: CollectorConfig, topics: dict[str, tuple[str, int]]) -> str:
    """Names the poses of a bag without /tf that are not read; "" where there is /tf, or none."""
    if config.pose_source == "topic" or "/tf" in topics or "/tf_static" in topics:
        return ""
    by_type = {name: next((topic for topic, (kind, _) in topics.items()
                           if kind.rpartition("/")[2] == name), "") for name in _POSES}
    if topic := by_type["PoseStamped"]:
        return f"poses on {topic}, no /tf: if they are of the optical frame, set pose_source: " \
               f"topic and pose_topic: {topic}"
    others = [f"{topic} ({name})" for name, topic in by_type.items() if topic]
    return f"no /tf, and {', '.join(others)}; expected poses as /tf or PoseStamped: publish the " \
           "camera's pose so (robot_state_publisher, tf2_ros) and record it" if others else ""


def _types(topics: dict[str, tuple[str, int]]) -> dict[str, str]:
    """The type names of topics."""
    return {topic: kind for topic, (kind, _) in topics.items()}
