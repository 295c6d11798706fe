# SPDX-License-Identifier: Apache-2.0
"""The collector's messages, handed to the recorder: scans that can be replayed."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from tf2_msgs.msg import TFMessage

from stack_counter import __version__
from stack_counter.bag.recorder import Received, Recorder
from stack_counter.config import CollectorConfig
from stack_counter.nodes.scan_queue import QueuedScan
from stack_counter.types import View
from stack_counter.views import decoding

_RECORDED_TYPES = {kind: f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
          for kind in (CameraInfo, CompressedImage, Image, JointState, PoseStamped, TFMessage)}


class ScanRecording:
    """Records scans if a folder is configured; otherwise every call does nothing."""

    def __init__(self) -> None:
        """Makes one that records nothing yet."""
        self._recorder: Recorder | None = None
        self._overrun: list[tuple[str, int]] = []

    def configure(self, config: CollectorConfig, warn: Callable[[str], object]) -> None:
        """Begins to keep what the first scan will need: transforms and calibration.

        Raises:
            ConfigError: the folder cannot be written.
        """
        self.close()
        if config.record_folder:
            self._recorder = Recorder(Path(config.record_folder).expanduser(),
                                      config.record_max_mb, warn)

    def record_before(self, kind: type, topic: str, callback: Callable[[Any], None]
            ) -> Callable[[Any], None]:
        """Returns a topic's callback, with the recorder before it where scans need the topic."""
        if self._recorder is None or kind not in _RECORDED_TYPES:
            return callback
        take = self._recorder.take

        def record_and_call(message: Any) -> None:
            # Raw subscriptions would spare the serialisation (0.05 ms for 640x480 in colour), but
            # taking raw messages costs 1.6 ms more than taking others.
            data = serialize_message(message)
            take(Received(topic, _RECORDED_TYPES[kind], data, _stamp_ns(message), time.time_ns()),
                 _replacement_key(message, topic))
            callback(message)

        return record_and_call

    def start(self, scan: QueuedScan) -> None:
        """Begins the recording of a scan."""
        self._overrun = []
        if self._recorder is not None:
            self._recorder.start({"scan_id": scan.scan_id, "part": scan.part.name,
                                  "unit_volume_m3": repr(scan.part.unit_volume),
                                  "part_size_m": " ".join(map(repr, scan.part.outer_size_m)),
                                  "version": __version__})

    def note_overrun(self, view: View) -> None:
        """Notes a view that the scan had no time for: replay must not count it either."""
        self._overrun.append((view.camera, view.stamp_ns))

    def stop(self, ended: str) -> None:
        """Ends the recording of the open scan, if there is one; `ended` says why it ended."""
        if self._recorder is not None:
            self._recorder.stop(ended, self._overrun)

    def close(self) -> None:
        """Finishes what is open and waits until it is written."""
        if self._recorder is not None:
            self._recorder.close()
            self._recorder = None


def _stamp_ns(message: Any) -> int:
    if isinstance(message, TFMessage):
        stamps = [decoding.stamp_ns(t.header.stamp) for t in message.transforms]
        return max(stamps, default=0)
    return decoding.stamp_ns(message.header.stamp)


def _replacement_key(message: Any, topic: str) -> Hashable:
    """Key that a later message shares if it replaces this one; None where none can."""
    if isinstance(message, CameraInfo):
        return topic
    if isinstance(message, TFMessage) and topic == "/tf_static":
        return topic, frozenset(t.child_frame_id for t in message.transforms)
    return None
