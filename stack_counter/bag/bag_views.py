# SPDX-License-Identifier: Apache-2.0
"""Posed views of a bag: what a collector would make of the messages in it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import BagError
from stack_counter.types import View
from stack_counter.views.color_transport import (
    AUTO,
    COMPRESSED,
    RAW,
    published_transports,
    transport_topic,
)
from stack_counter.views.depth_stream import depth_camera_info_topic
from stack_counter.views.rig import Rig, load_rig
from stack_counter.views.rig_assembler import RigAssembler

LABELS_TOPIC = "/camera/labels"
SCALE_TOPIC = "/camera/scale_std"  # relative standard deviation of all lengths in the poses
_TF_TOPICS = ("/tf", "/tf_static")


class BagViews:
    """The posed views of a bag, to be read once.

    Attributes:
        reader: of the bag.
        assembler: of the cameras; its tally counts images received, used and skipped.
        reading_s: time spent so far on reading messages and making views of them, seconds.
    """

    def __init__(self, path: Path, collector: CollectorConfig):
        """Opens the bag and fits the cameras to the topics it has.

        Args:
            path: rosbag2 folder or .mcap file.
            collector: settings of the cameras.

        Raises:
            FileNotFoundError: there is no such path.
            BagError: the bag cannot be read, or has no colour images of these cameras.
            ConfigError: the rig file cannot be used.
        """
        self.reader = BagReader(path)
        self.assembler = RigAssembler(fit_rig_to_bag(load_rig(collector), self.reader.topics),
                                      live=False)
        self.reading_s = 0.0

    def __iter__(self) -> Iterator[tuple[str, View]]:
        """Yields the views with their cameras' names, and adds up the time it takes."""
        views = read_views(self.reader, self.assembler)
        while True:
            begin = time.perf_counter()
            view = next(views, None)
            self.reading_s += time.perf_counter() - begin
            if view is None:
                return
            yield view


def with_scale_of_bag(config: Config, reader: BagReader) -> Config:
    """Settings that know how exact the scale of the poses is, where the bag says so.

    Args:
        config: settings, whose own `scale_std` holds if it is larger.
        reader: of the bag.

    Raises:
        BagError: what the bag says is no share of a length.
    """
    for record in reader.records({SCALE_TOPIC}) if SCALE_TOPIC in reader.topics else ():
        scale_std = float(record.decode().data)
        if not 0 <= scale_std <= 0.3:
            raise BagError(f"{SCALE_TOPIC} is {scale_std}; expected 0 to 0.3, a share of lengths")
        own = config.reconstructor
        return replace(config, reconstructor=replace(own, scale_std=max(own.scale_std, scale_std)))
    return config


def fit_camera_to_bag(config: CollectorConfig, topics: dict[str, tuple[str, int]]
                      ) -> CollectorConfig:
    """Settings of one camera with the topics and transports that a bag has, and no recording.

    Args:
        config: settings of the camera.
        topics: type name and number of messages by topic.

    Raises:
        BagError: the bag has no colour images of the camera.
    """
    compressed = transport_topic(config.color_topic, COMPRESSED)
    if compressed not in topics and config.color_topic not in topics:
        raise BagError(f"no images on {config.color_topic} or {compressed}; the bag has "
                       f"{', '.join(topics) or 'no topics'}")
    labels = config.labels_topic or LABELS_TOPIC
    info = depth_camera_info_topic(config)
    return replace(
        config, color_transport=_recorded_transport(config, topics),
        depth_topic=config.depth_topic if config.depth_topic in topics else "",
        depth_camera_info_topic=info if info in topics else config.depth_camera_info_topic,
        labels_topic=labels if labels in topics else "", record_folder="")


def _recorded_transport(config: CollectorConfig, topics: dict[str, tuple[str, int]]) -> str:
    """How a bag's colour images of a camera come: as is set, if they do, or else as they do."""
    recorded = published_transports(config.color_topic, lambda topic: topic in topics)
    return config.color_transport if config.color_transport in recorded else (recorded or [RAW])[0]


def fit_rig_to_bag(rig: Rig, topics: dict[str, tuple[str, int]]) -> Rig:
    """One camera with the topics and transports that a bag has; a rig file's as it names them.

    Args:
        rig: the cameras.
        topics: type name and number of messages by topic.

    Raises:
        BagError: the bag has no colour images of any camera.
    """
    if len(rig.cameras) == 1:
        camera = rig.cameras[0]
        fitted = fit_camera_to_bag(camera.config, topics)
        return replace(rig, cameras=(replace(camera, config=fitted),))
    rig = replace(rig, cameras=tuple(
        replace(camera, config=replace(camera.config, color_transport=_recorded_transport(
            camera.config, topics))) if camera.config.color_transport == AUTO else camera
        for camera in rig.cameras))
    expected = RigAssembler(rig).color_topics()
    if not set(expected) & set(topics):
        raise BagError(f"no images on {', '.join(expected)}; the bag has "
                       f"{', '.join(topics) or 'no topics'}")
    return rig


def subscribed_topics(assembler: RigAssembler) -> list[str]:
    """Topics that a collector of these cameras subscribes to."""
    return [*assembler.topic_handlers(), *assembler.tf_topics()]


def read_views(reader: BagReader, assembler: RigAssembler) -> Iterator[tuple[str, View]]:
    """Feeds a bag to the cameras' assemblers.

    Yields:
        Camera names and views, of each camera in stamp order.

    Raises:
        BagError: a message does not decode.
    """
    handlers = assembler.topic_handlers()
    for record in reader.records(set(subscribed_topics(assembler))):
        try:
            message = record.decode()
        except Exception as error:  # the decoder's errors are of many classes
            raise BagError(f"a message on {record.topic} does not decode: {error}") from error
        if record.topic in _TF_TOPICS:
            for transform in message.transforms:
                assembler.add_transform(transform, record.topic == "/tf_static")
        for _, handle in handlers.get(record.topic, ()):
            handle(message)
        yield from assembler.poll()
    yield from assembler.flush()
