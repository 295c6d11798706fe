# SPDX-License-Identifier: Apache-2.0
"""Takes the messages of cameras and TF, makes views of them, and notes what came."""

from __future__ import annotations

from typing import Any

from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import View
from stack_counter.views import decoding
from stack_counter.views.checkup.pictures import SETTINGS, PictureStatistics
from stack_counter.views.checkup.streams import Stream
from stack_counter.views.checkup.tf_tree import TfTree
from stack_counter.views.color_transport import transport_topic
from stack_counter.views.rig_assembler import RigAssembler


class Checkup:
    """What was said of the cameras of a rig.

    Attributes:
        assembler: of the cameras; its tally says which views would be used.
        streams: of the cameras' topics, by name.
        tf: the frames.
        pictures: figures of some of the pictures, of all cameras together.
        picture_errors: the first error of a depth picture, by its reason.
        first: the first view; None without any.
        last: the last view; None without any.
    """

    def __init__(self, assembler: RigAssembler):
        """Begins without messages. `assembler` is fresh, and not live."""
        self.assembler = assembler
        self._handlers = assembler.topic_handlers()
        self._configs: dict[str, CollectorConfig] = {
            topic: config for config in (camera.config for camera in assembler.rig.cameras)
            for topic in (transport_topic(config.color_topic, config.color_transport),
                          config.depth_topic)}
        self.streams = {topic: Stream(topic, handlers[0][0])
                        for topic, handlers in self._handlers.items()}
        self.tf = TfTree()
        self.pictures = PictureStatistics()
        self.picture_errors: dict[str, ViewError] = {}
        self.first: View | None = None
        self.last: View | None = None
        self._looked_ns: dict[str, int] = {}

    @property
    def topics(self) -> list[str]:
        """Topics whose messages are wanted."""
        return [*self._handlers, *self.assembler.tf_topics()]

    def stream_of(self, content: str) -> Stream | None:
        """The first camera's stream of a content; None where there is none."""
        return next((s for s in self.streams.values() if s.content == content), None)

    def add(self, topic: str, message: Any, size: int, time_ns: int) -> None:
        """Takes a message of `size` bytes that came or was recorded at a time, ns since 1970."""
        if topic in ("/tf", "/tf_static"):
            for transform in message.transforms:
                self.tf.add(transform, topic == "/tf_static", time_ns)
                self.assembler.add_transform(transform, topic == "/tf_static")
        elif topic in self._handlers:
            self.streams[topic].add(message, size, time_ns)
            self._look_at(topic, message)
            for _, handle in self._handlers[topic]:
                handle(message)
        self._keep_ends(self.assembler.poll())

    def finish(self) -> None:
        """Decides the images that wait."""
        self._keep_ends(self.assembler.flush())

    def _keep_ends(self, views: list[tuple[str, View]]) -> None:
        for _, view in views:
            self.first, self.last = self.first or view, view

    def _look_at(self, topic: str, message: Any) -> None:
        """Looks at a picture, if some time has passed since the one before."""
        stream, config = self.streams[topic], self._configs.get(topic)
        stamp = stream.stamps[-1]
        if config is None or abs(stamp - self._looked_ns.get(topic, -2**62)) < SETTINGS.every_ns:
            return
        self._looked_ns[topic] = stamp
        try:
            if stream.content == "color":
                self.pictures.add_color(decoding.color_to_array(message))
            elif stream.content == "depth":
                self.pictures.add_depth(decoding.depth_to_metres(message, config.depth_scale))
        except ViewError as error:
            self.picture_errors.setdefault(error.reason, error.on(topic))
