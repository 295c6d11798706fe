"""Publishes what RViz and Foxglove show of a scan."""

from __future__ import annotations

import time

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from stack_counter.pipeline import StackCounter
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.markers import scene_markers, surface_points
from stack_counter.ros.qos import LATCHED_NEWEST
from stack_counter.types import StackVolume, View

_PERIOD_S = 0.5
_REST = 4.0  # so many times as long as showing took, a running scan has for counting alone


class Display:
    """Markers and the surface of the scan as it stands.

    Making the messages takes some tenths of a second. Counting comes first: they are made apart
    from it, the newest only, and of a running scan only while somebody looks.
    """

    def __init__(self, node: ManagedNode):
        self._next: tuple | None = None  # arguments of `_publish`, if there are new ones
        self._rested_at = 0.0
        self._markers = node.advertise(MarkerArray, "markers", LATCHED_NEWEST)
        self._points = node.advertise(PointCloud2, "surface", LATCHED_NEWEST)
        node.add_timer(_PERIOD_S, self._publish_newest)

    def show(self, stack: StackCounter, volume: StackVolume | None, header: Header,
             final: bool) -> None:
        """Has it published soon.

        Args:
            stack: whose region and views are drawn.
            volume: None where the scan gave none.
            header: world frame, stamp of the data.
            final: the scan has ended.
        """
        self._next = volume, stack.region, stack.views, header, final

    def _publish_newest(self) -> None:
        if self._next is None:
            return
        *_, final = newest = self._next
        begin = time.monotonic()
        if final or begin >= self._rested_at:
            self._next = None
            self._publish(*newest)
            self._rested_at = time.monotonic() + _REST * (time.monotonic() - begin)

    def _publish(self, volume: StackVolume | None, region: tuple[np.ndarray, np.ndarray] | None,
                 views: list[View], header: Header, final: bool) -> None:
        if final or self._markers.get_subscription_count():
            self._markers.publish(scene_markers(volume, region, views, header))
        if final or self._points.get_subscription_count():
            self._points.publish(surface_points(volume.mesh if volume else None, header))
