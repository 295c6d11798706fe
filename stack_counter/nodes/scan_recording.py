"""What the collector hears, handed to the recorder: scans that can be replayed."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_msgs.msg import TFMessage

from stack_counter import __version__
from stack_counter.bag.recorder import Received, Recorder
from stack_counter.config import CollectorConfig
from stack_counter.nodes.scan_queue import QueuedScan
from stack_counter.types import View
from stack_counter.views import decoding

_KINDS = {kind: f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
          for kind in (CameraInfo, CompressedImage, Image, PoseStamped, TFMessage)}


class ScanRecording:
    """Records scans if a folder is configured; else every call does nothing."""

    def __init__(self) -> None:
        self._recorder: Recorder | None = None
        self._overrun: list[tuple[str, int]] = []

    def configure(self, config: CollectorConfig, warn: Callable[[str], object]) -> None:
        """Begins to remember what the first scan will need.

        Raises:
            ConfigError: as `Recorder`.
        """
        self.close()
        if config.record_folder:
            self._recorder = Recorder(Path(config.record_folder).expanduser(),
                                      config.record_max_mb, warn)

    def tap(self, kind: type, topic: str, callback: Callable[[Any], None]
            ) -> Callable[[Any], None]:
        """The callback of a topic, with the recorder before it where it is one of a scan's."""
        if self._recorder is None or kind not in _KINDS:
            return callback
        take = self._recorder.take

        def tapped(message: Any) -> None:
            # Raw subscriptions would spare the serialisation (0.05 ms for 640x480 in colour), but
            # taking raw messages costs 1.6 ms more than taking others.
            data = serialize_message(message)
            take(Received(topic, _KINDS[kind], data, _stamp_ns(message), time.time_ns()),
                 _key(message, topic))
            callback(message)

        return tapped

    def start(self, scan: QueuedScan) -> None:
        """A scan begins."""
        self._overrun = []
        if self._recorder is not None:
            self._recorder.start({"scan_id": scan.scan_id, "part": scan.part,
                                  "unit_volume_m3": repr(scan.unit_volume),
                                  "version": __version__})

    def overrun(self, view: View) -> None:
        """The scan has no time for a view: replay must not count it either."""
        self._overrun.append((view.camera, view.stamp_ns))

    def stop(self, ended: str) -> None:
        """The scan, if one is open, has ended."""
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


def _key(message: Any, topic: str) -> Hashable:
    """What a later message must have in common to replace this one; None: nothing can."""
    if isinstance(message, CameraInfo):
        return topic
    if isinstance(message, TFMessage) and topic == "/tf_static":
        return topic, frozenset(t.child_frame_id for t in message.transforms)
    return None
