# SPDX-License-Identifier: Apache-2.0
"""From the recording of an empty container to what is known of it: `container teach`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.replay import measure_scan
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.config import Config
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.container.wall_shapes import BoxWall
from stack_counter.errors import ScanError
from stack_counter.pipeline import StackCounter
from stack_counter.types import StackVolume


@dataclass(frozen=True)
class TeachingSettings:
    """When a container is taken to be empty.

    Attributes:
        max_fill: share of its capacity that an empty container may seem to hold, by noise of the
            fused surface; chosen.
    """

    max_fill: float = 0.02


SETTINGS = TeachingSettings()


def teach_container(path: Path, config: Config, on_view: Callable[[], None] = lambda: None,
                    time_range: TimeRange = WHOLE_BAG) -> TaughtContainer:
    """Measures walls and floor of an empty container from its recording.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: settings; topics are fitted to the bag; an already taught container is not used.
        on_view: called after each view used, for progress.
        time_range: the part of the recording whose images are used.

    Raises:
        BagError: the recording cannot be read, or lacks images.
        ConfigError: the settings do not hold together.
        ScanError: no container, one that is not empty, or too few views.
    """
    stack = StackCounter(replace(config.reconstructor, container="", live=False))
    volume = measure_scan(stack, BagViews(path, config.collector, time_range), on_view)
    return taught_from(volume, f"{date.today()} from {path.resolve().name}")


def taught_from(volume: StackVolume, taught: str) -> TaughtContainer:
    """Takes walls and floor over from the scan of an empty container.

    Args:
        volume: of the scan.
        taught: when it was measured, and from which recording.

    Raises:
        ScanError: no container was found, or it is not empty.
    """
    box, inner = volume.container, volume.inner
    if box.wall_shape is None or inner is None:
        raise ScanError(f"container is '{box.kind}'; expected a box, round or free one in views "
                        "with depth")
    # Refuse a container with something in it: its walls and floor would be measured wrong.
    rim = box.floor_thickness_m + box.inner_size_m[2]
    capacity = float(np.nansum(rim - inner.heights)) * inner.pitch**2
    if volume.stack_volume > SETTINGS.max_fill * capacity:
        raise ScanError(f"the container holds {volume.stack_volume * 1e6:.0f} cm3, "
                        f"{volume.stack_volume / capacity:.1%} of its capacity; expected an empty "
                        f"one, at most {SETTINGS.max_fill:.0%}")
    # A given yaw can only be understood if it is known which side is x: the longer one.
    shape = box.wall_shape
    if isinstance(shape, BoxWall) and shape.params[3] < shape.params[4]:
        shape = BoxWall(shape.params[[0, 1, 2, 4, 3, 5]])
    return TaughtContainer(shape, box.wall_thickness_m, box.floor_thickness_m, rim, taught)
