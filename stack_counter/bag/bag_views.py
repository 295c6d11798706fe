# SPDX-License-Identifier: Apache-2.0
"""Posed views of a bag: what a collector would make of the messages in it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from stack_counter.bag.camera_topics import (
    fit_rig_to_bag,
    missing_depth_line,
    topic_notes,
    unread_poses_line,
)
from stack_counter.bag.formats.recording_file import decoding
from stack_counter.bag.reader import BagReader
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import BagError
from stack_counter.types import View
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

SCALE_TOPIC = "/camera/scale_std"  # relative standard deviation of all lengths in the poses
_TF_TOPICS = ("/tf", "/tf_static")


class BagViews:
    """The posed views of a bag, to be read once.

    Attributes:
        reader: of the bag.
        assembler: of the cameras; its tally counts images received, used and skipped.
        reading_s: time spent so far on reading messages and making views of them, seconds.
    """

    def __init__(self, path: Path, collector: CollectorConfig, time_range: TimeRange = WHOLE_BAG):
        """Opens the bag and fits the cameras to the topics it has.

        Args:
            path: rosbag2 folder, or a file of a recording.
            collector: settings of the cameras.
            time_range: the part of the bag whose images are used.

        Raises:
            FileNotFoundError: there is no such path.
            BagError: the bag cannot be read, or has no colour images of these cameras.
            ConfigError: the rig file cannot be used.
        """
        self.reader = BagReader(path, time_range)
        rig = fit_rig_to_bag(load_rig(collector), self.reader.topics, self.reader.frame_of)
        self._topic_notes = topic_notes(collector, rig, self.reader.topics)
        self._missing = [missing_depth_line(collector, rig, self.reader.topics),
                         unread_poses_line(collector, self.reader.topics)]
        self.assembler = RigAssembler(rig, live=False)
        self.reading_s = 0.0

    @property
    def notes(self) -> list[str]:
        """What was found or assumed, a line each, for the person who reads the result."""
        return [*self._topic_notes, *self.assembler.notes]

    @property
    def hints(self) -> list[str]:
        """What may keep the bag from being counted: the notes, and the errors of its images."""
        return [*self.notes, *filter(None, self._missing), *self.assembler.last_errors]

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
        with decoding(record):
            scale_std = float(record.decode().data)
        if not 0 <= scale_std <= 0.3:
            raise BagError(f"{SCALE_TOPIC} is {scale_std}; expected 0 to 0.3, a share of lengths")
        own = config.reconstructor
        return replace(config, reconstructor=replace(own, scale_std=max(own.scale_std, scale_std)))
    return config


def subscribed_topics(assembler: RigAssembler) -> list[str]:
    """Topics that a collector of these cameras subscribes to."""
    return [*assembler.topic_handlers(), *assembler.tf_topics()]


def read_views(reader: BagReader, assembler: RigAssembler) -> Iterator[tuple[str, View]]:
    """Feeds a bag, or the part of it that its reader gives, to the cameras' assemblers.

    Yields:
        Camera names and views, of each camera in stamp order.

    Raises:
        BagError: a message does not decode.
    """
    handlers = assembler.topic_handlers()
    for record in reader.records(set(subscribed_topics(assembler)),
                                 set(assembler.color_topics())):
        with decoding(record):
            message = record.decode()
            if record.topic in _TF_TOPICS:
                for transform in message.transforms:
                    assembler.add_transform(transform, record.topic == "/tf_static")
            for _, handle in handlers.get(record.topic, ()):
                handle(message)
        yield from assembler.poll()
    yield from assembler.flush()
