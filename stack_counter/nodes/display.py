# SPDX-License-Identifier: Apache-2.0
"""Publishes what RViz and Foxglove show of a scan."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from stack_counter.region_counters import RegionCounters
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.markers import joined_mesh, scene_markers, surface_points
from stack_counter.ros.qos import LATCHED_NEWEST
from stack_counter.types import StackVolume, View


@dataclass(frozen=True)
class DisplaySettings:
    """How much time showing may take from counting; all are chosen.

    Attributes:
        period_s: seconds between two publications.
        rest_factor: after a publication of a running scan, the time without one, in multiples of
            what it took: a fifth of the time goes to showing at most.
    """

    period_s: float = 0.5
    rest_factor: float = 4.0


SETTINGS = DisplaySettings()


@dataclass(frozen=True, eq=False)
class Scene:
    """What is shown of a scan.

    Attributes:
        volumes: of the regions that gave one.
        regions: low and high corner (3,) of each region of interest, world, metres.
        views: whose cameras are drawn.
        header: world frame, stamp of the data.
        final: the scan has ended.
    """

    volumes: list[StackVolume]
    regions: list[tuple[np.ndarray, np.ndarray]]
    views: list[View]
    header: Header
    final: bool


class Display:
    """Markers and surface of the scan as it stands.

    Making the messages takes some tenths of a second, and counting comes first: a timer makes
    them, of the newest scene alone, and of a running scan only for subscribers.
    """

    def __init__(self, node: ManagedNode):
        """Advertises the topics of a node that is being set up."""
        self._next: Scene | None = None
        self._rested_at = 0.0
        self._markers = node.advertise(MarkerArray, "markers", LATCHED_NEWEST)
        self._points = node.advertise(PointCloud2, "surface", LATCHED_NEWEST)
        node.add_timer(SETTINGS.period_s, self._publish_next)

    def show_scan(self, stack: RegionCounters, volumes: list[StackVolume], header: Header,
                  final: bool) -> None:
        """Has a scan published soon, in place of what waits.

        Args:
            stack: whose regions and views are drawn.
            volumes: of the regions that gave one.
            header: world frame, stamp of the data.
            final: the scan has ended; it is published at once and without subscribers too.
        """
        self._next = Scene(volumes, stack.regions, stack.views, header, final)

    def _publish_next(self) -> None:
        scene = self._next
        if scene is None:
            return
        begin = time.monotonic()
        if scene.final or begin >= self._rested_at:
            self._next = None
            self._publish(scene)
            self._rested_at = time.monotonic() + SETTINGS.rest_factor * (time.monotonic() - begin)

    def _publish(self, scene: Scene) -> None:
        if scene.final or self._markers.get_subscription_count():
            self._markers.publish(scene_markers(scene.volumes, scene.regions, scene.views,
                                                scene.header))
        if scene.final or self._points.get_subscription_count():
            self._points.publish(surface_points(joined_mesh(scene.volumes), scene.header))
